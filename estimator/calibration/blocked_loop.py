"""A record with the tip blocked, cut at the turns of the motor into branches and averaged.

The motor's travel is clean and tension is not, so turns are found in the travel, and a branch is
averaged over spans of travel: over tension the noise itself would choose what is averaged. Next to
a turn the tension changes with the square root of the travel, so the spans grow from the turn on.
"""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.noise_treatment import estimate_noise_sigma


class CalibrationError(ValueError):
    """Data insufficient for a calibration; the message says what is missing and what to do."""


MIN_SAMPLES = 40
"""Samples a branch needs."""

_REVERSAL_SHARE = 0.02  # of the travel: what comes back by less is no turn
_BIN_COUNT = 80  # of a branch
_END_SHARE = 0.1  # of a branch: what the tension at its end is read from
_NOISE_FLOOR = 1e-5  # of the peak; a record free of noise is not known better than the law holds
_SLACK_SIGMAS = 5.0  # sigma: tension below is slack, or nearly
_SWING_MAX = 4.0  # 2K of the largest friction for which a pull from low tension is trusted
_TRUSTED_SHARE = 0.6  # of the peak: where a first pull is trusted, whatever came before
_TURN_SIGMAS = 4.0  # sigma
_PLATEAU_SHARE = 0.03  # of the travel: a flat top as wide is a saturated cell, not a turn
_SATURATED_SLOPE_RATIO = 0.2  # of the slope below it


@dataclass(frozen=True, slots=True)
class Branch:
    """A motion in one direction, averaged: shape (n,) each, in order of time."""

    pull: bool
    T: Array  # [N]
    q: Array  # [m]
    count: Array  # samples in each average
    readings: Array  # those of travel that differ: at rest an encoder errs by one and the same


@dataclass(frozen=True, slots=True)
class BlockedLoop:
    """Branches of which the first is a pull, pulls and releases in turn."""

    # what the law describes of them: no slack, no pull that may still feel an unknown past
    branches: tuple[Branch, ...]
    turns: Array  # T_in [N] at the end of each branch, shape (branches,)
    start: float  # T_in [N] at the beginning
    travel: float  # of the motor in the first pull [m]
    sigma: float  # noise of a sample of tension [N]
    step: float  # noise of a sample of travel [m], or what its resolution amounts to

    @property
    def peak(self) -> float:
        """The highest turn [N]."""
        return float(self.turns.max())

    @property
    def slack(self) -> float:
        """Tension [N] below which noise hides whether the tendon is taut."""
        return max(_SLACK_SIGMAS * self.sigma, 1e-3 * self.peak)


def segment_loop(tension: ArrayLike, displacement: ArrayLike) -> BlockedLoop:
    """Cut T_in [N] and q_p [m], shape (n,), in order of time, into branches.

    Raises
    ------
    CalibrationError
        If there is not a pull and a release to be found, or the load cell is saturated.
    """
    T, q = validate_signals(tension, displacement, 2 * MIN_SAMPLES, CalibrationError)
    sigma = max(estimate_noise_sigma(T), _NOISE_FLOOR * float(np.abs(T).max()))
    resolution = _estimate_resolution(q)
    step = resolution / math.sqrt(12.0) if resolution else max(estimate_noise_sigma(q), 1e-9)
    if np.ptp(T) < 20.0 * sigma or np.ptp(q) < 20.0 * step:
        raise CalibrationError(
            "nothing moves, or tension never rises: pull the tendon against the blocked tip"
        )
    ends = [0, *_find_turning_points(q)]
    if q[ends[1]] < q[ends[0]]:
        ends = ends[1:]  # released before the first pull
    if len(ends) < 2 or ends[1] - ends[0] < MIN_SAMPLES:
        raise CalibrationError("no pull before the release: record the loop from before the pull")
    if len(ends) < 3:
        raise CalibrationError("no release after the pull: record the loop to the end")
    spans = list(itertools.pairwise(ends))
    if min(b - a for a, b in spans) < MIN_SAMPLES:
        raise CalibrationError(
            f"a branch of fewer than {MIN_SAMPLES} samples: record more slowly or more densely"
        )
    _refuse_saturation(T, q, spans[0])
    turns = np.array([_estimate_end_tension(T[a : b + 1], q[a : b + 1]) for a, b in spans])
    start = float(np.median(T[ends[0] : ends[0] + 5]))
    travel = float(q[ends[1]] - q[ends[0]])
    rough = BlockedLoop((), turns, start, travel, sigma, step)
    if turns[0] < 0.8 * rough.peak or turns[1] > 0.9 * turns[0]:
        raise CalibrationError(
            f"turns at {turns[0]:.3g} N and {turns[1]:.3g} N: pull to the highest tension first, "
            "then release well below it"
        )
    branches = tuple(
        _average_branch(T[a : b + 1], q[a : b + 1], rough, number, resolution)
        for number, (a, b) in enumerate(spans)
    )
    return replace(rough, branches=branches)


