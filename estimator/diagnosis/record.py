"""A record of measured data, made ready to be compared with a simulation.

The simulation is driven by the motor's travel where there is one, else by the tension at the
housing, without its noise (`estimator.diagnosis.drive`). All other channels are compared as they
are, without filters.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.bench_scale import UNSCALED, BenchScale
from estimator.diagnosis.channel_noise import counted_step, white_noise
from estimator.diagnosis.drive import (
    Drive,
    rate,
    tension_drive,
    travel_drive,
    turning_points,
    turns_between_samples,
)
from estimator.diagnosis.held_samples import held
from estimator.diagnosis.missing_values import (
    LONG_GAP,
    PERIODS,
    as_missing,
    in_stretches,
    known,
    only_rows,
)
from estimator.diagnosis.sampling import LONG, times_of
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    CHANNELS,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Signals,
)
from estimator.measured_data import Samples
from estimator.plausibility import doubts
from estimator.signals import noise_sigma
from estimator.spikes import single_spikes
from estimator.units import LINEAR, Units

Mask = NDArray[np.bool_]

DRAWS = 8  # of the driver's noise
STEPS_OFF = 0.05  # of the period: a time step is uneven
UNEVEN_SHARE = 0.02  # of the time steps, that are uneven before it is said
NEARBY = 5  # samples over which the variance that it makes is averaged, or a speed is taken
TURNED = 0.5  # of the speed beside a gap: in one that is crossed slower the motor may have turned
GAPS_NAMED = 3
EXACT = 1e-9  # of the range of a drive: what rounds off in sums turns nothing


class Simulation(Protocol):
    """What a simulation gives."""

    @property
    def signals(self) -> Signals:
        """By channel, shape (n,)."""


class RecordError(ValueError):
    """Data that cannot be diagnosed; the message says why and what to do."""


class Trouble(NamedTuple):
    """Samples that were excluded, or are odd, and why."""

    what: str
    channel: str
    samples: int
    first: float  # [s], as in the data
    excluded: bool = True


@dataclass(frozen=True)
class Record:
    """One record, ready.

    Attributes
    ----------
    time
        From the first sample on [s], shape (n,).
    signals
        By channel, as measured, shape (n,) each; what does not count is interpolated.
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
    units
        Of the measured data.
    loop
        Whether it is of a closed loop of two cables, with effort of either sign, not of one tendon.
    start
        Time of the first sample in the data [s].
    scale
        Of what the signals are counted in, to `units`.
    known
        Which samples were measured, by channel, shape (n,) each; the others are interpolated.
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
    units: Units = LINEAR
    loop: bool = False
    start: float = 0.0
    scale: BenchScale = UNSCALED
    known: dict[str, Mask] = field(default_factory=dict)

    @property
    def compared(self) -> tuple[str, ...]:
        """Channels that a simulation is compared with."""
        return tuple(c for c in CHANNELS if c in self.signals and c != self.driver)

    @property
    def starts_slack(self) -> bool:
        """Whether there is no tension at the first sample, as far as it was measured."""
        T = self.signals[PROXIMAL_TENSION][:5][self.good[PROXIMAL_TENSION][:5]]
        if self.loop or not len(T):
            return False
        return bool(np.median(T) <= 5.0 * self.noise[PROXIMAL_TENSION])

    @property
    def first_tensions(self) -> tuple[float, Array]:
        """Where the drive was when tension was first measured, and five readings from there on."""
        rows = np.flatnonzero(self.known[PROXIMAL_TENSION])[:5]
        return float(self.drive[rows[0]]), self.signals[PROXIMAL_TENSION][rows]

    def shown(self, channel: str) -> Mask:
        """Return which rows of a channel are to be drawn: not those that lack values for long."""
        return self.measured & ~in_stretches(self.time, self.known[channel])


