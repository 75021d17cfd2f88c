"""What is odd in the samples of a record, and which of them do not count for it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.channel_noise import counted_step
from estimator.diagnosis.drive import turning_points
from estimator.diagnosis.held_samples import held
from estimator.diagnosis.missing_values import LONG_GAP, PERIODS, known
from estimator.diagnosis.sampling import LONG
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_TENSION, Signals
from estimator.signals import noise_sigma
from estimator.spikes import single_spikes

Mask = NDArray[np.bool_]

STEPS_OFF = 0.05  # of the period: a time step is uneven
UNEVEN_SHARE = 0.02  # of the time steps, that are uneven before it is said
NEARBY = 5  # samples over which a speed beside a gap is taken
TURNED = 0.5  # of the speed beside a gap: in one that is crossed slower the motor may have turned
GAPS_NAMED = 3


class Trouble(NamedTuple):
    """Samples that were excluded, or are odd, and why."""

    what: str
    channel: str
    samples: int
    first: float  # [s], as in the data
    excluded: bool = True


def away_from_turns(time: Array, drive: Array, good: Mask) -> tuple[Mask, list[Trouble]]:
    """Return which samples of the tension are not at a turn of the motor, and what is said of them.

    There friction reverses within less than an encoder resolves, or between two samples: the state
    of the reversal is unknown.
    """
    turns = np.array(turning_points(drive, SETTINGS.reversal * float(np.ptp(drive))))[1:-1]
    beside = np.zeros_like(good)
    for off in (-1, 0, 1):
        beside[turns + off] = True
    if not beside.any() or np.mean(beside) > SETTINGS.reversals_max:
        return good, []
    first = float(time[int(np.argmax(beside))])
    what = "samples at motor reversals excluded"
    return good & ~beside, [Trouble(what, PROXIMAL_TENSION, int(beside.sum()), first)]


def counted_samples(time: Array, name: str, signal: Array) -> tuple[Mask, list[Trouble]]:
    """Return which samples of a channel count, and what is said of the others."""
    present = np.isfinite(signal)
    repeats = np.zeros(len(signal), dtype=np.bool_)
    repeats[present] = held(signal[present], counted_step(signal[present]))
    excluded = {"single-sample spikes": single_spikes(signal), "held samples excluded": repeats}
    troubles = [
        Trouble(what, name, int(rows.sum()), float(time[int(np.argmax(rows))]))
        for what, rows in excluded.items()
        if rows.any()
    ]
    return present & ~np.logical_or.reduce(list(excluded.values())), troubles


def repeated_samples(time: Array, signals: Signals) -> list[Trouble]:
    """Say where all channels repeat a sample, or where samples are missing."""
    found = []
    same = np.ones(len(time) - 1, dtype=np.bool_)
    for signal in signals.values():
        change = np.diff(signal)
        same &= (change == 0.0) | np.isnan(change)
    noisy = any(noise_sigma(known(signal)) > 0.0 for signal in signals.values())
    if noisy and same.any():
        first = float(time[1:][same][0])
        found.append(Trouble("repeated samples", "all channels", int(same.sum()), first, False))
    steps = np.diff(time)
    period = float(np.median(steps))
    uneven = np.abs(steps - period) > STEPS_OFF * period
    gaps = steps > LONG * period
    if np.mean(uneven & ~gaps) > UNEVEN_SHARE:
        what = f"uneven time steps, from {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms"
        first = float(time[1:][uneven][0])
        found.append(Trouble(what, "all channels", int(uneven.sum()), first, False))
    if gaps.any():
        missing, first = int(np.rint(steps[gaps] / period - 1.0).sum()), float(time[1:][gaps][0])
        found.append(Trouble("missing samples", "all channels", missing, first, False))
    return found


def unseen_turns(
    driver: str, time: Array, drive: Array, jitter: float, start: float
) -> list[Trouble]:
    """Say in which gaps the drive may have turned: it went another way, or slower, than beside."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > max(LONG_GAP, PERIODS * float(np.median(steps))))
    found = []
    for i in gaps.tolist():
        spans = ((max(i - NEARBY, 0), i), (i, i + 1), (i + 1, min(i + 1 + NEARBY, len(time) - 1)))
        ways = [float(drive[end] - drive[begin]) for begin, end in spans]
        speeds = [
            way / float(time[end] - time[begin]) if abs(way) > jitter else 0.0
            for way, (begin, end) in zip(ways, spans, strict=True)
        ]
        before, across, after = speeds
        beside = min(abs(before), abs(after))
        if min(speeds) < 0.0 < max(speeds) or abs(across) < TURNED * beside:
            found.append((start + float(time[i]), start + float(time[i + 1])))
    if not found:
        return []
    times = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in found[:GAPS_NAMED])
    times += ", ..." * (len(found) > GAPS_NAMED)
    what = f"gaps in which the motor may have turned ({times}): friction after them is uncertain"
    return [Trouble(what, driver, len(found), found[0][0] - start, excluded=False)]