def validate_signals(
    tension: ArrayLike, signal_values: ArrayLike, samples_min: int, error: type[ValueError]
) -> tuple[Array, Array]:
    """Return a tension and another signal, shape (n,); raises `error` where they cannot be used."""
    T = np.asarray(tension, dtype=np.float64)
    signal = np.asarray(signal_values, dtype=np.float64)
    if T.ndim != 1 or T.shape != signal.shape:
        raise error(f"shapes {T.shape} and {signal.shape}: give two rows of equal length")
    if len(T) < samples_min:
        raise error(f"{len(T)} samples, at least {samples_min} are needed: record more densely")
    missing = np.flatnonzero(~(np.isfinite(T) & np.isfinite(signal)))
    if len(missing):
        raise error(
            f"{len(missing)} samples are not finite, the first at index {missing[0]}: remove them"
        )
    return T, signal


def _estimate_resolution(q: Array) -> float:
    """Return the smallest step between different readings that is no rounding [m]."""
    levels = np.unique(q)
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * float(np.ptp(q))]
    # Steps of an encoder are all alike; a smooth signal has as many gaps as samples.
    return float(gaps.min()) if len(gaps) and len(levels) < 0.9 * len(q) else 0.0


def _find_turning_points(q: Array) -> list[int]:
    """Return where the motor turned, the last sample included; from a rest, its end."""
    swing = _REVERSAL_SHARE * float(np.ptp(q))
    up = q[int(np.argmax(np.abs(q - q[0]) > swing))] > q[0]
    turns, furthest = [], 0
    for i in range(len(q)):
        ahead = q[i] - q[furthest] if up else q[furthest] - q[i]
        if ahead >= 0.0:
            furthest = i
        elif ahead < -swing:
            turns.append(furthest)
            furthest, up = i, not up
    return [*turns, len(q) - 1]


def _estimate_end_tension(T: Array, q: Array) -> float:
    """Return the tension at the last travel; the extreme sample would be extreme by its noise."""
    distance = np.abs(q - q[-1]) / max(abs(q[0] - q[-1]), 1e-12)
    is_near_end = distance < _END_SHARE
    degree = 2 if int(is_near_end.sum()) > 12 else 0
    return float(np.polynomial.polynomial.polyfit(distance[is_near_end], T[is_near_end], degree)[0])


def _refuse_saturation(T: Array, q: Array, span: tuple[int, int]) -> None:
    T, q = T[span[0] : span[1] + 1], q[span[0] : span[1] + 1]
    travel = float(q[-1] - q[0])
    top = q > q[-1] - _PLATEAU_SHARE * travel
    is_below = ~top & (q > q[-1] - 10.0 * _PLATEAU_SHARE * travel)
    if np.ptp(q[top]) <= 0.0 or is_below.sum() < 3:
        return
    rate_top, rate_below = (float(np.polyfit(q[k], T[k], 1)[0]) for k in (top, is_below))
    noise = (
        3.0
        * estimate_noise_sigma(T)
        / max(float(np.std(q[top])) * math.sqrt(int(top.sum())), 1e-12)
    )
    if rate_top + noise < _SATURATED_SLOPE_RATIO * rate_below or (
        rate_top < _SATURATED_SLOPE_RATIO * rate_below and rate_below > 2.0 * noise
    ):
        raise CalibrationError(
            f"tension stays at {float(np.median(T[top])):.4g} N while the motor goes on: the tip "
            "gives way, or the load cell is saturated and the peak must be lower"
        )


def _average_branch(
    T: Array, q: Array, loop: BlockedLoop, number: int, resolution: float
) -> Branch:
    share = np.sqrt(np.clip(np.abs(q - q[0]) / abs(q[-1] - q[0]), 0.0, 1.0))
    span = np.minimum((share * _BIN_COUNT).astype(np.int64), _BIN_COUNT - 1)
    count = np.bincount(span, minlength=_BIN_COUNT)
    has_samples = count > 0
    mean_T = np.bincount(span, T, _BIN_COUNT)[has_samples] / count[has_samples]
    mean_q = np.bincount(span, q, _BIN_COUNT)[has_samples] / count[has_samples]
    n = count[has_samples].astype(np.float64)
    readings = n
    if resolution:
        different = np.unique(np.column_stack([span, np.rint(q / resolution)]), axis=0)[:, 0]
        number_of = np.bincount(different.astype(np.int64), minlength=_BIN_COUNT)
        readings = number_of[has_samples].astype(np.float64)
    usable = mean_T > loop.slack
    pull = number % 2 == 0
    begin = loop.start if number == 0 else float(loop.turns[number - 1])
    if number == 0 or begin < loop.slack:
        # The profile before is unknown, but nowhere above T e^s: the pull has wiped it out from
        # e^2K on.
        from_ = min(max(begin, loop.slack) * math.exp(_SWING_MAX), _TRUSTED_SHARE * loop.peak)
        usable &= mean_T > (from_ if pull else 0.0)
    else:
        usable &= np.abs(mean_T - begin) > _TURN_SIGMAS * loop.sigma / np.sqrt(n)
    return Branch(pull, mean_T[usable], mean_q[usable], n[usable], readings[usable])
