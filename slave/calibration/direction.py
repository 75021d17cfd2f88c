"""Identify one tendon from its pulls and releases against its stop: pure functions.

While the joint rests against its stop, motor travel is elongation, and `estimator.calibration`
identifies K, M_pull, M_rel and EA/L from the loop (docs/theory.md (T6), (T7)). Data inconsistent
with a tendon in a sheath against a stop raise `CalibrationRefused`.
"""

import math

import numpy as np

from estimator import signals
from estimator.calibration import calibration as blocked_tip
from estimator.calibration.calibration import CalibrationError, MeasuredValue
from estimator.law.sheath import Sheath
from estimator.plausibility import find_implausible_parameter
from slave.calibration import refusals
from slave.calibration.config import KnownSheathConfig
from slave.calibration.file import TendonCalibration, ValueWithUncertainty
from slave.calibration.procedure_state import Phase
from slave.calibration.pulled import PulledTendon, Rows, extract_loops, fit_slope
from slave.calibration.refusals import TENDON_NAMES
from slave.calibration.run import CalibrationRefused
from slave.rigs.simulated.plant.tendon import SectionConfig
from slave.tendon_config import TendonConfig

# of the rise of tension after contact: from there on the tip rests at the stop
REST_TENSION_SHARE = 0.15
SIGNIFICANCE = 3.0  # standard uncertainties
CURVATURE_MAX = 0.06  # allowed relative difference of the slopes of the two halves of a pull
COMPLIANCE_EXCESS_MAX = 0.15  # of the known L/EA: allowed excess of the measured compliance
RESOLUTION_MARGIN = 0.2  # relative distance of K to the end of the range that the loop can resolve
OFFSET_WARNING = 0.1  # [N] allowed zero offset of a load cell
OFFSET_MAX = 0.15  # [N] zero offset above which a small tension cannot be controlled
COVERAGE_FACTOR = 1.96  # standard uncertainties on each side of 95 %
RELATIVE_ERROR_MIN = 0.02  # relative error of K, the least that the estimator's interval allows for
QUICK_RELEASES = 2  # in the quick procedure, including the one after the first pull
DIGITS = 6


def calibrate_tendon(
    pulled: PulledTendon, known: KnownSheathConfig, low: float
) -> blocked_tip.Calibration:
    """Identify one tendon from its pulls and releases down to `low` [N].

    Raises
    ------
    CalibrationRefused
        If the data are not those of a tendon in a sheath against an end stop.
    """
    zero = pulled.zero
    if zero is not None and abs(zero) > OFFSET_MAX:
        raise CalibrationRefused(
            f"{pulled.name}: the load cell reads {zero:.2f} N while the tendon is slack; tare it"
        )
    _require_straight_pull(pulled, known)
    found = _fit_loops(pulled, known, low)
    EA = found.stiffness_per_length.value * known.length
    if wrong := find_implausible_parameter(found.K.value, EA, found.T_peak.value):
        raise CalibrationRefused(f"{pulled.name}: {wrong}")
    if known.axial_stiffness is not None:
        _require_stiff_loop(
            pulled, found, known.length / known.axial_stiffness, known.stiffness_error
        )
    return found


def build_tendon_calibration(
    pulled: PulledTendon, known: KnownSheathConfig, found: blocked_tip.Calibration, remark: str = ""
) -> tuple[TendonCalibration, TendonConfig]:
    """Return the file entry and the estimator parameters of a tendon.

    `remark` is a note from an earlier step.
    """
    zero = pulled.zero
    remarks = [remark, _describe_disagreement(found, known)]
    if zero is not None and abs(zero) > OFFSET_WARNING:
        remarks.append(f"its load cell reads {zero:.2f} N while it is slack: tare it")
    first = _select_beyond_contact(pulled)
    unstretched = pulled.travel[first] - found.M_pull.value * pulled.tension[first]
    direction = TendonCalibration(
        joint=pulled.joint + 1,
        tendon=TENDON_NAMES[pulled.side],
        K=_to_value(found.K),
        K_slopes=_to_value(found.K_loop),
        K_paper=found.K_paper and _to_value(found.K_paper),
        K_paper_ratio=found.K_paper_ratio and _to_value(found.K_paper_ratio),
        M_pull=_to_value(found.M_pull),
        M_rel=_to_value(found.M_rel),
        stiffness_per_length=_to_value(found.stiffness_per_length),
        uniform=found.uniform,
        stop=round_significant(float(np.mean(unstretched))),
        free_tension=round_significant(pulled.free_tension),
        zero=None if zero is None else round_significant(zero),
        remark="; ".join(filter(None, remarks)),
    )
    return direction, _build_tendon_config(pulled, found, known)


def _build_tendon_config(
    pulled: PulledTendon, found: blocked_tip.Calibration, known: KnownSheathConfig
) -> TendonConfig:
    """Return the estimator parameters; several sections if the curvature is uneven."""
    model = found.sheath(known.length)
    even = len(model.sections) == 1
    moving = pulled.rows(Phase.PULL, Phase.RELEASE)
    return TendonConfig(
        effective_friction=round_significant(found.K.value) if even else None,
        length=known.length,
        friction=None if even else model.friction,
        sections=() if even else _scale_sections(model, found.K.value),
        axial_stiffness=round_significant(model.axial_stiffness),
        tension_noise=round_significant(signals.noise_sigma(pulled.tension[moving])),
        displacement_noise=round_significant(signals.noise_sigma(pulled.travel[moving])),
        friction_error=round_significant(
            max(RELATIVE_ERROR_MIN, COVERAGE_FACTOR * found.K.uncertainty / found.K.value)
        ),
    )


