"""Effects at the ends of a tendon: its start, the joint, and what moves the tip."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Parameter,
    Values,
    compute_step,
    set_physics,
    transform_channel,
)
from estimator.effects.sensors import rotate_wave
from estimator.lumped.lumped_model import Physics
from estimator.noise_treatment import apply_play

TRAVEL = frozenset({PROXIMAL_DISPLACEMENT})
BOTH_TRAVELS = frozenset({PROXIMAL_DISPLACEMENT, DISTAL_DISPLACEMENT})
ONSET_COUNT = 16
GRAVITY_PART = 0.3  # of a weight, to begin with: what friction lags behind all of it costs more
CONTACT_SHARES = (0.3, 0.5, 0.7, 0.9)  # of the largest travel
BEND_COUNT = 30  # places where tension over travel may bend
DWELL_TIMES = (0.5, 1.0, 2.0, 4.0, 8.0)  # [s]

PRETENSION = Effect(
    name="pretension",
    cause="the tendon was under tension all along when the record began, not slack",
    equation="T(s) = tension before the first sample",
    parameters=(Parameter("tension", "N", 0.0, 500.0, 0.5),),
    source="docs/explanation/theory.md (T15)",
    advice="Begin each record with a full pull and release; that erases the initial state.",
    starts=lambda context: [(float(context.measured[PROXIMAL_TENSION][0]),), (2.0,), (6.0,)],
    physics=set_physics("start"),
    where="the same all along",
)


def _build_pretension(
    stroke: str, where: str, build_turns: Callable[[float, float], list[float]]
) -> Effect:
    """Return the pretension that motion before the record has left behind in the sheath."""
    return replace(
        PRETENSION,
        cause=f"the record begins in the midst of motion, after a {stroke} that the "
        "sheath remembers",
        equation=f"before the first sample the motor came from further {where}, by a share of its "
        "range in the record (the tension did, where there is no travel)",
        parameters=(Parameter("share", "", 0.0, 1.0, 0.01, None),),
        starts=lambda _: [(share,) for share in (0.01, 0.04, 0.2)],
        physics=lambda physics, values, context: physics._replace(
            earlier_turns=np.array(build_turns(values[0], float(np.ptp(context.drive))))
        ),
        where=f"left by a {stroke}",
    )


PRETENSION_PULLED = _build_pretension("pull", "out", lambda share, span: [share * span])
PRETENSION_RELEASED = _build_pretension("release", "in", lambda share, span: [span, -share * span])


JOINT_BACKLASH = Effect(
    name="joint_backlash",
    cause="there is play between the tendon's pulley and the link",
    equation="the tip's encoder reads the play of q_d",
    parameters=(Parameter("width", "m", 0.0, 5e-3, 2e-5),),
    source="range assumed: 0.1 to 2 degrees",
    advice="Take the play out, or measure at the pulley and at the link.",
    starts=lambda _: [(3e-5,), (1.5e-4,)],
    measure=lambda signals, values, _: transform_channel(
        signals, DISTAL_DISPLACEMENT, lambda q: apply_play(q, 0.5 * values[0])
    ),
    required_channels=BOTH_TRAVELS,
)


JOINT_FRICTION = Effect(
    name="joint_friction",
    cause="the joint itself has dry friction",
    equation="T_out = k q_d + friction sgn(dq_d/dt)",
    parameters=(Parameter("friction", "N", 0.0, 200.0, 0.1),),
    source="range assumed: 0.1 to 3 N",
    advice="Look at the joint's bearings; the force on the tool is less than the tendon's by it.",
    starts=lambda _: [(0.15,), (0.6,)],
    physics=lambda physics, values, _: physics._replace(load_low=-values[0], load_high=values[0]),
    required_channels=TRAVEL,
)


def _apply_antagonist(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    tension, K, stiffness = values
    # less the tension in which the tip was balanced at the start
    low, high = tension * np.expm1(-K), tension * np.expm1(K)
    return physics._replace(load_low=low, load_high=high, load_stiffness=stiffness)


ANTAGONIST_TENSION = Effect(
    name="antagonist_tension",
    cause="the other tendon of the joint is not slack and pulls against this one",
    equation="T_out = k q_d + tension (e^s - 1), s between -K and K of the other tendon, as it is "
    "let go or drawn out",
    parameters=(
        Parameter("tension", "N", 0.0, 200.0, 0.05),
        Parameter("K", "", 0.05, 3.0, 0.1, None),
        Parameter("stiffness", "N/m", 300.0, 1e6, 1000.0, None),
    ),
    source="docs/explanation/theory.md, section 7",
    advice="Read its load cell, and let it out further before you measure.",
    starts=lambda _: [(tension, 0.8, s) for tension in (0.2, 0.8) for s in (2e3, 1e4)],
    physics=_apply_antagonist,
    required_channels=TRAVEL,
)


def _find_contact_starts(context: EffectContext) -> Iterable[Values]:
    """Return contacts spread over the travel, and where tension over travel bends at the tip."""
    measured = context.measured
    reach = float(measured.get(DISTAL_DISPLACEMENT, measured[PROXIMAL_DISPLACEMENT]).max())
    starts = [(share * reach, 0.8) for share in CONTACT_SHARES]
    if not {DISTAL_TENSION, DISTAL_DISPLACEMENT} <= measured.keys():
        return starts
    rows = context.select_measured(DISTAL_TENSION) & context.select_measured(DISTAL_DISPLACEMENT)
    tension, travel = measured[DISTAL_TENSION][rows], measured[DISTAL_DISPLACEMENT][rows]
    best = (math.inf, 0.0, 0.0)
    for bend in np.linspace(travel.min(), travel.max(), BEND_COUNT + 2)[1:-1]:
        lines = np.column_stack([np.ones_like(travel), travel, np.maximum(travel - bend, 0.0)])
        (zero, slope, rise), *_ = np.linalg.lstsq(lines, tension, rcond=None)
        error = float(np.sum((lines @ (zero, slope, rise) - tension) ** 2))
        if slope > 0.0 and rise > 0.0:
            best = min(best, (error, float(zero / slope + bend), float(rise / (slope + rise))))
    return [*starts, (max(best[1], 0.0), min(best[2], 0.99))] if best[2] > 0.0 else starts


def _apply_contact(physics: Physics, values: Values, _context: EffectContext) -> Physics:
    travel, hardness = values
    if physics.tip_compliance <= 0.0:
        return physics
    stiffness = hardness / (1.0 - hardness) / physics.tip_compliance
    return physics._replace(contact=travel, contact_stiffness=stiffness)


TIP_CONTACT = Effect(
    name="tip_contact",
    cause="the tip meets something on its way: a stop, tissue, a wall",
    equation="T_out = k q_d, and beyond the travel k/(1 - hardness) for each further metre",
    parameters=(
        Parameter("travel", "m", 0.0, 0.5, 5e-5, None),
        Parameter("hardness", "", 0.0, 0.999, 0.02),
    ),
    source="Hooke, two springs side by side",
    advice="No fault of the transmission; to see it alone, pull less far or take away what is met.",
    starts=_find_contact_starts,
    physics=_apply_contact,
    required_channels=TRAVEL,
)


TIP_INERTIA = Effect(
    name="tip_inertia",
    cause="what hangs on the tip is heavy, or is damped",
    equation="T_out = k q_d + damping dq_d/dt + mass d2q_d/dt2",
    parameters=(
        Parameter("mass", "kg", 0.0, 50.0, 0.1),
        Parameter("damping", "N s/m", 0.0, 1e4, 10.0),
    ),
    source="Newton",
    advice="Move more smoothly, or take the load off the tip.",
    starts=lambda _: [(0.05, 5.0), (0.5, 10.0), (0.05, 100.0)],
    physics=set_physics("mass", "damping"),
    required_channels=TRAVEL,
)


def _find_gravity_starts(context: EffectContext) -> Iterable[Values]:
    """Return the weight that explains most beside any spring, a part of what this one leaves."""
    rows = context.select_measured(PROXIMAL_TENSION)
    simulated, angle = context.simulated[PROXIMAL_TENSION], context.drive / context.radian
    residual = (context.measured[PROXIMAL_TENSION] - simulated)[rows]
    known = np.column_stack([np.ones_like(angle), angle, simulated, np.sin(angle), np.cos(angle)])[
        rows
    ]
    sine, cosine = np.linalg.lstsq(known, residual, rcond=None)[0][-2:].tolist()
    torque = _compute_gravity_torque((sine, cosine), context)[rows]
    share = float(torque @ (residual - residual.mean())) / max(float(torque @ torque), 1e-30)
    return [(GRAVITY_PART * share * sine, GRAVITY_PART * share * cosine)]


def _compute_gravity_torque(values: Values, context: EffectContext) -> Array:
    """Return the torque of a weight, (n,), less its mean and the slope where it hangs still.

    The load's spring has that slope, and where the tendon is taut that mean: so a fit begins where
    the base law's spring already stands for the weight, and the spring is not negative above.
    """
    angle = context.drive / context.radian
    torque = values[0] * np.sin(angle) + values[1] * np.cos(angle) - math.hypot(*values) * angle
    return np.asarray(torque - torque.mean())


def _apply_gravity(physics: Physics, values: Values, context: EffectContext) -> Physics:
    torque = _compute_gravity_torque(values, context)
    return physics._replace(tip_offset=physics.tip_offset - physics.tip_compliance * torque)


LINK_GRAVITY = Effect(
    name="link_gravity",
    cause="the joint carries the weight of its link",
    equation="T_out = k q_d + sine sin(q_p) + cosine cos(q_p) - weight q_p, weight^2 = sine^2 + "
    "cosine^2: k is the spring of all where the link hangs still",
    parameters=(
        Parameter("sine", "N", -200.0, 200.0, 0.05),
        Parameter("cosine", "N", -200.0, 200.0, 0.05),
    ),
    source="Newton; the elongation is small beside a turn",
    advice="No fault. To see the transmission alone, balance the link or turn its axis upright.",
    starts=_find_gravity_starts,
    physics=_apply_gravity,
    required_channels=TRAVEL,
    shift_encoder_zero=lambda values, zero: rotate_wave((*values, 1.0), zero)[:2],
)


def _apply_tip_motion(physics: Physics, values: Values, context: EffectContext) -> Physics:
    size, onset, duration = values
    offset = size * compute_step(context.time, onset + 0.5 * duration, max(duration, 0.02))
    return physics._replace(tip_offset=physics.tip_offset + offset)


def _apply_tip_excursion(physics: Physics, values: Values, context: EffectContext) -> Physics:
    size, onset, duration, stay = values
    step_duration = max(duration, 0.02)
    departure = compute_step(context.time, onset + 0.5 * duration, step_duration)
    return_step = compute_step(context.time, onset + stay + 1.5 * duration, step_duration)
    return physics._replace(tip_offset=physics.tip_offset + size * (departure - return_step))


def _build_excursion_starts(context: EffectContext) -> Iterable[Values]:
    widths = [width for width in DWELL_TIMES if 3.0 * width < context.time[-1] - context.time[0]]
    visits = [(find_largest_deviation(context, width), width) for width in widths]
    return [(size, onset, 0.5, width) for onset, width in visits for size in (-2e-4, 2e-4)]


def find_largest_deviation(context: EffectContext, width: float) -> float:
    """Return when [s] a while of `width` [s] begins whose residual differs most from the rest."""
    count = max(2, round(width / float(np.median(np.diff(context.time)))))
    peak, begin = 0.0, 0
    for channel, simulated in context.simulated.items():
        error, rows = context.measured[channel] - simulated, context.select_measured(channel)
        error = (error - np.median(error[rows])) / max(float(np.std(error[rows])), 1e-30)
        error[~rows] = 0.0
        cumulative = np.concatenate([[0.0], np.cumsum(error)])
        window_sum = np.abs(cumulative[count:] - cumulative[:-count])
        if window_sum.max() > peak:
            peak, begin = float(window_sum.max()), int(np.argmax(window_sum))
    return float(context.time[begin])


TIP_MOVED = Effect(
    name="tip_moved",
    cause="something other than the tendon moved the tip",
    equation="q_d = c T_out + size from the onset on",
    parameters=(
        Parameter("size", "m", -0.05, 0.05, 5e-5),
        Parameter("onset", "s", 1.0, 1e6, 0.3, None, jumps=True),
        Parameter("duration", "s", 0.02, 10.0, 0.2, None),
    ),
    source="docs/explanation/theory.md (T18)",
    advice="No fault of the bench; watch what touches the tip at that time.",
    starts=lambda context: [(2e-4, t, 0.5) for t in context.spread_times(2 * ONSET_COUNT)],
    physics=_apply_tip_motion,
    where="and left it there",
    required_channels=TRAVEL,
)

TIP_MOVED_BACK = replace(
    TIP_MOVED,
    equation="q_d = c T_out + size between onset and return",
    parameters=(*TIP_MOVED.parameters, Parameter("stay", "s", 0.0, 1e5, 0.5, None)),
    starts=_build_excursion_starts,
    physics=_apply_tip_excursion,
    where="and took it back",
)

EFFECTS = (
    PRETENSION,
    PRETENSION_PULLED,
    PRETENSION_RELEASED,
    JOINT_BACKLASH,
    JOINT_FRICTION,
    ANTAGONIST_TENSION,
    TIP_CONTACT,
    TIP_INERTIA,
    LINK_GRAVITY,
    TIP_MOVED,
    TIP_MOVED_BACK,
)
