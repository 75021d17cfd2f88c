"""The model that is fitted: the law, what holds the tip, and effects on top of it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Parameter,
    Signals,
    Values,
)
from estimator.lumped.lumped_model import Motion, Physics, by_tension, by_travel
from estimator.lumped.nodes import even_weights

FRICTION = Parameter("K", "", 0.01, 5.0, 0.05)
COMPLIANCE = Parameter("L/EA", "m/N", 1e-7, 2e-3, 5e-6)
TIP = Parameter("tip compliance", "m/N", 0.0, 0.1, 1e-5)
TAUT = Parameter("taut at", "m", -10.0, 10.0, 1e-5)  # of each record
TIP_ZERO = Parameter("tip zero", "m", -10.0, 10.0, 1e-6)  # of each record


class Base(NamedTuple):
    """Parameters that every model has: of the dataset, and of each record."""

    shared: tuple[Parameter, ...]
    own: tuple[Parameter, ...]


class Simulated(NamedTuple):
    """One record, simulated."""

    signals: Signals  # what the sensors would have read, by channel
    motion: Motion  # what they would have read it of


def base_of(record: Record) -> Base:
    """Return the parameters that the channels of a record call for."""
    if record.driver == PROXIMAL_TENSION:
        return Base((FRICTION,), ())
    own = (TAUT, TIP_ZERO) if DISTAL_DISPLACEMENT in record.signals else (TAUT,)
    return Base((FRICTION, COMPLIANCE, TIP), own)


def own_bounds(record: Record) -> list[tuple[float, float]]:
    """Return between which values a record's own parameters may be, in the order of its base."""
    bounds = [(p.low, p.high) for p in base_of(record).own]
    if bounds and record.starts_slack:
        T = record.signals[PROXIMAL_TENSION]
        soft = float(np.ptp(record.drive)) / float(np.ptp(T))
        near = SETTINGS.slack_noise * record.noise[PROXIMAL_TENSION] * soft
        bounds[0] = (float(record.drive[0]) - near, float(record.drive[0]) + near)
    return bounds


def plain_physics(record: Record, shared: Sequence[float]) -> Physics:
    """Return the tendon of the plain law, from the values of `base_of` the record."""
    K, *elastic = shared
    compliance, tip = elastic if elastic else (SETTINGS.assumed_compliance, 0.0)
    return Physics(np.full(len(record.time), K), compliance, even_weights(), tip)


def simulate(
    record: Record,
    context: EffectContext,
    shared: Sequence[float],
    own: Sequence[float],
    effects: Sequence[tuple[Effect, Values]],
) -> Simulated:
    """Return what the sensors of a record would have read.

    Parameters
    ----------
    record : Record
        What drives it.
    context : EffectContext
        What effects may know of it.
    shared, own : sequence of float
        Values of `base_of` the record.
    effects : sequence of (Effect, values)
        On top, in this order.
    """
    physics = plain_physics(record, shared)
    for effect, values in effects:
        physics = effect.physics(physics, values, context)
    drive = record.drive
    for effect, values in reversed(effects):
        drive = effect.invert(drive, values, context)
    if record.driver == PROXIMAL_TENSION:
        motion = by_tension(physics, record.time, np.maximum(drive, 0.0), record.speed)
    else:
        motion = by_travel(physics, record.time, drive - own[0], record.speed)
    signals: Signals = {
        PROXIMAL_TENSION: motion.proximal_tension,
        PROXIMAL_DISPLACEMENT: motion.proximal_displacement,
        DISTAL_TENSION: motion.distal_tension,
    }
    if len(own) > 1:
        signals[DISTAL_DISPLACEMENT] = motion.distal_displacement + own[1]
    for effect, values in effects:
        signals = effect.measure(signals, values, context)
    return Simulated({name: signals[name] for name in record.compared}, motion)


def scene_of(record: Record, simulated: Simulated | None, compliance: float) -> EffectContext:
    """Return what effects may know of a record, with the model without them where there is one."""
    none: Mapping[str, Array] = {}
    return EffectContext(
        record.time,
        record.driver,
        record.drive,
        record.speed,
        record.signals,
        dict(none if simulated is None else simulated.signals),
        np.zeros_like(record.time) if simulated is None else simulated.motion.compliance,
        compliance,
    )
