"""What effects add to the closed law in the loop: the law on nodes with them, less without them.

Both tendons of nodes (lumped_model) are pulled with the tension that drives the closed law,
so what nodes and closed law have in common, and whoever drives, cancels out of their difference.

Friction that depends on speed wants to know how fast the tendon slides, which the tension does not
tell:

* Viscous friction is part of each step's balance, and the tip's travel with it. What the tip pulls
  at is not what it pulled at on the bench, so it is learnt: the travel at the tip, measured less
  elongation, over the tension there, of changes in the last seconds.
* Stribeck's makes such a balance unstable. It is told the speed: measured travel less elongation up
  to each contact, averaged.

A sample without travel goes by what was learnt before, and by the speeds of the steps.

A free function of a diagnosis (effects.functions) changes friction or stretch by what it depends
on. Beyond the range that was seen it stays as at the end, and the interval is widened.
"""

import math
from enum import IntEnum
from typing import Annotated

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.lumped import lumped_model
from estimator.lumped.lumped_model import SAMPLE
from estimator.lumped.nodes import NODES
from estimator.small_arrays import copy_values
from estimator.spline import evaluate_spline_at
from estimator.structs import F64, I64, Field, Flag, Struct

SPEED_TIME_CONSTANT = 0.02  # [s] over which speeds are averaged
FAST_TIME_CONSTANT, SLOW_TIME_CONSTANT = 0.02, 2.0  # [s] between which changes at the tip count
FORGETTING_TIME = 2.0  # [s] for which they count
LEAK_TIME_CONSTANT = 10.0  # [s]
PRIOR_WEIGHT = 1e-4  # [N^2 s] of changes that weigh as much as the bench
NO_SUBSTEPS = 1.0  # a step is not divided: it must end in time
TIP_COMPLIANCE_MAX = 5e-3  # [m/N] of what the tip pulls at
TRAVEL_JUMP_MAX = 0.01  # [m] in a sample: no motion
STRETCH_MAX = 1.0  # [m] that effects stretch a tendon
REST_SPEED = 2e-5  # [m/s] of the motor, below which it rests, and below ...
REST_SPEED_RATIO = 0.02  # ... this share of the highest of late, as in effects.functions
HIGH_SPEED_TIME_CONSTANT = 300.0  # [s] over which that is forgotten
COEFFICIENTS_MAX = 20  # of a free function
FRICTION_SHARE_MIN = 0.05  # that a free function leaves of K at least


class FunctionVariable(IntEnum):
    """What a free function depends on."""

    NONE = 0
    POSITION = 1  # [m] of the motor
    TENSION = 2  # [N] at the housing
    SPEED = 3  # [m/s] of the motor
    REST_TIME = 4  # [s] of the motor, now or before it moved


class FunctionConstants(Struct):
    """A free function of a model."""

    variable: I64 = 0  # FunctionVariable
    stretches: Flag = False  # it changes the stretch [m], not the share of friction
    is_warped: Flag = False  # its knots are even in the signed square root
    low: F64 = 0.0  # of the variable that was seen
    high: F64 = 0.0
    spread: F64 = 0.0  # of its values, by which friction may be off beyond that range
    peak: F64 = math.inf  # of its absolute values; infinite beside other effects
    count: I64 = COEFFICIENTS_MAX  # of its coefficients
    coefficients: Annotated[Array, Field("f8", COEFFICIENTS_MAX)]


class FunctionState(Struct):
    """What is remembered for a free function."""

    started: Flag = False
    is_outside: Flag = False  # of the range that was seen
    position: F64 = 0.0  # [m] of the motor, averaged
    speed: F64 = 0.0  # [m/s] averaged once more: an encoder's noise is no motion
    high_speed: F64 = 0.0  # [m/s] of late
    direction: F64 = 0.0  # of its last motion; 0 at rest
    rest_time: F64 = 0.0  # [s]
    value: F64 = 0.0


class DynamicConstants(Struct):
    """What is run beside the closed law, from `build_constants`."""

    friction: F64 = 0.0  # K
    bench_compliance: F64 = 0.0  # [m/N] of what the tip pulled at on the bench
    function: FunctionConstants
    without_effects: Annotated[
        Array, Field("f8", lumped_model.CONSTANTS)
    ]  # the tendon of the closed law
    with_effects: Annotated[
        Array, Field("f8", lumped_model.CONSTANTS)
    ]  # the tendon with the effects


