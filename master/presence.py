"""Whether a hand holds the device: a living one is never quite still.

The engage switch is held to run, but a switch can be taped down or wedged. A device that has not
moved by more than `presence_motion` for `presence` seconds while the switch was closed has nobody
at it. The switch then counts as open until it really was: nothing engages again by a knock.

The physiological tremor of a hand that holds an instrument is some 0.05 to 0.1 mm, so the default
of 20 um is below it, and above the noise of an encoder.
"""

from estimator.compiled import compiled
from estimator.records import F64, I64, Flag, Record
from master.hand_input import Axes, HandInput
from master.operator import OperatorSettings


class Presence(Record):
    """What one tick hands to the next."""

    axes: I64 = 0  # how many entries of `around` are in use; 0 = the switch was open
    around: Axes  # [m] where the hand has been still since
    still_s: F64 = 0.0  # [s]
    away: Flag = False  # nobody was there, and the switch has not been open since


@compiled
def step(settings: OperatorSettings, memory: Presence, hand: HandInput, dt: float) -> None:
    """Update who is there in a tick, `dt` [s] after the last."""
    if not hand.present or not hand.engage:
        memory.axes = 0
        memory.still_s = 0.0
        memory.away = False
        return
    moved = memory.axes != hand.axes
    for k in range(min(memory.axes, hand.axes)):
        if abs(hand.position[k] - memory.around[k]) > settings.presence_motion:
            moved = True
    if moved:
        memory.axes = hand.axes
        for k in range(hand.axes):
            memory.around[k] = hand.position[k]
        memory.still_s = 0.0
        return
    memory.still_s += dt
    if memory.still_s > settings.presence:
        memory.away = True
