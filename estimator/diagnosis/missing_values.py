"""Values that are missing (NaN) in one channel of a record while others have theirs.

They are not compared. What drives the simulation must be known: rows without it are removed.
"""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.effects.effect import Signals

LONG = 0.25  # [s] and
PERIODS = 5.0  # sample times between two values: a curve drawn through both would be invented


def known(signal: Array) -> Array:
    """Return the values of a signal that are not missing, in their order."""
    return signal[np.isfinite(signal)]


def only_rows(time: Array, signals: Signals, rows: NDArray[np.bool_]) -> tuple[Array, Signals]:
    """Return some of the rows of a record."""
    return time[rows], {name: signal[rows] for name, signal in signals.items()}


def stretches(time: Array, signal: Array) -> Array:
    """Return between which times [s] values are missing for long, shape (m, 2)."""
    times = time[np.isfinite(signal)]
    steps = np.diff(times)
    long = steps > max(LONG, PERIODS * float(np.median(steps)))
    return np.column_stack([times[:-1][long], times[1:][long]])


def outside(time: Array, missing: Array) -> NDArray[np.bool_]:
    """Return which times are in none of the stretches of missing values, shape (n,)."""
    inside = np.zeros(len(time), dtype=np.bool_)
    for begin, end in missing:
        inside |= (begin < time) & (time < end)
    return ~inside
