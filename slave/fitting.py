"""A model of a tendon fitted to measured data, and whether to believe it."""

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from estimator import signals
from estimator.calibration import Calibration, CalibrationError, Measured, calibrate
from estimator.identification import (
    FitResult,
    IdentificationError,
    Parameter,
    fit_bench,
    fit_blocked_tip,
)
from slave.table import MeasuredTable
from slave.tendon_config import TendonConfig
from teleop.errors import UsageError

COVER = 1.96  # standard uncertainties on each side of 95 %
LEAST_ROWS = 20
LONGEST = 100.0  # [m]
SMOOTHED = 9  # samples, where the loop's turns are looked for
GIVES_WAY = 0.02  # of the motor's travel: a tip that moves by more is not blocked
TURN = 0.05  # of the peak: a tension that comes back by so much has turned


class Fit(NamedTuple):
    """A fitted model and what is to be said of it."""

    tendon: TendonConfig
    method: str
    parameters: Mapping[str, Parameter]  # with 95 % intervals
    believe: bool
    reason: str


def fit(table: MeasuredTable, blocked_tip: bool, length: float) -> Fit:
    """Fit what the channels of `table` allow; `length` [m] is that of the sheath.

    Raises
    ------
    UsageError
        If the data cannot carry a fit; the message says what is missing.
    """
    if not 0.0 < length <= LONGEST:
        raise UsageError(f"--length {length:g}: must be above 0 and at most {LONGEST:g} m")
    if len(table.time) < LEAST_ROWS:
        raise UsageError(f"{table.path}: {len(table.time)} rows, a fit needs {LEAST_ROWS}")
    travel = table.proximal_displacement
    base = TendonConfig(
        effective_friction=1.0,
        length=length,
        tension_noise=signals.noise_sigma(table.proximal_tension),
        displacement_noise=0.0 if travel is None else signals.noise_sigma(travel),
    )
    try:
        return from_loop(table, base) if blocked_tip else from_bench(table, base)
    except (IdentificationError, CalibrationError) as error:
        raise UsageError(f"{table.path}: {error}") from error


def from_loop(table: MeasuredTable, base: TendonConfig) -> Fit:
    """Calibrate from one pull-release loop with the tip blocked (docs/theory.md (T6), (T7))."""
    if table.proximal_displacement is None:
        raise UsageError(f"{table.path}: --blocked-tip needs proximal_displacement_m")
    loop = first_loop(table.proximal_tension)
    require_blocked(table, loop)
    found = calibrate(table.proximal_tension[loop], table.proximal_displacement[loop])
    stiffness = found.stiffness_per_length
    EA = Measured(stiffness.value * base.length, stiffness.uncertainty * base.length)
    tendon = with_friction(base, interval(found.K), EA.value)
    values = {"K": found.K, "K by slopes": found.K_loop, "EA": EA}
    parameters = {name: interval(value) for name, value in values.items()}
    return Fit(tendon, "pull-release loop, tip blocked", parameters, *loop_verdict(found))


def require_blocked(table: MeasuredTable, loop: slice) -> None:
    """Refuse a loop in which the tip went along, where there is a sensor to tell."""
    if table.distal_displacement is None or table.proximal_displacement is None:
        return
    tip, motor = np.ptp(table.distal_displacement[loop]), np.ptp(table.proximal_displacement[loop])
    if tip > GIVES_WAY * motor:
        raise UsageError(
            f"{table.path}: --blocked-tip, but the tip moved {tip * 1e3:.2f} mm of the motor's "
            f"{motor * 1e3:.2f} mm; leave --blocked-tip out where distal_tension_N was measured"
        )


def first_loop(tension: NDArray[np.float64]) -> slice:
    """Return the samples of the highest pull and the release behind it, what follows left out."""
    smooth = median_filter(tension, SMOOTHED, mode="nearest")
    peak = int(np.argmax(smooth))
    turn = TURN * smooth[peak]
    after = smooth[peak:]
    pulled_again = np.flatnonzero(after > np.minimum.accumulate(after) + turn)
    end = peak + int(pulled_again[0]) if len(pulled_again) else len(smooth)
    before = smooth[peak::-1]
    released_before = np.flatnonzero(before > np.minimum.accumulate(before) + turn)
    start = peak - int(released_before[0]) if len(released_before) else -1
    bottom = peak + int(np.argmin(smooth[peak:end]))
    foot = start + 1 + int(np.argmin(smooth[start + 1 : peak + 1]))
    return slice(foot, bottom + 1)


def loop_verdict(found: Calibration) -> tuple[bool, str]:
    """Return whether to believe a loop, and why."""
    if found.uniform:
        return (
            True,
            "both methods agree: the curvature is even enough for K and EA to be both right",
        )
    return False, (
        "the methods disagree: the sheath is bent unevenly (then K is right, elongation not, which "
        "is computed for an even bend), friction depends on direction, or the tip gives way"
    )


def from_bench(table: MeasuredTable, base: TendonConfig) -> Fit:
    """Fit K to both tensions, and EA to the elongation where both ends have a displacement."""
    if table.distal_tension is None:
        raise UsageError(
            f"{table.path}: --fit needs distal_tension_N; without it, and with the tip blocked "
            "while measuring, add --blocked-tip"
        )
    result = fit_bench(table.proximal_tension, table.distal_tension)
    require_decided(table, result)
    parameters, EA = dict(result.parameters), base.axial_stiffness
    if table.proximal_displacement is not None and table.distal_displacement is not None:
        stretch = table.proximal_displacement - table.distal_displacement
        elastic = fit_blocked_tip(table.proximal_tension, stretch, base.length)
        parameters["EA"] = elastic.parameters["axial_stiffness"]
        EA = parameters["EA"].value
    tendon = with_friction(base, parameters["K"], EA)
    return Fit(tendon, "symmetric law, by re-simulation", parameters, result.believe, result.reason)


def require_decided(table: MeasuredTable, result: FitResult) -> None:
    """Refuse a fit in which the record did not decide K."""
    K = result.parameters["K"]
    if not result.decided or not math.isfinite(K.high - K.low):
        raise UsageError(f"{table.path}: {result.reason}")


def with_friction(base: TendonConfig, K: Parameter, EA: float) -> TendonConfig:
    """Return `base` with a fitted K, its uncertainty left to the interval, and EA."""
    error = max(base.friction_error, 0.5 * (K.high - K.low) / K.value)
    return dataclasses.replace(
        base, effective_friction=K.value, friction_error=error, axial_stiffness=EA
    )


def interval(value: Measured) -> Parameter:
    """Return a value with its 95 % interval."""
    half = COVER * value.uncertainty
    return Parameter(value.value, value.value - half, value.value + half)
