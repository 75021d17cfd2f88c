"""The motion behind a noisy travel, by local polynomials whose window adapts to the motion.

At each sample the widest window is taken whose estimate agrees with those of all narrower ones
(intersection of confidence intervals: Goldenshluger and Nemirovski 1997, Katkovnik 1999): wide at
rest and at constant speed, narrow where the motor turns, and never across a step of the reading.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile

_HALF_WIDTHS = (1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # [samples]
_ORDER = 2
_CONFIDENCE = 1.2  # standard deviations on each side
_MEDIAN_WINDOW = 9  # samples over which the median of the chosen windows is taken
_STEP_THRESHOLD = 5.0  # sigma from a reading: a window over a step, as where an encoder slipped


class SmoothedSignal(NamedTuple):
    """A signal without most of its noise."""

    signal: Array  # shape (n,)
    sigma: Array  # standard deviation of the noise that is left, shape (n,)


def smooth_signal(signal: Array, sigma: float, time: Array | None = None) -> SmoothedSignal:
    """Return a signal with white noise of standard deviation `sigma` taken out.

    Parameters
    ----------
    signal : ndarray
        Shape (n,).
    sigma : float
        Of the white noise on it.
    time : ndarray, optional
        When it was sampled [s], shape (n,), strictly rising; evenly by default.
    """
    from scipy.ndimage import median_filter  # the control processes import this module

    n = len(signal)
    if not sigma > 0.0:
        return SmoothedSignal(signal, np.zeros(n))
    time = np.arange(n, dtype=np.float64) if time is None else time
    halves = np.array([0, *(half for half in _HALF_WIDTHS if 2 * half + 1 < n)])
    estimates, gains = _fit_local_polynomials(
        time / float(np.median(np.diff(time))), signal, halves
    )
    sigmas = sigma * gains
    low, high = signal - _CONFIDENCE * sigma, signal + _CONFIDENCE * sigma
    agreed = np.ones(n, dtype=np.bool_)
    chosen = np.zeros(n, dtype=np.int64)
    for k, half in enumerate(halves.tolist()):
        low = np.maximum(low, estimates[k] - _CONFIDENCE * sigmas[k])
        high = np.minimum(high, estimates[k] + _CONFIDENCE * sigmas[k])
        agreed &= low <= high
        agreed[:half] = agreed[n - half :] = False
        chosen[agreed] = k
    rows, steady = np.arange(n), median_filter(chosen, _MEDIAN_WINDOW)
    straddles = np.abs(estimates[steady, rows] - signal) > _STEP_THRESHOLD * sigma
    chosen = np.where(straddles, chosen, steady)
    return SmoothedSignal(estimates[chosen, rows], sigmas[chosen, rows])


@jit_compile
def _fit_local_polynomials(
    time: Array, signal: Array, halves: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return least-squares parabolas through windows about each sample, where the sample is.

    Of a window of three samples it is a line. Returns the values and the standard deviations that
    white noise of 1 leaves of them, shape (halves, n) each; beyond the ends of the signal windows
    are cut off.
    """
    n = len(signal)
    values, gains = np.empty((len(halves), n)), np.ones((len(halves), n))
    for i in range(n):
        s0, s1, s2, s3, s4 = 1.0, 0.0, 0.0, 0.0, 0.0
        b0, b1, b2 = 0.0, 0.0, 0.0
        done = 0
        for k in range(len(halves)):
            for j in range(done + 1, halves[k] + 1):
                for at in (i - j, i + j):
                    if at < 0 or at >= n:
                        continue
                    t, y = time[at] - time[i], signal[at] - signal[i]
                    s0, s1, s2 = s0 + 1.0, s1 + t, s2 + t * t
                    s3, s4 = s3 + t * t * t, s4 + t * t * t * t
                    b0, b1, b2 = b0 + y, b1 + t * y, b2 + t * t * y
            done = halves[k]
            straight = s0 * s2 - s1 * s1
            off, gain = b0 / s0, 1.0 / s0
            if done >= _ORDER and s0 > _ORDER + 1:
                c0, c1, c2 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
                whole = s0 * c0 + s1 * c1 + s2 * c2
                off, gain = (c0 * b0 + c1 * b1 + c2 * b2) / whole, c0 / whole
            elif done > 0 and straight > 0.0:
                off, gain = (s2 * b0 - s1 * b1) / straight, s2 / straight
            values[k, i], gains[k, i] = signal[i] + off, math.sqrt(gain)
    return values, gains
