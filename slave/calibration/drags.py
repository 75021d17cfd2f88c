"""Combine the loops of a joint's two tendons with the drags, which measure K_a + K_b.

A loop with the tip blocked hardly depends on friction near the tip. In a drag one tendon draws the
other out and both slide along their whole length: their K add up, wherever the friction is
(docs/theory.md (T20)). A relative gain difference g of the load cells biases the sum by g, with
opposite sign in the opposite drag, so the mean is unbiased.
"""

import math
from collections.abc import Sequence

from estimator.calibration.calibration import (
    AGREEMENT,
    Calibration,
    CalibrationError,
    MeasuredValue,
    combine_calibrations,
)
from estimator.calibration.drag import fit_friction_sum
from slave.calibration.pulled import PulledTendon


def combine_with_drags(
    pulled: Sequence[PulledTendon], found: Sequence[Calibration], gain_error: float
) -> tuple[list[Calibration], str]:
    """Return the calibrations of two antagonists from loops and drags, and a remark.

    If drags and loops contradict each other, the loops are used and the remark says so.

    Parameters
    ----------
    pulled : sequence of PulledTendon
        Tendon a, tendon b.
    found : sequence of Calibration
        From their loops.
    gain_error : float
        Relative standard uncertainty of each load cell's gain.
    """
    a, b = found
    try:
        total = _estimate_friction_sum(pulled, found, gain_error)
        return list(combine_calibrations(a, b, total)), ""
    except CalibrationError as error:
        return [a, b], (
            f"drags not used, K is from the loops alone: {error}; the joint's own friction may "
            "grow with its load, or load cells or friction differ with direction"
        )


def _estimate_friction_sum(
    pulled: Sequence[PulledTendon], found: Sequence[Calibration], gain_error: float
) -> MeasuredValue:
    """Return K_a + K_b from all drags."""
    sums = [
        _estimate_sum_from_drag(own, other, calibration.M_pull.value)
        for own, other, calibration in zip(pulled, reversed(pulled), found, strict=True)
        if own.dragging.any()
    ]
    if not sums:
        raise CalibrationError("no drag was recorded")
    gains = math.sqrt(2.0) * gain_error
    if len(sums) == 1:
        return MeasuredValue(sums[0].value, math.hypot(sums[0].uncertainty, gains))
    first, second = sums
    noise = math.hypot(first.uncertainty, second.uncertainty)
    if abs(first.value - second.value) > AGREEMENT * math.hypot(noise, 2.0 * gains):
        raise CalibrationError(
            f"K of both tendons is {first.value:.3f} as a draws b, {second.value:.3f} as b draws a"
        )
    return MeasuredValue(0.5 * (first.value + second.value), 0.5 * noise)


def _estimate_sum_from_drag(own: PulledTendon, other: PulledTendon, M_pull: float) -> MeasuredValue:
    """Return K_a + K_b from one drag; `M_pull` [m/N] is of the pulled tendon."""
    rows = own.dragging
    tension = own.tension[rows]
    travel = own.travel[rows] - M_pull * tension
    return fit_friction_sum(tension, other.tension[rows], travel)