def prepare(
    time: Array,
    signals: Signals,
    *,
    most: int = SETTINGS.samples_max,
    noise: Mapping[str, float] = MappingProxyType({}),
    units: Units = LINEAR,
    loop: bool | None = None,
) -> Record:
    """Return a record made ready.

    Parameters
    ----------
    time : ndarray
        Stamps [s], shape (n,), strictly rising; see `estimator.diagnosis.sampling.times_of`.
    signals : dict
        By channel of `estimator.effects.CHANNELS`, the tension at the housing at least, in
        `units`, shape (n,), not finite where a value is missing.
    most : int
        Samples that are kept of a longer record.
    noise : mapping
        Standard deviation of the white noise of channels, in `units`, where it is known better
        than the data tell it.
    units : Units
        [N] and [m] by default.
    loop : bool, optional
        Whether it is a closed loop of two cables; by default, whether effort changes its sign.

    Raises
    ------
    RecordError
        If nothing can be found out from the data.
    """
    signals = as_missing(signals)
    _check(time, signals, units)
    loop = is_loop(units, [signals]) if loop is None else loop
    if loop and PROXIMAL_DISPLACEMENT not in signals:
        raise RecordError(
            f"effort changes its sign, as in a closed loop of two cables: "
            f"the {units.word(PROXIMAL_DISPLACEMENT)} is needed, which drives the loop"
        )
    for name in (PROXIMAL_TENSION, DISTAL_TENSION):
        if loop or name not in signals:
            continue
        effort = known(signals[name])
        if -effort.min() > effort.max():
            raise RecordError(
                f"{units.word(name)}: negative where the tendon pulls; change its sign"
            )
    noise = dict(noise)
    driver = PROXIMAL_DISPLACEMENT if PROXIMAL_DISPLACEMENT in signals else PROXIMAL_TENSION
    time, signals, absent = _rows_with(driver, time, signals, units)
    start = float(time[0])
    time, late = times_of(time - start, signals)
    present = {name: np.isfinite(signal) for name, signal in signals.items()}
    good, rounded, troubles = {}, {}, _repeated(time, signals)
    if late > 0.0:
        what = f"time stamps jitter by {1e3 * late:.2g} ms where samples are even: taken as even"
        troubles.append(Trouble(what, "all channels", len(time), 0.0, excluded=False))
    for name, signal in signals.items():
        good[name], found = _counted(time, name, signal)
        rounded[name] = counted_step(signal[good[name]]) / math.sqrt(12.0)
        signals[name] = np.interp(time, time[good[name]], signal[good[name]])
        troubles += found
    thin = _thinned(time, signals, good, present, most)
    time, signals, good, present = thin.time, thin.signals, thin.good, thin.present
    rounded, given = (
        {name: value / math.sqrt(thin.averaged[name]) for name, value in each.items()}
        for each in (rounded, noise)
    )
    sigma = _noise_of(driver, time, signals, good, rounded, given)
    measured = np.ones(len(time), dtype=np.bool_)
    drive, jitter = _drive(driver, time, signals[driver], sigma[driver])
    troubles += _unseen_turns(driver, time, drive, jitter, start)
    if driver != PROXIMAL_TENSION:
        turns = turns_between_samples(time, drive, jitter)
        signals = {name: turns.insert(time, signal) for name, signal in signals.items()}
        good = {name: np.insert(mask, turns.rows, False) for name, mask in good.items()}
        present = {name: turns.between(mask) for name, mask in present.items()}
        measured = np.insert(measured, turns.rows, False)
        time = np.insert(time, turns.rows, turns.time)
        drive = np.insert(drive, turns.rows, turns.drive)
        good[PROXIMAL_TENSION], trouble = _between_turns(time, drive, good[PROXIMAL_TENSION])
        troubles += trouble
    block, speed = _blocks(time), rate(time, drive)
    return Record(
        time=time,
        signals=signals,
        driver=driver,
        drive=drive,
        speed=speed,
        noise=sigma,
        sigma={name: np.full(len(time), sigma[name]) for name in signals if name != driver},
        good=good,
        measured=measured,
        train=_fitted(block, drive, speed),
        block=block,
        troubles=(*absent, *(one._replace(first=one.first + start) for one in troubles)),
        thinned=thin.thinned,
        units=units,
        loop=loop,
        start=start,
        known=present,
    )


def efforts_of(signals: Signals) -> list[Array]:
    """Return what is known of the tensions, forces or torques among signals."""
    return [known(signals[name]) for name in (PROXIMAL_TENSION, DISTAL_TENSION) if name in signals]


def is_loop(units: Units, records: Sequence[Signals]) -> bool:
    """Return whether records are of a closed loop: effort pushes in earnest in one of them."""
    efforts = [effort for signals in records for effort in efforts_of(signals)]
    least, most = min(float(one.min()) for one in efforts), max(float(one.max()) for one in efforts)
    return units.signed and min(-least, most) > SETTINGS.push * max(-least, most)


def _noise_of(
    driver: str,
    time: Array,
    signals: Signals,
    good: dict[str, Mask],
    rounded: dict[str, float],
    given: dict[str, float],
) -> dict[str, float]:
    """Return the standard deviation of each channel's white noise, as given or as the data say.

    It is that of its rounding at least.
    """
    sigma = {}
    for name, signal in signals.items():
        told = max(white_noise(signal[good[name]], time[good[name]]), rounded[name])
        sigma[name] = given.get(name, told)
        if name != driver:  # nothing is simulated more precisely
            sigma[name] = max(sigma[name], SETTINGS.noise_min * float(np.ptp(signal)), 1e-9)
    return sigma


