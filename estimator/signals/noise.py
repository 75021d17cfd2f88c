"""White noise of a channel, estimated from the readings."""

import math

import numpy as np

from estimator.array_types import Array


def compute_divided_differences(time: Array, signal: Array, order: int) -> Array:
    """Return divided differences, normalised so that white noise of 1 has a variance of 1.

    Parameters
    ----------
    time, signal : ndarray
        Shape (n,), the time strictly rising.
    order : int
        m.

    Returns
    -------
    ndarray
        Shape (n - m,): sum w_j y_j over each m + 1 neighbours, w_j = 1 / prod_k (t_j - t_k), by
        the root of sum w_j^2.
    """
    count = len(time) - order
    t = time * ((len(time) - 1) / float(time[-1] - time[0]))  # in mean periods
    differences = signal
    for m in range(1, order + 1):
        differences = np.diff(differences) / (t[m:] - t[:-m])
    power = np.zeros(count)
    for j in range(order + 1):
        weight = np.ones(count)
        for k in range(order + 1):
            if k != j:
                weight /= t[j : j + count] - t[k : k + count]
        power += weight**2
    return np.asarray(differences / np.sqrt(power))


def compute_block_rms(values: Array, block: int) -> Array:
    """Return the root mean square of values over consecutive blocks."""
    count = max(len(values) // block, 1)
    return np.asarray(np.sqrt(np.mean(values[: count * block].reshape(count, -1) ** 2, axis=1)))


ORDERS = (2, 3, 4, 5, 6)  # of the differences that it is taken from
BLOCK_SIZE = 20  # differences of which one root mean square is taken
REST_QUANTILE = 0.25  # of the blocks without any change: the reading has steps, and no noise
STEPS_MAX = 1e4  # that a reading counted in steps changes by from one sample to the next
COUNT_TOLERANCE = 0.02  # of a step by which a change may be off a whole number of them


def estimate_white_noise(signal: Array, time: Array | None = None) -> float:
    """Return the standard deviation of a channel's white noise, in its unit.

    White noise contributes equally to (normalised, divided) differences of every order, motion less
    to higher ones, so the least of several orders is taken. Of each order it is the median over
    short blocks of their root mean square: bursts of motion do not count, and a reading in steps
    coarser than its noise still tells it, where a median of the differences themselves would be no
    or one step. A reading that rests without any change has none.

    Parameters
    ----------
    signal : ndarray
        Shape (n,), n >= 50.
    time : ndarray, optional
        When it was sampled [s], shape (n,), strictly rising; evenly by default.
    """
    time = np.arange(len(signal), dtype=np.float64) if time is None else time
    return min(_estimate_noise_by_order(signal, time, m) for m in ORDERS)


def find_quantisation_step(signal: Array) -> float:
    """Return the step in which a reading is counted.

    0 for one whose changes are not whole numbers of their least.

    Parameters
    ----------
    signal : ndarray
        Shape (n,).
    """
    changes = np.abs(np.diff(signal))
    changes = changes[changes > 0.0]
    if not len(changes):
        return 0.0
    step = float(changes.min())
    counts = changes / step
    if counts.max() > STEPS_MAX or np.abs(counts - np.rint(counts)).max() > COUNT_TOLERANCE:
        return 0.0
    return step


def _estimate_noise_by_order(signal: Array, time: Array, order: int) -> float:
    scatter = compute_block_rms(compute_divided_differences(time, signal, order), BLOCK_SIZE)
    if not np.quantile(scatter, REST_QUANTILE) > 0.0:
        return 0.0
    return float(np.median(scatter)) / _compute_median_ratio(order)


def _compute_median_ratio(order: int) -> float:
    """Return the median of a block's root mean square over its expectation.

    That of chi-square (Wilson and Hilferty, PNAS 17, 1931), with as many degrees of freedom as the
    differences, which correlate by C(2m, m+k)/C(2m, m), leave of a block (Bartlett 1946).
    """
    half = math.comb(2 * order, order)
    correlated = sum((math.comb(2 * order, order + k) / half) ** 2 for k in range(1, order + 1))
    freedom = BLOCK_SIZE / (1.0 + 2.0 * correlated)
    return math.pow(1.0 - 2.0 / (9.0 * freedom), 1.5)
