"""Rendered against true stiffness: a hand presses a spring, a step at a time, and rests.

The hand goes its way whatever it feels, so that also what is not stable with an arm is measured.
Where it rests, force and motion are read; the slope of a line through the steps is the stiffness
that is felt.
"""

from typing import NamedTuple

import numpy as np

from studies.transparency.hand import DT, Device, GuidedHand, Motion, build_reach
from studies.transparency.system import SETTLED, System, run_hand

FORCE = 4.0  # [N] at the tip, at the deepest
STEPS = 4
MOVES, RESTS = 0.4, 0.4  # [s] of a step; it rests for a round trip longer
READ = 0.1  # [s] at the end of a rest


class SpringContact(NamedTuple):
    """A spring that was pressed."""

    true: float  # [N/m] of the environment
    felt: float  # [N/m] at the hand
    rendered: float  # `felt` over what the scales make of `true`
    ripple: float  # [N] span of the force on the hand while it was read, at most


def press_spring(
    system: System, stiffness: float, scales: tuple[float, float], round_trip: float, device: Device
) -> SpringContact:
    """Return what is felt of a spring that `system` meets from where its tip starts.

    Parameters
    ----------
    stiffness : float
        Of the spring [N/m].
    scales : tuple of float
        Force on the hand per force at the tip; tip travel per hand travel.
    round_trip : float
        Delay of both ways [s].
    """
    begin = SETTLED + round_trip + 0.2
    step = FORCE / STEPS / stiffness / scales[1]
    lasts = MOVES + RESTS + round_trip
    motion = _build_stairs(begin, lasts, step)
    record = run_hand(
        system, GuidedHand(motion, device), begin + STEPS * lasts, engage=SETTLED + round_trip
    )
    ends = [round((begin + (n + 1) * lasts) / DT) for n in range(STEPS)]
    spans = [slice(end - round(READ / DT), end) for end in ends]
    hand = [record.hand[span].mean() for span in spans]
    force = [-record.force[span].mean() for span in spans]
    felt = float(np.polyfit(hand, force, 1)[0])
    ripple = max(float(np.ptp(record.force[span])) for span in spans)
    return SpringContact(stiffness, felt, felt / (scales[0] * scales[1] * stiffness), ripple)


def _build_stairs(begin: float, lasts: float, step: float) -> Motion:
    steps = [build_reach(step, begin + n * lasts, MOVES) for n in range(STEPS)]
    return lambda time: sum(one(time) for one in steps)
