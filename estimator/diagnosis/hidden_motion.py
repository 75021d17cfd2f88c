"""Motion of the motor that the noise of its travel hides and the tension at the housing shows.

Just behind a turn the tension changes with the root of the travel: where the motor goes back by
less than the noise, the travel looks at rest while the tension falls or rises by many times its own
noise. There the tension tells the motion better. So where a simulation by the plain law leaves the
measured tension, the most probable motion is followed sample by sample, by tension and travel
together, until the travel alone tells the tension again: a few samples. It is taken if it lies
within the noise of the travel. Otherwise something else is wrong and nothing changes.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.drive import compute_rate
from estimator.diagnosis.model import (
    BaseParameters,
    build_plain_physics,
    invert_effects,
    simulate_record,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.troubles import DataIssue
from estimator.effects.effect import (
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Values,
)
from estimator.lumped.lumped_model import DrivenTendon

Mask = NDArray[np.bool_]

AGREEING_SAMPLES = 3  # neighbouring samples in which the tension agrees: nothing is hidden any more
SAMPLES_AFTER = 6  # samples in which the travel must tell the tension behind a hidden motion
SAMPLES_BEFORE = 4  # samples before the tension is seen off, in which the motion may have begun
MOTION_SAMPLES_MAX = 400  # samples that the tension may tell together
TENSION_OFFSETS = np.linspace(
    -3.0, 3.0, 13
)  # sigma: tensions about the measured one that are tried
EXCLUSION_TEXT = "samples excluded, in which the motor moved within the noise of its travel"


class _Readings(NamedTuple):
    """What a record says of tension and travel."""

    tension: Array  # [N]
    travel: Array  # [m] since the tendon is taut
    known: Mask  # which tensions were measured
    good: Mask  # and count
    noise: Array  # [N] of the tension, and what the noise of the travel makes of a simulation's
    accuracy: float  # [N] of the tension itself, and of a simulation
    sigma: float  # [m] noise of the travel
    inaccuracy: float  # [m] by which the travel of a simulation may be off


class _HiddenMotion(NamedTuple):
    """A hidden motion."""

    begin: int
    told: int  # the first sample that the tension does not tell
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
    base : Base
        The base law.
    shared, own : tuple of float
        Its numbers, fitted to the record.
    """
    if not may_hide_motion(record):
        return record
    physics = build_plain_physics(record, base, base.values(shared, own))
    drive, told = record.drive - own[0], np.zeros(len(record.time), dtype=np.bool_)
    for noise in (record.sigma[PROXIMAL_TENSION], record.noise[PROXIMAL_TENSION]):
        tendon, position = DrivenTendon(physics, record.time), 0
        readings = _build_readings(record, own[0], np.full(len(drive), noise))
        while (found := _find_next_motion(readings, tendon, drive, position)) is not None:
            drive[found.begin : found.end] = found.travel
            told[found.begin : found.told] = True
            position = found.end
        if told.mean() > SETTINGS.hidden_share:  # a misfit all over is no noise
            return record
    if not told.any():
        return record
    good = record.good | {PROXIMAL_TENSION: record.good[PROXIMAL_TENSION] & ~told}
    first = record.start + float(record.time[int(np.argmax(told))])
    return replace(
        record,
        drive=drive + own[0],
        speed=compute_rate(record.time, drive),
        good=good,
        troubles=(
            *record.troubles,
            DataIssue(EXCLUSION_TEXT, PROXIMAL_TENSION, int(told.sum()), first),
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

    What they make of readings and of the tension is taken off first, as they are without it.

    Parameters
    ----------
    record : Record
        With what hidden motion was found before, if any.
    context : EffectContext
        What effects may know of it.
    base, shared, own, effects
        The model, fitted to the record.
    """
    if not may_hide_motion(record):
        return record
    alone = simulate_record(record, context, base, shared, own, effects).signals[PROXIMAL_TENSION]
    travel = invert_effects(record.signals[PROXIMAL_DISPLACEMENT], context, effects)
    bare = replace(record, drive=invert_effects(record.drive, context, effects))
    plain = simulate_record(bare, context, base, shared, own, ()).signals[PROXIMAL_TENSION]
    tension = record.signals[PROXIMAL_TENSION] - (alone - plain)
    taken = {PROXIMAL_TENSION: tension, PROXIMAL_DISPLACEMENT: travel}
    bare = replace(bare, signals=record.signals | taken)
    moved = recover_hidden_motion(bare, base, shared, own)
    if moved is bare:
        return record
    drive = record.drive + (moved.drive - bare.drive)
    return replace(
        record,
        drive=drive,
        speed=compute_rate(record.time, drive),
        good=moved.good,
        troubles=moved.troubles,
    )


def _build_readings(record: Record, taut: float, noise: Array) -> _Readings:
    tension, travel = record.signals[PROXIMAL_TENSION], record.signals[PROXIMAL_DISPLACEMENT]
    off = SETTINGS.accuracy * float(np.ptp(tension))
    return _Readings(
        tension,
        travel - taut,
        record.known[PROXIMAL_TENSION],
        record.good[PROXIMAL_TENSION],
        noise,
        float(np.hypot(record.noise[PROXIMAL_TENSION], off)),
        record.noise[PROXIMAL_DISPLACEMENT],
        SETTINGS.accuracy * float(np.ptp(travel)),
    )


def _find_next_motion(
    readings: _Readings, tendon: DrivenTendon, drive: Array, position: int
) -> _HiddenMotion | None:
    """Return the first hidden motion from a sample on."""
    while position < len(drive):
        off = tendon.by_travel(drive, position) - readings.tension[position:]
        off = np.abs(off) / readings.noise[position:]
        off[~readings.good[position:]] = 0.0
        far = off > SETTINGS.hidden_tension
        both = far[:-1] & far[1:]
        if not both.any():
            return None
        first = position + int(np.argmax(both))
        begin = max(first - SAMPLES_BEFORE, position, 1)
        for about in (drive, readings.travel):  # a short motion may have been smoothed away
            found = _track_motion(readings, tendon, drive, about, begin, first)
            if found is not None and not _is_within_noise(readings, found):
                shifted = _shift_to_rest(readings, about, found)
                found = _track_motion(readings, tendon, drive, shifted, begin, first)
            if found is not None and _is_within_noise(readings, found):
                return found
        near = np.convolve(off < SETTINGS.hidden_again, np.ones(AGREEING_SAMPLES), "full")[
            AGREEING_SAMPLES - 1 :
        ]
        again = np.flatnonzero(near[first - position :] == AGREEING_SAMPLES)
        position = first + int(again[0]) if len(again) else len(drive)
    return None


def _track_motion(
    readings: _Readings, tendon: DrivenTendon, drive: Array, about: Array, begin: int, first: int
) -> _HiddenMotion | None:
    """Return the most probable motion `about` a travel [m] from a sample on.

    It ends where the travel alone tells the tension best from there on, of the first few samples in
    which it does. None if it leaves the tension by more than noise, or never ends.
    """
    tendon, moved = tendon.copy(), drive.copy()
    found: _HiddenMotion | None = None
    missed, least = 0.0, SETTINGS.hidden_again**2
    last = min(begin + MOTION_SAMPLES_MAX, len(drive) - SAMPLES_AFTER)
    for i in range(begin, last):
        if i > last or not readings.known[i]:
            break
        moved[i], off = _estimate_position(readings, tendon, moved, about, i)
        missed += off**2
        if missed > SETTINGS.hidden_again**2 * (i - begin + SAMPLES_AFTER):
            break
        for end in _find_motion_ends(readings, drive, i + 1, float(moved[i])) if i >= first else ():
            moved[i + 1 : end], moved[end:] = moved[i], drive[end:]
            then = _compute_tension_error(readings, tendon, moved, i + 1)
            if then < least:
                last = last if found else i + SAMPLES_AFTER
                least, found = then, _HiddenMotion(begin, i + 1, end, moved[begin:end].copy())
    return found


def _shift_to_rest(readings: _Readings, about: Array, found: _HiddenMotion) -> Array:
    """Return a travel moved so that a motion about it ends where the motor rests behind it.

    From the turn on the tension tells by how far the motor went back; where it turned was read in
    one noisy sample, where it rests is read in many.
    """
    rest = slice(found.told, found.end)
    off = readings.travel[rest] - found.travel[rest.start - found.begin :]
    shift = np.zeros_like(about)
    if len(off):
        shift[found.begin : found.told] = off.mean()
    return np.asarray(about + shift)


def _estimate_position(
    readings: _Readings, tendon: DrivenTendon, moved: Array, about: Array, i: int
) -> tuple[float, float]:
    """Return where the motor most probably is at a sample [m], and by how far that tension is off.

    That is counted in its noise. The motor is at `about`, or where it has a tension near the
    measured one; behind a turn that is within nanometres, on the way millimetres.
    """
    tensions = np.maximum(readings.tension[i] + TENSION_OFFSETS * readings.accuracy, 0.0)
    places = [
        tendon.by_tension(moved, i, tensions[k : k + 1])[0][0] for k in range(len(TENSION_OFFSETS))
    ]
    costs = TENSION_OFFSETS**2 + ((np.array(places) - about[i]) / readings.sigma) ** 2
    best = int(np.argmin(costs))
    there = np.append(moved[:i], about[i])
    off = float(tendon.by_travel(there, i)[0] - readings.tension[i]) / readings.accuracy
    if off**2 <= costs[best]:
        return float(about[i]), off
    return float(places[best]), float(TENSION_OFFSETS[best])


def _compute_tension_error(
    readings: _Readings, tendon: DrivenTendon, moved: Array, begin: int
) -> float:
    """Return the mean square by which a travel misses the tension in the samples from one on."""
    later = slice(begin, begin + SAMPLES_AFTER)
    simulated = tendon.copy().by_travel(moved[: later.stop], begin)
    return float(np.mean(((simulated - readings.tension[later]) / readings.accuracy) ** 2))


def _is_within_noise(readings: _Readings, found: _HiddenMotion) -> bool:
    """Return whether a motion is within the noise of the travel: on average, in scatter, anywhere.

    A simulation may be off itself besides, up to half the noise.
    """
    off = readings.travel[found.begin : found.end] - found.travel
    n, sigma, most = len(off), readings.sigma, SETTINGS.hidden_travel
    average = np.hypot(sigma / np.sqrt(n), min(readings.inaccuracy, 0.5 * sigma))
    scatter = 1.5 + most * np.sqrt(2.0 / n)
    return bool(
        abs(float(off.mean())) < most * average
        and float(np.mean(off**2)) < scatter * sigma**2
        and float(np.abs(off).max()) < SETTINGS.hidden_farthest * sigma
    )


def _find_motion_ends(
    readings: _Readings, drive: Array, begin: int, left_at: float
) -> tuple[int, int]:
    """Return where a motor that the tension left at a place [m] may go on as the travel has it.

    Where it passes the place or turns before; or where it is further off than noise.
    """
    steps = np.diff(drive[begin - 1 :])
    moving = np.flatnonzero(steps)
    way = np.sign(steps[moving[0]]) if len(moving) else 0.0
    off = drive[begin:] - left_at
    passed = (way * off > 0.0) | (way * steps < 0.0)
    left = np.abs(off) > SETTINGS.hidden_travel * readings.sigma
    return _find_first_true(passed, begin), _find_first_true(left, begin)


def _find_first_true(mask: Mask, begin: int) -> int:
    """Return the first sample from `begin` on of which a mask is true, or behind the last."""
    return begin + (int(np.argmax(mask)) if mask.any() else len(mask))
