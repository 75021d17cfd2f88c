"""One joint of the simulated robot: motors, tendons in their sheaths, a body, an environment.

The body has one coordinate q, the travel of its tendons [m]; tendon `a` pulls it towards +, tendon
`b`, if there is one, towards -. In a step of dt the motors move first, loaded by the previous
tensions; then `chain.compute_response` gives each tendon's response at the tip, and the body solves

    mass v' + damping v + friction sgn(v) + spring q + F_environment(q, v, t) = T_a(q) - T_b(-q)

with v = (q - q_before)/dt (implicit Euler) and q between the stops, at which v becomes 0.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numba.typed import List

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.simulation.chain_step import compute_response, recover_state
from slave.simulation.environment import (
    STIFFNESS_MAX,
    TRAVEL_MAX,
    Environment,
    build_empty_environment,
    compute_environment_force,
)
from slave.simulation.friction_nodes import Curve, interpolate_curve
from slave.simulation.motor import Motor, MotorState, advance_motor, init_motor
from slave.simulation.sensor_models import CHANNELS
from slave.simulation.tendon import Chain, get_tensions, init_chain_state
from teleop.config.ranges import build_ranged_field, check_ranges

# --- the joint's own body: inertia, damping, friction, a return spring, end stops, backlash
# All in units of tendon travel at the joint: with a joint pulley of radius r, a travel is an angle
# times r, a force a torque over r, a mass an inertia over r^2.


@dataclass(frozen=True, slots=True)
class BodyConfig:
    """A light joint with a return spring and end stops."""

    # inertia over radius squared; 0 = always in balance
    mass: float = build_ranged_field(0.02, 0.0, 1e3, "kg")
    damping: float = build_ranged_field(2.0, 0.0, 1e5, "N s/m")  # viscous
    friction: float = build_ranged_field(0.0, 0.0, 1e3, "N")  # Coulomb, dry
    spring: float = build_ranged_field(200.0, 0.0, STIFFNESS_MAX, "N/m")  # towards the start
    # of all tendons at the start; a return spring holds a single one
    pretension: float = build_ranged_field(1.0, 0.0, 100.0, "N")
    stops: tuple[float, float] = (-0.030, 0.030)  # [m] of travel; rigid, without rebound
    # whole play between the tendons' pulley and the link
    backlash: float = build_ranged_field(0.0, 0.0, 0.1, "m")

    def __post_init__(self) -> None:
        check_ranges(self)
        low, high = self.stops
        if not -TRAVEL_MAX <= low < 0.0 < high <= TRAVEL_MAX:
            raise ValueError(
                f"stops: must be one below and one above 0, within {TRAVEL_MAX:g} m of it"
            )


class Body(NamedTuple):
    """A body's constants."""

    mass: float  # [kg]
    damping: float  # [N s/m]
    friction: float  # [N]
    spring: float  # [N/m]
    pull_back: float  # [N] of the return spring at the start
    stop_low: float  # [m]
    stop_high: float  # [m]
    backlash: float  # [m]


def build_body(config: BodyConfig, tendons: int) -> Body:
    """Return the body that `config` describes, for a joint of one or two tendons."""
    return Body(
        config.mass,
        config.damping,
        config.friction,
        config.spring,
        config.pretension if tendons == 1 else 0.0,
        *config.stops,
        config.backlash,
    )


# --- force balance of a link at the end of a step: tendons against all resistance
#     T_a(q) - T_b(-q) = base + slope (q - q_before) + friction sgn(q - q_before) + F_environment(q)
#
# The left side is non-increasing in q and the right one non-decreasing, so the solution is unique
# if there is any resistance. While q = q_before friction may take any value within its limits: a
# stuck link stays exactly where it is. Within its backlash the tendons' pulley turns without the
# link.


MAX_ITERATIONS = 200  # of the root search; about ten are needed
FORCE_TOLERANCE = 1e-11  # [N] of balance


class JointResponse(NamedTuple):
    """Tension responses of the tendons of a joint to the position of its pulley in this step."""

    a: Curve
    b: Curve
    pair: bool  # without it there is no `b`


class Resistance(NamedTuple):
    """Resistance of a link to motion, without its environment."""

    base: float  # [N] at the start of the step
    slope: float  # [N/m]
    friction: float  # [N]
    backlash: float  # [m] whole play between pulley and link


@jit_compile
def compute_pulley_tensions(answer: JointResponse, pulley: float) -> tuple[float, float]:
    """Return the tensions of `a` and `b` [N] with the joint's pulley at `pulley` [m]."""
    a = interpolate_curve(answer.a, pulley)
    if not answer.pair:
        return a, 0.0
    return a, interpolate_curve(answer.b, -pulley)


