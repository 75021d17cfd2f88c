"""From the estimated force at the tips to the force on the hand: choose, reflect, clamp.

The estimate counts a force against pulling as positive, and a hand moving along its positive axis
pulls, so the hand is pushed the other way:

    F_hand = clamp(-scale * F_tip)

A joint whose sample the estimator refused is not rendered: what is left of it is an old estimate.
A value that is not finite goes through as it is, for the gate to refuse.
"""

import math
from dataclasses import dataclass
from typing import Literal

from master.device import Axes
from teleop.messages import STATUS_NAMES, SlaveState

INVALID = 1 << STATUS_NAMES.index("invalid input")


@dataclass(frozen=True, slots=True)
class FeedbackConfig:
    """How the force at the tips is rendered."""

    scale: float = 0.2  # force on the hand per force at the tip
    limit: float = 2.5  # [N] on one axis; rendering saturates here, below the gate's limits
    source: Literal["estimate", "certified"] = "estimate"  # see `certified`

    def __post_init__(self) -> None:
        """Refuse what could not be felt or would push the hand on."""
        if not 0.0 <= self.scale <= 10.0:
            raise ValueError("scale: must be within 0 ... 10")
        if not 0.0 < self.limit < math.inf:
            raise ValueError("limit: must be above 0 [N] and finite")


def bounded(force: float, low: float, high: float) -> float:
    """Return `force` [N] within the certified interval `low ... high` [N]; NaN if that is none."""
    if not low <= high:
        return math.nan
    return min(max(force, low), high) if math.isfinite(force) else force


def certified(low: float, high: float) -> float:
    """Return the smallest force in the certified interval `low ... high` [N].

    It is the part of the force that is there for sure: zero as long as the interval contains zero.
    An interval that is not one (an end is NaN, or they are swapped) gives NaN.
    """
    if not low <= high:
        return math.nan
    return max(low, 0.0) + min(high, 0.0)


def reflect(scale: float, force: float) -> float:
    """Return the force on the hand [N] for a force at the tip [N], positive = against pulling."""
    return -scale * force


def clamp(limit: float, force: float) -> float:
    """Return `force` [N] saturated at `limit` [N]; not finite stays not finite."""
    return min(max(force, -limit), limit) if math.isfinite(force) else force


def step(config: FeedbackConfig, state: SlaveState, axes: int) -> Axes:
    """Return the force wanted on the hand [N], one for each axis.

    Zero for axes without a joint, and for joints whose estimate is of a refused sample.
    """
    if config.source == "certified":
        tip = tuple(map(certified, state.force_low, state.force_high))
    else:
        tip = tuple(map(bounded, state.force, state.force_low, state.force_high))
    return tuple(
        clamp(config.limit, reflect(config.scale, tip[axis]))
        if axis < state.joints and not state.status[axis] & INVALID
        else 0.0
        for axis in range(axes)
    )
