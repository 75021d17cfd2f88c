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
from estimator.effects.functions import FRICTION_MIN, evaluate_function, split_values
from estimator.law.sheath import Section, Sheath
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import EDGES, build_even_weights
from estimator.online import dynamic_correction
from estimator.online.dynamic_correction import (
    DynamicConstants,
    FunctionConstants,
    FunctionVariable,
)
from estimator.online.reading_correction import CorrectionKind

FRICTION_COEFFICIENT = 0.1  # nominal; bend radii follow, force and elongation do not
SECTIONS_MAX = 16  # of a sheath, at most
CURVATURE_TOLERANCE = 1e-6  # relative, of curvatures
INSTANT_COUNT = 1001  # of a record, at which effects are looked at

_LAW_FIELDS = ("friction", "weights", "drag", "asymmetry")
_DYNAMIC_FIELDS = (
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

_REASON_RECORD = "belongs to the record it was found in"
_REASON_NEUTRAL = "changes nothing at these values"
_REASON_TIP = "is of what the tip pulled at, not of the tendon"
_REASON_LATE = "cannot be put right before it is too late"
OMISSION_REASONS = {
    "pretension": _REASON_RECORD,
    "slack": _REASON_RECORD,
    "thermal_expansion": _REASON_RECORD,
    "tip_moved": _REASON_RECORD,
    "encoder_slip": _REASON_RECORD,
    "proximal_tension_drift": _REASON_RECORD,
    "distal_tension_drift": _REASON_RECORD,
    "joint_backlash": _REASON_TIP,
    "joint_friction": _REASON_TIP,
    "antagonist_tension": _REASON_TIP,
    "tip_contact": _REASON_TIP,
    "tip_inertia": _REASON_TIP,
    "link_gravity": _REASON_TIP,
    "sensor_lag": _REASON_LATE,
    "saturation": "hides what it hides",
    "stick_slip": "does not show in the tension at the housing before it is over",
}
"""Why an effect does nothing in the loop, in words that can follow its name."""


_FUNCTION_VARIABLES = {
    "position": FunctionVariable.POSITION,
    "tension": FunctionVariable.TENSION,
    "speed": FunctionVariable.SPEED,
    "rest_time": FunctionVariable.REST_TIME,
}
FUNCTIONS_AT_END = frozenset({"friction_by_time", "friction_by_path"})  # as a record has ended
_TIP_FUNCTIONS = frozenset({"distal_tension_by_reading", "distal_displacement_by_reading"})


class EffectUse(Enum):
    """What becomes of an effect, in words that can follow "is"."""

    LAW = "in the friction and shape of the sheath"
    DYNAMICS = "run beside the law"
    READING_CORRECTION = "taken out of what the housing reads"
    TIP_SENSOR = "in what the sensor at the tip reads; the force at the tip is free of it"
    OMITTED = "left out"


class Extension(NamedTuple):
    """What the estimator does besides the law of a sheath."""

    dynamics: DynamicConstants | None  # None where nothing is run beside the law
    readings: tuple[tuple[CorrectionKind, Values], ...]  # what puts readings right, in this order


class ExtendedModel(NamedTuple):
    """A model of a bench, for the loop."""

    sheath: Sheath
    extension: Extension | None  # None where the sheath has all of it
    uses: tuple[tuple[Effect, Values, EffectUse], ...]  # what becomes of each effect

    @property
    def tip_effects(self) -> tuple[tuple[Effect, Values], ...]:
        """Effects of the sensors at the tip, which only a bench has."""
        return tuple(
            (effect, values) for effect, values, use in self.uses if use is EffectUse.TIP_SENSOR
        )


def build_extended_model(
    shared: Sequence[float],
    effects: Sequence[tuple[Effect, Values]],
    duration: float,
    length: float,
    axial_stiffness: float = 9000.0,
) -> ExtendedModel:
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
    instants = np.linspace(0.0, max(duration, 1.0), INSTANT_COUNT)
    context = _build_context(instants, PROXIMAL_TENSION, compliance)
    base = current = Physics(np.array([K]), compliance, build_even_weights(), tip)
    uses, readings = [], []
    function: FunctionConstants | None = None
    for effect, values in effects:
        if effect.file:
            uses.append((effect, values, EffectUse.OMITTED))
            continue
        if effect.function is not None and effect.correction is None:
            by = effect.name.partition("_by_")[2]
            is_tendon = effect.name.startswith(("friction", "elongation"))
            if is_tendon and by in _FUNCTION_VARIABLES:
                function = _build_function(effect, values, _FUNCTION_VARIABLES[by])
                use = EffectUse.DYNAMICS
            else:
                if effect.name.startswith("friction"):
                    current = apply_lasting_friction(current, values, effect)
                is_at_tip = effect.name in _TIP_FUNCTIONS
                use = EffectUse.TIP_SENSOR if is_at_tip else EffectUse.OMITTED
                use = EffectUse.LAW if effect.name in FUNCTIONS_AT_END else use
            uses.append((effect, values, use))
            continue
        extended = effect.physics(current, values, context)
        extended = extended._replace(
            friction=np.broadcast_to(extended.friction, INSTANT_COUNT)[-1:].copy()
        )
        if effect.correction is not None:
            use = EffectUse.READING_CORRECTION
            readings.append((effect.correction, values))
        elif _is_different(current, extended, _LAW_FIELDS):
            use = EffectUse.LAW
        elif _is_different(current, extended, _DYNAMIC_FIELDS):
            use = EffectUse.DYNAMICS
        elif _is_of_tip_sensor(effect):
            use = EffectUse.TIP_SENSOR
        else:
            use = EffectUse.OMITTED
        current = base._replace(
            **{name: getattr(extended, name) for name in (*_LAW_FIELDS, *_DYNAMIC_FIELDS)}
        )
        uses.append((effect, values, use))
    law = base._replace(**{name: getattr(current, name) for name in _LAW_FIELDS})
    dynamics = None
    has_dynamics = _is_different(law, current, _DYNAMIC_FIELDS)
    if function is not None or has_dynamics:
        if function is not None:
            is_alone = not has_dynamics and law.drag == 0.0
            function.peak = function.peak * max(1.0, law.asymmetry) if is_alone else np.inf
        dynamics = dynamic_correction.build_constants(law, current, function)
    extension = None
    if dynamics is not None or readings:
        extension = Extension(dynamics, tuple(readings[::-1]))
    return ExtendedModel(build_sheath(law, length), extension, tuple(uses))


def _build_function(
    effect: Effect, values: Values, variable: FunctionVariable
) -> FunctionConstants:
    """Return a free function for the loop."""
    grid = evaluate_function(effect, values, np.linspace(values[0], values[1], INSTANT_COUNT))
    coefficients = split_values(effect, values)[1]
    constants = FunctionConstants.new(
        variable=int(variable),
        stretches=effect.name.startswith("elongation"),
        is_warped=effect.function is not None and effect.function.is_warped,
        low=values[0],
        high=values[1],
        spread=float(np.ptp(grid)),
        peak=float(np.abs(grid).max()),
        count=len(coefficients),
    )
    constants.coefficients[: len(coefficients)] = coefficients
    return constants


def apply_lasting_friction(physics: Physics, values: Values, effect: Effect) -> Physics:
    """Return a tendon whose friction a function scales that no loop follows.

    It is as a function of `FUNCTIONS_AT_END` leaves it, and with the mean of any other.
    """
    is_periodic = effect.function is not None and effect.function.is_periodic
    begin, end = (0.0, values[0]) if is_periodic else values[:2]
    begin = end if effect.name in FUNCTIONS_AT_END else begin
    f = evaluate_function(effect, values, np.linspace(begin, end, INSTANT_COUNT))
    return physics._replace(friction=physics.friction * (1.0 + f).clip(FRICTION_MIN).mean())


def keeps_mean(effect: Effect) -> bool:
    """Return whether an effect is friction by a variable that no loop follows: K has its mean."""
    variable = effect.name.removeprefix("friction_by_")
    is_followed = variable in _FUNCTION_VARIABLES or effect.name in FUNCTIONS_AT_END
    return effect.function is not None and variable != effect.name and not is_followed


def is_record_specific(effect: Effect) -> bool:
    """Return whether an effect is of something that happened in its record only."""
    if effect.file:
        return True
    if effect.function is not None:
        is_of_time = effect.name.endswith(("_by_time", "_by_path", "_by_phase"))
        return is_of_time and not effect.name.startswith("friction")
    return OMISSION_REASONS.get(effect.name) == _REASON_RECORD


def explain_omission(effect: Effect) -> str:
    """Return why an effect does nothing in the loop, in words that can follow its name."""
    if effect.function is not None:
        rest = "; K has its mean" if keeps_mean(effect) else ""
        return f"follows {effect.function.variable}, for which the loop has no correction{rest}"
    return OMISSION_REASONS.get(effect.name, _REASON_NEUTRAL)


def build_sheath(physics: Physics, length: float) -> Sheath:
    """Return the sheath whose law is that of `physics`, for a `length` [m].

    Neighbouring nodes of one curvature make one section; so do those most alike, while there are
    more than SECTIONS.
    """
    K = float(physics.friction[0])
    pieces = list(zip((K * np.diff(EDGES)).tolist(), physics.weights.tolist(), strict=True))
    while len(pieces) > 1:
        density = np.log([weight / ds for ds, weight in pieces])
        density_steps = np.abs(np.diff(density))
        i = int(np.argmin(density_steps))
        if density_steps[i] > CURVATURE_TOLERANCE and len(pieces) <= SECTIONS_MAX:
            break
        (ds, weight), (next_ds, next_weight) = pieces[i : i + 2]
        pieces[i : i + 2] = [(ds + next_ds, weight + next_weight)]
    mu = FRICTION_COEFFICIENT
    sections = tuple(Section(w * length, mu * w * length / ds) for ds, w in pieces)
    EA = length / physics.compliance
    return Sheath(sections, mu, EA, drag=physics.drag, asymmetry=physics.asymmetry)


def _is_different(a: Physics, b: Physics, fields: Sequence[str]) -> bool:
    return any(not np.array_equal(getattr(a, f), getattr(b, f)) for f in fields)


def _is_of_tip_sensor(effect: Effect) -> bool:
    at_tip = bool(effect.required_channels & {DISTAL_TENSION, DISTAL_DISPLACEMENT})
    return at_tip and effect.measure is not Effect.measure and effect.name not in OMISSION_REASONS


def _build_context(time: Array, driver: str, elongation_per_newton: float) -> EffectContext:
    """Return a context of which nothing is known but its times."""
    zeros = np.zeros_like(time)
    return EffectContext(time, driver, zeros, zeros, {}, {}, zeros, elongation_per_newton)
