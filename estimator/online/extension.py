"""An extended model in the loop: what of a diagnosis holds in another session, ready for `online`.

What a model of a bench has found is of four kinds. Friction and shape go into the sheath, whose
closed law has drag, asymmetry and uneven bends. What else the tendon does is run beside it
(estimator.online.dynamic_correction). Sensors at the housing have their readings put right
(estimator.online.reading_correction). The rest is left out: what
belongs to the record it was found in, to what the tip pulled at, or to sensors that only a bench
has.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Values,
)
from estimator.law.sheath import Section, Sheath
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import EDGES, even_weights
from estimator.online import dynamic_correction
from estimator.online.dynamic_correction import DynamicConstants
from estimator.online.reading_correction import CorrectionKind

FRICTION_COEFFICIENT = 0.1  # nominal; bend radii follow, force and elongation do not
SECTIONS = 16  # of a sheath, at most
ALIKE = 1e-6  # relative, of curvatures
INSTANTS = 1001  # of a record, at which effects are looked at

_OF_LAW = ("friction", "weights", "drag", "asymmetry")
_BESIDE = (
    "viscosity",
    "stribeck",
    "stribeck_speed",
    "stribeck_memory",
    "exponent",
    "reference",
    "rise",
    "presliding",
    "presliding_tension",
    "spectrum",
    "toe",
    "toe_tension",
    "creep",
    "creep_time",
    "compression",
    "threshold",
)

_RECORD = "belongs to the record it was found in"
_NOTHING = "changes nothing at these values"
_TIP = "is of what the tip pulled at, not of the tendon"
_LATE = "cannot be put right before it is too late"
LEFT_OUT = {
    "pretension": _RECORD,
    "slack": _RECORD,
    "thermal_expansion": _RECORD,
    "tip_moved": _RECORD,
    "encoder_slip": _RECORD,
    "proximal_tension_drift": _RECORD,
    "distal_tension_drift": _RECORD,
    "joint_backlash": _TIP,
    "joint_friction": _TIP,
    "antagonist_tension": _TIP,
    "tip_inertia": _TIP,
    "sensor_lag": _LATE,
    "saturation": "hides what it hides",
    "stick_slip": "does not show in the tension at the housing before it is over",
}
"""Why an effect does nothing in the loop, in words that can follow its name."""


class Use(Enum):
    """What becomes of an effect, in words that can follow "is"."""

    LAW = "in the friction and shape of the sheath"
    BESIDE = "run beside the law"
    READING = "taken out of what the housing reads"
    REFERENCE = "in what the sensor at the tip reads; the force at the tip is free of it"
    NOTHING = "left out"


class Extension(NamedTuple):
    """What the estimator does besides the law of a sheath."""

    dynamics: DynamicConstants | None  # None where nothing is run beside the law
    readings: tuple[tuple[CorrectionKind, Values], ...]  # what puts readings right, in this order


class Extended(NamedTuple):
    """A model of a bench, for the loop."""

    sheath: Sheath
    extension: Extension | None  # None where the sheath has all of it
    uses: tuple[tuple[Effect, Values, Use], ...]  # what becomes of each effect

    @property
    def tip_effects(self) -> tuple[tuple[Effect, Values], ...]:
        """Effects of the sensors at the tip, which only a bench has."""
        return tuple((effect, values) for effect, values, use in self.uses if use is Use.REFERENCE)


def extended(
    shared: Sequence[float],
    effects: Sequence[tuple[Effect, Values]],
    duration: float,
    length: float,
    axial_stiffness: float = 9000.0,
) -> Extended:
    """Return what of a model holds in another session.

    Parameters
    ----------
    shared : sequence of float
        K, and L/EA [m/N] and the compliance at the tip [m/N] where the record had a travel.
    effects : sequence of (Effect, values)
        On top, in this order.
    duration : float
        Of the record [s]; friction is taken as it was at its end.
    length : float
        L of the sheath [m]; only EA goes by it.
    axial_stiffness : float
        EA [N], for a model of a record without a travel, which does not tell it.
    """
    K, compliance, tip = shared if len(shared) > 1 else (shared[0], length / axial_stiffness, 0.0)
    instants = np.linspace(0.0, max(duration, 1.0), INSTANTS)
    context = _context(instants, PROXIMAL_TENSION, compliance)
    plain = now = Physics(np.array([K]), compliance, even_weights(), tip)
    uses, readings = [], []
    for effect, values in effects:
        then = effect.physics(now, values, context)
        then = then._replace(friction=np.broadcast_to(then.friction, INSTANTS)[-1:].copy())
        if effect.correction is not None:
            use = Use.READING
            readings.append((effect.correction, values))
        elif _differ(now, then, _OF_LAW):
            use = Use.LAW
        elif _differ(now, then, _BESIDE):
            use = Use.BESIDE
        elif _is_of_tip_sensor(effect):
            use = Use.REFERENCE
        else:
            use = Use.NOTHING
        now = plain._replace(**{name: getattr(then, name) for name in (*_OF_LAW, *_BESIDE)})
        uses.append((effect, values, use))
    law = plain._replace(**{name: getattr(now, name) for name in _OF_LAW})
    dynamics = None
    if _differ(law, now, _BESIDE):
        dynamics = dynamic_correction.constants_of(law, now)
    extension = None
    if dynamics is not None or readings:
        extension = Extension(dynamics, tuple(readings[::-1]))
    return Extended(sheath_of(law, length), extension, tuple(uses))


def belongs_to_record(effect: Effect) -> bool:
    """Return whether an effect is of something that happened in its record only."""
    return LEFT_OUT.get(effect.name) == _RECORD


def why_left_out(effect: Effect) -> str:
    """Return why an effect does nothing in the loop, in words that can follow its name."""
    return LEFT_OUT.get(effect.name, _NOTHING)


def sheath_of(physics: Physics, length: float) -> Sheath:
    """Return the sheath whose law is that of `physics`, for a `length` [m].

    Neighbouring nodes of one curvature make one section; so do those most alike, while there are
    more than SECTIONS.
    """
    K = float(physics.friction[0])
    pieces = list(zip((K * np.diff(EDGES)).tolist(), physics.weights.tolist(), strict=True))
    while len(pieces) > 1:
        density = np.log([weight / ds for ds, weight in pieces])
        apart = np.abs(np.diff(density))
        i = int(np.argmin(apart))
        if apart[i] > ALIKE and len(pieces) <= SECTIONS:
            break
        (ds, weight), (more, further) = pieces[i : i + 2]
        pieces[i : i + 2] = [(ds + more, weight + further)]
    mu = FRICTION_COEFFICIENT
    sections = tuple(Section(w * length, mu * w * length / ds) for ds, w in pieces)
    EA = length / physics.compliance
    return Sheath(sections, mu, EA, drag=physics.drag, asymmetry=physics.asymmetry)


def _differ(one: Physics, other: Physics, fields: Sequence[str]) -> bool:
    return any(not np.array_equal(getattr(one, f), getattr(other, f)) for f in fields)


def _is_of_tip_sensor(effect: Effect) -> bool:
    at_tip = bool(effect.needs & {DISTAL_TENSION, DISTAL_DISPLACEMENT})
    return at_tip and effect.measure is not Effect.measure and effect.name not in LEFT_OUT


def _context(time: Array, driver: str, elongation_per_newton: float) -> EffectContext:
    """Return a context of which nothing is known but its times."""
    none = np.zeros_like(time)
    return EffectContext(time, driver, none, none, {}, {}, none, elongation_per_newton)