@jit_compile
def compute_drive_force(answer: JointResponse, travel: float, backlash: float) -> float:
    """Return the force [N] of the tendons on a link at `travel` [m], through its backlash."""
    a, b = compute_pulley_tensions(answer, travel + 0.5 * backlash)
    if backlash == 0.0:
        return a - b
    forward = a - b
    a, b = compute_pulley_tensions(answer, travel - 0.5 * backlash)
    return max(0.0, forward) + min(0.0, a - b)


@jit_compile
def compute_force_residual(
    answer: JointResponse,
    resistance: Resistance,
    environment: Environment,
    travel: float,
    start: float,
    time: float,
    dt: float,
) -> float:
    """Return resistance less driving force [N] for a move to `travel`."""
    resisting = resistance.base + resistance.slope * (travel - start)
    resisting += compute_environment_force(environment, travel, start, time, dt)
    return resisting - compute_drive_force(answer, travel, resistance.backlash)


@jit_compile
def solve_balance(
    answer: JointResponse,
    resistance: Resistance,
    environment: Environment,
    start: float,
    low: float,
    high: float,
    time: float,
    dt: float,
) -> float:
    """Return the travel [m] between `low` and `high` of a link in force balance.

    Bracketed by the old position and a stop, solved by the Illinois variant of the secant method:
    the forces are nearly piecewise linear. The link was at `start` [m]; the step of `dt` [s] ends
    at `time` [s].
    """
    excess = compute_force_residual(answer, resistance, environment, start, start, time, dt)
    if abs(excess) <= resistance.friction:
        return start
    sense = -1.0 if excess > 0.0 else 1.0  # of the move
    friction = sense * resistance.friction
    near, near_excess = start, excess + friction
    far = high if sense > 0.0 else low
    far_excess = (
        compute_force_residual(answer, resistance, environment, far, start, time, dt) + friction
    )
    if sense * far_excess <= 0.0:
        return far
    kept = 0  # end kept in the last iteration (Illinois rule)
    for _ in range(MAX_ITERATIONS):
        new = near - near_excess * (far - near) / (far_excess - near_excess)
        if not min(near, far) < new < max(near, far):
            new = 0.5 * (near + far)
        excess = (
            compute_force_residual(answer, resistance, environment, new, start, time, dt) + friction
        )
        if abs(excess) <= FORCE_TOLERANCE or new in (near, far):
            return new
        if sense * excess < 0.0:
            near, near_excess = new, excess
            far_excess *= 0.5 if kept == 1 else 1.0
            kept = 1
        else:
            far, far_excess = new, excess
            near_excess *= 0.5 if kept == -1 else 1.0
            kept = -1
    return near


class Winding(NamedTuple):
    """Winding of a tendon in addition to the rotation of its pulley."""

    eccentricity: float = 0.0  # [m] of the pulley
    phase: float = 0.0  # [rad] of the eccentricity, at the start
    take_up: float = 0.0  # [m]


class Tendon(NamedTuple):
    """A tendon's constants."""

    motor: Motor
    winding: Winding
    chain: Chain


class TendonState(NamedTuple):
    """State of a tendon and of its motor."""

    motor: MotorState
    chain: Array


class Joint(NamedTuple):
    """A joint's constants; a joint that is not a pair has no tendon `b`."""

    a: Tendon
    b: Tendon
    pair: bool
    body: Body
    environment: Environment


class JointState(NamedTuple):
    """State of a joint."""

    a: TendonState
    b: TendonState
    travel: float  # [m] q of the link
    speed: float  # [m/s] v of the link
    pulley: float  # [m] of the tendons at the joint: q except for backlash
    time: float  # [s]


def init_joint(joint: Joint, time: float = 0.0) -> JointState:
    """Return the initial state of a joint at `time` [s]."""
    motor_state = init_motor()
    a, b = (
        TendonState(motor_state, init_chain_state(tendon.chain)) for tendon in (joint.a, joint.b)
    )
    return JointState(a, b, 0.0, 0.0, 0.0, time)


@jit_inline
def advance_joint(
    joint: Joint, state: JointState, targets: Array, steps: int, dt: float
) -> JointState:
    """Advance by `steps` of `dt` [s] with the motor targets `targets` [m], shape (2,)."""
    chain_a, chain_b = joint.a.chain, joint.b.chain
    for _ in range(steps):
        time = state.time + dt
        a, b = state.a, state.b
        motor_a, end_a = wind_tendon(joint.a, a, targets[0], dt)
        response_a = response_b = compute_response(chain_a, a.chain, end_a, dt)
        motor_b, end_b = b.motor, 0.0
        if joint.pair:
            motor_b, end_b = wind_tendon(joint.b, b, targets[1], dt)
            response_b = compute_response(chain_b, b.chain, end_b, dt)
        answer = JointResponse(response_a.tip, response_b.tip, joint.pair)
        travel, speed, pulley = move_body(joint, state, answer, dt)
        tension_a, tension_b = compute_pulley_tensions(answer, pulley)
        a = TendonState(
            motor_a, recover_state(chain_a, a.chain, response_a, end_a, pulley, tension_a, dt)
        )
        if joint.pair:
            b = TendonState(
                motor_b, recover_state(chain_b, b.chain, response_b, end_b, -pulley, tension_b, dt)
            )
        state = JointState(a, b, travel, speed, pulley, time)
    return state


