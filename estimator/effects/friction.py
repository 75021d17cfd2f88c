"""Effects in the friction of a tendon on its sheath (docs/how-to/diagnose.md, friction)."""

from dataclasses import replace

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    DISTAL_TENSION,
    Effect,
    EffectContext,
    Parameter,
    Values,
    compute_step,
    set_physics,
)
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import EDGES, PLACES
from estimator.lumped.play_spectrum import ONE_PLAY, build_spectrum

ONSET_COUNT = 16


def _apply_friction_step(physics: Physics, values: Values, context: EffectContext) -> Physics:
    change, onset = values
    share = 1.0 + change * compute_step(context.time, onset)
    return physics._replace(friction=physics.friction * share)


FRICTION_STEP = Effect(
    name="friction_step",
    cause="the shape of the sheath changed during the record, and its friction with it",
    equation="K(t) = K (1 + change) from the onset on",
    parameters=(
        Parameter("change", "", -0.8, 3.0, 0.05),
        Parameter("onset", "s", 1.0, 1e6, 0.5, None, jumps=True),
    ),
    source="shape dependence: Wang, Sun, Phee, Robotica 2014; range assumed",
    advice="Fix the sheath, or calibrate again after it has been moved.",
    starts=lambda context: [(a, t) for t in context.spread_times(ONSET_COUNT) for a in (-0.2, 0.2)],
    physics=_apply_friction_step,
)


def _apply_friction_drift(physics: Physics, values: Values, context: EffectContext) -> Physics:
    (rate,) = values
    share = 1.0 + rate * (context.time - context.time[0]) / 60.0
    return physics._replace(friction=physics.friction * share.clip(0.05))


FRICTION_DRIFT = Effect(
    name="friction_drift",
    cause="friction changes slowly: wear, lubricant or temperature",
    equation="K(t) = K (1 + rate t)",
    parameters=(Parameter("rate", "1/min", -0.9, 5.0, 0.05),),
    source="range assumed: 10 to 30 % in a session",
    advice="Run the tendon in before you calibrate, and calibrate again within the session.",
    starts=lambda _: [(0.1,)],
    physics=_apply_friction_drift,
)

CONSTANT_DRAG = Effect(
    name="constant_drag",
    cause="part of the friction does not depend on tension: seals, or a stiff tendon in bends",
    equation="dT/ds = -/+ (T + drag)",
    parameters=(Parameter("drag", "N", 0.0, 50.0, 0.1),),
    source="docs/explanation/theory.md, section 8; range assumed: 0.1 to 2 N",
    advice="Look at seals and at sharp bends of a stiff tendon; tare both load cells while slack.",
    starts=lambda _: [(0.4,)],
    physics=set_physics("drag"),
)

VISCOUS_FRICTION = Effect(
    name="viscous_friction",
    cause="friction grows with speed: grease or a fluid in the sheath",
    equation="dT/ds = -/+ (T + viscosity |v|)",
    parameters=(Parameter("viscosity", "N s/m", 0.0, 1e5, 50.0),),
    source="docs/explanation/theory.md, section 8; small on cable drives: Miyasaka et al. 2015",
    advice="Change the lubricant, or move more slowly.",
    starts=lambda _: [(100.0,), (500.0,)],
    physics=set_physics("viscosity"),
)

STRIBECK_SHARES = (0.03, 0.1, 0.25, 0.6)  # of a record's high speeds, where a fit begins


def _choose_stribeck_speeds(context: EffectContext) -> list[float]:
    high = float(np.quantile(np.abs(context.speed), 0.95))
    return [max(share * high, 2e-5) for share in STRIBECK_SHARES]


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    cause="friction is higher near standstill than in motion",
    equation="K(v) = K (1 + ratio exp(-(v/speed)^2)), v from the motor's speed",
    parameters=(
        Parameter("ratio", "", -0.5, 3.0, 0.05),
        Parameter("speed", "m/s", 2e-5, 0.5, 2e-4, None),
    ),
    source="Stribeck; range assumed: 5 to 50 %, 0.1 to 10 mm/s",
    advice="Avoid creeping speeds, or use a lubricant with less stiction.",
    starts=lambda context: [(0.2, speed) for speed in _choose_stribeck_speeds(context)],
    physics=set_physics("stribeck", "stribeck_speed"),
    where="by the motor's speed",
)