class DynamicState(Struct):
    """What is remembered of both tendons, and of what the tip pulls at."""

    tension: F64 = 0.0  # [N] T_out with the effects less without
    elongation: F64 = 0.0  # [m] e with the effects less without
    travel: F64 = 0.0  # [m] q_p with the effects less without, the tip pulling at the same
    refused_time: F64 = 0.0  # [s] since the last push, for which samples were refused
    learns: Flag = False  # the sample before had a travel, and the tendon was taut
    tip_compliance: F64 = 0.0  # [m/N] of what the tip pulls at
    tip_offset: F64 = 0.0  # [m] of where it would be without tension
    fast_displacement: F64 = 0.0  # [m] of the tip, averaged over QUICK
    fast_tension: F64 = 0.0  # [N]
    slow_displacement: F64 = 0.0  # [m] of the tip, averaged over SLOW
    slow_tension: F64 = 0.0  # [N]
    sum_travel_tension: F64 = 0.0  # [m N s] of products of changes at the tip
    sum_tension_squared: F64 = 0.0  # [N^2 s]
    function: FunctionState
    contact_displacements: Annotated[Array, Field("f8", NODES - 1)]  # [m] averaged
    without_effects: Annotated[Array, Field("f8", lumped_model.STATE)]
    with_effects: Annotated[Array, Field("f8", lumped_model.STATE)]


def build_constants(
    without_effects: lumped_model.Physics,
    with_effects: lumped_model.Physics,
    function: FunctionConstants | None = None,
) -> DynamicConstants:
    """Return what `update_correction` needs to know."""
    return DynamicConstants.new(
        function=FunctionConstants.new() if function is None else function,
        friction=float(without_effects.friction[0]),
        bench_compliance=without_effects.tip_compliance,
        without_effects=lumped_model.build_constants(without_effects),
        with_effects=lumped_model.build_constants(with_effects),
    )


@jit_compile
def update_correction(
    constants: DynamicConstants, state: DynamicState, T: float, q: float, dt: float
) -> None:
    """Pull with `T` [N], the motor being at `q` [m] or NaN, and note what effects make of it.

    In place. Should numbers run away, the effects are forgotten until the tendon is pulled again.
    """
    has_travel = not math.isnan(q)
    dt += state.refused_time
    state.refused_time = 0.0
    plain_state, effect_constants = state.without_effects[:], constants.with_effects[:]
    sample = np.empty((1, SAMPLE))
    sample[0, lumped_model.DT], sample[0, lumped_model.FRICTION] = dt, constants.friction
    sample[0, lumped_model.STRETCH], sample[0, lumped_model.OFFSET] = 0.0, 0.0
    sample[0, lumped_model.COMPLIANCE] = constants.bench_compliance
    sample[0, lumped_model.TARGET] = T
    sample[0, lumped_model.SPEED] = abs(T - plain_state[0]) / dt if dt > 0.0 else 0.0
    no_speeds, forced = np.empty(0), bool(1)  # a literal compiles `advance` once more
    work, motions = np.empty(lumped_model.WORK), np.empty((2, 5))
    plain_motion, effect_motion = motions[0], motions[1]
    lumped_model.advance(
        constants.without_effects[:], plain_state, sample, no_speeds, forced, NO_SUBSTEPS, work,
        motions[:1],
    )  # fmt: skip
    speeds = no_speeds
    if has_travel and effect_constants[lumped_model.STRIBECK] != 0.0:
        speeds = _estimate_sliding_speeds(state, plain_state, q, dt)
    if constants.function.variable != FunctionVariable.NONE:
        f = update_function(constants.function, state.function, T, q, dt)
        if constants.function.stretches:
            sample[0, lumped_model.STRETCH] = f
        else:
            sample[0, lumped_model.FRICTION] *= max(1.0 + f, FRICTION_SHARE_MIN)
    sample[0, lumped_model.OFFSET] = state.tip_offset
    sample[0, lumped_model.COMPLIANCE] = state.tip_compliance
    lumped_model.advance(
        effect_constants, state.with_effects[:], sample, speeds, forced, NO_SUBSTEPS, work,
        motions[1:],
    )  # fmt: skip
    T_out, q_d = effect_motion[1], effect_motion[3]
    elongation = effect_motion[2] - q_d
    tension_change = T_out - plain_motion[1]
    elongation_change = elongation - (plain_motion[2] - plain_motion[3])
    if not (math.isfinite(tension_change) and abs(elongation_change) < STRETCH_MAX):
        reset(constants, state)
        return
    if not varies_friction(constants):
        state.travel += elongation_change - state.elongation
    if effect_constants[lumped_model.VISCOSITY] != 0.0:
        state.travel += state.tip_compliance * (tension_change - state.tension)
        # the sum of changes with a compliance that is learnt does not close by itself
        target_travel = elongation_change + state.tip_compliance * tension_change
        state.travel += -math.expm1(-dt / LEAK_TIME_CONSTANT) * (target_travel - state.travel)
    state.tension, state.elongation = tension_change, elongation_change
    _estimate_tip_compliance(constants, state, T > 0.0 and has_travel, q - elongation, T_out, dt)


