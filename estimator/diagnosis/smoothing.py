"""The motion behind a noisy travel, by local polynomials whose window adapts to the motion.

At each sample the widest window is taken whose estimate agrees with those of all narrower ones
(intersection of confidence intervals: Goldenshluger and Nemirovski 1997, Katkovnik 1999): wide at
rest and at constant speed, narrow where the motor turns.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array

_HALF_WIDTHS = (1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # [samples]
_ORDER = 2
_CONFIDENCE = 1.2  # standard deviations on each side
_STEADY = 9  # samples over which the median of the chosen windows is taken


class Smoothed(NamedTuple):
    """A signal without most of its noise."""

    signal: Array  # shape (n,)
    sigma: Array  # standard deviation of the noise that is left, shape (n,)


def smooth(signal: Array, sigma: float) -> Smoothed:
    """Return a signal with white noise of standard deviation `sigma` taken out, shape (n,)."""
    from scipy.ndimage import convolve1d, median_filter  # the control processes import this module
    from scipy.signal import savgol_coeffs

    n = len(signal)
    if not sigma > 0.0:
        return Smoothed(signal, np.zeros(n))
    estimates, sigmas = [signal], [sigma]
    low, high = signal - _CONFIDENCE * sigma, signal + _CONFIDENCE * sigma
    agreed = np.ones(n, dtype=np.bool_)
    chosen = np.zeros(n, dtype=np.int64)
    for half in _HALF_WIDTHS:
        if 2 * half + 1 >= n:
            break
        weights = savgol_coeffs(2 * half + 1, min(_ORDER, half))
        estimate = convolve1d(signal, weights, mode="nearest")
        left = sigma * math.sqrt(float(weights @ weights))
        low = np.maximum(low, estimate - _CONFIDENCE * left)
        high = np.minimum(high, estimate + _CONFIDENCE * left)
        agreed &= low <= high
        agreed[:half] = agreed[n - half :] = False
        chosen[agreed] = len(estimates)
        estimates.append(estimate)
        sigmas.append(left)
    chosen = median_filter(chosen, _STEADY)
    return Smoothed(np.stack(estimates)[chosen, np.arange(n)], np.array(sigmas)[chosen])
