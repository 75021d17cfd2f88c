"""Detect whether a hand holds the device, by its tremor.

The engage switch can be taped down or wedged. If the device has not moved by more than
`presence_motion` for `presence` seconds while the switch was closed, no hand is present. The switch
then counts as open until it has really been open, so a knock does not engage again.

The physiological tremor of a hand that holds an instrument is some 0.05 to 0.1 mm, so the default
of 20 um is below it, and above the noise of an encoder.
"""

from estimator.compiled import jit_compile
from estimator.records import F64, I64, Flag, Struct
from master.hand_input import Axes, HandInput
from master.operator import OperatorSettings


class Presence(Struct):
    """State between ticks."""

    axes: I64 = 0  # how many entries of `around` are in use; 0 = the switch was open
    around: Axes  # [m] reference position of the still hand
    still_s: F64 = 0.0  # [s]
    away: Flag = False  # no hand detected, and the switch has not been open since


@jit_compile
def update_presence(
    settings: OperatorSettings, memory: Presence, hand: HandInput, dt: float
) -> None:
    """Update the detection at a tick, `dt` [s] after the last."""
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
