"""Forces that the master makes by itself: the soft limits of the workspace, the device's weight.

They come from the hand alone, with no delay and no slave, so they are not part of the coupling.
The limits are felt while hand and tip are coupled. Outside them a hand at x, going further at v, is
pushed back with

    F = -min(wall * depth + wall_damping * v, wall_max),    depth, v > 0 outwards

and the tip does not follow it there (`master.operator.within`). The damping only opposes going
deeper, so a limit never pulls. A hand that is outside already when it is coupled is not kicked: its
limit begins where the hand is, and comes back with it.
"""

from master.device import Axes, HandState
from master.operator import OperatorConfig

Reach = tuple[tuple[float, float], ...]  # [m] from ... to, one an axis that has limits


def reach(config: OperatorConfig, before: Reach, hand: HandState | None, felt: bool) -> Reach:
    """Return where the limits begin: at the workspace's, or further out where the hand was."""
    if hand is None:
        return before
    limits = config.workspace
    if not felt or not before:
        return tuple(
            (min(low, x), max(high, x))
            for (low, high), x in zip(limits, hand.position, strict=False)
        )
    return tuple(
        (min(low, max(was[0], x)), max(high, min(was[1], x)))
        for (low, high), was, x in zip(limits, before, hand.position, strict=False)
    )


def walls(config: OperatorConfig, limits: Reach, hand: HandState) -> Axes:
    """Return the force of the limits, as `reach` has them, on the hand [N], one number an axis."""
    return tuple(
        _wall(config, x, v, *limits[k]) if k < len(limits) else 0.0
        for k, (x, v) in enumerate(zip(hand.position, hand.velocity, strict=True))
    )


def weight(config: OperatorConfig, axes: int) -> Axes:
    """Return the force that keeps a device of so many axes where it is let go of [N]."""
    return tuple(config.weight[k] if k < len(config.weight) else 0.0 for k in range(axes))


def plus(force: Axes, own: Axes) -> Axes:
    """Return `force` with `own` [N] added; `own` may be empty."""
    return tuple(f + o for f, o in zip(force, own, strict=True)) if own else force


def less(force: Axes, own: Axes) -> Axes:
    """Return how much of a written `force` [N] may have been the coupling's, if `own` was not."""
    return tuple(f - o for f, o in zip(force, own, strict=True)) if own else force


def _wall(config: OperatorConfig, x: float, v: float, low: float, high: float) -> float:
    side = 1.0 if x > high else -1.0
    depth = max(x - high, low - x)
    if not depth > 0.0:
        return 0.0
    push = config.wall * depth + config.wall_damping * max(side * v, 0.0)
    return -side * min(push, config.wall_max)