STRIBECK_WITH_MEMORY = replace(
    STRIBECK_FRICTION,
    equation="K(v) = K (1 + ratio exp(-(v/speed)^2)), v the contact's own, late by the memory",
    parameters=(
        *STRIBECK_FRICTION.parameters,
        Parameter("memory", "s", 0.02, 5.0, 0.05, None),
    ),
    starts=lambda context: [(0.2, speed, 0.15) for speed in _choose_stribeck_speeds(context)],
    physics=set_physics("stribeck", "stribeck_speed", "stribeck_memory"),
    where="by each contact's own, with a memory",
    is_transient=True,
)

PRESLIDING = Effect(
    name="presliding",
    cause="contacts give elastically before they slide",
    equation="friction rises to its limit over the distance, as a spring; the distance is the same "
    "at any tension",
    parameters=(Parameter("distance", "m", 1e-6, 5e-4, 1e-5),),
    source="bristle models: Dahl 1968; 5 to 100 um, after Do et al. 2013",
    advice="Nothing is broken; the model needs it where small reversals matter.",
    starts=lambda _: [(8e-6,), (3e-5,), (1e-4,)],
    physics=set_physics("presliding"),
    where="the same distance at any tension",
)

PRESLIDING_STIFF = replace(
    PRESLIDING,
    equation="friction rises to its limit as a spring of constant stiffness, which gives the "
    "distance where the tension is 10 N",
    parameters=(PRESLIDING.parameters[0]._replace(unit="m/10 N"),),
    physics=lambda physics, values, _: physics._replace(
        presliding=values[0], presliding_tension=10.0
    ),
    where="the same stiffness at any tension",
)

# Thresholds over K are where the chain has nodes: between them a play would be a mean of two.
_SPREAD_K, _PLAYS_K = 30, 32  # the node of K; the last, of 2 K and of 1.75 K
_SPREAD_THRESHOLDS = PLACES / PLACES[_SPREAD_K]
_PLAY_THRESHOLDS = PLACES[[_PLAYS_K, 15, 25, 37, 40]] / PLACES[_PLAYS_K]


def _compute_triangle_weights(low: float, high: float) -> Array:
    """Return weights of the thresholds of a spread, of sum 1, highest between two of them."""
    middle = 0.5 * (low + high)
    weights = np.interp(_SPREAD_THRESHOLDS, [low, middle, high], [0.0, 1.0, 0.0]) * np.diff(EDGES)
    return np.asarray(weights / weights.sum())


_EARLY_WEIGHTS = _compute_triangle_weights(0.0, 1.0)
_LATE_WEIGHTS = _compute_triangle_weights(1.0, float(_SPREAD_THRESHOLDS[-1]))
_K_WEIGHTS = np.eye(len(_SPREAD_THRESHOLDS))[_SPREAD_K]


