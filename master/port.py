"""The master's port of the coupling: from forces wanted on the hand to forces it can be given.

Scales of motion and force are a transformer between the hand and the port, whose units are those of
the tip. What the hand does is counted by the hand's own motion, whether or not the tip is asked to
follow it (a locked axis, a limit of the workspace), and by the force that was really rendered, in
the scale that it was rendered with.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

from master.device import Axes, HandState
from teleop import coupling
from teleop.coupling import Bilateral, Side
from teleop.messages import MAX_JOINTS


class Rendered(NamedTuple):
    """What the port had of the tick before."""

    hand: Axes = ()  # [m] where it was
    force: Axes = ()  # [N] on the hand that the coupling had asked for
    scale: float = 0.0  # force on the hand per force at the tip, with it


def step(
    bilateral: Bilateral,
    side: Side,
    before: Rendered,
    hand: HandState | None,
    scale: float,
    position_scale: float,
    written: Axes,
    wanted: Axes,
    coupled: bool,
    dt: float,
) -> tuple[Axes, Side, Rendered]:
    """Return the forces [N] that the coupling gives the hand, and the new memory.

    Parameters
    ----------
    before : Rendered
        What this returned last.
    hand : HandState or None
        Newest read of the device, if it can be read.
    scale : float
        Force on the hand per force at the tip.
    position_scale : float
        Tip travel per hand travel.
    written, wanted : tuples of float
        Forces on the hand [N] rendered since the last tick, and wanted now.
    coupled : bool
        Whether the session lets forces reach the hand.
    """
    where = hand.position if hand is not None else before.hand
    speed = hand.velocity if hand is not None else (0.0,) * len(where)
    was = before.hand or where
    place = tuple(
        at + position_scale * (x - x0) for at, x, x0 in zip(side.asked, where, was, strict=False)
    )
    velocity = tuple(position_scale * v for v in speed)
    given, side = coupling.at_hand(
        bilateral,
        side,
        place + side.asked[len(place) :],
        velocity + (0.0,) * (MAX_JOINTS - len(velocity)),
        _at_tip(before.scale, map(_part, written, before.force or written)),
        _at_tip(scale, wanted),
        scale * position_scale,
        coupled and all(map(math.isfinite, wanted)),
        dt,
    )
    if not coupled:
        return wanted, side, before._replace(hand=where)
    force = wanted if scale == 0.0 else tuple(-scale * f for f in given)
    return force, side, Rendered(where, force, scale)


def _part(written: float, asked: float) -> float:
    """Return how much of a `written` force was the coupling's: no more than it `asked` for."""
    if not math.isfinite(asked):
        return 0.0
    return min(max(written, min(asked, 0.0)), max(asked, 0.0))


def _at_tip(scale: float, forces: Iterable[float]) -> tuple[float, ...]:
    return tuple(-force / scale if scale > 0.0 else 0.0 for force in forces)
