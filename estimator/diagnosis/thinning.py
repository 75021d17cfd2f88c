"""A long record with fewer samples: means of several."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.missing_values import LONG_GAP
from estimator.effects.effect import Signals

Mask = NDArray[np.bool_]


class DecimatedRecord(NamedTuple):
    """A record of which several samples were averaged to one."""

    time: Array
    signals: Signals
    good: dict[str, Mask]
    present: dict[str, Mask]
    averaged: dict[str, float]  # values in a sample, by channel
    thinned: int  # samples in one


def decimate_record(
    time: Array,
    signals: Signals,
    good: dict[str, Mask],
    present: dict[str, Mask],
    most: int,
) -> DecimatedRecord:
    """Return every k-th sample, all channels averaged over the k around it.

    What does not count is interpolated in `signals`, so that a mean of few values is one at the
    same time as that of many. A channel counts where it has more than half as many values as it
    usually has, and none where samples before and after a gap come together.
    """
    k = math.ceil(len(time) / most)
    if k <= 1:
        return DecimatedRecord(time, signals, good, present, dict.fromkeys(signals, 1.0), 1)
    rows = np.arange(k // 2, len(time) - (k - 1) // 2, k)
    window = rows[:, None] + np.arange(k) - k // 2
    spans = time[window[:, -1]] - time[window[:, 0]]
    unbroken = spans < float(np.median(spans)) + LONG_GAP
    counts = {name: mask[window].sum(axis=1) for name, mask in good.items()}
    usual = {name: float(np.median(count[count > 0])) for name, count in counts.items()}
    return DecimatedRecord(
        time[window].mean(axis=1),
        {name: signal[window].sum(axis=1) / k for name, signal in signals.items()},
        {name: unbroken & (count > 0.5 * usual[name]) for name, count in counts.items()},
        {name: mask[window].any(axis=1) for name, mask in present.items()},
        usual,
        k,
    )