@jit_compile
def update_function(
    function: FunctionConstants, state: FunctionState, T: float, q: float, dt: float
) -> float:
    """Return a free function at one sample; without a travel it stays as it was."""
    if math.isnan(q) and function.variable != FunctionVariable.TENSION:
        return state.value
    speed = 0.0
    if not math.isnan(q):
        if not state.started or abs(q - state.position) > TRAVEL_JUMP_MAX:
            state.position = q
        speed = _average_speed(q - state.position, dt)
        state.position += speed * dt
        state.started = True
    state.speed += -math.expm1(-dt / SPEED_TIME_CONSTANT) * (speed - state.speed)
    state.high_speed *= math.exp(-dt / HIGH_SPEED_TIME_CONSTANT)
    state.high_speed = max(abs(state.speed), state.high_speed)
    direction = 0.0
    if abs(state.speed) > max(REST_SPEED, REST_SPEED_RATIO * state.high_speed):
        direction = 1.0 if state.speed > 0.0 else -1.0
    if direction == 0.0:
        state.rest_time = state.rest_time + dt if state.direction == 0.0 else 0.0
    elif direction == -state.direction:
        state.rest_time = 0.0
    state.direction = direction
    x = T
    if function.variable == FunctionVariable.POSITION:
        x = q
    elif function.variable == FunctionVariable.SPEED:
        x = speed
    elif function.variable == FunctionVariable.REST_TIME:
        x = state.rest_time
    low, high = function.low, function.high
    state.is_outside = not low <= x <= high
    if function.is_warped:
        x, low, high = _warp(x), _warp(low), _warp(high)
    state.value = evaluate_spline_at(
        function.coefficients[: function.count], (x - low) / (high - low)
    )
    return state.value


@jit_compile
def slide_tendons(constants: DynamicConstants, state: DynamicState, T: float, side: float) -> None:
    """Let both tendons slide as a whole as the closed law's does, whose `side` is -1 or rho."""
    log_ratio = side * constants.friction
    plain, with_effects = state.without_effects[:], state.with_effects[:]
    lumped_model.slide_all(constants.without_effects[:], plain, T, log_ratio)
    log_ratio *= max(1.0 + state.function.value, FRICTION_SHARE_MIN)
    lumped_model.slide_all(constants.with_effects[:], with_effects, T, log_ratio)
    state.tension = with_effects[NODES - 1] - plain[NODES - 1]


@jit_compile
def varies_friction(constants: DynamicConstants) -> bool:
    """Return whether a free function changes friction."""
    function = constants.function
    is_friction: bool = function.variable != FunctionVariable.NONE and not function.stretches
    return is_friction


@jit_compile
def _warp(x: float) -> float:
    return math.copysign(math.sqrt(abs(x)), x)


@jit_compile
def bound_tip_tension(constants: DynamicConstants, T_law: float, T_out: float) -> float:
    """Return a tension at the tip [N] no farther from that of the law than friction allows.

    ln T_out is a superposition of plays of T_in, none wider than K; where K changes by a share of
    at most `peak`, no play, and so not ln T_out, differs by more than `peak` K.
    """
    if not varies_friction(constants) or math.isinf(constants.function.peak):
        return T_out
    ratio = math.exp(constants.friction * constants.function.peak)
    return min(max(T_out, T_law / ratio), T_law * ratio)


