"""Forces that the master makes by itself: the soft limits of the workspace.

They come from the hand alone, with no delay and no slave, so they are not part of the coupling.
The limits are felt while hand and tip are coupled. Outside them a hand at x, going further at v, is
pushed back with

    F = -min(wall * depth + wall_damping * v, wall_max),    depth, v > 0 outwards

and the tip does not follow it there (`master.operator.within`). The damping only opposes going
deeper, so a limit never pulls. A hand that is outside already when it is coupled is not kicked: its
limit begins where the hand is, and comes back with it.

The other force of the master's own is the one that keeps the device's weight,
`OperatorSettings.weight`.
"""

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import Flag, Record
from master.hand_input import Axes, HandInput
from master.operator import OperatorSettings


class WorkspaceLimits(Record):
    """Where the limits begin: at the workspace's, or further out where the hand was."""

    known: Flag = False  # a hand was seen
    low: Axes  # [m] -inf where an axis has none
    high: Axes  # [m] inf where an axis has none


@compiled
def update_limits(
    settings: OperatorSettings, limits: WorkspaceLimits, hand: HandInput, rendered: bool
) -> None:
    """Move the limits with the hand: out to it while they are not `rendered`, and back with it."""
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


@compiled
def wall_forces(
    settings: OperatorSettings, limits: WorkspaceLimits, hand: HandInput, out: Array
) -> None:
    """Write the force of the limits on the hand [N] to `out`, shape (8,), axis by axis."""
    for k in range(hand.axes):
        out[k] = _wall(settings, hand.position[k], hand.velocity[k], limits.low[k], limits.high[k])


@compiled
def _wall(settings: OperatorSettings, x: float, v: float, low: float, high: float) -> float:
    side = 1.0 if x > high else -1.0
    depth = max(x - high, low - x)
    if not depth > 0.0:
        return 0.0
    push = settings.wall * depth + settings.wall_damping * max(side * v, 0.0)
    return -side * min(push, settings.wall_max)
