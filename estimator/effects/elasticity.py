"""Effects in the elasticity, length and shape of a tendon and its sheath."""

from dataclasses import replace

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    PROXIMAL_DISPLACEMENT,
    Effect,
    EffectContext,
    Parameter,
    Values,
    set_physics,
)
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import EDGES, PLACES

TRAVEL = frozenset({PROXIMAL_DISPLACEMENT})


def compute_section_weights(cuts: tuple[float, ...], densities: tuple[float, ...]) -> Array:
    """Return the nodes' shares of the compliance for sections between `cuts`, shares of K."""
    places = np.array([0.0, *cuts, 1.0])
    total = np.concatenate([[0.0], np.cumsum(np.diff(places) * np.array(densities))])
    weights = np.diff(np.interp(EDGES, places, total))
    return np.asarray(weights / weights.sum())


def _apply_two_sections(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    ratio, cut = values
    return physics._replace(weights=compute_section_weights((cut,), (1.0, float(np.exp(ratio)))))


def _apply_three_sections(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    second, third, cut, width = values
    end = cut + (0.98 - cut) * width
    densities = (1.0, float(np.exp(second)), float(np.exp(third)))
    return physics._replace(weights=compute_section_weights((cut, end), densities))


def _apply_gradual_curvature(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    weights = np.exp(values[0] * PLACES) * np.diff(EDGES)
    return physics._replace(weights=weights / weights.sum())


TWO_SECTIONS = Effect(
    name="nonuniform_curvature",
    cause="the sheath is not bent evenly",
    equation="compliance per friction e^ratio times as large behind the cut, a share of K",
    parameters=(
        Parameter("ratio", "ln", -5.0, 5.0, 0.3),
        Parameter("cut", "of K", 0.02, 0.98, 0.1, None),
    ),
    source="docs/explanation/theory.md (T4)",
    advice="Calibrate with the loop: its K is right for any shape; M_e alone is not.",
    starts=lambda _: [(0.6, cut) for cut in (0.15, 0.35, 0.6, 0.85)],
    physics=_apply_two_sections,
    where="two sections",
    required_channels=TRAVEL,
)

THREE_SECTIONS = replace(
    TWO_SECTIONS,
    equation="compliance per friction e^second and e^third times the first section's; cuts in "
    "shares of K",
    parameters=(
        Parameter("second", "ln", -5.0, 5.0, 0.3),
        Parameter("third", "ln", -5.0, 5.0, 0.3),
        Parameter("cut", "of K", 0.02, 0.9, 0.1, None),
        Parameter("width", "of the rest", 0.05, 0.95, 0.1, None),
    ),
    starts=lambda _: [
        (a, b, 0.33, 0.5) for a, b in ((0.6, 0.0), (0.0, 0.6), (0.5, 1.0), (0.5, -0.5))
    ],
    physics=_apply_three_sections,
    where="three sections",
)

GRADUAL_CURVATURE = replace(
    TWO_SECTIONS,
    equation="compliance per friction ~ e^(ratio s/K)",
    parameters=(Parameter("ratio", "ln", -6.0, 6.0, 0.3),),
    starts=lambda _: [(0.6,)],
    physics=_apply_gradual_curvature,
    where="gradually along the sheath",
)

NONLINEAR_STIFFNESS = Effect(
    name="nonlinear_stiffness",
    cause="strands bed in at low tension, so the tendon is softer there",
    equation="elongation + toe (1 - exp(-T/tension)) if T were the same all along",
    parameters=(
        Parameter("toe", "m", 0.0, 2e-2, 2e-5),
        Parameter("tension", "N", 0.1, 30.0, 0.5, None),
    ),
    source="range assumed: 0.05 to 0.5 % strain over 1 to 5 N",
    advice="Test the bare tendon in tension, stay above the toe, or use a tendon that is set.",
    starts=lambda _: [(1e-4, tension) for tension in (0.7, 2.0, 6.0)],
    physics=set_physics("toe", "toe_tension"),
    required_channels=TRAVEL,
)

CREEP = Effect(
    name="creep",
    cause="the tendon goes on stretching under tension and comes back slowly",
    equation="elongation e + c, dc/dt = (share e - c)/time",
    parameters=(
        Parameter("share", "", -0.5, 5.0, 0.02),
        Parameter("time", "s", 0.05, 1e4, 2.0, None),
    ),
    source="standard linear solid; steel below 1 %, UHMWPE 2 to 10 % a minute, assumed",
    advice="Preload the tendon before use; polymer tendons need the model.",
    starts=lambda _: [(0.08, time) for time in (1.0, 4.0, 15.0)],
    physics=set_physics("creep", "creep_time"),
    required_channels=TRAVEL,
)

SHEATH_COMPRESSION = Effect(
    name="sheath_compression",
    cause="the sheath gives way under its axial load",
    equation="elongation + compression (T_in - threshold)^2 above the threshold",
    parameters=(
        Parameter("compression", "m/N^2", 0.0, 1e-3, 1e-7),
        Parameter("threshold", "N", 0.0, 100.0, 1.0, None),
    ),
    source="a spring wound sheath that buckles; range assumed",
    advice="Anchor the sheath, use an over-tube, or one of a stiffer winding.",
    starts=lambda context: [(5e-7, share * context.peak) for share in (0.1, 0.35, 0.6)],
    physics=set_physics("compression", "threshold"),
    required_channels=TRAVEL,
)

SLACK = Effect(
    name="slack",
    cause="the tendon is longer than its path, and its slack is taken up before anything pulls",
    equation="the motor travels length at no tension",
    parameters=(Parameter("length", "m", 0.0, 0.1, 1e-5),),
    source="range assumed: 0.1 to 5 mm",
    advice="Wind the slack in before you begin, or keep a small tension.",
    starts=lambda _: [(2e-5,), (3e-4,), (1.5e-3,)],
    physics=lambda physics, values, _: physics._replace(stretch=physics.stretch + values[0]),
    required_channels=TRAVEL,
)


def _apply_expansion(physics: Physics, values: Values, context: EffectContext) -> Physics:
    per_minute, time = values
    t = context.time - context.time[0]
    longer = per_minute / 60.0 * time * -np.expm1(-t / time)
    return physics._replace(stretch=physics.stretch + longer)


THERMAL_EXPANSION = Effect(
    name="thermal_expansion",
    cause="the tendon grows longer or shorter against its sheath as it warms",
    equation="elongation + rate time (1 - exp(-t/time))",
    parameters=(
        Parameter("rate", "m/min", -0.05, 0.05, 1e-5),
        Parameter("time", "s", 3.0, 1e5, 30.0, None),
    ),
    source="steel: 0.012 mm/(m K)",
    advice="Warm the bench up, log the temperature, or return to a hard stop now and then.",
    starts=lambda _: [(5e-5, time) for time in (10.0, 40.0, 1e3)],
    physics=_apply_expansion,
    required_channels=TRAVEL,
)

EFFECTS = (
    GRADUAL_CURVATURE,
    TWO_SECTIONS,
    THREE_SECTIONS,
    NONLINEAR_STIFFNESS,
    CREEP,
    SHEATH_COMPRESSION,
    SLACK,
    THERMAL_EXPANSION,
)