@jit_compile
def bound_function_error(constants: DynamicConstants, state: DynamicState, tension: float) -> float:
    """Return by how much a tension at the tip [N] may be off beyond a function's range."""
    if not state.function.is_outside or constants.function.stretches:
        return 0.0
    return tension * math.expm1(constants.friction * constants.function.spread)


@jit_compile
def _estimate_sliding_speeds(state: DynamicState, plain_state: Array, q: float, dt: float) -> Array:
    """Return how fast the tendon slides over each contact [m/s], by the motor's travel."""
    averages = state.contact_displacements[:]
    speeds = np.empty(NODES - 1)
    is_first = not state.learns
    contact_displacement = q
    for j in range(NODES - 1):
        contact_displacement -= plain_state[lumped_model.LENGTHS + j]
        if is_first:
            averages[j] = contact_displacement
        speed = _average_speed(contact_displacement - averages[j], dt)
        averages[j] += speed * dt
        speeds[j] = abs(speed)
    return speeds


@jit_compile
def _average_speed(change: float, dt: float) -> float:
    """Return the speed [m/s] of what is `change` [m] from its average: a steady one as it is."""
    return -math.expm1(-dt / SPEED_TIME_CONSTANT) * change / dt if dt > 0.0 else 0.0


@jit_compile
def _estimate_tip_compliance(
    constants: DynamicConstants, state: DynamicState, taut: bool, q: float, T: float, dt: float
) -> None:
    """Note that the tip is measured at `q` [m] under `T` [N], and let its own node stay there."""
    if taut and state.learns and abs(q - state.fast_displacement) < TRAVEL_JUMP_MAX:
        fast_gain = -math.expm1(-dt / FAST_TIME_CONSTANT)
        slow_gain = -math.expm1(-dt / SLOW_TIME_CONSTANT)
        state.fast_displacement += fast_gain * (q - state.fast_displacement)
        state.fast_tension += fast_gain * (T - state.fast_tension)
        state.slow_displacement += slow_gain * (q - state.slow_displacement)
        state.slow_tension += slow_gain * (T - state.slow_tension)
        dT = state.fast_tension - state.slow_tension
        dq = min(
            max(state.fast_displacement - state.slow_displacement, -TIP_COMPLIANCE_MAX * abs(dT)),
            TIP_COMPLIANCE_MAX * abs(dT),
        )
        decay = math.exp(-dt / FORGETTING_TIME)
        state.sum_travel_tension = decay * state.sum_travel_tension + dq * dT * dt
        state.sum_tension_squared = decay * state.sum_tension_squared + dT * dT * dt
        estimate = (state.sum_travel_tension + PRIOR_WEIGHT * constants.bench_compliance) / (
            state.sum_tension_squared + PRIOR_WEIGHT
        )
        state.tip_compliance = min(max(estimate, 0.0), TIP_COMPLIANCE_MAX)
        last_node_tension = (
            constants.with_effects[lumped_model.LAST_SHARE] * state.with_effects[NODES - 1]
        )
        node_position = state.with_effects[lumped_model.TIP]
        state.tip_offset = node_position - state.tip_compliance * last_node_tension
    elif taut:
        state.fast_displacement = state.slow_displacement = q
        state.fast_tension = state.slow_tension = T
    state.learns = taut


@jit_compile
def reset(constants: DynamicConstants, state: DynamicState) -> None:
    """Begin with a slack tendon, in place."""
    state.tension = state.elongation = state.travel = state.refused_time = 0.0
    state.learns = False
    state.tip_compliance, state.tip_offset = constants.bench_compliance, 0.0
    state.fast_displacement = state.fast_tension = 0.0
    state.slow_displacement = state.slow_tension = 0.0
    state.sum_travel_tension = state.sum_tension_squared = 0.0
    state.contact_displacements[:] = 0.0
    state.function.started = state.function.is_outside = False
    state.function.direction = state.function.rest_time = state.function.value = 0.0
    state.function.speed = state.function.high_speed = 0.0
    at_rest = lumped_model.build_initial_state(constants.without_effects, 0.0, 0.0, 0.0)
    copy_values(at_rest, state.without_effects)
    at_rest = lumped_model.build_initial_state(constants.with_effects, 0.0, 0.0, 0.0)
    copy_values(at_rest, state.with_effects)
