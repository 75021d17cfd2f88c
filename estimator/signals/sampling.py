"""When samples were taken: by their time stamps, or evenly where only the stamps jitter.

A loop that reads late has stamps that are uneven and true; one that reads evenly and is stamped
late, by a receiver or by a clock that counts in milliseconds, has stamps that are wrong. The motion
tells them apart: against wrong times it is rough. Derivatives are divided differences over the
times, so that uneven samples of a motion are no noise.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.effects.effect import Signals
from estimator.noise_treatment import estimate_noise_sigma
from estimator.signals.noise import (
    compute_block_rms,
    compute_divided_differences,
    find_quantisation_step,
)
from estimator.signals.spikes import find_spikes

STEP_SCATTER_MAX = 0.02  # of the period: scatter of the steps below which stamps are even
GAP_PERIODS = 1.75  # periods: a step with a sample missing in it
DIFFERENCE_ORDER = 3  # of the differences that roughness is taken from
BLOCK_SIZE = 20  # of them, of which one root mean square is taken
ROUGHNESS_QUANTILE = 0.8  # of the blocks: the motor may be at rest for most of a record
ROUGHNESS_RATIO_MIN = 1.25  # by stamps over by even times, all channels: the stamps are wrong
DRIFT_WINDOW = 99  # samples over which a clock runs evenly; no record is shorter
# of a stamp's error that corrects the phase and the period of a clock
PHASE_GAIN, PERIOD_GAIN = 0.1, 0.002


class SampleTimes(NamedTuple):
    """When the samples of a record were taken."""

    time: Array  # [s], shape (n,), strictly rising
    jitter: float  # [s] rms of the stamps about it; 0 where they are the time


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
    regular_steps = steps[steps < GAP_PERIODS * period]
    if not float(regular_steps.std()) > STEP_SCATTER_MAX * period:
        return SampleTimes(time, 0.0)
    without_gaps = np.arange(len(time), dtype=np.float64)
    candidates = [
        _fit_even_times(time, counts) for counts in (without_gaps, _count_with_gaps(time))
    ]
    roughness = [_compute_roughness(times, signals) for times in candidates]
    best = int(np.argmin(roughness))
    if roughness[best] + math.log(ROUGHNESS_RATIO_MIN) > _compute_roughness(time, signals):
        return SampleTimes(time, 0.0)
    even_times = candidates[best]
    return SampleTimes(even_times, float(np.std(time - even_times)))


def _compute_roughness(time: Array, signals: Signals) -> float:
    """Return ln of how rough channels are over a time, all together."""
    total = 0.0
    for signal in signals.values():
        present = np.isfinite(signal)
        span = float(np.ptp(signal[present]))
        if not span > 0.0:
            continue
        block_rms = compute_block_rms(
            compute_divided_differences(time[present], signal[present], DIFFERENCE_ORDER),
            BLOCK_SIZE,
        )
        total += math.log(max(float(np.quantile(block_rms, ROUGHNESS_QUANTILE)), 1e-12 * span))
    return total


def _count_with_gaps(time: Array) -> Array:
    """Return the counts of samples by a clock that follows their stamps, missing ones counted."""
    period = float(np.median(np.diff(time)))
    counts, clock, count = np.zeros(len(time)), float(time[0]), 0
    for i, stamp in enumerate(time[1:].tolist(), start=1):
        elapsed_periods = max(1, round((stamp - clock) / period))
        count += elapsed_periods
        clock += elapsed_periods * period
        lag = stamp - clock
        clock += PHASE_GAIN * lag
        period += PERIOD_GAIN * lag / elapsed_periods
        counts[i] = count
    return counts


def _fit_even_times(time: Array, counts: Array) -> Array:
    """Return times in proportion to counts, but for a clock that drifts."""
    from scipy.signal import savgol_filter  # here: the control processes import this module

    period = float(np.polyfit(counts, time, 1)[0])
    drift = savgol_filter(time - period * counts, DRIFT_WINDOW, 1)
    even_times = period * counts + drift
    return np.asarray(even_times) if np.all(np.diff(even_times) > 0.0) else time


# --- values that are missing (NaN) in one channel of a record while others have theirs
# They are not compared. What drives the simulation must be known: rows without it are removed.


LONG_GAP = 0.25  # [s] and
# sample times between two values: a curve drawn through both would be invented
LONG_GAP_PERIODS = 5.0


def drop_missing(signal: Array) -> Array:
    """Return the values of a signal that are not missing, in their order."""
    return signal[np.isfinite(signal)]


def mark_missing(signals: Signals) -> Signals:
    """Return signals with NaN for what is not finite."""
    return {name: np.where(np.isfinite(signal), signal, np.nan) for name, signal in signals.items()}


def select_signal_rows(time: Array, signals: Signals, rows: Mask) -> tuple[Array, Signals]:
    """Return some of the rows of a record."""
    return time[rows], {name: signal[rows] for name, signal in signals.items()}


def find_long_gaps(time: Array, present: Mask) -> Mask:
    """Return which times [s] lie where no value is present for long, shape (n,)."""
    times = time[present]
    steps = np.diff(times, prepend=time[0], append=time[-1])
    long_steps = np.flatnonzero(
        steps > max(LONG_GAP, LONG_GAP_PERIODS * float(np.median(np.diff(times))))
    )
    edges = np.concatenate([[-np.inf], times, [np.inf]])
    inside = np.zeros(len(time), dtype=np.bool_)
    for begin, end in zip(edges[long_steps], edges[long_steps + 1], strict=True):
        inside |= (begin < time) & (time < end)
    return inside


# --- samples that only repeat the one before, as their sensor is slower than the record

REGULAR_SHARE = 0.8  # of the new values, that come at one distance, or a sample more or less
STEPS_MIN = 4.0  # of a reading's rounding, between two new values: fewer are a slow motion


def find_held_samples(signal: Array, step: float) -> Mask:
    """Return which samples of a channel are held ones; none where the sensor keeps up.

    Parameters
    ----------
    signal : ndarray
        Shape (n,).
    step : float
        In which the reading is counted; 0 for none.
    """
    no_samples = np.zeros(len(signal), dtype=np.bool_)
    changes = np.flatnonzero(np.diff(signal)) + 1
    if len(changes) < 3:
        return no_samples
    distances = np.diff(changes)
    usual_distance = float(np.median(distances))
    if usual_distance < 2.0 or np.mean(np.abs(distances - usual_distance) <= 1.0) < REGULAR_SHARE:
        return no_samples
    if np.median(np.abs(np.diff(signal[changes]))) < STEPS_MIN * step:
        return no_samples
    is_held = ~no_samples
    is_held[changes] = is_held[0] = False
    return is_held


# --- which samples of a record are fitted, and which are held out: blocks in turn

BLOCK = 5.0  # [s] that are fitted, and as long that are held out
BLOCKS_MIN = 12  # of a record; in a short one they are shorter
IMBALANCE_MAX = 0.5  # of what moves both halves, up to which every other block is fitted
REST_SPEED_RATIO = 0.02  # of a high speed, below which the drive rests


def select_training_half(block: NDArray[np.int64], drive: Array, speed: Array) -> Mask:
    """Return which samples are fitted: every other block, if both halves see the same motion.

    A motion that repeats itself may be in one half while it pulls and in the other while it lets
    go. Then they are chosen aperiodically.
    """
    alternate: Mask = block % 2 == 0
    if _compute_imbalance(alternate, drive, speed) < IMBALANCE_MAX:
        return alternate
    halves = alternate, select_aperiodic_half(block)
    return min(halves, key=lambda half: _compute_imbalance(half, drive, speed))


def select_aperiodic_half(block: NDArray[np.int64]) -> Mask:
    """Return which samples are in blocks whose number has an even count of ones.

    The sequence of Thue and Morse repeats nothing, so that no cycle falls onto it.
    """
    parity = np.zeros_like(block)
    while block.any():
        parity, block = parity ^ (block & 1), block >> 1
    return np.asarray(parity == 0)


def _compute_imbalance(fitted: Mask, drive: Array, speed: Array) -> float:
    """Return how differently two halves are moved: 0 if the same, 1 if nothing is in both.

    It is the distance in total variation between what they have of low, middle and high drive,
    each while it rises, rests and falls.
    """
    level = np.searchsorted(np.quantile(drive, [1.0 / 3.0, 2.0 / 3.0]), drive)
    rest_speed = REST_SPEED_RATIO * float(np.quantile(np.abs(speed), 0.95))
    direction = np.sign(speed) * (np.abs(speed) > rest_speed)
    state = (3 * level + direction + 1.0).astype(np.int64)
    shares = [
        np.bincount(state[half], minlength=9) / max(int(half.sum()), 1)
        for half in (fitted, ~fitted)
    ]
    return 0.5 * float(np.abs(shares[0] - shares[1]).sum())


def assign_blocks(time: Array, share: float = 1.0) -> NDArray[np.int64]:
    """Return the number of the block each sample is in, shape (n,); they are a `share` as long."""
    length = share * min(BLOCK, float(time[-1] - time[0]) / BLOCKS_MIN)
    length = max(length, 2.0 * float(np.median(np.diff(time))))
    return np.asarray((time - time[0]) / length, dtype=np.int64)


# --- a long record with fewer samples: means of several


class DecimatedRecord(NamedTuple):
    """A record of which several samples were averaged to one."""

    time: Array
    signals: Signals
    valid: dict[str, Mask]
    present: dict[str, Mask]
    averaged: dict[str, float]  # values in a sample, by channel
    decimation_factor: int  # samples in one


def decimate_record(
    time: Array,
    signals: Signals,
    valid: dict[str, Mask],
    present: dict[str, Mask],
    samples_max: int,
) -> DecimatedRecord:
    """Return every k-th sample, all channels averaged over the k around it.

    What does not count is interpolated in `signals`, so that a mean of few values is one at the
    same time as that of many. A channel counts where it has more than half as many values as it
    usually has, and none where samples before and after a gap come together.
    """
    k = math.ceil(len(time) / samples_max)
    if k <= 1:
        return DecimatedRecord(time, signals, valid, present, dict.fromkeys(signals, 1.0), 1)
    rows = np.arange(k // 2, len(time) - (k - 1) // 2, k)
    window = rows[:, None] + np.arange(k) - k // 2
    spans = time[window[:, -1]] - time[window[:, 0]]
    unbroken = spans < float(np.median(spans)) + LONG_GAP
    counts = {name: mask[window].sum(axis=1) for name, mask in valid.items()}
    usual_counts = {name: float(np.median(count[count > 0])) for name, count in counts.items()}
    return DecimatedRecord(
        time[window].mean(axis=1),
        {name: signal[window].sum(axis=1) / k for name, signal in signals.items()},
        {name: unbroken & (count > 0.5 * usual_counts[name]) for name, count in counts.items()},
        {name: mask[window].any(axis=1) for name, mask in present.items()},
        usual_counts,
        k,
    )


STEP_TOLERANCE = 0.05  # of the period: a time step is uneven
UNEVEN_SHARE = 0.02  # of the time steps, that are uneven before it is said
SPEED_SAMPLES = 5  # samples over which a speed beside a gap is taken
# of the speed beside a gap: in one that is crossed slower the motor may have turned
GAP_SPEED_MIN = 0.5
GAPS_LISTED_MAX = 3


class DataIssue(NamedTuple):
    """Samples that were excluded, or are odd, and why."""

    what: str
    channel: str
    samples: int
    first: float  # [s], as in the data
    excluded: bool = True


def select_valid_samples(time: Array, name: str, signal: Array) -> tuple[Mask, list[DataIssue]]:
    """Return which samples of a channel count, and what is said of the others."""
    present = np.isfinite(signal)
    is_held = np.zeros(len(signal), dtype=np.bool_)
    is_held[present] = find_held_samples(signal[present], find_quantisation_step(signal[present]))
    excluded = {"single-sample spikes": find_spikes(signal), "held samples excluded": is_held}
    issues = [
        DataIssue(message, name, int(rows.sum()), float(time[int(np.argmax(rows))]))
        for message, rows in excluded.items()
        if rows.any()
    ]
    return present & ~np.logical_or.reduce(list(excluded.values())), issues


def find_sampling_issues(time: Array, signals: Signals) -> list[DataIssue]:
    """Say where all channels repeat a sample, or where samples are missing."""
    issues = []
    is_repeated = np.ones(len(time) - 1, dtype=np.bool_)
    for signal in signals.values():
        change = np.diff(signal)
        is_repeated &= (change == 0.0) | np.isnan(change)
    has_noise = any(estimate_noise_sigma(drop_missing(signal)) > 0.0 for signal in signals.values())
    if has_noise and is_repeated.any():
        first_time = float(time[1:][is_repeated][0])
        issues.append(
            DataIssue("repeated samples", "all channels", int(is_repeated.sum()), first_time, False)
        )
    steps = np.diff(time)
    period = float(np.median(steps))
    is_uneven = np.abs(steps - period) > STEP_TOLERANCE * period
    is_gap = steps > GAP_PERIODS * period
    if np.mean(is_uneven & ~is_gap) > UNEVEN_SHARE:
        message = f"uneven time steps, from {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms"
        first_time = float(time[1:][is_uneven][0])
        issues.append(DataIssue(message, "all channels", int(is_uneven.sum()), first_time, False))
    if is_gap.any():
        missing = int(np.rint(steps[is_gap] / period - 1.0).sum())
        first_time = float(time[1:][is_gap][0])
        issues.append(DataIssue("missing samples", "all channels", missing, first_time, False))
    return issues


def find_unseen_turns(
    driver: str, time: Array, drive: Array, jitter: float, start: float
) -> list[DataIssue]:
    """Say in which gaps the drive may have turned: it went another way, or slower, than beside."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > max(LONG_GAP, LONG_GAP_PERIODS * float(np.median(steps))))
    uncertain_gaps = []
    for i in gaps.tolist():
        spans = (
            (max(i - SPEED_SAMPLES, 0), i),
            (i, i + 1),
            (i + 1, min(i + 1 + SPEED_SAMPLES, len(time) - 1)),
        )
        distances = [float(drive[end] - drive[begin]) for begin, end in spans]
        speeds = [
            distance / float(time[end] - time[begin]) if abs(distance) > jitter else 0.0
            for distance, (begin, end) in zip(distances, spans, strict=True)
        ]
        speed_before, speed_across, speed_after = speeds
        speed_beside = min(abs(speed_before), abs(speed_after))
        if min(speeds) < 0.0 < max(speeds) or abs(speed_across) < GAP_SPEED_MIN * speed_beside:
            uncertain_gaps.append((start + float(time[i]), start + float(time[i + 1])))
    if not uncertain_gaps:
        return []
    times = ", ".join(
        f"{begin:.4g} to {end:.4g} s" for begin, end in uncertain_gaps[:GAPS_LISTED_MAX]
    )
    times += ", ..." * (len(uncertain_gaps) > GAPS_LISTED_MAX)
    message = f"gaps in which the motor may have turned ({times}): friction after them is uncertain"
    return [
        DataIssue(
            message, driver, len(uncertain_gaps), uncertain_gaps[0][0] - start, excluded=False
        )
    ]