@jit_compile
def wind_tendon(
    tendon: Tendon, state: TendonState, target: float, dt: float
) -> tuple[MotorState, float]:
    """Return a tendon's motor after a step, and its housing end [m]."""
    tension = get_tensions(tendon.chain, state.chain)[0]
    motor = advance_motor(tendon.motor, state.motor, target, tension, dt)
    winding, angle = tendon.winding, motor.pulley / tendon.motor.pulley_radius
    wobble = math.sin(angle + winding.phase) - math.sin(winding.phase)
    return motor, motor.pulley + winding.take_up + winding.eccentricity * wobble


@jit_inline
def move_body(
    joint: Joint, state: JointState, answer: JointResponse, dt: float
) -> tuple[float, float, float]:
    """Return the link's travel [m] and speed [m/s], and the travel of the tendons' pulley [m]."""
    body, start, time = joint.body, state.travel, state.time + dt
    resistance = Resistance(
        body.pull_back + body.spring * start - body.mass * state.speed / dt,
        body.spring + (body.damping + body.mass / dt) / dt,
        body.friction,
        body.backlash,
    )
    travel = solve_balance(
        answer, resistance, joint.environment, start, body.stop_low, body.stop_high, time, dt
    )
    speed = (travel - start) / dt
    if body.backlash == 0.0:
        return travel, speed, travel
    low, high = travel - 0.5 * body.backlash, travel + 0.5 * body.backlash
    free = Resistance(0.0, 0.0, 0.0, 0.0)
    pulley = min(max(state.pulley, low), high)
    return (
        travel,
        speed,
        solve_balance(answer, free, build_empty_environment(), pulley, low, high, time, dt),
    )


@jit_compile
def compute_truth(joint: Joint, state: JointState) -> Array:
    """Return the true values of the sensors, shape (4, 2): `sensor_models.CHANNELS` by tendon."""
    channels = np.zeros((len(CHANNELS), 2))
    fill_truth(channels[:, 0], joint.a, state.a, state.travel)
    if joint.pair:
        fill_truth(channels[:, 1], joint.b, state.b, -state.travel)
    return channels


@jit_compile
def fill_truth(channels: Array, tendon: Tendon, state: TendonState, distal: float) -> None:
    """Write the true values of a tendon's sensors into `channels`, shape (4,)."""
    tension = get_tensions(tendon.chain, state.chain)
    channels[0], channels[1] = tension[0], state.motor.position
    channels[2], channels[3] = tension[-1], distal


# --- all joints of a rig in numba lists; passing them one by one would cost more than a step
# Make the lists with `to_compiled_list`; do not read items from Python.


T = TypeVar("T")


def to_compiled_list(items: list[T]) -> list[T]:
    """Return joints, or states of joints, as a compiled list."""
    first, *remaining = items
    compiled = build_single_list(first)
    for item in remaining:
        append_item(compiled, item)
    return compiled


@jit_compile
def build_single_list(item: T) -> list[T]:
    """Return a compiled list of one item."""
    compiled: list[T] = List()
    compiled.append(item)
    return compiled


@jit_compile
def append_item(compiled: list[T], item: T) -> None:
    """Add an item to a compiled list."""
    compiled.append(item)


@jit_compile
def replace_item(compiled: list[T], index: int, item: T) -> None:
    """Replace the item at `index`."""
    compiled[index] = item


@jit_compile
def advance_joints(
    joints: list[Joint], states: list[JointState], targets: Array, steps: int, dt: float
) -> Array:
    """Advance all joints, changing `states`; return the truth, shape (4, joints, 2).

    `targets` [m] has shape (joints, 2); for the rest see `advance_joint` and `compute_truth`.
    """
    channels = np.empty((len(CHANNELS), len(joints), 2))
    for i in range(len(joints)):
        states[i] = advance_joint(joints[i], states[i], targets[i], steps, dt)
        at_joint = compute_truth(joints[i], states[i])
        for channel in range(len(CHANNELS)):
            for tendon in range(2):
                channels[channel, i, tendon] = at_joint[channel, tendon]
    return channels
