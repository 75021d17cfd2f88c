"""A record of measured data, made ready to be compared with a simulation.

The simulation is driven by the motor's travel where there is one, else by the tension at the
housing, without its noise (`estimator.signals.driving_signal`). All other channels are compared
as they are, without filters.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    CHANNELS,
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Signals,
)
from estimator.measured_data import Samples
from estimator.plausibility import find_channel_faults, suggest_sign
from estimator.signals.driving_signal import (
    REVERSAL_SHARE,
    compute_rate,
    estimate_drive,
    find_turning_points,
    find_turns_between_samples,
)
from estimator.signals.noise import estimate_white_noise, find_quantisation_step
from estimator.signals.sampling import (
    DataIssue,
    assign_blocks,
    decimate_record,
    drop_missing,
    estimate_sample_times,
    find_long_gaps,
    find_sampling_issues,
    find_unseen_turns,
    mark_missing,
    select_aperiodic_half,
    select_signal_rows,
    select_training_half,
    select_valid_samples,
)
from estimator.units import LINEAR, Units

TRAVELS = {PROXIMAL_DISPLACEMENT, DISTAL_DISPLACEMENT}
TURN_TOLERANCE = 1e-9  # of the range of a drive: what rounds off in sums turns nothing


class RecordError(ValueError):
    """Data that cannot be diagnosed; the message says why and what to do."""


# --- the size of a bench: the diagnosis counts in units in which all benches are about as large
# Bounds of parameters, steps of fits, thresholds and tolerances of solvers are those of a bench of
# about 20 N and some millimetres. A record of another size is counted in other units of force and
# travel, tens or tenths of newtons and metres (or of newton metres and radians), and from another
# zero of the motor's encoder. No law changes by that: K, shares, gains and times stay, and numbers
# with a unit go along. Powers of ten leave the records of the usual size as they are.


REFERENCE_FORCE = 20.0  # [N] largest effort
REFERENCE_TRAVEL = 3.5e-3  # [m] range of the motor's travel

_POWERS = {"N": (1, 0), "m": (0, 1), "kg": (1, -1), "N^2": (2, 0), "m^2": (0, 2)}
"""Part of a unit -> powers of force and of travel; a time stays as it is."""


class BenchScale(NamedTuple):
    """Units of a bench, in those of its records, and its zero."""

    force: float = 1.0  # how much of a record's unit of effort the unit is
    travel: float = 1.0  # the same of travel
    zero: float = 0.0  # reading of the motor's encoder that counts as none, in the record's unit

    def size(self, unit: str) -> float:
        """Return how much of a unit of the record, as "m/N" or "N s/m", one of the bench is."""
        force, travel = parse_dimension(unit)
        return self.force**force * self.travel**travel

    def size_of(self, channel: str) -> float:
        """Return the same of the unit of a channel, such as `proximal_tension`."""
        return self.travel if channel.endswith("displacement") else self.force

    @property
    def inverse(self) -> "BenchScale":
        """The scale that takes a bench back."""
        return BenchScale(1.0 / self.force, 1.0 / self.travel, -self.zero / self.travel)


UNIT_SCALE = BenchScale()


def parse_dimension(unit: str) -> tuple[int, int]:
    """Return the powers of force and of travel in a unit: (-1, 1) of "m/N", (0, 0) of "of K"."""
    force = travel = 0
    for sign, side in zip((1, -1), unit.split("/"), strict=False):
        for factor in side.split(" "):
            force_power, travel_power = _POWERS.get(factor, (0, 0))
            force, travel = force + sign * force_power, travel + sign * travel_power
    return force, travel


def choose_bench_scale(efforts: Sequence[Array], travels: Sequence[Array]) -> BenchScale:
    """Return the scale of a bench.

    Without a travel, lengths are relative to an L/EA that is assumed, and the scale keeps it.

    Parameters
    ----------
    efforts : sequence of ndarray
        Of all records.
    travels : sequence of ndarray
        What drives them, the first record's first; empty where tensions do.
    """
    force = _round_to_power_of_ten(
        max(float(abs(effort).max()) for effort in efforts) / REFERENCE_FORCE
    )
    span = max((float(travel.max() - travel.min()) for travel in travels), default=0.0)
    if not span > 0.0:
        return BenchScale(force, force)
    zero = span * round(float(travels[0][0]) / span)  # whole spans: none where it counts from one
    return BenchScale(force, _round_to_power_of_ten(span / REFERENCE_TRAVEL), zero)


def _round_to_power_of_ten(ratio: float) -> float:
    return float(10.0 ** round(math.log10(ratio))) if ratio > 0.0 else 1.0


def exclude_turns(time: Array, drive: Array, valid: Mask) -> tuple[Mask, list[DataIssue]]:
    """Return which samples of the tension are not at a turn of the motor, and what is said of them.

    There friction reverses within less than an encoder resolves, or between two samples: the state
    of the reversal is unknown.
    """
    reversal_min = REVERSAL_SHARE * float(np.ptp(drive))
    turns = np.array(find_turning_points(drive, reversal_min))[1:-1]
    is_at_turn = np.zeros_like(valid)
    for offset in (-1, 0, 1):
        is_at_turn[turns + offset] = True
    if not is_at_turn.any() or np.mean(is_at_turn) > SETTINGS.reversals_max:
        return valid, []
    first_time = float(time[int(np.argmax(is_at_turn))])
    message = "samples at motor reversals excluded"
    return valid & ~is_at_turn, [
        DataIssue(message, PROXIMAL_TENSION, int(is_at_turn.sum()), first_time)
    ]


@dataclass(frozen=True)
class Record:
    """One record, ready; arrays by sample, shape (n,), and by channel where they are dicts."""

    time: Array  # from the first sample on [s]
    signals: Signals  # as measured; what does not count is interpolated
    driver: str  # the channel that drives the simulation
    drive: Array  # it, monotone between its turning points
    speed: Array  # its rate
    noise: dict[str, float]  # standard deviation of the white noise, of the driver too
    # of what a simulation cannot know: the channel's own noise, and what the driver's noise makes
    # of it; see `hidden_motion.propagate_driver_noise`
    sigma: dict[str, Array]
    valid: dict[str, Mask]  # which samples count
    measured: Mask  # which rows are samples; others, at turns of the motor between two, never count
    train: Mask  # which samples are fitted while others are kept for the test
    block: NDArray[np.int64]  # number of the block each sample is in
    issues: tuple[DataIssue, ...]  # what was excluded
    decimation_factor: int  # how many measured samples became one
    units: Units = LINEAR  # of the measured data
    loop: bool = False  # of a closed loop of two cables, with effort of either sign; or a tendon
    start: float = 0.0  # time of the first sample in the data [s]
    scale: BenchScale = UNIT_SCALE  # of what the signals are counted in, to `units`
    present: dict[str, Mask] = field(default_factory=dict)  # measured, not interpolated
    variables: dict[str, Array] = field(default_factory=dict)  # further columns, by name
    file: int = 0  # its number among the fitted records, from 1; 0 if it is none of them

    @cached_property
    def compared(self) -> tuple[str, ...]:
        """Channels that a simulation is compared with."""
        return tuple(c for c in CHANNELS if c in self.signals and c != self.driver)

    @cached_property
    def starts_slack(self) -> bool:
        """Whether there is no tension at the first sample, as far as it was measured."""
        T = self.signals[PROXIMAL_TENSION][:5][self.valid[PROXIMAL_TENSION][:5]]
        if self.loop or not len(T):
            return False
        return bool(np.median(T) <= 5.0 * self.noise[PROXIMAL_TENSION])

    @cached_property
    def first_tensions(self) -> tuple[float, Array]:
        """Where the drive was when tension was first measured, and five readings from there on."""
        rows = np.flatnonzero(self.present[PROXIMAL_TENSION])[:5]
        return float(self.drive[rows[0]]), self.signals[PROXIMAL_TENSION][rows]

    def select_drawn_rows(self, channel: str) -> Mask:
        """Return which rows of a channel are to be drawn: not those that lack values for long."""
        return self.measured & ~find_long_gaps(self.time, self.present[channel])


def prepare_record(
    time: Array,
    signals: Signals,
    *,
    samples_max: int = SETTINGS.samples_max,
    noise: Mapping[str, float] = MappingProxyType({}),
    units: Units = LINEAR,
    loop: bool | None = None,
    variables: Mapping[str, Array] = MappingProxyType({}),
) -> Record:
    """Return a record made ready.

    Parameters
    ----------
    time : ndarray
        Stamps [s], shape (n,), strictly rising; see
        `estimator.signals.sampling.estimate_sample_times`.
    signals : dict
        By channel of `estimator.effects.CHANNELS`, the tension at the housing at least, in
        `units`, shape (n,), not finite where a value is missing.
    samples_max : int
        Samples that are kept of a longer record.
    noise : mapping
        Standard deviation of the white noise of channels, in `units`, where it is known better
        than the data tell it.
    units : Units
        [N] and [m] by default.
    loop : bool, optional
        Whether it is a closed loop of two cables; by default, whether effort changes its sign.
    variables : mapping
        Further columns that something may depend on, such as a temperature, shape (n,) each.

    Raises
    ------
    RecordError
        If nothing can be found out from the data.
    """
    signals = mark_missing(signals)
    _validate_signals(time, signals, units)
    has_tension = PROXIMAL_TENSION in signals  # else two travels, see travel_diagnosis.py
    loop = has_tension and (is_loop(units, [signals]) if loop is None else loop)
    if loop and PROXIMAL_DISPLACEMENT not in signals:
        raise RecordError(
            f"effort changes its sign, as in a closed loop of two cables: "
            f"the {units.name_channel(PROXIMAL_DISPLACEMENT)} is needed, which drives the loop"
        )
    for name in (PROXIMAL_TENSION, DISTAL_TENSION):
        if loop or name not in signals:
            continue
        effort = drop_missing(signals[name])
        if -effort.min() > effort.max():
            raise RecordError(
                f"{units.name_channel(name)}: negative where the tendon pulls; "
                f"{suggest_sign(name, units)}"
            )
    noise, stamps = dict(noise), time
    driver = PROXIMAL_DISPLACEMENT if PROXIMAL_DISPLACEMENT in signals else PROXIMAL_TENSION
    time, signals, missing_issues = _select_driver_rows(driver, time, signals, units)
    start = float(time[0])
    time, stamp_jitter = estimate_sample_times(time - start, signals)
    present = {name: np.isfinite(signal) for name, signal in signals.items()}
    valid, rounding, issues = {}, {}, find_sampling_issues(time, signals)
    if stamp_jitter > 0.0:
        message = (
            f"time stamps jitter by {1e3 * stamp_jitter:.2g} ms where samples are even: "
            "taken as even"
        )
        issues.append(DataIssue(message, "all channels", len(time), 0.0, excluded=False))
    for name, signal in signals.items():
        valid[name], channel_issues = select_valid_samples(time, name, signal)
        rounding[name] = find_quantisation_step(signal[valid[name]]) / math.sqrt(12.0)
        signals[name] = np.interp(time, time[valid[name]], signal[valid[name]])
        issues += channel_issues
    time, signals, valid, present, averaged, decimation_factor = decimate_record(
        time, signals, valid, present, samples_max
    )
    rounding, given_noise = (
        {name: value / math.sqrt(averaged[name]) for name, value in values.items()}
        for values in (rounding, noise)
    )
    sigma = _estimate_noise(driver, time, signals, valid, rounding, given_noise)
    measured = np.ones(len(time), dtype=np.bool_)
    drive, jitter = estimate_drive(driver, time, signals[driver], sigma[driver])
    issues += find_unseen_turns(driver, time, drive, jitter, start)
    if driver != PROXIMAL_TENSION:
        turns = find_turns_between_samples(time, drive, jitter)
        signals = {name: turns.interpolate_signal(time, signal) for name, signal in signals.items()}
        valid = {name: np.insert(mask, turns.rows, False) for name, mask in valid.items()}
        present = {name: turns.interpolate_mask(mask) for name, mask in present.items()}
        measured = np.insert(measured, turns.rows, False)
        time = np.insert(time, turns.rows, turns.time)
        drive = np.insert(drive, turns.rows, turns.drive)
        if has_tension:
            at_turns = exclude_turns(time, drive, valid[PROXIMAL_TENSION])
            valid[PROXIMAL_TENSION], issues = at_turns[0], [*issues, *at_turns[1]]
    block, speed = assign_blocks(time), compute_rate(time, drive)
    return Record(
        time=time,
        signals=signals,
        driver=driver,
        drive=drive,
        speed=speed,
        noise=sigma,
        sigma={name: np.full(len(time), sigma[name]) for name in signals if name != driver},
        valid=valid,
        measured=measured,
        train=select_training_half(block, drive, speed),
        block=block,
        issues=(*missing_issues, *(issue._replace(first=issue.first + start) for issue in issues)),
        decimation_factor=decimation_factor,
        units=units,
        loop=loop,
        start=start,
        present=present,
        variables={
            name: np.interp(time + start, stamps[rows], np.asarray(values)[rows])
            for name, values in variables.items()
            if (rows := np.isfinite(values)).any()
        },
    )


def collect_efforts(signals: Signals) -> list[Array]:
    """Return what is known of the tensions, forces or torques among signals."""
    return [
        drop_missing(signals[name])
        for name in (PROXIMAL_TENSION, DISTAL_TENSION)
        if name in signals
    ]


def is_loop(units: Units, records: Sequence[Signals]) -> bool:
    """Return whether records are of a closed loop: effort pushes in earnest in one of them."""
    efforts = [effort for signals in records for effort in collect_efforts(signals)]
    lowest = min(float(values.min()) for values in efforts)
    highest = max(float(values.max()) for values in efforts)
    return units.signed and min(-lowest, highest) > SETTINGS.push_share * max(-lowest, highest)


def _estimate_noise(
    driver: str,
    time: Array,
    signals: Signals,
    valid: dict[str, Mask],
    rounding: dict[str, float],
    given_noise: dict[str, float],
) -> dict[str, float]:
    """Return the standard deviation of each channel's white noise, as given or as the data say.

    It is that of its rounding at least.
    """
    sigma = {}
    for name, signal in signals.items():
        estimated = max(
            estimate_white_noise(signal[valid[name]], time[valid[name]]), rounding[name]
        )
        sigma[name] = given_noise.get(name, estimated)
        if name != driver:  # nothing is simulated more precisely
            sigma[name] = max(sigma[name], SETTINGS.noise_min * float(np.ptp(signal)), 1e-9)
    return sigma


def check_finite_values(signals: Signals) -> None:
    """Raise `RecordError` for a channel without any finite value."""
    for name, signal in signals.items():
        if not np.isfinite(signal).any():
            is_required = name == PROXIMAL_TENSION
            remedy = "it is needed; check the load cell" if is_required else "remove the channel"
            raise RecordError(f"{name}: has no finite value: {remedy}")


def _validate_signals(time: Array, signals: Signals, units: Units) -> None:
    travels_only = set(signals) == TRAVELS
    if PROXIMAL_TENSION not in signals and not travels_only:
        raise RecordError(
            "proximal_tension is missing: without it, both the motor's travel and that of the tip "
            "are needed"
        )
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
    unordered = np.flatnonzero(~(np.diff(time) > 0.0))
    if len(unordered):
        k = int(unordered[0]) + 1
        raise RecordError(
            f"time: sample {k} at {time[k]:.6g} s does not follow {time[k - 1]:.6g} s: "
            "remove samples that repeat a time, and sort them"
        )
    for name, signal in signals.items():
        if name not in CHANNELS:
            raise RecordError(f"{name}: no such channel, there are {', '.join(CHANNELS)}")
        if signal.shape != time.shape:
            raise RecordError(f"{name}: {time.shape} values are needed, NaN where one is missing")
    check_finite_values(signals)
    if travels_only:
        if still := [name for name in signals if not np.ptp(drop_missing(signals[name])) > 0.0]:
            raise RecordError(f"{still[0]} never changes: without a tension that says nothing")
        return
    if not np.ptp(drop_missing(signals[PROXIMAL_TENSION])) > 0.0:
        raise RecordError("proximal_tension never changes: pull and release while you record")
    q_p, T_out, q_d = (signals.get(name) for name in CHANNELS[1:])
    if faults := find_channel_faults(
        Samples(time, signals[PROXIMAL_TENSION], q_p, T_out, q_d), units
    ):
        raise RecordError("; ".join(faults))


def _select_driver_rows(
    driver: str, time: Array, signals: Signals, units: Units
) -> tuple[Array, Signals, list[DataIssue]]:
    """Return the rows in which the driver was measured, and what is said of missing values."""
    has_driver = np.isfinite(signals[driver])
    removed = "missing values of what drives the simulation, their rows removed"
    issues = []
    for name, signal in signals.items():
        is_missing = ~has_driver if name == driver else has_driver & ~np.isfinite(signal)
        if is_missing.any():
            message = removed if name == driver else "missing values, not compared"
            first_time = float(time[int(np.argmax(is_missing))])
            issues.append(DataIssue(message, name, int(is_missing.sum()), first_time))
    time, signals = select_signal_rows(time, signals, has_driver)
    for name, signal in signals.items():
        if (count := len(drop_missing(signal))) < SETTINGS.samples_min:
            condition = (
                "" if name == driver else f" in rows that have the {units.name_channel(driver)}"
            )
            raise RecordError(
                f"{name}: {count} values{condition}, at least {SETTINGS.samples_min} are needed: "
                "record all channels at the same times, or remove this one"
            )
    return time, signals, issues


def mark_all_as_train(record: Record) -> Record:
    """Return a record of which all samples are fitted."""
    return replace(record, train=np.ones_like(record.train))


def shorten_blocks(record: Record) -> Record:
    """Return a record that is cut into shorter blocks, so that a short stretch is in some of both.

    What is wrong in one block only can be fitted and not judged, or judged and not fitted.
    """
    block = assign_blocks(record.time, SETTINGS.short_block)
    return replace(
        record, train=select_training_half(block, record.drive, record.speed), block=block
    )


def hold_out_aperiodically(record: Record) -> Record:
    """Return a record whose fitted half repeats nothing; of every other block, a cycle may.

    Blocks are short, so that both halves see the whole range of a variable: longer ones leave
    speeds, or phases of a long cycle, that one half never sees, and nothing tells a function there.
    """
    if record.train.all():
        return record
    block = assign_blocks(record.time, SETTINGS.function_block)
    return replace(record, train=select_aperiodic_half(block), block=block)


def select_subsample(record: Record, samples_max: int) -> Mask:
    """Return which samples of a record stay for a first look: about `samples_max`, and all turns.

    The drive has no turn by noise, and none is too small: one of 2 um may take a newton away, which
    friction then remembers.
    """
    n = len(record.time)
    is_kept = np.zeros(n, dtype=np.bool_)
    is_kept[:: math.ceil(n / samples_max)] = True
    is_kept[find_turning_points(record.drive, TURN_TOLERANCE * float(np.ptp(record.drive)))] = True
    return is_kept


def select_record_rows(record: Record, rows: Mask) -> Record:
    """Return a record of some of its samples."""
    return replace(
        record,
        time=record.time[rows],
        signals={name: signal[rows] for name, signal in record.signals.items()},
        drive=record.drive[rows],
        speed=record.speed[rows],
        sigma={name: sigma[rows] for name, sigma in record.sigma.items()},
        valid={name: valid[rows] for name, valid in record.valid.items()},
        present={name: present[rows] for name, present in record.present.items()},
        variables={name: values[rows] for name, values in record.variables.items()},
        measured=record.measured[rows],
        train=record.train[rows],
        block=record.block[rows],
    )
