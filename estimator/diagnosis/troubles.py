"""What is odd in the samples of a record, and which of them do not count for it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.channel_noise import find_quantisation_step
from estimator.diagnosis.drive import find_turning_points
from estimator.diagnosis.sampling import (
    GAP_PERIODS,
    LONG_GAP,
    LONG_GAP_PERIODS,
    drop_missing,
    find_held_samples,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_TENSION, Signals
from estimator.signals import noise_sigma
from estimator.spikes import find_spikes

Mask = NDArray[np.bool_]

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


def exclude_turns(time: Array, drive: Array, good: Mask) -> tuple[Mask, list[DataIssue]]:
    """Return which samples of the tension are not at a turn of the motor, and what is said of them.

    There friction reverses within less than an encoder resolves, or between two samples: the state
    of the reversal is unknown.
    """
    turns = np.array(find_turning_points(drive, SETTINGS.reversal * float(np.ptp(drive))))[1:-1]
    is_at_turn = np.zeros_like(good)
    for offset in (-1, 0, 1):
        is_at_turn[turns + offset] = True
    if not is_at_turn.any() or np.mean(is_at_turn) > SETTINGS.reversals_max:
        return good, []
    first_time = float(time[int(np.argmax(is_at_turn))])
    message = "samples at motor reversals excluded"
    return good & ~is_at_turn, [
        DataIssue(message, PROXIMAL_TENSION, int(is_at_turn.sum()), first_time)
    ]


def select_valid_samples(time: Array, name: str, signal: Array) -> tuple[Mask, list[DataIssue]]:
    """Return which samples of a channel count, and what is said of the others."""
    present = np.isfinite(signal)
    is_held = np.zeros(len(signal), dtype=np.bool_)
    is_held[present] = find_held_samples(signal[present], find_quantisation_step(signal[present]))
    excluded = {"single-sample spikes": find_spikes(signal), "held samples excluded": is_held}
    troubles = [
        DataIssue(message, name, int(rows.sum()), float(time[int(np.argmax(rows))]))
        for message, rows in excluded.items()
        if rows.any()
    ]
    return present & ~np.logical_or.reduce(list(excluded.values())), troubles


def find_sampling_issues(time: Array, signals: Signals) -> list[DataIssue]:
    """Say where all channels repeat a sample, or where samples are missing."""
    issues = []
    is_repeated = np.ones(len(time) - 1, dtype=np.bool_)
    for signal in signals.values():
        change = np.diff(signal)
        is_repeated &= (change == 0.0) | np.isnan(change)
    has_noise = any(noise_sigma(drop_missing(signal)) > 0.0 for signal in signals.values())
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
        missing, first_time = (
            int(np.rint(steps[is_gap] / period - 1.0).sum()),
            float(time[1:][is_gap][0]),
        )
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