def _apply_threshold_spread(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    early_share, late_share = values
    if early_share == late_share == 0.0:
        return physics._replace(spectrum=ONE_PLAY)
    weights = _K_WEIGHTS + early_share * _EARLY_WEIGHTS + late_share * _LATE_WEIGHTS
    return physics._replace(spectrum=build_spectrum(_SPREAD_THRESHOLDS, weights))


def _apply_play_spectrum(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    if not any(values):
        return physics._replace(spectrum=ONE_PLAY)
    return physics._replace(spectrum=build_spectrum(_PLAY_THRESHOLDS, np.array([1.0, *values])))


DISTRIBUTED_PLAY = Effect(
    name="distributed_play",
    cause="contacts between tendon and sheath let go one after another, so that the force is "
    "shared by plays of many thresholds",
    equation="T_out = (T(K) + early T(0..K) + late T(K..2K)) / (1 + early + late), where T(s) is "
    "T_in after a play of threshold s, averaged over a triangle of thresholds",
    parameters=(
        Parameter("early", "of the force at K", 0.0, 50.0, 0.05),
        Parameter("late", "of the force at K", 0.0, 50.0, 0.05),
    ),
    source="Prandtl-Ishlinskii: Kuhnen, Eur. J. Control 9, 2003; Iwan, J. Appl. Mech. 33, 1966",
    advice="Nothing is broken: strands bear on the sheath unevenly; the model carries it.",
    starts=lambda _: [(0.3, 0.0), (0.0, 0.3), (0.3, 0.3)],
    physics=_apply_threshold_spread,
    where="spread about K",
    required_channels=frozenset({DISTAL_TENSION}),
)

PLAY_SPECTRUM = replace(
    DISTRIBUTED_PLAY,
    equation="T_out = (T(K) + w1 T(0.24 K) + w2 T(0.59 K) + w3 T(1.42 K) + w4 T(1.75 K)) over the "
    "sum of the weights, where T(s) is T_in after a play of threshold s",
    parameters=tuple(
        Parameter(f"w{j}", "of the force at K", 0.0, 50.0, 0.05)
        for j in range(1, len(_PLAY_THRESHOLDS))
    ),
    starts=lambda _: [(0.1, 0.1, 0.1, 0.1), (0.2, 0.2, 0.0, 0.0), (0.0, 0.0, 0.2, 0.2)],
    physics=_apply_play_spectrum,
    where="a weight for each of five plays",
)

DIRECTION_ASYMMETRY = Effect(
    name="direction_asymmetry",
    cause="friction towards the tip differs from friction towards the housing",
    equation="slopes of ln T: -1 while pulling, + ratio while releasing",
    parameters=(Parameter("ratio", "", 0.2, 4.0, 0.05, 1.0),),
    source="docs/explanation/theory.md, section 8; range assumed: 0.8 to 1.2",
    advice="Check the load cells with weights first: a wrong gain looks the same at the tip.",
    starts=lambda _: [(1.1,)],
    physics=set_physics("asymmetry"),
)

TENSION_DEPENDENT_POWER = Effect(
    name="tension_dependent_friction",
    cause="friction is no fixed share of the tension",
    equation="dT/ds = -/+ T (T / 10 N)^(exponent - 1)",
    parameters=(Parameter("exponent", "", 0.4, 1.6, 0.03, 1.0),),
    source="power-law capstan: Jung, Pan, Kang, Tribology Int. 2008; 0.7 to 1",
    advice="Calibrate over the tensions you use; polymer tendons do this.",
    starts=lambda _: [(0.95,)],
    physics=lambda physics, values, context: physics._replace(
        exponent=values[0], reference=10.0 * context.newton
    ),
    where="a power of the tension",
)

TENSION_DEPENDENT_LINEAR = replace(
    TENSION_DEPENDENT_POWER,
    equation="dT/ds = -/+ T (1 + rise T)",
    parameters=(Parameter("rise", "1/N", -0.03, 0.2, 0.002),),
    source="a sheath that is pressed closer, or buckles; range assumed",
    starts=lambda _: [(0.005,)],
    physics=set_physics("rise"),
    where="linear in the tension",
)

STICK_SLIP = Effect(
    name="stick_slip",
    cause="contacts at rest hold more than sliding ones, so that the tendon jerks when it is slow",
    equation="K (1 + ratio a) of a contact, da/dt = (1 - a)/time - a |v|/distance",
    parameters=(
        Parameter("ratio", "", 0.0, 3.0, 0.03),
        Parameter("time", "s", 1e-3, 30.0, 0.1, None),
        Parameter("distance", "m", 1e-7, 1e-3, 5e-6, None),
    ),
    source="Rabinowicz 1951; range assumed: above 10 %, below 1 mm/s",
    advice="Move faster than it sticks, lubricate, or stiffen the drive.",
    starts=lambda _: [(0.2, time, d) for time in (0.05, 0.3) for d in (5e-6, 3e-5)],
    physics=set_physics("static", "static_time", "static_distance"),
    is_transient=True,
)

EFFECTS = (
    FRICTION_STEP,
    FRICTION_DRIFT,
    CONSTANT_DRAG,
    VISCOUS_FRICTION,
    STRIBECK_FRICTION,
    STRIBECK_WITH_MEMORY,
    PRESLIDING,
    PRESLIDING_STIFF,
    DISTRIBUTED_PLAY,
    PLAY_SPECTRUM,
    DIRECTION_ASYMMETRY,
    TENSION_DEPENDENT_POWER,
    TENSION_DEPENDENT_LINEAR,
    STICK_SLIP,
)