def check_known(signals: Signals) -> None:
    """Raise `RecordError` for a channel without any finite value."""
    for name, signal in signals.items():
        if not np.isfinite(signal).any():
            needed = name == PROXIMAL_TENSION
            remedy = "it is needed; check the load cell" if needed else "remove the channel"
            raise RecordError(f"{name}: has no finite value: {remedy}")


def _check(time: Array, signals: Signals, units: Units) -> None:
    if PROXIMAL_TENSION not in signals:
        raise RecordError("proximal_tension is missing: nothing is known without it")
    if len(signals) < 2:
        raise RecordError(
            "proximal_tension alone: a travel or the tension at the tip is needed beside it"
        )
    if len(time) < SETTINGS.samples_min:
        raise RecordError(
            f"{len(time)} samples, at least {SETTINGS.samples_min} are needed: record for longer"
        )
    if not np.isfinite(time).all():
        k = int(np.argmin(np.isfinite(time)))
        raise RecordError(f"time: sample {k} is {time[k]}: remove samples without a time")
    late = np.flatnonzero(~(np.diff(time) > 0.0))
    if len(late):
        k = int(late[0]) + 1
        raise RecordError(
            f"time: sample {k} at {time[k]:.6g} s does not follow {time[k - 1]:.6g} s: "
            "remove samples that repeat a time, and sort them"
        )
    for name, signal in signals.items():
        if name not in CHANNELS:
            raise RecordError(f"{name}: no such channel, there are {', '.join(CHANNELS)}")
        if signal.shape != time.shape:
            raise RecordError(f"{name}: {time.shape} values are needed, NaN where one is missing")
    check_known(signals)
    if not np.ptp(known(signals[PROXIMAL_TENSION])) > 0.0:
        raise RecordError("proximal_tension never changes: pull and release while you record")
    q_p, T_out, q_d = (signals.get(name) for name in CHANNELS[1:])
    if wrong := doubts(Samples(time, signals[PROXIMAL_TENSION], q_p, T_out, q_d), units):
        raise RecordError("; ".join(wrong))


def _rows_with(
    driver: str, time: Array, signals: Signals, units: Units
) -> tuple[Array, Signals, list[Trouble]]:
    """Return the rows in which the driver was measured, and what is said of missing values."""
    driven = np.isfinite(signals[driver])
    removed = "missing values of what drives the simulation, their rows removed"
    troubles = []
    for name, signal in signals.items():
        absent = ~driven if name == driver else driven & ~np.isfinite(signal)
        if absent.any():
            what = removed if name == driver else "missing values, not compared"
            first = float(time[int(np.argmax(absent))])
            troubles.append(Trouble(what, name, int(absent.sum()), first))
    time, signals = only_rows(time, signals, driven)
    for name, signal in signals.items():
        if (count := len(known(signal))) < SETTINGS.samples_min:
            beside = "" if name == driver else f" in rows that have the {units.word(driver)}"
            raise RecordError(
                f"{name}: {count} values{beside}, at least {SETTINGS.samples_min} are needed: "
                "record all channels at the same times, or remove this one"
            )
    return time, signals, troubles


def in_full(record: Record) -> Record:
    """Return a record of which all samples are fitted."""
    return replace(record, train=np.ones_like(record.train))


def in_short_blocks(record: Record) -> Record:
    """Return a record that is cut into shorter blocks, so that a short stretch is in some of both.

    What is wrong in one block only can be fitted and not judged, or judged and not fitted.
    """
    block = _blocks(record.time, SETTINGS.short_block)
    return replace(record, train=_fitted(block, record.drive, record.speed), block=block)


def _fitted(block: NDArray[np.int64], drive: Array, speed: Array) -> Mask:
    """Return which samples are fitted: every other block, if both halves see the same motion.

    A motion that repeats itself may be in one half while it pulls and in the other while it lets
    go. Then it is the blocks whose number has an even count of ones, a sequence (of Thue and Morse)
    that repeats nothing.
    """
    alternate: Mask = block % 2 == 0
    if _imbalance(alternate, drive, speed) < SETTINGS.imbalance_max:
        return alternate
    odd = np.zeros_like(block)
    while block.any():
        odd, block = odd ^ (block & 1), block >> 1
    aperiodic = np.asarray(odd == 0)
    return min((alternate, aperiodic), key=lambda one: _imbalance(one, drive, speed))


def _imbalance(fitted: Mask, drive: Array, speed: Array) -> float:
    """Return how differently two halves are moved: 0 if the same, 1 if nothing is in both.

    It is the distance in total variation between what they have of low, middle and high drive,
    each while it rises, rests and falls.
    """
    level = np.searchsorted(np.quantile(drive, [1.0 / 3.0, 2.0 / 3.0]), drive)
    rest = SETTINGS.rest * float(np.quantile(np.abs(speed), 0.95))
    way = np.sign(speed) * (np.abs(speed) > rest)
    state = (3 * level + way + 1.0).astype(np.int64)
    shares = [
        np.bincount(state[half], minlength=9) / max(int(half.sum()), 1)
        for half in (fitted, ~fitted)
    ]
    return 0.5 * float(np.abs(shares[0] - shares[1]).sum())


