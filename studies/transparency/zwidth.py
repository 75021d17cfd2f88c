"""Z-width: the stiffest wall that is rendered stably (Colgate & Brown 1994).

A wall is stable with a hand if the hand that reached into it comes to rest there, or is about to,
and was not fed with energy on its way: `has_settled`. That is asked for a rising stiffness until it
fails once, then in between (Colgate & Brown, "Factors affecting the Z-width of a haptic display",
IEEE Int. Conf. Robotics and Automation 1994, 3205-3210). A hand that creeps, or swings ever less,
is stable; one that goes on swinging is not.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.signal import detrend

from estimator.array_types import Array
from studies.transparency.hand import DT, Arm, Device, HandModel, build_reach
from studies.transparency.system import SETTLED, RunData, System, run_hand

SPAN = 1.0  # [s] at the end, and as long before, in which the hand's swing is looked at
SWING = 0.3e-3  # [m] is rest; more must have become less,
FADES = 0.85  # so many times the swing of the span before
ENERGY = 5e-3  # [J] that the hand may have got out of the system, on balance, at any time
PUSH = 1.6  # [N] with which the arm pushes against a wall that does not yield
REST = 2.5  # [s] for which it pushes


class Width(NamedTuple):
    """Result of a search [N/m]."""

    stable: float  # the largest that was stable; 0 = not even the lowest
    unstable: float  # the smallest that was not; inf = none up to the cap


def has_settled(record: RunData) -> bool:
    """Return whether a hand comes to rest, still engaged, and was not fed on its way."""
    ticks = round(SPAN / DT)
    before, after = map(compute_swing, (record.hand[-2 * ticks : -ticks], record.hand[-ticks:]))
    fed = record.work.max(initial=0.0) > ENERGY
    return bool(record.engaged[-1] and not fed and (after <= SWING or after <= FADES * before))


def compute_swing(position: Array) -> float:
    """Return how far a position [m] goes to and fro: its span beside its straight trend."""
    return float(np.ptp(detrend(position)))


def compute_buzz(record: RunData) -> float:
    """Return how the force trembles [N] at the end: its standard deviation beside its trend."""
    return float(np.std(detrend(record.force[-round(SPAN / DT) :])))


def push_wall(
    system: System, hand: HandModel, device: Device, contact: float, round_trip: float = 0.0
) -> RunData:
    """Return how `hand` reaches into a wall that begins at `contact` [m] of it, and rests."""
    begin = SETTLED + round_trip + 0.2
    arm = Arm(build_reach(contact + PUSH / hand.stiffness, begin), hand, device)
    return run_hand(system, arm, begin + 0.6 + REST, engage=SETTLED + round_trip)


def find_largest_width(
    stable: Callable[[float], bool], lowest: float, cap: float, factor: float, within: float
) -> Width:
    """Return up to which stiffness walls are stable.

    Parameters
    ----------
    stable : callable
        Whether a wall of so many N/m is.
    lowest, cap : float
        Where the search begins and ends [N/m].
    factor : float
        By which the stiffness rises until one is not stable: what is beyond that is not looked at.
    within : float
        Ratio of `unstable` to `stable` at which to stop looking in between.
    """
    below, above = 0.0, lowest
    while stable(above):
        if above >= cap:
            return Width(above, math.inf)
        below, above = above, min(above * factor, cap)
    while below > 0.0 and above / below > within:
        middle = math.sqrt(below * above)
        if stable(middle):
            below = middle
        else:
            above = middle
    return Width(below, above)