def _scale_sections(model: Sheath, K: float) -> tuple[SectionConfig, ...]:
    """Return the sections of a model, bends scaled to the identified K."""
    scale = model.K / K
    return tuple(
        SectionConfig(round_significant(section.length), round_significant(section.radius * scale))
        for section in model.sections
    )


def _fit_loops(
    pulled: PulledTendon, known: KnownSheathConfig, low: float
) -> blocked_tip.Calibration:
    there = extract_loops(pulled, low)
    again = int(pulled.record.releases[:, pulled.joint].max()) > QUICK_RELEASES
    try:
        found = [
            blocked_tip.calibrate(
                loop.tension,
                loop.travel,
                axial_stiffness=known.axial_stiffness,
                length=None if known.axial_stiffness is None else known.length,
                stiffness_uncertainty=known.stiffness_error,
            )
            for loop in there
        ]
    except CalibrationError as error:
        raise CalibrationRefused(refusals.format_no_loop(pulled.name, str(error))) from error
    best, loop = min(zip(found, there, strict=True), key=lambda one: one[0].K.uncertainty)
    lowest = max(float(np.quantile(loop.tension, 0.01)), 1e-3 * best.T_peak.value)
    reach = 0.5 * math.log(best.T_peak.value / lowest)
    if best.K.value > reach - RESOLUTION_MARGIN:
        raise CalibrationRefused(
            refusals.format_unresolved_friction(
                pulled.name, best.K.value, best.T_peak.value, lowest, reach, again
            )
        )
    return best


def _select_beyond_contact(pulled: PulledTendon) -> Rows:
    """Return the first pull without its beginning, where the joint may still have moved."""
    top = float(pulled.tension[pulled.first_pull].max())
    least = pulled.contact.tension + REST_TENSION_SHARE * (top - pulled.contact.tension)
    return pulled.first_pull & (pulled.tension > least)


def _require_straight_pull(pulled: PulledTendon, known: KnownSheathConfig) -> None:
    """Refuse a pull that is curved, or softer than a tendon without friction.

    Tissue grows stiffer as it is pressed, a tendon does not; and m = M_pull EA/L is below 1.
    """
    rows = _select_beyond_contact(pulled)
    T, q = pulled.tension[rows], pulled.travel[rows]
    middle = 0.5 * (T.min() + T.max())
    halves = [fit_slope(T[half], q[half]) for half in (middle > T, middle <= T)]
    change = halves[1].value - halves[0].value
    doubt = SIGNIFICANCE * math.hypot(halves[0].uncertainty, halves[1].uncertainty)
    if abs(change) > CURVATURE_MAX * abs(halves[1].value) + doubt:
        first, second = (half.value * 1e3 for half in halves)
        raise CalibrationRefused(
            f"{pulled.name}: the pull against the stop is not straight ({first:.3f} mm/N, then "
            f"{second:.3f} mm/N): the tip presses on something soft, or the sheath moves; free "
            "the tip and fix the sheath"
        )
    slope = fit_slope(T, q)
    m = slope.value * (known.axial_stiffness or 0.0) / known.length
    if m >= 1.0:
        raise CalibrationRefused(
            f"{pulled.name}: M_pull EA/L is {m:.2f}, must be below 1: the tip yields, as against "
            "something soft, or length and axial_stiffness of slave.initialise.sheaths are wrong"
        )


def _require_stiff_loop(
    pulled: PulledTendon, found: blocked_tip.Calibration, known: float, error: float
) -> None:
    """Refuse a loop softer than the frictionless tendon, L/EA `known` in m/N."""
    stiffness = found.stiffness_per_length
    doubt = SIGNIFICANCE * math.hypot(stiffness.uncertainty / stiffness.value, error)
    if 1.0 / stiffness.value > known * (1.0 + COMPLIANCE_EXCESS_MAX + doubt):
        raise CalibrationRefused(
            f"{pulled.name}: the measured compliance is {1e3 / stiffness.value:.3f} mm/N "
            f"without friction, L/EA is {known * 1e3:.3f} mm/N: the tip yields, as against "
            "something soft, or length and axial_stiffness of slave.initialise.sheaths are wrong"
        )


def _describe_disagreement(found: blocked_tip.Calibration, known: KnownSheathConfig) -> str:
    """Return a remark if the methods for K disagree, else an empty text."""
    if found.agree:
        return ""
    K, paper = found.K.value, found.K_paper
    if not found.uniform:
        what = f"the sheath is bent unevenly: K = {K:.3f}, by the whole loop, stands"
    else:
        what = (
            f"EA/L is {found.stiffness_per_length.value * 1e-3:.3f} N/mm by the loop, "
            f"{(known.axial_stiffness or 0.0) / known.length * 1e-3:.3f} N/mm as it was known"
        )
    by, other = ("the paper's", paper) if paper is not None else ("the slopes'", found.K_loop)
    share = math.expm1(K - other.value)
    return (
        f"{what}; with {by} K ({other.value:.3f}) T_out would be {abs(share):.0%} too "
        f"{'low' if share < 0.0 else 'high'} while pulling"
    )


def _to_value(measured: MeasuredValue) -> ValueWithUncertainty:
    return ValueWithUncertainty(
        round_significant(measured.value), round_significant(measured.uncertainty)
    )


def round_significant(value: float) -> float:
    """Return a number rounded to `DIGITS` significant digits."""
    return float(f"{value:.{DIGITS}g}")
