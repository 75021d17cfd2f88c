"""Identify one tendon from its pulls and releases against its stop: pure functions.

While the joint rests against its stop, motor travel is elongation, and `estimator.calibration`
identifies K, M_pull, M_rel and EA/L from the loop (docs/explanation/theory.md (T6), (T7)). Data
inconsistent with a tendon in a sheath against a stop raise `CalibrationRefused`.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.calibration import calibration as blocked_tip
from estimator.calibration.calibration import CalibrationError
from estimator.calibration.pattern import NO_TAIL, Tail
from estimator.fitting import COVERAGE_FACTOR, MeasuredValue
from estimator.law.sheath import Sheath
from estimator.plausibility import find_implausible_parameter
from estimator.sensing_loop_friction import SensingLoopState, measure_loop_friction
from estimator.structs import view_struct
from slave.calibration.calibration_file import TendonCalibration, ValueWithUncertainty
from slave.calibration.config import KnownSheathConfig
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_run import CalibrationRefused
from slave.calibration.procedure_state import (
    TENDON_NAMES,
    Phase,
    StopContact,
    format_tendon_name,
)
from slave.sheath_section import SectionConfig
from slave.tendon_config import TendonConfig

Rows = NDArray[np.bool_]

# [m] of travel before the contact, from and to: the joint moves freely there
FREE_TRAVEL = 2e-3, 3e-4
# times the low tension; a release that ends above it ended as the joint left its stop
RELEASE_RATIO_MAX = 1.5
STOP_TENSION_RATIO = 1.15  # times the tension at which the joint left its stop
REVERSAL_COUNTS = 2.5  # encoder counts from a reversal
RESOLUTION_MIN, RESOLUTION_MAX = 5e-7, 5e-6  # [m] of a count
PULL_SAMPLES_MIN = 100  # least samples of a first pull to be evaluated


class HysteresisLoop(NamedTuple):
    """Alternating pulls and releases against a stop, the tip at rest."""

    tension: Array  # [N]
    travel: Array  # [m]


class ArmStretches(NamedTuple):
    """The stretches of a tendon between guides of an arm, behind its sheath, while it is pulled."""

    length: tuple[float, ...]  # [m]
    depth: tuple[float, ...]  # friction from the sheath's end to each
    yields: tuple[float, ...]  # by how much the sheath's end moves where a stop yields by 1 m/N
    error: float  # relative standard uncertainty of the friction


class PulledTendon(NamedTuple):
    """One tendon of one joint in a record."""

    record: ProcedureData
    joint: int  # counted from 0
    side: int  # which of its tendons
    in_arm: ArmStretches | None = None

    @property
    def tendon(self) -> int:
        """Its number in the rig."""
        return self.record.joints[self.joint][self.side]

    @property
    def name(self) -> str:
        """What messages call it."""
        return format_tendon_name(self.joint + 1, len(self.record.joints[self.joint]), self.side)

    @property
    def contact(self) -> StopContact:
        """The contact with its stop."""
        return self.record.stops[self.joint][self.side]

    @property
    def tension(self) -> Array:
        """Tension at the housing [N] in the whole record, zero offset removed."""
        return self.record.tension[:, self.tendon] - (self.zero or 0.0)

    @property
    def zero(self) -> float | None:
        """Zero offset of its load cell [N]: the reading while the other tendon was pulled."""
        if len(self.record.joints[self.joint]) == 1:
            return None
        slack = PulledTendon(self.record, self.joint, 1 - self.side).select_rows(
            Phase.RELEASE, Phase.PULL
        )
        return float(np.mean(self.record.tension[slack, self.tendon]))

    @property
    def travel(self) -> Array:
        """Motor travel [m] in the whole record."""
        return self.record.travel[:, self.tendon]

    def select_rows(self, *phases: Phase) -> Rows:
        """Return the mask of samples in which this tendon was pulled in one of these phases."""
        codes = [int(phase) for phase in phases]
        is_side = np.equal(self.record.side[:, self.joint], self.side)
        return np.asarray(is_side & np.isin(self.record.phase[:, self.joint], codes))

    @property
    def dragging(self) -> Rows:
        """Mask of samples in which it drew out the other tendon of its joint."""
        codes = self.record.phase[:, self.joint], self.record.side[:, self.joint]
        return np.asarray((codes[0] == Phase.DRAG) & (codes[1] == 2 + self.side))

    @property
    def first_pull(self) -> Rows:
        """Mask of the samples of the first pull after contact with the stop.

        The stop is detected a little late; contact is where the line of the pull crosses the
        tension of the free joint.
        """
        beyond_contact = self.select_rows(Phase.SEEK) & (self.travel >= self.contact.travel)
        slope = fit_slope(self.tension[beyond_contact], self.travel[beyond_contact]).value
        excess = max(0.0, self.contact.tension - self.free_tension)
        contact_travel = self.contact.travel - slope * excess
        return self.select_rows(Phase.SEEK) & np.greater_equal(self.travel, contact_travel)

    @property
    def free_tension(self) -> float:
        """The tension [N] at which the joint moved just before its stop."""
        ahead = self.contact.travel - self.travel
        rows = self.select_rows(Phase.SEEK) & (ahead < FREE_TRAVEL[0]) & (ahead > FREE_TRAVEL[1])
        return float(np.median(self.tension[rows])) if rows.any() else self.contact.tension


def extract_loops(pulled: PulledTendon, low: float) -> list[HysteresisLoop]:
    """Return the alternating pulls and releases against the stop while the tip rested.

    As one loop, unless a return spring pulled the joint off its stop during the releases: then one
    loop per pull and release, without the samples in which the tip moved. A first pull that met the
    stop near its end is left out with its release.
    """
    of_release = pulled.record.releases[:, pulled.joint]
    count = int(of_release[pulled.select_rows(Phase.RELEASE)].max()) + 1
    pulls = [pulled.select_rows(Phase.PULL) & (of_release == i) for i in range(count)]
    releases = [pulled.select_rows(Phase.RELEASE) & (of_release == i) for i in range(count)]
    pulls[0] = pulled.first_pull
    if pulls[0].sum() < PULL_SAMPLES_MIN:
        pulls, releases = pulls[1:], releases[1:]
    ends = [float(np.median(pulled.tension[release][-5:])) for release in releases]
    if max(ends) <= RELEASE_RATIO_MAX * low:
        return [_build_loop(pulled, pulls, releases)]
    at_stop = pulled.tension > STOP_TENSION_RATIO * max(ends)
    regained = pulled.tension > STOP_TENSION_RATIO * pulled.contact.tension
    return [
        _build_loop(pulled, [pull & regained], [release & at_stop])
        for pull, release in zip(pulls, releases, strict=True)
    ]


def _build_loop(pulled: PulledTendon, pulls: list[Rows], releases: list[Rows]) -> HysteresisLoop:
    """Return the branches in order, without the samples at the reversals.

    There one encoder count corresponds to much tension, and the two branches cannot be separated.
    """
    branches = [branch for pair in zip(pulls, releases, strict=True) for branch in pair]
    rows = np.logical_or.reduce(branches)
    count = _estimate_resolution(pulled.travel[rows])
    for i, (before, after) in enumerate(pairwise(branches)):
        around = np.flatnonzero(before | after)
        ahead = pulled.travel[around] * (1.0 if i % 2 == 0 else -1.0)
        short = ahead.max() - ahead
        first = int(np.argmax(short <= REVERSAL_COUNTS * count))
        last = int(np.flatnonzero(short <= (REVERSAL_COUNTS + 1.0) * count)[-1])
        rows[around[first + 1 : last + 1]] = False
    return HysteresisLoop(pulled.tension[rows], pulled.travel[rows])


def _estimate_resolution(travel: Array) -> float:
    """Return the travel per encoder count [m], or a small value if there is no quantisation."""
    steps = np.diff(np.unique(travel))
    return float(min(max(steps.min(), RESOLUTION_MIN), RESOLUTION_MAX))


def fit_slope(T: Array, q: Array) -> MeasuredValue:
    """Return dq/dT [m/N] from tension and travel by least squares."""
    (slope, _), covariance = np.polyfit(T, q, 1, cov=True)
    return MeasuredValue(float(slope), math.sqrt(float(covariance[0, 0])))


# --- the parameters of the tendon


# of the rise of tension after contact: from there on the tip rests at the stop
REST_TENSION_SHARE = 0.15
SIGNIFICANCE = 3.0  # standard uncertainties
CURVATURE_MAX = 0.06  # allowed relative difference of the slopes of the two halves of a pull
COMPLIANCE_EXCESS_MAX = 0.15  # of the known L/EA: allowed excess of the measured compliance
RESOLUTION_MARGIN = 0.2  # relative distance of K to the end of the range that the loop can resolve
OFFSET_WARNING = 0.1  # [N] allowed zero offset of a load cell
OFFSET_MAX = 0.15  # [N] zero offset above which a small tension cannot be controlled
RELATIVE_ERROR_MIN = 0.02  # relative error of K, the least that the estimator's interval allows for
QUICK_RELEASES = 2  # in the quick procedure, including the one after the first pull
DIGITS = 6


def calibrate_tendon(
    pulled: PulledTendon, sheath: KnownSheathConfig, low: float
) -> blocked_tip.Calibration:
    """Identify one tendon from its pulls and releases down to `low` [N].

    `CalibrationRefused` if the data are not those of a tendon in a sheath against an end stop.
    """
    zero = pulled.zero
    if zero is not None and abs(zero) > OFFSET_MAX:
        raise CalibrationRefused(
            f"{pulled.name}: the load cell reads {zero:.2f} N while the tendon is slack; tare it"
        )
    _require_straight_pull(pulled, sheath)
    calibration = _fit_loops(pulled, sheath, low)
    EA = calibration.stiffness_per_length.value * sheath.length
    if fault := find_implausible_parameter(calibration.K.value, EA, calibration.T_peak.value):
        raise CalibrationRefused(f"{pulled.name}: {fault}")
    if sheath.axial_stiffness is not None:
        _require_stiff_loop(
            pulled, calibration, sheath.length / sheath.axial_stiffness, sheath.stiffness_error
        )
    return calibration


def build_tendon_calibration(
    pulled: PulledTendon,
    sheath: KnownSheathConfig,
    calibration: blocked_tip.Calibration,
    remark: str = "",
) -> tuple[TendonCalibration, TendonConfig]:
    """Return the file entry and the estimator parameters of a tendon.

    `remark` is a note from an earlier step.
    """
    zero = pulled.zero
    remarks = [remark, _describe_disagreement(calibration, sheath)]
    if zero is not None and abs(zero) > OFFSET_WARNING:
        remarks.append(f"its load cell reads {zero:.2f} N while it is slack: tare it")
    first = _select_beyond_contact(pulled)
    unstretched = pulled.travel[first] - calibration.M_pull.value * pulled.tension[first]
    direction = TendonCalibration(
        joint=pulled.joint + 1,
        tendon=TENDON_NAMES[pulled.side],
        K=_to_value(calibration.K),
        K_slopes=_to_value(calibration.K_loop),
        K_paper=calibration.K_paper and _to_value(calibration.K_paper),
        K_paper_ratio=calibration.K_paper_ratio and _to_value(calibration.K_paper_ratio),
        M_pull=_to_value(calibration.M_pull),
        M_rel=_to_value(calibration.M_rel),
        stiffness_per_length=_to_value(calibration.stiffness_per_length),
        uniform=calibration.uniform,
        stop=round_significant(float(np.mean(unstretched))),
        free_tension=round_significant(pulled.free_tension),
        zero=None if zero is None else round_significant(zero),
        remark="; ".join(filter(None, remarks)),
    )
    return direction, _build_tendon_config(pulled, calibration, sheath)


def _build_tendon_config(
    pulled: PulledTendon, calibration: blocked_tip.Calibration, sheath: KnownSheathConfig
) -> TendonConfig:
    """Return the estimator parameters; several sections if the curvature is uneven."""
    model = calibration.build_sheath(sheath.length)
    in_arm = () if pulled.in_arm is None else (SectionConfig(math.fsum(pulled.in_arm.length)),)
    is_uniform = len(model.sections) == 1 and not in_arm
    moving = pulled.select_rows(Phase.PULL, Phase.RELEASE)
    return TendonConfig(
        effective_friction=round_significant(calibration.K.value) if is_uniform else None,
        length=sheath.length,
        friction=None if is_uniform else model.friction,
        sections=() if is_uniform else _scale_sections(model, calibration.K.value) + in_arm,
        axial_stiffness=round_significant(model.axial_stiffness),
        tension_noise=round_significant(
            noise_treatment.estimate_noise_sigma(pulled.tension[moving])
        ),
        displacement_noise=round_significant(
            noise_treatment.estimate_noise_sigma(pulled.travel[moving])
        ),
        friction_error=round_significant(
            max(
                RELATIVE_ERROR_MIN,
                COVERAGE_FACTOR * calibration.K.uncertainty / calibration.K.value,
            )
        ),
        loop_friction=_measure_loop(pulled.record, pulled.tendon),
    )


def _measure_loop(record: ProcedureData, tendon: int) -> float:
    """Return the friction of its sensing loop, the median reading; 0 without one."""
    if record.loop_tension is None:
        return 0.0
    state, dt = view_struct(SensingLoopState.array()), np.diff(record.time, prepend=record.time[0])
    moved, held = record.loop_tension[:, :, tendon]
    rows = zip(moved, held, dt, strict=True)
    readings = np.array([measure_loop_friction(state, *row) for row in rows])
    finite = readings[np.isfinite(readings)]
    return round_significant(float(np.median(finite))) if len(finite) else 0.0


def _scale_sections(model: Sheath, K: float) -> tuple[SectionConfig, ...]:
    """Return the sections of a model, bends scaled to the identified K."""
    scale = model.K / K
    return tuple(
        SectionConfig(round_significant(section.length), round_significant(section.radius * scale))
        for section in model.sections
    )


def _fit_loops(
    pulled: PulledTendon, sheath: KnownSheathConfig, low: float
) -> blocked_tip.Calibration:
    loops = extract_loops(pulled, low)
    is_full = int(pulled.record.releases[:, pulled.joint].max()) > QUICK_RELEASES
    tail = NO_TAIL
    if pulled.in_arm is not None:
        length, depth, yields, error = pulled.in_arm
        tail = Tail(tuple(part / sheath.length for part in length), depth, yields, error)
    try:
        calibrations = [
            blocked_tip.calibrate(
                loop.tension,
                loop.travel,
                axial_stiffness=sheath.axial_stiffness,
                length=None if sheath.axial_stiffness is None else sheath.length,
                stiffness_uncertainty=sheath.stiffness_error,
                tail=tail,
            )
            for loop in loops
        ]
    except CalibrationError as error:
        is_single = len(pulled.record.joints[pulled.joint]) == 1
        other = "the spring holds it there" if is_single else "the other tendon is not jammed"
        raise CalibrationRefused(
            f"{pulled.name}: {error}; check that the joint rests against its stop, that the tip "
            f"does not press on something soft, and that {other}"
        ) from error
    best, loop = min(zip(calibrations, loops, strict=True), key=lambda pair: pair[0].K.uncertainty)
    lowest = max(float(np.quantile(loop.tension, 0.01)), 1e-3 * best.T_peak.value)
    reach = 0.5 * math.log(best.T_peak.value / lowest)
    if best.K.value > reach - RESOLUTION_MARGIN:
        remedy = "" if is_full else ", or run the full procedure"
        raise CalibrationRefused(
            f"{pulled.name}: K = {best.K.value:.2f} is at the limit of what a loop from "
            f"{best.T_peak.value:.1f} N to {lowest:.2f} N resolves ({reach:.2f}) and may be "
            "higher; check that the tendon is not jammed, raise slave.initialise.tension, lower "
            f"slave.initialise.low{remedy}"
        )
    return best


def _select_beyond_contact(pulled: PulledTendon) -> Rows:
    """Return the first pull without its beginning, where the joint may still have moved."""
    top = float(pulled.tension[pulled.first_pull].max())
    least = pulled.contact.tension + REST_TENSION_SHARE * (top - pulled.contact.tension)
    return pulled.first_pull & (pulled.tension > least)


def _require_straight_pull(pulled: PulledTendon, sheath: KnownSheathConfig) -> None:
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
    m = slope.value * (sheath.axial_stiffness or 0.0) / sheath.length
    if m >= 1.0:
        raise CalibrationRefused(
            f"{pulled.name}: M_pull EA/L is {m:.2f}, must be below 1: the tip yields, as against "
            "something soft, or length and axial_stiffness of slave.initialise.sheaths are wrong"
        )


def _require_stiff_loop(
    pulled: PulledTendon, calibration: blocked_tip.Calibration, compliance: float, error: float
) -> None:
    """Refuse a loop softer than the frictionless tendon, L/EA `compliance` in m/N."""
    stiffness = calibration.stiffness_per_length
    doubt = SIGNIFICANCE * math.hypot(stiffness.uncertainty / stiffness.value, error)
    if 1.0 / stiffness.value > compliance * (1.0 + COMPLIANCE_EXCESS_MAX + doubt):
        raise CalibrationRefused(
            f"{pulled.name}: the measured compliance is {1e3 / stiffness.value:.3f} mm/N "
            f"without friction, L/EA is {compliance * 1e3:.3f} mm/N: the tip yields, as against "
            "something soft, or length and axial_stiffness of slave.initialise.sheaths are wrong"
        )


def _describe_disagreement(calibration: blocked_tip.Calibration, sheath: KnownSheathConfig) -> str:
    """Return a remark if the methods for K disagree, else an empty text."""
    if calibration.agree:
        return ""
    K, paper = calibration.K.value, calibration.K_paper
    if not calibration.uniform:
        what = f"the sheath is bent unevenly: K = {K:.3f}, by the whole loop, stands"
    else:
        what = (
            f"EA/L is {calibration.stiffness_per_length.value * 1e-3:.3f} N/mm by the loop, "
            f"{(sheath.axial_stiffness or 0.0) / sheath.length * 1e-3:.3f} N/mm as it was known"
        )
    by, other = ("the paper's", paper) if paper is not None else ("the slopes'", calibration.K_loop)
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
