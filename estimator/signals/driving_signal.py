"""What drives a simulation: the measured driver without its noise.

What drives a hysteresis must not jitter, or the jitter is remembered: noise of 1 um on a travel is
0.4 N behind a reversal at 10 N. So noise is smoothed where the motion allows it, and between its
turning points the drive is monotone, which keeps its peaks (docs/explanation/theory.md, section 9).
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.compiled import jit_compile
from estimator.effects.effect import PROXIMAL_TENSION

# --- the motion behind a noisy travel, by local polynomials whose window adapts to the motion
# At each sample the widest window is taken whose estimate agrees with those of all narrower ones
# (intersection of confidence intervals: Goldenshluger and Nemirovski 1997, Katkovnik 1999): wide at
# rest and at constant speed, narrow where the motor turns, and never across a step of the reading.


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
        included = 0
        for k in range(len(halves)):
            for j in range(included + 1, halves[k] + 1):
                for row in (i - j, i + j):
                    if row < 0 or row >= n:
                        continue
                    t, y = time[row] - time[i], signal[row] - signal[i]
                    s0, s1, s2 = s0 + 1.0, s1 + t, s2 + t * t
                    s3, s4 = s3 + t * t * t, s4 + t * t * t * t
                    b0, b1, b2 = b0 + y, b1 + t * y, b2 + t * t * y
            included = halves[k]
            line_determinant = s0 * s2 - s1 * s1
            offset, gain = b0 / s0, 1.0 / s0
            if included >= _ORDER and s0 > _ORDER + 1:
                c0, c1, c2 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
                determinant = s0 * c0 + s1 * c1 + s2 * c2
                offset, gain = (c0 * b0 + c1 * b1 + c2 * b2) / determinant, c0 / determinant
            elif included > 0 and line_determinant > 0.0:
                offset, gain = (s2 * b0 - s1 * b1) / line_determinant, s2 / line_determinant
            values[k, i], gains[k, i] = signal[i] + offset, math.sqrt(gain)
    return values, gains


SPEED_WINDOW = 0.02  # [s] over which speed is taken
JITTER = 4.0  # minimum reversal size, in sigma of the drive's noise
JITTER_QUANTILE = 0.9  # of the noise that smoothing leaves on its samples
REVERSAL_NOISE = 3.0  # minimum reversal size, in sigma of a travel's noise
REVERSAL_SHARE = 1e-3  # of the drive's range that the motor goes back by, at least
TURN_CANDIDATES = 24  # places in a rest at which the motor may have turned
EQUAL_ERROR = 12.0  # noise variances by which two places of a reversal fit alike
CORNER_RATIO = 0.4  # least over largest curvature about a reversal; below it is a corner


class Drive(NamedTuple):
    """A driver without its noise."""

    signal: Array  # shape (n,)
    jitter: float  # how far it goes back at a turn, at least


def estimate_drive(driver: str, time: Array, measured: Array, sigma: float) -> Drive:
    """Return the drive of a channel with white noise `sigma`, sampled at `time` [s]."""
    if driver == PROXIMAL_TENSION:
        return estimate_tension_drive(measured, sigma)
    return estimate_travel_drive(measured, sigma, time)


def estimate_tension_drive(tension: Array, sigma: float) -> Drive:
    """Return the drive of a tension [N] with noise `sigma`: monotone between its turns."""
    jitter = JITTER * sigma
    return Drive(make_monotone(tension, find_turning_points(tension, jitter), jitter), jitter)


def estimate_travel_drive(travel: Array, sigma: float, time: Array | None = None) -> Drive:
    """Return the drive of a travel [m] with white noise `sigma`: smooth, monotone between turns.

    It was sampled at `time` [s], evenly by default.
    """
    smoothed, residual_sigma = smooth_signal(travel, sigma, time)
    jitter = max(
        JITTER * float(np.quantile(residual_sigma, JITTER_QUANTILE)),
        REVERSAL_NOISE * sigma,
    )
    turns = _find_latest_turns(travel, smoothed, find_turning_points(smoothed, jitter), sigma)
    return Drive(make_monotone(smoothed, turns, jitter), jitter)


def make_monotone(signal: Array, turns: list[int], band: float) -> Array:
    """Return a signal made monotone between its turning points, which are `band` apart or more."""
    from scipy.optimize import isotonic_regression  # here: the control processes import this module

    if band <= 0.0:
        return signal
    if len(turns) <= 2 and float(np.ptp(signal)) <= band:
        return np.full_like(signal, float(signal.mean()))
    monotone = signal.copy()
    for begin, end in itertools.pairwise(turns):
        piece = slice(begin, end + 1)
        rises = bool(signal[end] >= signal[begin])
        monotone[piece] = isotonic_regression(signal[piece], increasing=rises).x
    # with noise the extreme sample overshoots: clip it to its neighbours
    for turn in turns[1:-1]:
        neighbours = monotone[[turn - 1, turn + 1]]
        if abs(signal[turn] - neighbours.mean()) < band:
            monotone[turn] = np.clip(signal[turn], neighbours.min(), neighbours.max())
    return monotone


def _find_latest_turns(travel: Array, smoothed: Array, turns: list[int], sigma: float) -> list[int]:
    """Return turning points, each as late as noise lets it be.

    A motor that rests before it turns back has its extreme anywhere in the rest, by noise; at that
    sample, friction would reverse for the rest of the rest.
    """
    latest = list(turns)
    for i in range(1, len(turns) - 1):
        turn = turns[i]
        is_near = np.abs(smoothed - smoothed[turn]) <= JITTER * sigma
        begin = turn - _count_leading_true(is_near[latest[i - 1] : turn + 1][::-1]) + 1
        end = turn + _count_leading_true(is_near[turn : turns[i + 1]]) - 1
        if end <= turn:
            continue
        rises = bool(smoothed[turn] > smoothed[turns[i - 1]])
        candidates = np.unique(np.linspace(turn, end, TURN_CANDIDATES).astype(np.int64))
        errors = np.array(
            [
                _compute_monotone_error(travel[begin : row + 1], rises=rises)
                + _compute_monotone_error(travel[row : end + 1], rises=not rises)
                for row in candidates
            ]
        )
        is_equivalent = errors <= errors.min() + EQUAL_ERROR * sigma**2
        latest[i] = int(candidates[np.flatnonzero(is_equivalent)[-1]])
    return latest


def _count_leading_true(mask: Array) -> int:
    """Return how many of the first entries are true."""
    return len(mask) if mask.all() else int(np.argmin(mask))


def _compute_monotone_error(signal: Array, *, rises: bool) -> float:
    from scipy.optimize import isotonic_regression

    return float(np.sum((isotonic_regression(signal, increasing=rises).x - signal) ** 2))


def find_turning_points(signal: Array, band: float) -> list[int]:
    """Return where a signal turns by more than `band`, its first and last sample with them."""
    turns = [0]
    extreme, rising = 0, None
    values = signal.tolist()
    for i, x in enumerate(values):
        if rising is None:
            if abs(x - values[0]) > band:
                rising, extreme = x > values[0], i
        elif (x >= values[extreme]) == rising:
            extreme = i
        elif abs(x - values[extreme]) > band:
            turns.append(extreme)
            rising, extreme = not rising, i
    if turns[-1] != len(values) - 1:
        turns.append(len(values) - 1)
    return turns


def compute_rate(time: Array, signal: Array) -> Array:
    """Return the slope of a signal over a few samples [1/s], shape (n,)."""
    reach = max(1, round(0.5 * SPEED_WINDOW / float(np.median(np.diff(time)))))
    next_rows = np.minimum(np.arange(len(time)) + reach, len(time) - 1)
    previous_rows = np.maximum(np.arange(len(time)) - reach, 0)
    return np.asarray(
        (signal[next_rows] - signal[previous_rows]) / (time[next_rows] - time[previous_rows])
    )


class Turns(NamedTuple):
    """Turns of the motor between two samples."""

    rows: list[int]  # before which they belong
    time: list[float]  # [s]
    drive: list[float]  # [m]

    def interpolate_signal(self, time: Array, signal: Array) -> Array:
        """Return a signal with rows at the turns, interpolated."""
        return np.insert(signal, self.rows, np.interp(self.time, time, signal))

    def interpolate_mask(self, mask: Mask) -> Mask:
        """Return a mask with rows at the turns, true where it is on both sides of one."""
        rows = np.array(self.rows, dtype=np.int64)
        return np.insert(mask, rows, mask[rows - 1] & mask[rows])


def find_turns_between_samples(time: Array, drive: Array, excess_min: float) -> Turns:
    """Return where the motor turned between two samples, further than both by `excess_min` [m].

    Friction remembers how far it went. A parabola through three samples tells, where the motion is
    round there.
    """
    curvatures = np.diff(np.diff(drive) / np.diff(time)) / (time[2:] - time[:-2])
    turns = Turns([], [], [])
    for i in find_turning_points(drive, REVERSAL_SHARE * float(np.ptp(drive)))[1:-1]:
        curvature = curvatures[max(i - 2, 0) : i + 1]
        if len(curvature) < 3 or np.ptp(np.sign(curvature)):
            continue
        if not np.abs(curvature).min() > CORNER_RATIO * float(np.abs(curvature).max()):
            continue
        time_before, time_here = float(time[i - 1]), float(time[i])
        slope = float(drive[i] - drive[i - 1]) / (time_here - time_before)
        turn_time = 0.5 * (time_before + time_here) - 0.5 * slope / float(curvature[1])
        turn_drive = float(drive[i - 1]) + (turn_time - time_before) * (
            slope + float(curvature[1]) * (turn_time - time_here)
        )
        earliest = max([time_before, *turns.time[-1:]])
        if abs(turn_drive - float(drive[i])) > excess_min and earliest < turn_time < float(
            time[i + 1]
        ):
            turns.rows.append(i if turn_time < time_here else i + 1)
            turns.time.append(turn_time)
            turns.drive.append(turn_drive)
    return turns
