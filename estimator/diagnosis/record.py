"""A record of measured data, made ready to be compared with a simulation.

The simulation is driven by the motor's travel where there is one, else by the tension at the
housing. What drives a hysteresis must not jitter, or the jitter is remembered: between its turning
points the driving signal is made monotone, which keeps its peaks (docs/theory.md, section 9). All
other channels are compared as they are, without filters.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.smoothing import smooth
from estimator.effects.effect import (
    CHANNELS,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Signals,
)
from estimator.signals import noise_sigma

Mask = NDArray[np.bool_]

LEAST = 100  # samples
MOST = 20_000  # samples that are simulated; a longer record is thinned
BLOCK = 5.0  # [s] that are fitted, and then as long that are not
BLOCKS = 12  # at least, in a short record
SHORT = 0.02  # of a block's length, where what is wrong fills but a block
SPIKE = 8.0  # times what neighbours differ by
FLOOR = 2e-4  # of a channel's range: nothing is simulated better
TURN = 1e-3  # of the range of the drive: turns that are no jitter of an encoder
SPEED_OVER = 0.02  # [s] over which speed is taken
ORDERS = (2, 3, 4, 5, 6)  # of the differences that an encoder's noise is taken from
JITTER = 4.0  # times its noise: a driver that turns by less has not turned
TURNED = 3.0  # times its noise: the least that a motion without its noise turns by
MOSTLY = 0.9  # of its samples: what noise is left on them
DRAWS = 8  # of the driver's noise
REST = 3  # samples: fewer are no rest
PLACES_OF_TURN = 24  # that are tried in a rest
SAME = 6.0  # squares of the noise: an error that is no larger than another
NEARBY = 5  # samples over which the variance that it makes is averaged
ROUND = 0.4  # of the largest bend about a turn, that the least has: it is no corner


class Simulation(Protocol):
    """What a simulation gives."""

    @property
    def signals(self) -> Signals:
        """By channel, shape (n,)."""


class RecordError(ValueError):
    """Data that cannot be diagnosed; the message says why and what to do."""


class Trouble(NamedTuple):
    """Excluded samples, and why."""

    what: str
    channel: str
    samples: int
    first: float  # [s]


@dataclass(frozen=True)
class Record:
    """One record, ready.

    Attributes
    ----------
    time
        From the first sample on [s], shape (n,).
    signals
        By channel, as measured, shape (n,) each.
    driver
        The channel that drives the simulation.
    drive
        It, monotone between its turning points, shape (n,).
    speed
        Its rate, shape (n,).
    noise
        Standard deviation of the white noise of each channel, the driver's too.
    sigma
        Standard deviation of what a simulation cannot know, by channel, shape (n,) each: the
        channel's own noise, and what the driver's noise makes of it; see `with_driver_noise`.
    good
        Which samples count, by channel, shape (n,) each.
    measured
        Which rows are samples; the others, at turns of the motor between two, count nowhere, (n,).
    train
        Which samples are fitted while others are kept for the test, shape (n,).
    block
        Number of the block each sample is in, shape (n,).
    troubles
        What was excluded.
    thinned
        How many measured samples became one.
    """

    time: Array
    signals: Signals
    driver: str
    drive: Array
    speed: Array
    noise: dict[str, float]
    sigma: dict[str, Array]
    good: dict[str, Mask]
    measured: Mask
    train: Mask
    block: NDArray[np.int64]
    troubles: tuple[Trouble, ...]
    thinned: int

    @property
    def compared(self) -> tuple[str, ...]:
        """Channels that a simulation is compared with."""
        return tuple(c for c in CHANNELS if c in self.signals and c != self.driver)

    @property
    def starts_slack(self) -> bool:
        """Whether there is no tension at the first sample."""
        T = self.signals[PROXIMAL_TENSION]
        return bool(np.median(T[:5]) <= 5.0 * self.noise[PROXIMAL_TENSION])


def prepare(
    time: Array,
    signals: Signals,
    *,
    most: int = MOST,
    noise: Mapping[str, float] = MappingProxyType({}),
) -> Record:
    """Return a record made ready.

    Parameters
    ----------
    time : ndarray
        [s], shape (n,), strictly rising.
    signals : dict
        By channel of `estimator.effects.CHANNELS`, the tension at the housing at least, [N] and
        [m], shape (n,).
    most : int
        Samples that are kept of a longer record.
    noise : mapping
        Standard deviation of a channel's white noise, [N] and [m], where it is known better than
        the data tell it.

    Raises
    ------
    RecordError
        If nothing can be found out from the data.
    """
    if PROXIMAL_TENSION not in signals:
        raise RecordError("proximal_tension is missing: nothing is known without it")
    if len(signals) < 2:
        raise RecordError(
            "proximal_tension alone: a travel or the tension at the tip is needed beside it"
        )
    if len(time) < LEAST:
        raise RecordError(f"{len(time)} samples, at least {LEAST} are needed: record for longer")
    for name, signal in signals.items():
        if name not in CHANNELS:
            raise RecordError(f"{name}: no such channel, there are {', '.join(CHANNELS)}")
        if signal.shape != time.shape or not np.isfinite(signal).all():
            raise RecordError(f"{name}: {time.shape} finite values are needed")
    if not np.ptp(signals[PROXIMAL_TENSION]) > 0.0:
        raise RecordError("proximal_tension never changes: pull and release while you record")
    time = time - time[0]
    good, troubles = {}, list(_repeated(time, signals))
    for name, signal in signals.items():
        good[name], spikes = _without_spikes(time, name, signal)
        troubles += spikes
    time, signals, good, thinned = _thinned(time, signals, good, most)
    driver = PROXIMAL_DISPLACEMENT if PROXIMAL_DISPLACEMENT in signals else PROXIMAL_TENSION
    least = {name: max(FLOOR * float(np.ptp(signal)), 1e-9) for name, signal in signals.items()}
    sigma = {name: noise_sigma(signal[good[name]]) for name, signal in signals.items()}
    whole = np.interp(time, time[good[driver]], signals[driver][good[driver]])
    measured = np.ones(len(time), dtype=np.bool_)
    if driver != PROXIMAL_TENSION:
        sigma[driver] = _encoder_noise(whole)
    sigma |= noise
    drive, jitter = _drive(driver, whole, sigma[driver])
    if driver != PROXIMAL_TENSION:
        turns = _between_samples(time, drive, jitter)
        added = {name: np.interp(turns.time, time, signal) for name, signal in signals.items()}
        signals = {name: np.insert(one, turns.rows, added[name]) for name, one in signals.items()}
        good = {name: np.insert(mask, turns.rows, False) for name, mask in good.items()}
        measured = np.insert(measured, turns.rows, False)
        time = np.insert(time, turns.rows, turns.time)
        drive = np.insert(drive, turns.rows, turns.drive)
        good[PROXIMAL_TENSION], trouble = _between_turns(time, drive, good[PROXIMAL_TENSION])
        troubles += trouble
    sigma |= {name: max(sigma[name], least[name]) for name in signals if name != driver}
    block = _blocks(time)
    return Record(
        time=time,
        signals=signals,
        driver=driver,
        drive=drive,
        speed=rate(time, drive),
        noise=sigma,
        sigma={name: np.full(len(time), sigma[name]) for name in signals if name != driver},
        good=good,
        measured=measured,
        train=block % 2 == 0,
        block=block,
        troubles=tuple(troubles),
        thinned=thinned,
    )


def in_full(record: Record) -> Record:
    """Return a record of which all samples are fitted."""
    return replace(record, train=np.ones_like(record.train))


def in_short_blocks(record: Record) -> Record:
    """Return a record that is cut into shorter blocks, so that a short stretch is in some of both.

    What is wrong in one block only can be fitted and not judged, or judged and not fitted.
    """
    block = _blocks(record.time, SHORT)
    return replace(record, train=block % 2 == 0, block=block)


def _blocks(time: Array, share: float = 1.0) -> NDArray[np.int64]:
    length = share * min(BLOCK, float(time[-1] - time[0]) / BLOCKS)
    return np.asarray((time - time[0]) / length, dtype=np.int64)


def with_driver_noise(record: Record, again: Callable[[Record], Simulation]) -> Record:
    """Return a record whose `sigma` has in it what the driver's noise does to a simulation.

    Friction remembers where the driver turned, so an error of the driver is seen most just behind a
    turn, where the tension changes with the root of the travel: `again` simulates a record whose
    driver has noise once more (parametric bootstrap), and the variance that makes is taken sample
    by sample.
    """
    sigma = record.noise[record.driver]
    if not sigma > 0.0:
        return record
    rng = np.random.default_rng(0)
    same = again(record).signals
    power = {channel: np.zeros_like(record.time) for channel in record.compared}
    for _ in range(DRAWS):
        noisy = record.drive + sigma * rng.standard_normal(len(record.time))
        drive, _ = _drive(record.driver, noisy, sigma)
        other = again(replace(record, drive=drive)).signals
        for channel, total in power.items():
            total += (other[channel] - same[channel]) ** 2 / DRAWS
    near = np.ones(NEARBY) / NEARBY
    return replace(
        record,
        sigma={
            channel: np.sqrt(record.noise[channel] ** 2 + np.convolve(total, near, mode="same"))
            for channel, total in power.items()
        },
    )


def _drive(driver: str, measured: Array, sigma: float) -> tuple[Array, float]:
    """Return a driver without its noise, and how far it has to turn to have turned."""
    if driver == PROXIMAL_TENSION:
        jitter = JITTER * sigma
        return np.maximum(monotone(measured, jitter), 0.0), jitter
    found = smooth(measured, sigma)
    jitter = max(JITTER * float(np.quantile(found.sigma, MOSTLY)), TURNED * sigma)
    turns = _ends_of_rests(measured, found.signal, sigma, _turning_points(found.signal, jitter))
    return _monotone_between(found.signal, turns, jitter), jitter


def _ends_of_rests(measured: Array, smoothed: Array, sigma: float, turns: list[int]) -> list[int]:
    """Return turning points, each as late as the noise lets it be.

    A motor that rests before it turns back has its extreme anywhere in the rest, by noise. Put
    there, friction would have turned round for the rest of that time.
    """
    from scipy.optimize import isotonic_regression

    out = list(turns)
    for i in range(1, len(turns) - 1):
        turn, high = turns[i], smoothed[turns[i]] > smoothed[turns[i - 1]]

        def near(rows: Array, turn: int = turn) -> int:
            off = np.flatnonzero(np.abs(smoothed[rows] - smoothed[turn]) > JITTER * sigma)
            return int(off[0]) if len(off) else len(rows)

        begin = turn - near(np.arange(turn, out[i - 1], -1)) + 1
        end = turn + near(np.arange(turn, turns[i + 1])) - 1
        if end - turn < REST:
            continue
        late = np.unique(np.linspace(turn, end, PLACES_OF_TURN).astype(np.int64))
        errors = [
            float(
                np.sum(
                    (
                        isotonic_regression(measured[begin : at + 1], increasing=high).x
                        - measured[begin : at + 1]
                    )
                    ** 2
                )
                + np.sum(
                    (
                        isotonic_regression(measured[at : end + 1], increasing=not high).x
                        - measured[at : end + 1]
                    )
                    ** 2
                )
            )
            for at in late
        ]
        out[i] = int(late[np.flatnonzero(np.array(errors) <= min(errors) + SAME * sigma**2)[-1]])
    return out


def first_look(record: Record, most: int) -> Mask:
    """Return which samples of a record stay for a first look: about `most`, and all turns."""
    n = len(record.time)
    kept = np.zeros(n, dtype=np.bool_)
    kept[:: math.ceil(n / most)] = True
    kept[_turning_points(record.drive, TURN * float(np.ptp(record.drive)))] = True
    return kept


def at_rows(record: Record, kept: Mask) -> Record:
    """Return a record of some of its samples."""
    return replace(
        record,
        time=record.time[kept],
        signals={name: signal[kept] for name, signal in record.signals.items()},
        drive=record.drive[kept],
        speed=record.speed[kept],
        sigma={name: sigma[kept] for name, sigma in record.sigma.items()},
        good={name: good[kept] for name, good in record.good.items()},
        measured=record.measured[kept],
        train=record.train[kept],
        block=record.block[kept],
    )


def monotone(signal: Array, band: float) -> Array:
    """Return a signal made monotone between turning points that are more than `band` apart."""
    if band <= 0.0:
        return signal
    return _monotone_between(signal, _turning_points(signal, band), band)


def _monotone_between(signal: Array, turns: list[int], band: float) -> Array:
    from scipy.optimize import isotonic_regression  # here: the control processes import this module

    if len(turns) <= 2 and float(np.ptp(signal)) <= band:
        return np.full_like(signal, float(signal.mean()))
    out = signal.copy()
    for begin, end in itertools.pairwise(turns):
        piece = slice(begin, end + 1)
        rises = bool(signal[end] >= signal[begin])
        out[piece] = isotonic_regression(signal[piece], increasing=rises).x
    # of noise the highest sample is the turn: no further out than its neighbours are, then
    for turn in turns[1:-1]:
        beside = out[[turn - 1, turn + 1]]
        if abs(signal[turn] - beside.mean()) < band:
            out[turn] = np.clip(signal[turn], beside.min(), beside.max())
    return out


def rate(time: Array, signal: Array) -> Array:
    """Return the slope of a signal over a few samples [1/s], shape (n,)."""
    reach = max(1, round(0.5 * SPEED_OVER / float(np.median(np.diff(time)))))
    ahead = np.minimum(np.arange(len(time)) + reach, len(time) - 1)
    behind = np.maximum(np.arange(len(time)) - reach, 0)
    return np.asarray((signal[ahead] - signal[behind]) / (time[ahead] - time[behind]))


def _turning_points(signal: Array, band: float) -> list[int]:
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


def _encoder_noise(travel: Array) -> float:
    """Return the standard deviation of an encoder's noise [m].

    White noise is in differences of every order alike, motion is less in each further one: what few
    samples have of a hand's fast motion is no noise, or its turns would be lost.
    """
    return min(
        float(np.median(np.abs(np.diff(travel, m)))) * 1.4826 / math.sqrt(math.comb(2 * m, m))
        for m in ORDERS
    )


class _Turns(NamedTuple):
    """Turns of the motor between two samples."""

    rows: list[int]  # before which they belong
    time: list[float]  # [s]
    drive: list[float]  # [m]


def _between_samples(time: Array, drive: Array, least: float) -> _Turns:
    """Return where the motor turned between two samples, further than those by `least` [m].

    Friction remembers how far it went. A parabola through three samples tells, where the motion is
    round there.
    """
    bend = np.diff(np.diff(drive) / np.diff(time)) / (time[2:] - time[:-2])
    turns = _Turns([], [], [])
    for i in _turning_points(drive, TURN * float(np.ptp(drive)))[1:-1]:
        about = bend[max(i - 2, 0) : i + 1]
        if len(about) < 3 or np.ptp(np.sign(about)):
            continue
        if not np.abs(about).min() > ROUND * float(np.abs(about).max()):
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


def _between_turns(time: Array, drive: Array, good: Mask) -> tuple[Mask, list[Trouble]]:
    """Return which samples of the tension are not at a turn of the motor, and what is said of them.

    There friction turns round within less than an encoder resolves, or between two samples: how far
    it has come at that sample, nobody can tell.
    """
    turns = np.array(_turning_points(drive, TURN * float(np.ptp(drive))))[1:-1]
    beside = np.zeros_like(good)
    for off in (-1, 0, 1):
        beside[turns + off] = True
    if not beside.any():
        return good, []
    first = float(time[int(np.argmax(beside))])
    what = "samples at motor reversals excluded"
    return good & ~beside, [Trouble(what, PROXIMAL_TENSION, int(beside.sum()), first)]


def _without_spikes(time: Array, name: str, signal: Array) -> tuple[Mask, list[Trouble]]:
    """Return which samples are no single-sample spikes, and what is said of those that are."""
    from scipy.ndimage import median_filter  # here: the control processes import this module

    off = np.zeros_like(signal)
    off[1:-1] = signal[1:-1] - 0.5 * (signal[:-2] + signal[2:])
    across = np.zeros_like(signal)
    across[1:-1] = np.abs(signal[2:] - signal[:-2])
    usual = 1.4826 * median_filter(np.abs(off), 101, mode="nearest")
    least = max(noise_sigma(signal), 1e-3 * float(np.ptp(signal)))
    spike = (np.abs(off) > SPIKE * np.maximum(usual, least)) & (across < 0.5 * np.abs(off))
    # beside a spike both neighbours are off by half of it, the other way; beside a sharp turn not
    for beside in (np.roll(off, 1), np.roll(off, -1)):
        spike &= (off * beside < 0.0) & (np.abs(beside) > 0.25 * np.abs(off))
        spike &= np.abs(beside) < 0.8 * np.abs(off)
    if not spike.any():
        return np.ones(len(signal), dtype=np.bool_), []
    first = float(time[int(np.argmax(spike))])
    return ~spike, [Trouble("single-sample spikes", name, int(spike.sum()), first)]


def _repeated(time: Array, signals: Signals) -> list[Trouble]:
    """Say where all channels repeat a sample, or where samples are missing."""
    found = []
    same = np.ones(len(time) - 1, dtype=np.bool_)
    for signal in signals.values():
        same &= np.diff(signal) == 0.0
    noisy = any(noise_sigma(signal) > 0.0 for signal in signals.values())
    if noisy and same.any():
        first = float(time[1:][same][0])
        found.append(Trouble("repeated samples", "all channels", int(same.sum()), first))
    steps = np.diff(time)
    gaps = steps > 1.75 * np.median(steps)
    if gaps.any():
        missing = int(np.rint(steps[gaps] / np.median(steps) - 1.0).sum())
        found.append(Trouble("missing samples", "all channels", missing, float(time[1:][gaps][0])))
    return found


def _thinned(
    time: Array, signals: Signals, good: dict[str, Mask], most: int
) -> tuple[Array, Signals, dict[str, Mask], int]:
    """Return every k-th sample, the compared channels averaged over the k around it."""
    k = math.ceil(len(time) / most)
    if k <= 1:
        return time, signals, good, 1
    rows = np.arange(k // 2, len(time) - (k - 1) // 2, k)
    window = rows[:, None] + np.arange(k) - k // 2
    window = np.clip(window, 0, len(time) - 1)
    kept, masks = {}, {}
    for name, signal in signals.items():
        weight = good[name][window].astype(np.float64)
        masks[name] = weight.sum(axis=1) > 0.5 * k
        total = np.maximum(weight.sum(axis=1), 1.0)
        kept[name] = (signal[window] * weight).sum(axis=1) / total
        kept[name][~masks[name]] = signal[rows][~masks[name]]
    return time[window].mean(axis=1), kept, masks, k
