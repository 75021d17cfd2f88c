"""Samples that only repeat the one before, as their sensor is slower than the record."""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

REGULAR_SHARE = 0.8  # of the new values, that come at one distance, or a sample more or less
STEPS_MIN = 4.0  # of a reading's rounding, between two new values: fewer are a slow motion


def find_held_samples(signal: Array, step: float) -> NDArray[np.bool_]:
    """Return which samples of a channel are held ones; none where the sensor keeps up.

    Parameters
    ----------
    signal : ndarray
        Shape (n,).
    step : float
        In which the reading is counted; 0 for none.
    """
    none = np.zeros(len(signal), dtype=np.bool_)
    new = np.flatnonzero(np.diff(signal)) + 1
    if len(new) < 3:
        return none
    apart = np.diff(new)
    usual = float(np.median(apart))
    if usual < 2.0 or np.mean(np.abs(apart - usual) <= 1.0) < REGULAR_SHARE:
        return none
    if np.median(np.abs(np.diff(signal[new]))) < STEPS_MIN * step:
        return none
    repeats = ~none
    repeats[new] = repeats[0] = False
    return repeats
