"""The safety gate before the hand: finite, fresh, engaged, within limits, or no force.

Every force the master loop writes to a device has passed `step`, at every tick. For any request the
output is finite, within the limits, grows no faster than the slew limit, and is zero as soon as the
session is not engaged. A decreasing force is never slowed down. Two exceptions are up to the
caller. When messages of the peer stop, it sets `is_force_fading`: each axis then goes to zero at
`axis_max` per `FADE_S`, so it is zero `FADE_S` after the timeout. And `rest`, a small force that
carries the device's weight, replaces zero.

The limits are `master.gate.axis_max` and `total_max`. A torque on an axis that turns counts as the
force at the lever `torque_max` / `axis_max`, here and in all limits of forces. Rendering saturates
earlier, at `master.force.limit` (`master.feedback.clamp`): the gate is the last resort, not the
usual limit.
"""

import math
from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from master.hand_input import is_all_finite
from teleop.config.ranges import RangedConfig, build_ranged_field
from teleop.messages.messages import MAX_JOINTS
from teleop.runtime.clock import STEP_MAX_S

FADE_S = 0.015  # [s] within which the largest force on one axis is gone; 30 ms + this < 50 ms


@dataclass(frozen=True, slots=True)
class GateConfig(RangedConfig):
    """Force limits of device and hand; `FeedbackConfig.limit`, for rendering, lies below them."""

    # on one axis; desktop haptic devices reach about 3 N
    axis_max: float = build_ranged_field(3.0, 0.0, math.inf, "N", above=True, bound=12.0)
    # length of the force vector
    total_max: float = build_ranged_field(4.0, 0.0, math.inf, "N", above=True, bound=20.0)
    # at which a force may grow
    slew_max: float = build_ranged_field(200.0, 0.0, math.inf, "N/s", above=True, bound=5e3)
    # on one axis that turns; counts in all limits as axis_max
    torque_max: float = build_ranged_field(0.15, 0.0, math.inf, "N m", above=True, bound=0.6)
    exceed_bounds: bool = False  # accept limits beyond those of docs/explanation/safety.md

    @property
    def torque_lever(self) -> float:
        """[m] at which a torque counts as a force."""
        return self.torque_max / self.axis_max


class GateFlags(IntFlag):
    """Interventions of the gate at a tick; 0 = request passed unchanged."""

    PASSED = 0
    NOT_ENGAGED = 1  # zero
    STALE_STATE = 2  # zero
    NOT_FINITE = 4  # zero
    AXIS_LIMIT = 8  # clamped
    TOTAL_LIMIT = 16  # shortened, same direction
    SLEW = 32  # growth slowed


# for compiled code, which does not support flags
PASSED = int(GateFlags.PASSED)
NOT_ENGAGED = int(GateFlags.NOT_ENGAGED)
STALE_STATE = int(GateFlags.STALE_STATE)
NOT_FINITE = int(GateFlags.NOT_FINITE)
AXIS_LIMIT = int(GateFlags.AXIS_LIMIT)
TOTAL_LIMIT = int(GateFlags.TOTAL_LIMIT)
SLEW = int(GateFlags.SLEW)


@jit_compile
def step(
    config: GateConfig,
    last: Array,
    requested: Array,
    axes: int,
    fresh: bool,
    may_render: bool,
    dt: float,
    is_force_fading: bool,
    rest: Array,
    out: Array,
) -> int:
    """Limit `requested` to a safe force.

    Parameters
    ----------
    last, requested : arrays of shape (8,)
        Forces [N] written last, and requested now; the first `axes` are in use.
    fresh : bool
        Whether the slave's state behind `requested` is recent.
    may_render : bool
        Whether the session is engaged on both sides.
    dt : float
        Time since the last tick [s].
    is_force_fading : bool
        Whether a refused force ramps to zero instead of stepping.
    rest : array of shape (8,)
        Forces [N] in place of zero; zero if any is not finite.
    out : array of shape (8,)
        The forces that leave the gate [N]; may be `last` or `requested` itself. They are the `last`
        of the next tick.

    Returns
    -------
    int
        The bits of a `GateFlags`.
    """
    refusal = PASSED
    if not may_render:
        refusal |= NOT_ENGAGED
    if not fresh:
        refusal |= STALE_STATE
    if not is_all_finite(requested, axes):
        refusal |= NOT_FINITE
    verdict = refusal
    has_rest = is_all_finite(rest, axes)
    is_fading = is_force_fading and refusal & NOT_FINITE == 0 and 0.0 < dt < FADE_S
    limit = config.axis_max
    bounded = np.empty(MAX_JOINTS)
    for k in range(axes):
        force = requested[k]
        if refusal != PASSED:
            force = rest[k] if has_rest else 0.0
            if is_fading:
                force = _fade_force(last[k], force, config.axis_max * dt / FADE_S)
        bounded[k] = min(max(force, -limit), limit)
        if bounded[k] != force:
            verdict |= AXIS_LIMIT
    total = _compute_norm(bounded, axes)
    if total > config.total_max:
        verdict |= TOTAL_LIMIT
        for k in range(axes):
            bounded[k] *= config.total_max / total
    growth = config.slew_max * min(dt, STEP_MAX_S) if dt > 0.0 else 0.0
    for k in range(axes):
        previous, force = last[k], bounded[k]
        out[k] = min(max(force, min(previous, 0.0) - growth), max(previous, 0.0) + growth)
        if out[k] != force:
            verdict |= SLEW
    return verdict


@jit_compile
def _fade_force(last: float, target: float, step: float) -> float:
    """Return `last` moved towards `target` [N] by at most `step` [N]."""
    return max(target, last - step) if last > target else min(target, last + step)


@jit_compile
def _compute_norm(force: Array, axes: int) -> float:
    """Return the norm of a vector, scaled against overflow and underflow."""
    largest = 0.0
    for k in range(axes):
        largest = max(largest, abs(force[k]))
    if largest == 0.0:
        return 0.0
    total = 0.0
    for k in range(axes):
        total += (force[k] / largest) ** 2
    return largest * math.sqrt(total)