def _blocks(time: Array, share: float = 1.0) -> NDArray[np.int64]:
    length = share * min(SETTINGS.block, float(time[-1] - time[0]) / SETTINGS.blocks_min)
    length = max(length, 2.0 * float(np.median(np.diff(time))))
    return np.asarray((time - time[0]) / length, dtype=np.int64)


def with_driver_noise(record: Record, simulate: Callable[[Record], Simulation]) -> Record:
    """Return a record whose `sigma` has in it what the driver's noise does to a simulation.

    Friction remembers where the driver turned, so an error of the driver shows most just behind a
    turn, where the tension changes with the root of the travel. `simulate` takes the record with
    noise put on its drive once more (parametric bootstrap); the variance that this makes of each
    channel is taken sample by sample.
    """
    sigma = record.noise[record.driver]
    if not sigma > 0.0:
        return record
    rng = np.random.default_rng(0)
    same = simulate(record).signals
    variance = {channel: np.zeros_like(record.time) for channel in record.compared}
    for _ in range(DRAWS):
        noisy = record.drive + sigma * rng.standard_normal(len(record.time))
        drive = _drive(record.driver, record.time, noisy, sigma).signal
        other = simulate(replace(record, drive=drive)).signals
        for channel in variance:
            variance[channel] += (other[channel] - same[channel]) ** 2 / DRAWS
    nearby = np.full(NEARBY, 1.0 / NEARBY)
    return replace(
        record,
        sigma={
            channel: np.sqrt(record.noise[channel] ** 2 + np.convolve(total, nearby, mode="same"))
            for channel, total in variance.items()
        },
    )


def _drive(driver: str, time: Array, measured: Array, sigma: float) -> Drive:
    if driver == PROXIMAL_TENSION:
        return tension_drive(measured, sigma)
    return travel_drive(measured, sigma, time)


def first_look(record: Record, most: int) -> Mask:
    """Return which samples of a record stay for a first look: about `most`, and all turns.

    The drive has no turn by noise, and none is too small: one of 2 um may take a newton away, which
    friction then remembers.
    """
    n = len(record.time)
    kept = np.zeros(n, dtype=np.bool_)
    kept[:: math.ceil(n / most)] = True
    kept[turning_points(record.drive, EXACT * float(np.ptp(record.drive)))] = True
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
        known={name: known[kept] for name, known in record.known.items()},
        measured=record.measured[kept],
        train=record.train[kept],
        block=record.block[kept],
    )


def _between_turns(time: Array, drive: Array, good: Mask) -> tuple[Mask, list[Trouble]]:
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


def _counted(time: Array, name: str, signal: Array) -> tuple[Mask, list[Trouble]]:
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


def _repeated(time: Array, signals: Signals) -> list[Trouble]:
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


def _unseen_turns(
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


class _Thinned(NamedTuple):
    """A record of which several samples were averaged to one."""

    time: Array
    signals: Signals
    good: dict[str, Mask]
    present: dict[str, Mask]
    averaged: dict[str, float]  # values in a sample, by channel
    thinned: int  # samples in one


def _thinned(
    time: Array,
    signals: Signals,
    good: dict[str, Mask],
    present: dict[str, Mask],
    most: int,
) -> _Thinned:
    """Return every k-th sample, all channels averaged over the k around it.

    What does not count is interpolated in `signals`, so that a mean of few values is one at the
    same time as that of many. A channel counts where it has more than half as many values as it
    usually has, and none where samples before and after a gap come together.
    """
    k = math.ceil(len(time) / most)
    if k <= 1:
        return _Thinned(time, signals, good, present, dict.fromkeys(signals, 1.0), 1)
    rows = np.arange(k // 2, len(time) - (k - 1) // 2, k)
    window = rows[:, None] + np.arange(k) - k // 2
    spans = time[window[:, -1]] - time[window[:, 0]]
    unbroken = spans < float(np.median(spans)) + LONG_GAP
    counts = {name: mask[window].sum(axis=1) for name, mask in good.items()}
    usual = {name: float(np.median(count[count > 0])) for name, count in counts.items()}
    return _Thinned(
        time[window].mean(axis=1),
        {name: signal[window].sum(axis=1) / k for name, signal in signals.items()},
        {name: unbroken & (count > 0.5 * usual[name]) for name, count in counts.items()},
        {name: mask[window].any(axis=1) for name, mask in present.items()},
        usual,
        k,
    )
