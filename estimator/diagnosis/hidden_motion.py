"""What the noise of the driving channel does to a simulation, and motion that it hides."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array, Mask
from estimator.diagnosis.dataset import (
    BaseParameters,
    Dataset,
    Fit,
    build_plain_physics,
    build_unsimulated_contexts,
    invert_effects,
    simulate_record,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Values,
)
from estimator.lumped.lumped_model import DrivenTendon
from estimator.signals.driving_signal import compute_rate, estimate_drive
from estimator.signals.sampling import DataIssue

# --- what the noise of what drives a simulation makes of it


NOISE_DRAWS = 8  # of the driver's noise
AVERAGING_SAMPLES = 5  # samples over which the variance that it makes is averaged


def propagate_driver_noise(records: Sequence[Record], dataset: Dataset, fit: Fit) -> list[Record]:
    """Return records whose `sigma` has in it what the driver's noise does to a simulation.

    Friction remembers where the driver turned, so an error of the driver shows most just behind a
    turn, where the tension changes with the root of the travel. The base law, `fit` to a `dataset`
    of these records, simulates them with noise put on the drive once more (parametric bootstrap);
    the variance that this makes of each channel is taken sample by sample.
    """
    contexts = build_unsimulated_contexts(dataset, fit)
    return [
        _propagate_noise(record, context, dataset.base, fit.model.shared, own)
        for record, context, own in zip(records, contexts, fit.model.own, strict=True)
    ]


def _propagate_noise(
    record: Record, context: EffectContext, base: BaseParameters, shared: Values, own: Values
) -> Record:
    sigma = record.noise[record.driver]
    if not sigma > 0.0:
        return record
    rng = np.random.default_rng(0)
    reference = simulate_record(record, context, base, shared, own, ()).signals
    variance = {channel: np.zeros_like(record.time) for channel in record.compared}
    for _ in range(NOISE_DRAWS):
        noisy = record.drive + sigma * rng.standard_normal(len(record.time))
        drive = estimate_drive(record.driver, record.time, noisy, sigma).signal
        driven = replace(record, drive=drive)
        perturbed = simulate_record(driven, context, base, shared, own, ()).signals
        for channel in variance:
            variance[channel] += (perturbed[channel] - reference[channel]) ** 2 / NOISE_DRAWS
    kernel = np.full(AVERAGING_SAMPLES, 1.0 / AVERAGING_SAMPLES)
    return replace(
        record,
        sigma={
            channel: np.sqrt(
                record.noise[channel] ** 2 + np.convolve(channel_variance, kernel, mode="same")
            )
            for channel, channel_variance in variance.items()
        },
    )


# --- motion of the motor that the noise of its travel hides and the tension at the housing shows
# Just behind a turn the tension changes with the root of the travel: where the motor goes back by
# less than the noise, the travel looks at rest while the tension falls or rises by many times its
# own noise. There the tension determines the motion better. So where a simulation by the base law
# leaves the measured tension, the most probable motion is followed sample by sample, by tension and
# travel together, until the travel alone tells the tension again: a few samples. It is taken if it
# lies within the noise of the travel. Otherwise something else is wrong and nothing changes.


AGREEING_SAMPLES = 3  # neighbouring samples in which the tension agrees: nothing is hidden any more
SAMPLES_AFTER = 6  # samples in which the travel must tell the tension behind a hidden motion
SAMPLES_BEFORE = 4  # samples before the tension is seen off, in which the motion may have begun
MOTION_SAMPLES_MAX = 400  # samples that the tension may tell together
# sigma: tensions about the measured one that are tried
TENSION_OFFSETS = np.linspace(-3.0, 3.0, 13)
EXCLUSION_TEXT = "samples excluded, in which the motor moved within the noise of its travel"


class _Readings(NamedTuple):
    """What a record says of tension and travel."""

    tension: Array  # [N]
    travel: Array  # [m] since the tendon is taut
    present: Mask  # which tensions were measured
    valid: Mask  # and count
    noise: Array  # [N] of the tension, and what the noise of the travel makes of a simulation's
    accuracy: float  # [N] of the tension itself, and of a simulation
    sigma: float  # [m] noise of the travel
    inaccuracy: float  # [m] by which the travel of a simulation may be off


class _HiddenMotion(NamedTuple):
    """A hidden motion."""

    begin: int
    inferred_end: int  # the first sample that the tension does not tell
    end: int  # the first one in which the motor is where the travel has it
    travel: Array  # [m], shape (end - begin,)


def may_hide_motion(record: Record) -> bool:
    """Return whether a tendon is driven by a travel that has noise."""
    travels = record.driver == PROXIMAL_DISPLACEMENT and not record.loop
    return travels and record.noise[PROXIMAL_DISPLACEMENT] > 0.0


def recover_hidden_motion(
    record: Record, base: BaseParameters, shared: tuple[float, ...], own: tuple[float, ...]
) -> Record:
    """Return a record whose drive has the motion that its travel hides.

    Where the tension was taken to find it, it is not compared any more.

    Parameters
    ----------
    record : Record
        Of which `sigma` tells what the noise of the travel makes of the tension.
    shared, own : tuple of float
        Its numbers, fitted to the record.
    """
    if not may_hide_motion(record):
        return record
    physics = build_plain_physics(record, base, base.values(shared, own))
    drive, tension_inferred = record.drive - own[0], np.zeros(len(record.time), dtype=np.bool_)
    for noise in (record.sigma[PROXIMAL_TENSION], record.noise[PROXIMAL_TENSION]):
        tendon, position = DrivenTendon(physics, record.time), 0
        readings = _build_readings(record, own[0], np.full(len(drive), noise))
        while (motion := _find_next_motion(readings, tendon, drive, position)) is not None:
            drive[motion.begin : motion.end] = motion.travel
            tension_inferred[motion.begin : motion.inferred_end] = True
            position = motion.end
        if tension_inferred.mean() > SETTINGS.hidden_share:  # a misfit all over is no noise
            return record
    if not tension_inferred.any():
        return record
    valid = record.valid | {PROXIMAL_TENSION: record.valid[PROXIMAL_TENSION] & ~tension_inferred}
    first_time = record.start + float(record.time[int(np.argmax(tension_inferred))])
    return replace(
        record,
        drive=drive + own[0],
        speed=compute_rate(record.time, drive),
        valid=valid,
        issues=(
            *record.issues,
            DataIssue(EXCLUSION_TEXT, PROXIMAL_TENSION, int(tension_inferred.sum()), first_time),
        ),
    )


def recover_motion_beside_effects(
    record: Record,
    context: EffectContext,
    base: BaseParameters,
    shared: tuple[float, ...],
    own: tuple[float, ...],
    effects: Sequence[tuple[Effect, Values]],
) -> Record:
    """Return a record with the hidden motion that shows beside effects.

    The change that the effects make to readings and to the tension is subtracted first.

    Parameters
    ----------
    record : Record
        With the hidden motion recovered before, if any.
    context : EffectContext
        What effects may know of it.
    base, shared, own, effects
        The model, fitted to the record.
    """
    if not may_hide_motion(record):
        return record
    tension_with = simulate_record(record, context, base, shared, own, effects).signals[
        PROXIMAL_TENSION
    ]
    travel = invert_effects(record.signals[PROXIMAL_DISPLACEMENT], context, effects)
    record_without = replace(record, drive=invert_effects(record.drive, context, effects))
    tension_without = simulate_record(record_without, context, base, shared, own, ()).signals[
        PROXIMAL_TENSION
    ]
    tension = record.signals[PROXIMAL_TENSION] - (tension_with - tension_without)
    signals_without = {PROXIMAL_TENSION: tension, PROXIMAL_DISPLACEMENT: travel}
    record_without = replace(record_without, signals=record.signals | signals_without)
    recovered = recover_hidden_motion(record_without, base, shared, own)
    if recovered is record_without:
        return record
    drive = record.drive + (recovered.drive - record_without.drive)
    return replace(
        record,
        drive=drive,
        speed=compute_rate(record.time, drive),
        valid=recovered.valid,
        issues=recovered.issues,
    )


def _build_readings(record: Record, taut_travel: float, noise: Array) -> _Readings:
    tension, travel = record.signals[PROXIMAL_TENSION], record.signals[PROXIMAL_DISPLACEMENT]
    simulation_error = SETTINGS.accuracy * float(np.ptp(tension))
    return _Readings(
        tension,
        travel - taut_travel,
        record.present[PROXIMAL_TENSION],
        record.valid[PROXIMAL_TENSION],
        noise,
        float(np.hypot(record.noise[PROXIMAL_TENSION], simulation_error)),
        record.noise[PROXIMAL_DISPLACEMENT],
        SETTINGS.accuracy * float(np.ptp(travel)),
    )


def _find_next_motion(
    readings: _Readings, tendon: DrivenTendon, drive: Array, position: int
) -> _HiddenMotion | None:
    """Return the first hidden motion from a sample on."""
    while position < len(drive):
        deviation = tendon.drive_by_travel(drive, position) - readings.tension[position:]
        deviation = np.abs(deviation) / readings.noise[position:]
        deviation[~readings.valid[position:]] = 0.0
        is_off = deviation > SETTINGS.hidden_tension
        is_off_twice = is_off[:-1] & is_off[1:]
        if not is_off_twice.any():
            return None
        first_off = position + int(np.argmax(is_off_twice))
        begin = max(first_off - SAMPLES_BEFORE, position, 1)
        for reference in (drive, readings.travel):  # a short motion may have been smoothed away
            motion = _track_motion(readings, tendon, drive, reference, begin, first_off)
            if motion is not None and not _is_within_noise(readings, motion):
                shifted = _shift_to_rest(readings, reference, motion)
                motion = _track_motion(readings, tendon, drive, shifted, begin, first_off)
            if motion is not None and _is_within_noise(readings, motion):
                return motion
        agreeing = np.convolve(
            deviation < SETTINGS.hidden_tension_end, np.ones(AGREEING_SAMPLES), "full"
        )[AGREEING_SAMPLES - 1 :]
        agreement = np.flatnonzero(agreeing[first_off - position :] == AGREEING_SAMPLES)
        position = first_off + int(agreement[0]) if len(agreement) else len(drive)
    return None


def _track_motion(
    readings: _Readings,
    tendon: DrivenTendon,
    drive: Array,
    reference: Array,
    begin: int,
    first_off: int,
) -> _HiddenMotion | None:
    """Return the most probable motion near the travel `reference` [m] from sample `begin` on.

    It ends where the travel alone tells the tension best from there on, of the first few samples in
    which it does. None if it leaves the tension by more than noise, or never ends.
    """
    tendon, tracked = tendon.copy(), drive.copy()
    motion: _HiddenMotion | None = None
    squared_error, error_min = 0.0, SETTINGS.hidden_tension_end**2
    end_max = min(begin + MOTION_SAMPLES_MAX, len(drive) - SAMPLES_AFTER)
    for i in range(begin, end_max):
        if i > end_max or not readings.present[i]:
            break
        tracked[i], deviation = _estimate_position(readings, tendon, tracked, reference, i)
        squared_error += deviation**2
        if squared_error > SETTINGS.hidden_tension_end**2 * (i - begin + SAMPLES_AFTER):
            break
        for end in (
            _find_motion_ends(readings, drive, i + 1, float(tracked[i])) if i >= first_off else ()
        ):
            tracked[i + 1 : end], tracked[end:] = tracked[i], drive[end:]
            error = _compute_tension_error(readings, tendon, tracked, i + 1)
            if error < error_min:
                end_max = end_max if motion else i + SAMPLES_AFTER
                error_min = error
                motion = _HiddenMotion(begin, i + 1, end, tracked[begin:end].copy())
    return motion


def _shift_to_rest(readings: _Readings, reference: Array, motion: _HiddenMotion) -> Array:
    """Return a reference travel shifted so that a motion near it ends where the motor rests.

    From the turn on the tension tells by how far the motor went back; where it turned was read in
    one noisy sample, where it rests is read in many.
    """
    rest_rows = slice(motion.inferred_end, motion.end)
    deviation = readings.travel[rest_rows] - motion.travel[rest_rows.start - motion.begin :]
    shift = np.zeros_like(reference)
    if len(deviation):
        shift[motion.begin : motion.inferred_end] = deviation.mean()
    return np.asarray(reference + shift)


def _estimate_position(
    readings: _Readings, tendon: DrivenTendon, tracked: Array, reference: Array, i: int
) -> tuple[float, float]:
    """Return where the motor most probably is at a sample [m], and by how far that tension is off.

    That is counted in its noise. The motor is at `reference`, or where it has a tension near the
    measured one; behind a turn that is within nanometres, on the way millimetres.
    """
    tensions = np.maximum(readings.tension[i] + TENSION_OFFSETS * readings.accuracy, 0.0)
    positions = [
        tendon.drive_by_tension(tracked, i, tensions[k : k + 1])[0][0]
        for k in range(len(TENSION_OFFSETS))
    ]
    costs = TENSION_OFFSETS**2 + ((np.array(positions) - reference[i]) / readings.sigma) ** 2
    best = int(np.argmin(costs))
    reference_drive = np.append(tracked[:i], reference[i])
    deviation = (
        float(tendon.drive_by_travel(reference_drive, i)[0] - readings.tension[i])
        / readings.accuracy
    )
    if deviation**2 <= costs[best]:
        return float(reference[i]), deviation
    return float(positions[best]), float(TENSION_OFFSETS[best])


def _compute_tension_error(
    readings: _Readings, tendon: DrivenTendon, drive: Array, begin: int
) -> float:
    """Return the mean square by which a travel misses the tension in the samples from one on."""
    later = slice(begin, begin + SAMPLES_AFTER)
    simulated = tendon.copy().drive_by_travel(drive[: later.stop], begin)
    return float(np.mean(((simulated - readings.tension[later]) / readings.accuracy) ** 2))


def _is_within_noise(readings: _Readings, motion: _HiddenMotion) -> bool:
    """Return whether a motion is within the noise of the travel: on average, in scatter, anywhere.

    A simulation may be off itself besides, up to half the noise.
    """
    deviation = readings.travel[motion.begin : motion.end] - motion.travel
    n, sigma, tolerance = len(deviation), readings.sigma, SETTINGS.hidden_travel
    average = np.hypot(sigma / np.sqrt(n), min(readings.inaccuracy, 0.5 * sigma))
    scatter = 1.5 + tolerance * np.sqrt(2.0 / n)
    return bool(
        abs(float(deviation.mean())) < tolerance * average
        and float(np.mean(deviation**2)) < scatter * sigma**2
        and float(np.abs(deviation).max()) < SETTINGS.hidden_travel_max * sigma
    )


def _find_motion_ends(
    readings: _Readings, drive: Array, begin: int, position: float
) -> tuple[int, int]:
    """Return where a motor that the tension left at a place [m] may go on as the travel has it.

    Where it passes the place or turns before; or where it is further off than noise.
    """
    steps = np.diff(drive[begin - 1 :])
    moving = np.flatnonzero(steps)
    direction = np.sign(steps[moving[0]]) if len(moving) else 0.0
    deviation = drive[begin:] - position
    is_past = (direction * deviation > 0.0) | (direction * steps < 0.0)
    is_beyond_noise = np.abs(deviation) > SETTINGS.hidden_travel * readings.sigma
    return _find_first_true(is_past, begin), _find_first_true(is_beyond_noise, begin)


def _find_first_true(mask: Mask, begin: int) -> int:
    """Return the first sample from `begin` on of which a mask is true, or behind the last."""
    return begin + (int(np.argmax(mask)) if mask.any() else len(mask))
