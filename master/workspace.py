"""The workspace of the hand: its soft limits, and whether a hand is there at all.

They depend only on the hand, so they are not part of the coupling. The limits are rendered while
hand and tip are coupled. Outside them a hand at x, moving outwards at v, is pushed back with

    F = -min(wall * depth + wall_damping * v, wall_max),    depth, v > 0 outwards

and the tip does not follow it there (`master.operator.clip_to_workspace`). The damping only opposes
outward motion, so a limit never pulls. If the hand is already outside when it is coupled, its limit
starts at the hand and moves back with it, so there is no force step.
"""

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, I64, Flag, Struct
from master.hand_input import Axes, HandInput
from master.operator import OperatorSettings

# --- detect whether a hand holds the device, by its tremor
# The engage switch can be taped down or wedged. If the device has not moved by more than
# `presence_motion` for `presence` seconds while the switch was closed, no hand is present. The
# switch then counts as open until it has really been open, so a knock does not engage again.  The
# physiological tremor of a hand that holds an instrument is some 0.05 to 0.1 mm, so the default of
# 20 um is below it, and above the noise of an encoder.


class Presence(Struct):
    """State between ticks."""

    axes: I64 = 0  # how many entries of `around` are in use; 0 = the switch was open
    reference: Axes  # [m] reference position of the still hand
    still_s: F64 = 0.0  # [s]
    is_away: Flag = False  # no hand detected, and the switch has not been open since


@jit_compile
def update_presence(
    settings: OperatorSettings, memory: Presence, hand: HandInput, dt: float
) -> None:
    """Update the detection at a tick, `dt` [s] after the last."""
    if not hand.present or not hand.engage:
        memory.axes = 0
        memory.still_s = 0.0
        memory.is_away = False
        return
    has_moved = memory.axes != hand.axes
    for k in range(min(memory.axes, hand.axes)):
        if abs(hand.position[k] - memory.reference[k]) > settings.presence_motion:
            has_moved = True
    if has_moved:
        memory.axes = hand.axes
        for k in range(hand.axes):
            memory.reference[k] = hand.position[k]
        memory.still_s = 0.0
        return
    memory.still_s += dt
    if memory.still_s > settings.presence:
        memory.is_away = True


class WorkspaceLimits(Struct):
    """Active limits: those of the workspace, or further out where the hand was."""

    known: Flag = False  # a hand position is known
    low: Axes  # [m] -inf where an axis has none
    high: Axes  # [m] inf where an axis has none


@jit_compile
def update_limits(
    settings: OperatorSettings, limits: WorkspaceLimits, hand: HandInput, rendered: bool
) -> None:
    """Move the limits with the hand: outwards while they are not `rendered`, and back with it."""
    if not hand.present:
        return
    for k in range(hand.axes):
        x, low, high = hand.position[k], settings.low[k], settings.high[k]
        if rendered and limits.known:
            limits.low[k] = min(low, max(limits.low[k], x))
            limits.high[k] = max(high, min(limits.high[k], x))
        else:
            limits.low[k] = min(low, x)
            limits.high[k] = max(high, x)
    limits.known = True


@jit_compile
def compute_wall_forces(
    settings: OperatorSettings, limits: WorkspaceLimits, hand: HandInput, lever: Array, out: Array
) -> None:
    """Write the force of the limits on the hand [N] to `out`, shape (8,).

    `lever`, shape (8,), is that of each axis: 1, or [m] at which one that turns is as one that
    does not.
    """
    for k in range(hand.axes):
        x, v = lever[k] * hand.position[k], lever[k] * hand.velocity[k]
        low, high = lever[k] * limits.low[k], lever[k] * limits.high[k]
        out[k] = _compute_wall_force(settings, x, v, low, high)


@jit_compile
def _compute_wall_force(
    settings: OperatorSettings, x: float, v: float, low: float, high: float
) -> float:
    side = 1.0 if x > high else -1.0
    depth = max(x - high, low - x)
    if not depth > 0.0:
        return 0.0
    push = settings.wall * depth + settings.wall_damping * max(side * v, 0.0)
    return -side * min(push, settings.wall_max)
