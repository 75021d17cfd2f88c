"""Simulate a hand on a system."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from master.device import HandState
from studies.transparency.hand import DT, Encoder, Hand
from studies.transparency.system import System

SETTLED = 0.4  # [s] after which a session over a network without delay may engage


class RunData(NamedTuple):
    """Signals of a run, one value per tick."""

    time: Array  # [s]
    hand: Array  # [m] true
    velocity: Array  # [m/s] true, of the hand
    force: Array  # [N] on the hand, held until the next tick
    tip: Array  # [m] true, half a tick later
    load: Array  # [N] true, on the tip, half a tick later
    commanded: Array  # [m] of the tip
    followed: Array  # [m]
    credit: Array  # [J] of master and slave, shape (n, 2)
    engaged: NDArray[np.bool_]
    work: Array  # [J] done on the hand so far
    dragged: Array  # [m^2/s] times a damping at the hand: what that has dissipated [J]


def part(record: RunData, begin: int, end: int) -> RunData:
    """Return the ticks from `begin` to before `end`."""
    span = slice(begin, end)
    return record._replace(**{name: column[span] for name, column in record._asdict().items()})


def nobody(_time: float) -> float:
    """Push nothing."""
    return 0.0


def run(
    system: System,
    hand: Hand,
    seconds: float,
    engage: float = SETTLED,
    push: Callable[[float], float] = nobody,
) -> RunData:
    """Simulate for `seconds` [s].

    Parameters
    ----------
    system : System
        What is between hand and tip.
    hand : Hand
        What holds the device.
    engage : float
        When the operator engages [s].
    push : callable
        Force on the tip [N] besides all that it meets, at a time [s].
    """
    encoder, rows = Encoder(hand.device), []
    for k in range(round(seconds / DT)):
        time = k * DT
        position, velocity = encoder.read(hand.position, hand.velocity)
        seen = HandState((position,), (velocity,), engage=time > engage)
        answer = system.tick(seen, push(time + DT / 2))
        rows.append((time, hand.position, hand.velocity, *answer))
        hand.advance(answer.force)
    time, x, v, f, tip, load, commanded, followed, *credit, engaged = np.array(rows, float).T
    work = np.concatenate([[0.0], np.cumsum(f[:-1] * np.diff(x))])
    dragged = np.concatenate([[0.0], np.cumsum(np.square(v[1:]) + np.square(v[:-1])) * DT / 2])
    return RunData(
        time,
        x,
        v,
        f,
        tip,
        load,
        commanded,
        followed,
        np.array(credit).T,
        engaged > 0,
        work,
        dragged,
    )
