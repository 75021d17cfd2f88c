"""When samples were taken: by their time stamps, or evenly where only the stamps jitter.

A loop that reads late has stamps that are uneven and true; one that reads evenly and is stamped
late, by a receiver or by a clock that counts in milliseconds, has stamps that are wrong. The motion
tells them apart: against wrong times it is rough. Derivatives are divided differences over the
times, so that uneven samples of a motion are no noise.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import Signals

STEP_SCATTER_MAX = 0.02  # of the period: scatter of the steps below which stamps are even
GAP_PERIODS = 1.75  # periods: a step with a sample missing in it
DIFFERENCE_ORDER = 3  # of the differences that roughness is taken from
BLOCK_SIZE = 20  # of them, of which one root mean square is taken
ROUGHNESS_QUANTILE = 0.8  # quantile of the blocks: the motor may be at rest for most of a record
ROUGHNESS_RATIO_MIN = (
    1.25  # by stamps than by even times, all channels multiplied: the stamps are wrong
)
DRIFT_WINDOW = 99  # samples over which a clock runs evenly; no record is shorter
PHASE_GAIN, PERIOD_GAIN = (
    0.1,
    0.002,
)  # of a stamp's error that corrects the phase and the period of a clock


class SampleTimes(NamedTuple):
    """When the samples of a record were taken."""

    time: Array  # [s], shape (n,), strictly rising
    jitter: float  # [s] rms of the stamps about it; 0 where they are the time


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


def estimate_sample_times(time: Array, signals: Signals) -> SampleTimes:
    """Return when the samples of a record were taken: by their stamps, or evenly.

    Parameters
    ----------
    time : ndarray
        Stamps [s], shape (n,), strictly rising.
    signals : dict
        By channel, shape (n,) each, NaN where a value is missing.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    usual = steps[steps < GAP_PERIODS * period]
    if not float(usual.std()) > STEP_SCATTER_MAX * period:
        return SampleTimes(time, 0.0)
    candidates = [
        _fit_even_times(time, counted)
        for counted in (_count_without_gaps(time), _count_with_gaps(time))
    ]
    roughness = [_compute_roughness(one, signals) for one in candidates]
    best = int(np.argmin(roughness))
    if roughness[best] + math.log(ROUGHNESS_RATIO_MIN) > _compute_roughness(time, signals):
        return SampleTimes(time, 0.0)
    even = candidates[best]
    return SampleTimes(even, float(np.std(time - even)))


def _compute_roughness(time: Array, signals: Signals) -> float:
    """Return ln of how rough channels are over a time, all together."""
    total = 0.0
    for signal in signals.values():
        present = np.isfinite(signal)
        span = float(np.ptp(signal[present]))
        if not span > 0.0:
            continue
        rough = compute_block_rms(
            compute_divided_differences(time[present], signal[present], DIFFERENCE_ORDER),
            BLOCK_SIZE,
        )
        total += math.log(max(float(np.quantile(rough, ROUGHNESS_QUANTILE)), 1e-12 * span))
    return total


def _count_without_gaps(time: Array) -> Array:
    """Return the counts of samples none of which is missing."""
    return np.arange(len(time), dtype=np.float64)


def _count_with_gaps(time: Array) -> Array:
    """Return the counts of samples by a clock that follows their stamps, missing ones counted."""
    period = float(np.median(np.diff(time)))
    counts, clock, count = np.zeros(len(time)), float(time[0]), 0
    for i, stamp in enumerate(time[1:].tolist(), start=1):
        passed = max(1, round((stamp - clock) / period))
        count += passed
        clock += passed * period
        late = stamp - clock
        clock += PHASE_GAIN * late
        period += PERIOD_GAIN * late / passed
        counts[i] = count
    return counts


def _fit_even_times(time: Array, counts: Array) -> Array:
    """Return times in proportion to counts, but for a clock that drifts over `DRIFT_WINDOW` samples."""
    from scipy.signal import savgol_filter  # here: the control processes import this module

    period = float(np.polyfit(counts, time, 1)[0])
    drift = savgol_filter(time - period * counts, DRIFT_WINDOW, 1)
    even = period * counts + drift
    return np.asarray(even) if np.all(np.diff(even) > 0.0) else time
