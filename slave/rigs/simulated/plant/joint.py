"""One joint of the simulated robot: motors, tendons in their sheaths, a body, an environment.

The body has one coordinate q, the travel of its tendons [m]; tendon `a` pulls it towards +, tendon
`b`, if there is one, towards -. In a step of dt the motors move first, loaded by the previous
tensions; then `chain.respond` gives each tendon's response at the tip, and the body solves

    mass v' + damping v + friction sgn(v) + spring q + F_environment(q, v, t) = T_a(q) - T_b(-q)

with v = (q - q_before)/dt (implicit Euler) and q between the stops, at which v becomes 0.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numba.typed import List

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from slave.rigs.simulated.plant.balance import (
    JointResponse,
    Resistance,
    compute_pulley_tensions,
    solve_balance,
)
from slave.rigs.simulated.plant.body import Body
from slave.rigs.simulated.plant.chain import compute_response, recover_state
from slave.rigs.simulated.plant.environment import Environment, build_empty_environment
from slave.rigs.simulated.plant.motor import Motor, MotorState, advance_motor, init_motor
from slave.rigs.simulated.plant.sensors import CHANNELS
from slave.rigs.simulated.plant.tendon import Chain, get_tensions, init_chain_state


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
    still = init_motor()
    a, b = (TendonState(still, init_chain_state(tendon.chain)) for tendon in (joint.a, joint.b))
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
    body, before, time = joint.body, state.travel, state.time + dt
    resistance = Resistance(
        body.pull_back + body.spring * before - body.mass * state.speed / dt,
        body.spring + (body.damping + body.mass / dt) / dt,
        body.friction,
        body.backlash,
    )
    travel = solve_balance(
        answer, resistance, joint.environment, before, body.stop_low, body.stop_high, time, dt
    )
    speed = (travel - before) / dt
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
    """Return the true values of the sensors, shape (4, 2): `sensors.CHANNELS` by tendon."""
    seen = np.zeros((len(CHANNELS), 2))
    fill_truth(seen[:, 0], joint.a, state.a, state.travel)
    if joint.pair:
        fill_truth(seen[:, 1], joint.b, state.b, -state.travel)
    return seen


@jit_compile
def fill_truth(seen: Array, tendon: Tendon, state: TendonState, distal: float) -> None:
    """Write the true values of a tendon's sensors into `seen`, shape (4,)."""
    tension = get_tensions(tendon.chain, state.chain)
    seen[0], seen[1] = tension[0], state.motor.position
    seen[2], seen[3] = tension[-1], distal


# --- all joints of a rig in numba lists; passing them one by one would cost more than a step
# Make the lists with `to_compiled_list`; do not read items from Python.


T = TypeVar("T")


def to_compiled_list(items: list[T]) -> list[T]:
    """Return joints, or states of joints, as a compiled list."""
    first, *others = items
    many = build_single_list(first)
    for item in others:
        append_item(many, item)
    return many


@jit_compile
def build_single_list(item: T) -> list[T]:
    """Return a compiled list of one item."""
    many: list[T] = List()
    many.append(item)
    return many


@jit_compile
def append_item(many: list[T], item: T) -> None:
    """Add an item to a compiled list."""
    many.append(item)


@jit_compile
def replace_item(many: list[T], index: int, item: T) -> None:
    """Replace the item at `index`."""
    many[index] = item


@jit_compile
def advance_joints(
    joints: list[Joint], states: list[JointState], targets: Array, steps: int, dt: float
) -> Array:
    """Advance all joints, changing `states`; return the truth, shape (4, joints, 2).

    `targets` [m] has shape (joints, 2); for the rest see `joint.advance` and `joint.truth`.
    """
    seen = np.empty((len(CHANNELS), len(joints), 2))
    for i in range(len(joints)):
        states[i] = advance_joint(joints[i], states[i], targets[i], steps, dt)
        at_joint = compute_truth(joints[i], states[i])
        for channel in range(len(CHANNELS)):
            for tendon in range(2):
                seen[channel, i, tendon] = at_joint[channel, tendon]
    return seen
