"""What drives a simulation: the measured driver without its noise.

What drives a hysteresis must not jitter, or the jitter is remembered: noise of 1 um on a travel is
0.4 N behind a reversal at 10 N. So noise is smoothed where the motion allows it, and between its
turning points the drive is monotone, which keeps its peaks (docs/theory.md, section 9).
"""

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.smoothing import smooth_signal
from estimator.effects.effect import PROXIMAL_TENSION

SPEED_WINDOW = 0.02  # [s] over which speed is taken
TURN_CANDIDATES = 24  # places in a rest at which the motor may have turned


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
    jitter = SETTINGS.jitter * sigma
    return Drive(make_monotone(tension, find_turning_points(tension, jitter), jitter), jitter)


def estimate_travel_drive(travel: Array, sigma: float, time: Array | None = None) -> Drive:
    """Return the drive of a travel [m] with white noise `sigma`: smooth, monotone between turns.

    It was sampled at `time` [s], evenly by default.
    """
    smoothed, left = smooth_signal(travel, sigma, time)
    jitter = max(
        SETTINGS.jitter * float(np.quantile(left, SETTINGS.jitter_quantile)),
        SETTINGS.reversal_noise * sigma,
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
    out = signal.copy()
    for begin, end in itertools.pairwise(turns):
        piece = slice(begin, end + 1)
        rises = bool(signal[end] >= signal[begin])
        out[piece] = isotonic_regression(signal[piece], increasing=rises).x
    # with noise the extreme sample overshoots: clip it to its neighbours
    for turn in turns[1:-1]:
        beside = out[[turn - 1, turn + 1]]
        if abs(signal[turn] - beside.mean()) < band:
            out[turn] = np.clip(signal[turn], beside.min(), beside.max())
    return out


def _find_latest_turns(travel: Array, smoothed: Array, turns: list[int], sigma: float) -> list[int]:
    """Return turning points, each as late as noise lets it be.

    A motor that rests before it turns back has its extreme anywhere in the rest, by noise; at that
    sample, friction would reverse for the rest of the rest.
    """
    latest = list(turns)
    for i in range(1, len(turns) - 1):
        turn = turns[i]
        near = np.abs(smoothed - smoothed[turn]) <= SETTINGS.jitter * sigma
        begin = turn - _count_leading_true(near[latest[i - 1] : turn + 1][::-1]) + 1
        end = turn + _count_leading_true(near[turn : turns[i + 1]]) - 1
        if end <= turn:
            continue
        rises = bool(smoothed[turn] > smoothed[turns[i - 1]])
        places = np.unique(np.linspace(turn, end, TURN_CANDIDATES).astype(np.int64))
        errors = np.array(
            [
                _compute_monotone_error(travel[begin : at + 1], rises=rises)
                + _compute_monotone_error(travel[at : end + 1], rises=not rises)
                for at in places
            ]
        )
        equal = errors <= errors.min() + SETTINGS.equal_error * sigma**2
        latest[i] = int(places[np.flatnonzero(equal)[-1]])
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
    ahead = np.minimum(np.arange(len(time)) + reach, len(time) - 1)
    behind = np.maximum(np.arange(len(time)) - reach, 0)
    return np.asarray((signal[ahead] - signal[behind]) / (time[ahead] - time[behind]))


class Turns(NamedTuple):
    """Turns of the motor between two samples."""

    rows: list[int]  # before which they belong
    time: list[float]  # [s]
    drive: list[float]  # [m]

    def insert(self, time: Array, signal: Array) -> Array:
        """Return a signal with rows at the turns, interpolated."""
        return np.insert(signal, self.rows, np.interp(self.time, time, signal))

    def between(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask with rows at the turns, true where it is on both sides of one."""
        rows = np.array(self.rows, dtype=np.int64)
        return np.insert(mask, rows, mask[rows - 1] & mask[rows])


def find_turns_between_samples(time: Array, drive: Array, least: float) -> Turns:
    """Return where the motor turned between two samples, further than those by `least` [m].

    Friction remembers how far it went. A parabola through three samples tells, where the motion is
    round there.
    """
    bend = np.diff(np.diff(drive) / np.diff(time)) / (time[2:] - time[:-2])
    turns = Turns([], [], [])
    for i in find_turning_points(drive, SETTINGS.reversal * float(np.ptp(drive)))[1:-1]:
        about = bend[max(i - 2, 0) : i + 1]
        if len(about) < 3 or np.ptp(np.sign(about)):
            continue
        if not np.abs(about).min() > SETTINGS.corner * float(np.abs(about).max()):
            continue
        before, here = float(time[i - 1]), float(time[i])
        slope = float(drive[i] - drive[i - 1]) / (here - before)
        at = 0.5 * (before + here) - 0.5 * slope / float(about[1])
        height = float(drive[i - 1]) + (at - before) * (slope + float(about[1]) * (at - here))
        earliest = max([before, *turns.time[-1:]])
        if abs(height - float(drive[i])) > least and earliest < at < float(time[i + 1]):
            turns.rows.append(i if at < here else i + 1)
            turns.time.append(at)
            turns.drive.append(height)
    return turns
