"""What drags add to the loops of a joint's two tendons: the friction of both together.

A blocked loop tells little of what has little compliance behind it, as at the tip. In a drag one
tendon draws the other one out, and both slide all along: their K add up, wherever the friction is
(docs/theory.md (T20)). Load cells whose gains differ by a share g make that sum wrong by g, and by
as much the other way in the other drag: their mean does not depend on it.
"""

import math
from collections.abc import Sequence

from estimator.calibration.calibration import (
    AGREEMENT,
    Calibration,
    CalibrationError,
    Measured,
    together,
)
from estimator.calibration.drag import friction_of_both
from slave.calibration.pulled import PulledTendon


def combine_with_drags(
    pulled: Sequence[PulledTendon], found: Sequence[Calibration], gain_error: float
) -> tuple[list[Calibration], str]:
    """Return the calibrations of two antagonists by loops and drags, and what is to be said.

    Where drags and loops contradict each other the loops stand, and it is said.

    Parameters
    ----------
    pulled : sequence of PulledTendon
        Tendon a, tendon b.
    found : sequence of Calibration
        By their loops.
    gain_error : float
        Relative standard uncertainty of each load cell's gain.
    """
    a, b = found
    try:
        total = _sum(pulled, found, gain_error)
        return list(together(a, b, total)), ""
    except CalibrationError as error:
        return [a, b], (
            f"the drags are not used, K is by the loops alone: {error}; the joint's own friction "
            "may grow with its load, or load cells or friction differ with direction"
        )


def _sum(
    pulled: Sequence[PulledTendon], found: Sequence[Calibration], gain_error: float
) -> Measured:
    """Return K_a + K_b by all drags there are."""
    sums = [
        _of_drag(own, other, calibration.M_pull.value)
        for own, other, calibration in zip(pulled, reversed(pulled), found, strict=True)
        if own.dragging.any()
    ]
    if not sums:
        raise CalibrationError("there is none")
    gains = math.sqrt(2.0) * gain_error
    if len(sums) == 1:
        return Measured(sums[0].value, math.hypot(sums[0].uncertainty, gains))
    first, second = sums
    noise = math.hypot(first.uncertainty, second.uncertainty)
    if abs(first.value - second.value) > AGREEMENT * math.hypot(noise, 2.0 * gains):
        raise CalibrationError(
            f"K of both tendons is {first.value:.3f} as a draws b, {second.value:.3f} as b draws a"
        )
    return Measured(0.5 * (first.value + second.value), 0.5 * noise)


def _of_drag(own: PulledTendon, other: PulledTendon, M_pull: float) -> Measured:
    """Return K_a + K_b by one drag; `M_pull` [m/N] is of the tendon that is pulled."""
    rows = own.dragging
    tension = own.tension[rows]
    travel = own.travel[rows] - M_pull * tension
    return friction_of_both(tension, other.tension[rows], travel)
