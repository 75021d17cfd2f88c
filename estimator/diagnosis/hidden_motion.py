"""Motion of the motor that the noise of its travel hides and the tension at the housing shows.

Just behind a turn the tension changes with the root of the travel: where the motor goes back by
less than the noise, the travel looks at rest while the tension falls or rises by many times its own
noise. There the tension tells the motion better. So, in a simulation by the plain law, it drives
the few samples in which the travel-driven one leaves the measured tension, if the motion that this
asks for lies within the noise of the travel. Otherwise something else is wrong and nothing changes.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.drive import rate, tension_drive
from estimator.diagnosis.model import Base, plain_physics
from estimator.diagnosis.record import Record, Trouble
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_DISPLACEMENT, PROXIMAL_TENSION
from estimator.lumped.lumped_model import Drivable

Mask = NDArray[np.bool_]

AGREES = 3  # neighbouring samples in which the tension agrees again: the end of a stretch
BEFORE = 4  # samples before the tension is seen off, in which the motion may have begun
WHAT = "samples excluded, in which the motor moved within the noise of its travel"


class _Stretch(NamedTuple):
    """Samples that the tension drives, and the travel that it asks for [m]."""

    begin: int
    end: int  # the first one that it does not drive
    travel: Array  # shape (end - begin,)


def with_hidden_motion(
    record: Record, base: Base, shared: tuple[float, ...], own: tuple[float, ...]
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
    sigma = record.noise[PROXIMAL_DISPLACEMENT] if record.driver == PROXIMAL_DISPLACEMENT else 0.0
    if record.loop or not sigma > 0.0:
        return record
    physics = plain_physics(record, base, base.values(shared, own))
    drive, driven = record.drive - own[0], np.zeros(len(record.time), dtype=np.bool_)
    for noise in (record.sigma[PROXIMAL_TENSION], record.noise[PROXIMAL_TENSION]):
        tendon = Drivable(physics, record.time)
        position, off_by = 0, np.full(len(drive), noise)
        while (found := _next(record, tendon, drive, position, off_by, sigma, own[0])) is not None:
            begin, end, travel = found
            resumed = _resumed(drive, end, float(travel[-1]))
            drive[begin:end] = travel
            drive[end:resumed] = travel[-1]
            driven[begin:end] = True
            position = resumed
        if driven.mean() > SETTINGS.hidden_share:  # a misfit all over is no noise
            return record
    if not driven.any():
        return record
    good = record.good | {PROXIMAL_TENSION: record.good[PROXIMAL_TENSION] & ~driven}
    first = record.start + float(record.time[int(np.argmax(driven))])
    return replace(
        record,
        drive=drive + own[0],
        speed=rate(record.time, drive),
        good=good,
        troubles=(*record.troubles, Trouble(WHAT, PROXIMAL_TENSION, int(driven.sum()), first)),
    )


def _next(
    record: Record,
    tendon: Drivable,
    drive: Array,
    position: int,
    noise: Array,
    sigma: float,
    taut: float,
) -> _Stretch | None:
    """Return the first stretch from `position` on in which the travel hides a motion."""
    measured = record.signals[PROXIMAL_TENSION]
    good = record.good[PROXIMAL_TENSION]
    while position < len(drive):
        off = np.abs(tendon.by_travel(drive, position) - measured[position:]) / noise[position:]
        off[~good[position:]] = 0.0
        far = off > SETTINGS.hidden_tension
        both = far[:-1] & far[1:]
        if not both.any():
            return None
        first = position + int(np.argmax(both))
        near = np.convolve(off < SETTINGS.hidden_again, np.ones(AGREES), "full")[AGREES - 1 :]
        again = np.flatnonzero(near[first - position :] == AGREES)
        end = first + int(again[0]) if len(again) else len(drive)
        begin = max(first - BEFORE, position, 1)
        driven_by = tension_drive(measured[begin:end], record.noise[PROXIMAL_TENSION])
        tension = np.maximum(driven_by.signal, 0.0)
        travel, compliance = tendon.by_tension(drive, begin, tension)
        off = record.signals[PROXIMAL_DISPLACEMENT][begin:end] - taut - travel
        known = record.known[PROXIMAL_TENSION][begin:end].all()
        if known and _is_within(off, sigma, SETTINGS.accuracy * float(np.ptp(drive))):
            noise_of_tension = compliance * record.noise[PROXIMAL_TENSION]
            share = sigma**2 / (sigma**2 + noise_of_tension**2)
            return _Stretch(begin, end, drive[begin:end] + share * (travel - drive[begin:end]))
        position = end
    return None


def _is_within(off: Array, sigma: float, inaccuracy: float) -> bool:
    """Return whether a travel is off by no more than its noise, on average and in its scatter.

    A simulation may be off by its own `inaccuracy` [m] besides, up to half the noise.
    """
    n, most = len(off), SETTINGS.hidden_travel
    bias = abs(float(off.mean())) / np.hypot(sigma / np.sqrt(n), min(inaccuracy, 0.5 * sigma))
    square = float(np.mean(off**2)) / sigma**2
    return bool(bias < most and square < 1.5 + most * np.sqrt(2.0 / n))


def _resumed(drive: Array, end: int, left_at: float) -> int:
    """Return where the motor passes the place at which the tension left it, or turns before."""
    steps = np.diff(drive[end - 1 :])
    moving = np.flatnonzero(steps)
    if not len(moving):
        return len(drive)
    way = np.sign(steps[moving[0]])
    on_its_own = (way * (drive[end:] - left_at) > 0.0) | (way * steps < 0.0)
    return end + int(np.argmax(on_its_own)) if on_its_own.any() else len(drive)
