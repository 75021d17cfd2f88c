"""Fit a sheath to measured data, and say whether to accept the fit."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.calibration.calibration import (
    Calibration,
    CalibrationError,
    MeasuredValue,
    calibrate,
)
from estimator.calibration.identification import (
    FitResult,
    IdentificationError,
    fit_bench,
    fit_blocked_tip,
)
from estimator.fitting import COVERAGE_FACTOR, IntervalEstimate, build_interval
from estimator.law.sheath import Sheath
from estimator.measured_data import MeasuredData, Samples
from estimator.online.estimator import Estimator
from estimator.online.force_error import Score
from estimator.online.tendon_model import TendonModel
from estimator.plausibility import (
    find_channel_faults,
    find_contradiction,
    find_implausible_parameter,
    find_unit_slip,
)
from estimator.signals.spikes import remove_spikes

AXIAL_STIFFNESS = 9000.0  # [N] where the data do not tell EA: the tendon of Phee et al. 2009
ROWS_MIN = 20
LENGTH_MAX = 100.0  # [m]
SMOOTHING_WINDOW = 9  # samples, where the loop's turns are looked for
TIP_TRAVEL_MAX = 0.02  # of the motor's travel: a tip that moves by more is not blocked
SAMPLES_MAX = 200_000  # samples that are fitted; of a longer record every so many
STRUCTURE_MAX = 0.003  # of the peak: residual beyond noise (RMS); above it K is off by 0.6 to 7 %
TURN_SHARE = 0.05  # of the peak: a tension that comes back by so much has turned


class FitError(ValueError):
    """Data that cannot carry a fit; the message says what is missing and what to do."""


@dataclasses.dataclass(frozen=True)
class SheathFit:
    """A sheath fitted to measured data.

    Attributes
    ----------
    model
        The sheath with the noise of the data, as `Estimator` takes it.
    method
        How it was fitted, in words.
    parameters
        By name, with 95 % intervals: "K" [-], "EA" [N] where the data tell it.
    accept
        Whether the law describes the data.
    reason
        One line that justifies `accept`.
    """

    model: TendonModel
    method: str
    parameters: Mapping[str, IntervalEstimate]
    accept: bool
    reason: str

    @property
    def sheath(self) -> Sheath:
        """The fitted sheath."""
        return self.model.sheath

    @property
    def K(self) -> IntervalEstimate:  # noqa: N802 (the paper's symbol)
        """Effective friction of the whole sheath, with its 95 % interval."""
        return self.parameters["K"]

    @property
    def EA(self) -> IntervalEstimate | None:  # noqa: N802 (the paper's symbol)
        """Axial stiffness [N] with its 95 % interval; None where the data do not tell it."""
        return self.parameters.get("EA")


def fit_sheath(data: MeasuredData, length: float = 1.0, *, blocked_tip: bool = False) -> SheathFit:
    """Fit the friction, and the stiffness where the channels allow, of a sheath.

    With a tension measured at the tip, K is fitted by re-simulation of the law (Phee et al. 2009
    with reversals, docs/explanation/theory.md section 3), and EA to the elongation if both ends
    have a displacement. With the tip blocked, K and EA come from one pull-release loop at the
    housing (docs/explanation/theory.md (T6), (T7)).

    Parameters
    ----------
    data : MeasuredData
        At least 20 samples; `distal_tension` is needed unless the tip was blocked.
    length : float
        L [m] of the sheath, above 0 and at most 100. Data tell EA/L only, so EA scales with it.
    blocked_tip : bool
        Whether the tip could not move while the data were measured.

    Raises
    ------
    FitError
        If the data cannot carry a fit.
    """
    if not 0.0 < length <= LENGTH_MAX:
        raise FitError(f"length {length:g}: must be above 0 and at most {LENGTH_MAX:g} m")
    if len(data.time) < ROWS_MIN:
        raise FitError(f"{len(data.time)} samples, a fit needs {ROWS_MIN}")
    clean = remove_spikes(data)
    complete = _drop_missing(clean)
    if len(complete.time) < ROWS_MIN:
        raise FitError(f"{len(complete.time)} samples without spikes, a fit needs {ROWS_MIN}")
    if fault := find_channel_faults(complete):
        raise FitError("; ".join(fault))
    stride = -(-len(complete.time) // SAMPLES_MAX)
    fewer = Samples(*(None if c is None else c[::stride] for c in complete[:5]))  # type: ignore[arg-type]
    try:
        fit = _fit_loop(fewer, length) if blocked_tip else _fit_both_ends(fewer, length)
    except (IdentificationError, CalibrationError) as error:
        slip = "" if blocked_tip or complete.distal_tension is None else _find_unit_slip(fewer)
        raise FitError(slip or str(error)) from error
    if stride > 1:
        fit = dataclasses.replace(fit, method=f"{fit.method}, from one sample in {stride}")
    reason = _find_objection(fit, fewer, clean)
    return dataclasses.replace(fit, accept=False, reason=reason) if reason else fit


def _find_objection(fit: SheathFit, fitted: Samples, data: Samples) -> str:
    """Return why a fit must not be accepted though the law may describe the data; "" if it may.

    `fitted` are the samples it was fitted to, `data` all, without spikes.
    """
    EA = None if fit.EA is None else fit.EA.value
    fault = find_implausible_parameter(fit.K.value, EA, float(fitted.proximal_tension.max()))
    if data.distal_tension is None:
        return fault
    if not fit.accept or find_implausible_parameter(fit.K.value, None, 0.0):
        return _find_unit_slip(fitted, may_be_right=not fault) or fault
    if fault:
        return fault
    error = _compute_error(fit.model, data)
    if error is None:
        return ""
    contradiction = find_contradiction(
        error["rmse_percent"] / 100.0, error["inside_interval"], fitted=True
    )
    return f"{contradiction}, of the estimate in the data it was fitted to" if contradiction else ""


def _find_unit_slip(data: Samples, may_be_right: bool = True) -> str:
    tensions = data.proximal_tension, cast(Array, data.distal_tension)
    return find_unit_slip(*tensions, may_be_right=may_be_right)


def _compute_error(model: TendonModel, data: Samples) -> dict[str, Any] | None:
    """Return the error of the estimate against the measured tension at the tip."""
    estimates, score = Estimator(model).run(data), Score([model])
    columns = (estimates.distal_tension, estimates.low, estimates.high)
    score.add_columns(*columns, cast(Array, data.distal_tension))
    return score.summarise()


def _drop_missing(data: Samples) -> Samples:
    """Return the samples of which no channel is missing."""
    channels = [channel for channel in data[:5] if channel is not None]
    is_complete = np.logical_and.reduce([np.isfinite(channel) for channel in channels])
    return Samples(*(None if c is None else c[is_complete] for c in data[:5]))  # type: ignore[arg-type]


def _fit_loop(data: MeasuredData, length: float) -> SheathFit:
    """Calibrate from one pull-release loop with the tip blocked (T6), (T7)."""
    if data.proximal_displacement is None:
        raise FitError("a fit with the tip blocked needs proximal_displacement_m")
    loop = find_first_loop(data.proximal_tension)
    _require_blocked_tip(data, loop)
    calibration = calibrate(data.proximal_tension[loop], data.proximal_displacement[loop])
    stiffness = calibration.stiffness_per_length
    EA = MeasuredValue(stiffness.value * length, stiffness.uncertainty * length)
    values = {"K": calibration.K, "K by slopes": calibration.K_loop, "EA": EA}
    parameters = {name: _compute_interval(value) for name, value in values.items()}
    model = _build_model(data, parameters["K"], length, EA.value)
    return SheathFit(model, "pull-release loop, tip blocked", parameters, *judge_loop(calibration))


def _require_blocked_tip(data: MeasuredData, loop: slice) -> None:
    """Refuse a loop in which the tip went along, where there is a sensor to tell."""
    if data.distal_displacement is None or data.proximal_displacement is None:
        return
    tip, motor = np.ptp(data.distal_displacement[loop]), np.ptp(data.proximal_displacement[loop])
    if tip > TIP_TRAVEL_MAX * motor:
        raise FitError(
            f"the tip is not blocked: it moved {tip * 1e3:.2f} mm of the motor's "
            f"{motor * 1e3:.2f} mm; fit without blocked_tip where distal_tension_N was measured"
        )


def find_first_loop(tension: Array) -> slice:
    """Return the samples of the highest pull and the release behind it, what follows left out."""
    from scipy.ndimage import median_filter  # here: a command's help needs no scipy

    smooth = median_filter(tension, SMOOTHING_WINDOW, mode="nearest")
    peak = int(np.argmax(smooth))
    turn = TURN_SHARE * smooth[peak]
    after = smooth[peak:]
    pulled_again = np.flatnonzero(after > np.minimum.accumulate(after) + turn)
    end = peak + int(pulled_again[0]) if len(pulled_again) else len(smooth)
    before = smooth[peak::-1]
    released_before = np.flatnonzero(before > np.minimum.accumulate(before) + turn)
    start = peak - int(released_before[0]) if len(released_before) else -1
    bottom = peak + int(np.argmin(smooth[peak:end]))
    foot = start + 1 + int(np.argmin(smooth[start + 1 : peak + 1]))
    return slice(foot, bottom + 1)


def judge_loop(calibration: Calibration) -> tuple[bool, str]:
    """Return whether to accept a loop, and why."""
    if calibration.uniform:
        return (
            True,
            "both methods agree: the curvature is even enough for K and EA to be both right",
        )
    return False, (
        "the methods disagree: the sheath is bent unevenly (then K is right, elongation not, which "
        "is computed for an even bend), friction depends on direction, or the tip gives way"
    )


def _fit_both_ends(data: MeasuredData, length: float) -> SheathFit:
    """Fit K to both tensions, and EA to the elongation where both ends have a displacement."""
    if data.distal_tension is None:
        raise FitError(
            "a fit needs distal_tension_N; without it, and with the tip blocked while measuring, "
            "fit with blocked_tip"
        )
    result = fit_bench(data.proximal_tension, data.distal_tension)
    _require_identifiable(result)
    parameters, EA = dict(result.parameters), AXIAL_STIFFNESS
    if data.proximal_displacement is not None and data.distal_displacement is not None:
        stretch = data.proximal_displacement - data.distal_displacement
        elastic = fit_blocked_tip(data.proximal_tension, stretch, length)
        parameters["EA"] = elastic.parameters["axial_stiffness"]
        EA = parameters["EA"].value
    model = _build_model(data, parameters["K"], length, EA)
    noise = math.hypot(
        noise_treatment.estimate_noise_sigma(data.distal_tension), model.tension_noise
    )
    structure = _compute_excess_rms(result.residuals, noise)
    accept, reason = result.accept, result.reason
    if accept and structure > STRUCTURE_MAX * float(data.distal_tension.max()):
        accept = False
        reason = (
            f"the residual is no noise: {structure:.2g} N of its {result.rmse:.2g} N follow the "
            "motion, so K may be off by more than its interval; run teleop diagnose on this record"
        )
    return SheathFit(model, "symmetric law, by re-simulation", parameters, accept, reason)


def _compute_excess_rms(residuals: Array, noise: float) -> float:
    """Return the RMS [N] of residuals beyond white noise of a standard deviation; 0 if within."""
    power = float(np.mean(residuals**2))
    return math.sqrt(power - noise**2) if power > 2.0 * noise**2 else 0.0


def _require_identifiable(result: FitResult) -> None:
    """Refuse a fit in which the record did not decide K."""
    K = result.parameters["K"]
    if not result.identifiable or not math.isfinite(K.high - K.low):
        raise FitError(result.reason)


def _build_model(data: MeasuredData, K: IntervalEstimate, length: float, EA: float) -> TendonModel:
    """Return the model of a fitted tendon, with the noise of the data."""
    travel = data.proximal_displacement
    model = TendonModel(
        Sheath.uniform(K.value, length, EA),
        tension_noise=noise_treatment.estimate_noise_sigma(data.proximal_tension),
        displacement_noise=0.0 if travel is None else noise_treatment.estimate_noise_sigma(travel),
    )
    error = max(model.friction_error, 0.5 * (K.high - K.low) / K.value)
    return dataclasses.replace(model, friction_error=error)


def _compute_interval(value: MeasuredValue) -> IntervalEstimate:
    """Return a value with its 95 % interval."""
    return build_interval(value.value, COVERAGE_FACTOR * value.uncertainty)
