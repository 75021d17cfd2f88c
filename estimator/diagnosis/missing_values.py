"""Values that are missing (NaN) in one channel of a record while others have theirs.

They are not compared. What drives the simulation must be known: rows without it are removed.
"""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.effects.effect import Signals

LONG_GAP = 0.25  # [s] and
LONG_GAP_PERIODS = (
    5.0  # sample times between two values: a curve drawn through both would be invented
)


def drop_missing(signal: Array) -> Array:
    """Return the values of a signal that are not missing, in their order."""
    return signal[np.isfinite(signal)]


def mark_missing(signals: Signals) -> Signals:
    """Return signals with NaN for what is not finite."""
    return {name: np.where(np.isfinite(signal), signal, np.nan) for name, signal in signals.items()}


def select_signal_rows(
    time: Array, signals: Signals, rows: NDArray[np.bool_]
) -> tuple[Array, Signals]:
    """Return some of the rows of a record."""
    return time[rows], {name: signal[rows] for name, signal in signals.items()}


def find_long_gaps(time: Array, present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which times [s] lie where no value is present for long, shape (n,)."""
    times = time[present]
    steps = np.diff(times, prepend=time[0], append=time[-1])
    long = np.flatnonzero(
        steps > max(LONG_GAP, LONG_GAP_PERIODS * float(np.median(np.diff(times))))
    )
    edges = np.concatenate([[-np.inf], times, [np.inf]])
    inside = np.zeros(len(time), dtype=np.bool_)
    for begin, end in zip(edges[long], edges[long + 1], strict=True):
        inside |= (begin < time) & (time < end)
    return inside
