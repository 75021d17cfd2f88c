"""Whether a hand holds the device: a living one is never quite still.

The engage switch is held to run, but a switch can be taped down or wedged. A device that has not
moved by more than `presence_motion` for `presence` seconds while the switch was closed has nobody
at it. The switch then counts as open until it really was: nothing engages again by a knock.

The physiological tremor of a hand that holds an instrument is some 0.05 to 0.1 mm, so the default
of 20 um is below it, and above the noise of an encoder.
"""

from typing import NamedTuple

from master.device import Axes, HandState
from master.operator import OperatorConfig


class Presence(NamedTuple):
    """What one tick hands to the next."""

    around: Axes = ()  # [m] where the hand has been still since
    still_s: float = 0.0  # [s]
    away: bool = False  # nobody was there, and the switch has not been open since


def step(config: OperatorConfig, memory: Presence, hand: HandState | None, dt: float) -> Presence:
    """Return who is there after a tick, `dt` [s] after the last."""
    if hand is None or not hand.engage:
        return Presence()
    moved = len(memory.around) != len(hand.position) or any(
        abs(x - was) > config.presence_motion
        for x, was in zip(hand.position, memory.around, strict=True)
    )
    if moved:
        return Presence(hand.position, 0.0, memory.away)
    still_s = memory.still_s + dt
    return Presence(memory.around, still_s, memory.away or still_s > config.presence)
