"""Joints of an arm that share tendons: a tendon of a distal joint passes the joints before it.

Joint j turns by theta_j; its travel is q_j = r_j theta_j with its own pulley radius r_j, so that
the body and the environment of a coupled joint read as those of a single one. At the end of its
sheath a tendon travels towards the housing by

    x_i = sum_j ratio_ij q_j,   ratio_ij = radii_ij / r_j

of tendons of a pair with either sign.

Within the arm a tendon does not stretch. At each joint that it passes it goes round a pin on the
link before it: two beads with Coulomb friction on what presses on them,

    f = T_before - T_behind,   |f| <= mu wrap / 2 * (T_before + T_behind) / 2

and an elastic deflection before they slide. They slide by the travel of the joints from there on,
by which the tendon is drawn past them. The wrap is |wrap_0 -+ theta_j|, less where the joint pulls
the tendon in; in a curved section, of two bends, the guide is its whole length and the wrap that of
both together. The tension behind the pin turns the joint. All joints are solved together, by
Newton's method with the exact slopes of the piecewise linear responses of tendons and contacts
(implicit Euler). The mass matrix of the links and their weight are those at the start of a step;
what their motion throws is that at the speed in the middle of it, extrapolated from two steps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba.typed import List
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.small_arrays import copy_values
from slave.simulation.chain_step import compute_response, recover_state
from slave.simulation.environment import compute_environment_force
from slave.simulation.friction_nodes import Curve, Response
from slave.simulation.joint import Joint, JointState, TendonState, fill_truth, wind_tendon
from slave.simulation.link_inertia import LinkMotion, Links, build_links, compute_link_motion
from slave.simulation.motor import MotorState
from slave.simulation.sensor_models import CHANNELS
from slave.simulation.space_contacts import (
    SpaceContacts,
    SurfaceConfig,
    build_space_contacts,
    locate_surfaces,
    press_surface,
)
from slave.simulation.tendon import Chain
from teleop.config.arm import (
    LinkedArmConfig,
    assemble_bend_partners,
    assemble_tendon_rows,
    find_guides,
)
from teleop.config.ranges import build_ranged_field

STOP_STIFFNESS = 1e6  # [N/m] of end stops and of stuck joints, soft enough to be solved
FORCE_TOLERANCE = 1e-9  # [N] of balance
MAX_ITERATIONS = 40  # of Newton's method; three are needed


@dataclass(frozen=True, slots=True)
class ArmPlantConfig(LinkedArmConfig):
    """An arm as it is: tendons that pass joints, their friction there, and what the tip meets."""

    # deflection of a guide's contact before it slides
    presliding: float = build_ranged_field(5e-6, 1e-7, 1e-3, "m")
    contacts: tuple[SurfaceConfig, ...] = ()  # of the tip, in the base

    def __post_init__(self) -> None:
        LinkedArmConfig.__post_init__(self)
        if self.contacts and not self.has_kinematics:
            raise ValueError("contacts: need the arm's kinematics, urdf or sections")


class Arm(NamedTuple):
    """An arm's constants, for n joints."""

    ratio: Array  # shape (n, 2, n): travel of tendons a and b of joint k over that of joint j
    guides: NDArray[np.bool_]  # shape (n, 2, n): where these rub
    radius: Array  # [m] shape (n,)
    friction: Array  # mu of what passes a joint, shape (n,)
    wrap: Array  # [rad] shape (n,)
    presliding: Array  # [m] shape (n,)
    partner: NDArray[np.int64]  # the other bend of a joint's curved section, -1: it is a pin
    contacts: SpaceContacts
    links: Links


def build_arm(configs: Sequence[ArmPlantConfig], joints: Sequence[Sequence[int]]) -> Arm:
    """Return the arms that `configs` describe as one, of a rig's joints; may raise `UsageError`."""
    rows, n = assemble_tendon_rows(configs, joints), len(joints)
    contact = np.zeros((3, n))
    first = 0
    for config in configs:
        last = first + config.joints
        contact[0, first:last] = config.list_friction()
        contact[1:, first:last] = [[config.wrap], [config.presliding]]
        first = last
    contacts = build_space_contacts([(config, config.contacts) for config in configs])
    partner = assemble_bend_partners(configs, n)
    ratio, guides = np.zeros((n, 2, n)), np.zeros((n, 2, n), dtype=np.bool_)
    rubs = find_guides(rows.travel, partner)
    for k, tendons in enumerate(joints):
        ratio[k, : len(tendons)], guides[k, : len(tendons)] = (
            rows.travel[list(tendons)],
            rubs[list(tendons)],
        )
    return Arm(
        ratio, guides, rows.radius, contact[0], contact[1], contact[2], np.array(partner), contacts,
        build_links(configs, rows.radius),
    )  # fmt: skip


def balance_springs(arm: Arm, joints: Sequence[Joint], pretensions: Array) -> list[Joint]:
    """Return the joints with springs that balance their tendons at the start, [N] shape (n, 2)."""
    pulls = np.einsum("ksj,ks->j", arm.ratio, pretensions).round(9)
    return [
        joint._replace(body=joint.body._replace(pull_back=float(pull)))
        for joint, pull in zip(joints, pulls, strict=True)
    ]


class ArmState(NamedTuple):
    """State of an arm beside that of its joints; changed in place."""

    beads: Array  # [N] friction, shape (n, 2, n, 2): joint, tendon, passed joint, before and behind
    joints: Array  # [N] dry friction of the joints, shape (n,)
    tension: Array  # [N] of each tendon at each joint, shape (n, 2, n)
    speed: Array  # [m/s] of the joints before the last step, shape (n,)


@jit_compile
def init_arm(arm: Arm) -> ArmState:
    """Return the state of an arm with all joints straight and no friction."""
    n = len(arm.radius)
    return ArmState(np.zeros((n, 2, n, 2)), np.zeros(n), np.zeros((n, 2, n)), np.zeros(n))


@jit_compile
def evaluate_curve(curve: Curve, place: float) -> tuple[float, float]:
    """Return the tension [N] of a response at `place` [m] and its slope [N/m]."""
    places, tensions = curve.place, curve.tension
    upper = int(np.searchsorted(-places, -place))
    if upper == 0:
        return 0.0, 0.0
    base, tension = places[upper - 1], tensions[upper - 1]
    slope = 1.0 / curve.ray
    if upper < len(places):
        slope = (tensions[upper] - tension) / (places[upper] - base)
    return tension + slope * (place - base), slope


@jit_compile
def transfer_through_arm(
    arm: Arm,
    k: int,
    side: int,
    curve: Curve,
    friction: Array,
    loads: Array,
    start: Array,
    travel: Array,
    out_friction: Array,
    out_tension: Array,
    out_slope: Array,
) -> None:
    """Compute the tension of a tendon of joint k at each joint, and its slopes.

    Parameters
    ----------
    side : int
        0 for tendon `a`, 1 for `b`.
    curve : Curve
        Response of the tendon at its sheath's end.
    friction, loads : array, shape (n, 2), (n,)
        Friction of the beads [N] and the tensions at the joints [N] before the step.
    start, travel : array, shape (n,)
        Of the joints [m], before the step and after it.
    out_friction, out_tension : array, shape (n, 2), (n,)
        The same at `travel`; zero at joints that the tendon does not move.
    out_slope : array, shape (n, n)
        Of the tensions over the travels [N/m].
    """
    n, ratio = len(travel), arm.ratio[k, side]
    behind, place = 0.0, 0.0  # slip of the next bead in this step, and the sheath's end [m]
    for j in range(n):
        behind += ratio[j] * (travel[j] - start[j])
        place += ratio[j] * travel[j]
    tension, slope = evaluate_curve(curve, place)
    slopes = slope * ratio
    out_tension[:], out_friction[:], out_slope[:] = 0.0, 0.0, 0.0
    for j in range(n):
        if ratio[j] == 0.0:
            continue
        if not arm.guides[k, side, j]:
            out_tension[j] = tension
            copy_values(slopes, out_slope[j])
            behind -= ratio[j] * (travel[j] - start[j])
            continue
        bend = abs(arm.wrap[j] - np.sign(ratio[j]) * start[j] / arm.radius[j])
        other = arm.partner[j]
        if other >= 0:
            bend = math.hypot(bend, start[other] / arm.radius[other])
        limit = 0.5 * arm.friction[j] * bend
        stiffness = limit * max(loads[j], 0.1) / arm.presliding[j]
        least, most = -limit / (1.0 - 0.5 * limit), limit / (1.0 + 0.5 * limit)
        for bead in range(2):
            force = friction[j, bead] + stiffness * behind
            if force >= most * tension:
                force = most * tension
                slopes = slopes * (1.0 - most)
            elif force <= least * tension:
                force = least * tension
                slopes = slopes * (1.0 - least)
            else:
                slopes = slopes.copy()
                for i in range(j, n):
                    slopes[i] -= stiffness * ratio[i]
            out_friction[j, bead] = force
            tension -= force
        out_tension[j] = tension
        copy_values(slopes, out_slope[j])
        behind -= ratio[j] * (travel[j] - start[j])


@jit_compile
def compute_residual(
    arm: Arm,
    joints: list[Joint],
    states: list[JointState],
    curves: list[Curve],
    before: ArmState,
    after: ArmState,
    motion: LinkMotion,
    depth: Array,
    depth_slope: Array,
    travel: Array,
    dt: float,
    out_residual: Array,
    out_slope: Array,
) -> None:
    """Compute what resists less what drives each joint at `travel` [m], shape (n,).

    `motion`, `depth` and `depth_slope` are of `compute_link_motion` and `locate_surfaces` before
    the step; `after` is filled in.
    `out_residual` [N] has shape (n,), `out_slope` [N/m] shape (n, n).
    """
    n = len(travel)
    start, one_slope = np.empty(n), np.empty((n, n))
    for j in range(n):
        start[j] = states[j].travel
    out_slope[:] = 0.0
    for j in range(n):
        body, move = joints[j].body, travel[j] - start[j]
        force = body.pull_back + body.spring * travel[j]
        force += body.mass * (move / dt - states[j].speed) / dt + body.damping * move / dt
        slope = body.spring + (body.mass / dt + body.damping) / dt
        friction = before.joints[j] + STOP_STIFFNESS * move
        after.joints[j] = min(max(friction, -body.friction), body.friction)
        if abs(friction) < body.friction:
            slope += STOP_STIFFNESS
        force += after.joints[j]
        beyond = travel[j] - min(max(travel[j], body.stop_low), body.stop_high)
        force += STOP_STIFFNESS * beyond
        slope += STOP_STIFFNESS if beyond != 0.0 else 0.0
        time, step = states[j].time + dt, 1e-8
        contact = compute_environment_force(joints[j].environment, travel[j], start[j], time, dt)
        further = compute_environment_force(
            joints[j].environment, travel[j] + step, start[j], time, dt
        )
        out_residual[j] = force + contact + motion.force[j]
        out_slope[j, j] = slope + (further - contact) / step
    for j in range(n):
        for i in range(n):
            move = travel[i] - start[i]
            out_residual[j] += motion.mass[j, i] * (move / dt - states[i].speed) / dt
            out_slope[j, i] += motion.mass[j, i] / dt**2
    for m in range(len(depth)):
        reached = depth[m]
        for j in range(n):
            reached += depth_slope[m, j] * (travel[j] - start[j])
        force, slope = press_surface(arm.contacts.surfaces[m], reached, depth[m], dt)
        for j in range(n):
            out_residual[j] += force * depth_slope[m, j]
            for i in range(n):
                out_slope[j, i] += slope * depth_slope[m, j] * depth_slope[m, i]
    for k in range(n):
        for side in range(2 if joints[k].pair else 1):
            transfer_through_arm(
                arm,
                k,
                side,
                curves[2 * k + side],
                before.beads[k, side],
                before.tension[k, side],
                start,
                travel,
                after.beads[k, side],
                after.tension[k, side],
                one_slope,
            )
            for j in range(n):
                out_residual[j] -= arm.ratio[k, side, j] * after.tension[k, side, j]
                for i in range(n):
                    out_slope[j, i] -= arm.ratio[k, side, j] * one_slope[j, i]


@jit_compile
def solve_arm(
    arm: Arm,
    joints: list[Joint],
    states: list[JointState],
    curves: list[Curve],
    before: ArmState,
    dt: float,
) -> tuple[Array, ArmState, int]:
    """Return the travels [m] of the joints in balance, the arm's new state, and the iterations."""
    n = len(arm.radius)
    after = init_arm(arm)
    travel, residual, slope = np.empty(n), np.empty(n), np.empty((n, n))
    for j in range(n):
        travel[j] = states[j].travel
    speed = np.empty(n)
    for j in range(n):
        speed[j] = 1.5 * states[j].speed - 0.5 * before.speed[j]
    motion = compute_link_motion(arm.links, travel, speed)
    depth, depth_slope = locate_surfaces(arm.contacts, motion)
    for j in range(n):
        after.speed[j] = states[j].speed
        travel[j] += states[j].speed * dt
    compute_residual(
        arm, joints, states, curves, before, after, motion, depth, depth_slope, travel, dt,
        residual, slope,
    )  # fmt: skip
    trial_residual, trial_slope = np.empty(n), np.empty((n, n))
    for iteration in range(MAX_ITERATIONS):
        excess = np.abs(residual).max()
        if excess <= FORCE_TOLERANCE:
            return travel, after, iteration
        move = np.linalg.solve(slope, residual)
        share = 1.0
        while True:  # a shorter step where the whole one is worse
            trial = travel - share * move
            compute_residual(
                arm, joints, states, curves, before, after, motion, depth, depth_slope, trial, dt,
                trial_residual, trial_slope,
            )  # fmt: skip
            if np.abs(trial_residual).max() < excess or share < 1e-3:
                break
            share *= 0.5
        travel = trial
        residual, trial_residual = trial_residual, residual
        slope, trial_slope = trial_slope, slope
    return travel, after, MAX_ITERATIONS


@jit_compile
def advance_arm(
    arm: Arm,
    joints: list[Joint],
    states: list[JointState],
    arm_state: ArmState,
    targets: Array,
    steps: int,
    dt: float,
) -> Array:
    """Advance all joints by `steps` of `dt` [s], changing the states; return the truth.

    `targets` [m] has shape (joints, 2). The truth has shape (4, joints, 2): the `CHANNELS` of
    `sensor_models` of the tendons, those of the tip at the end of the sheath.
    """
    n = len(joints)
    for _ in range(steps):
        ends = np.zeros((n, 2))
        motors: list[MotorState] = List()
        responses: list[Response] = List()
        curves: list[Curve] = List()
        for k in range(n):
            for side in range(2):
                tendon = joints[k].a if side == 0 else joints[k].b
                before = states[k].a if side == 0 else states[k].b
                motor, end = wind_tendon(tendon, before, targets[k, side], dt)
                motors.append(motor)
                ends[k, side] = end
                response = compute_response(tendon.chain, before.chain, end, dt)
                responses.append(response)
                curves.append(response.tip)
        travel, after, _ = solve_arm(arm, joints, states, curves, arm_state, dt)
        copy_values(after.beads.ravel(), arm_state.beads.ravel())
        copy_values(after.joints, arm_state.joints)
        copy_values(after.tension.ravel(), arm_state.tension.ravel())
        copy_values(after.speed, arm_state.speed)
        for k in range(n):
            joint, state = joints[k], states[k]
            place = compute_end_travel(arm, k, 0, travel)
            a = _recover_tendon(
                joint.a.chain, state.a, motors[2 * k], responses[2 * k], ends[k, 0], place, dt
            )
            b = state.b
            if joint.pair:
                b = _recover_tendon(
                    joint.b.chain,
                    state.b,
                    motors[2 * k + 1],
                    responses[2 * k + 1],
                    ends[k, 1],
                    compute_end_travel(arm, k, 1, travel),
                    dt,
                )
            speed = (travel[k] - state.travel) / dt
            states[k] = JointState(a, b, travel[k], speed, place, state.time + dt)
    return compute_arm_truth(arm, joints, states)


@jit_compile
def compute_end_travel(arm: Arm, k: int, side: int, travel: Array) -> float:
    """Return the travel [m] of a tendon of joint k at the end of its sheath."""
    place = 0.0
    for j in range(len(travel)):
        place += arm.ratio[k, side, j] * travel[j]
    return place


@jit_compile
def _recover_tendon(
    chain: Chain,
    state: TendonState,
    motor: MotorState,
    response: Response,
    end: float,
    place: float,
    dt: float,
) -> TendonState:
    """Return a tendon's state after a step that ends with its sheath's end at `place` [m]."""
    tension = evaluate_curve(response.tip, place)[0]
    return TendonState(motor, recover_state(chain, state.chain, response, end, place, tension, dt))


@jit_compile
def compute_arm_truth(arm: Arm, joints: list[Joint], states: list[JointState]) -> Array:
    """Return the true values of the sensors, shape (4, joints, 2); see `advance_arm`."""
    channels, travel = np.zeros((len(CHANNELS), len(joints), 2)), np.empty(len(joints))
    for k in range(len(joints)):
        travel[k] = states[k].travel
    for k in range(len(joints)):
        joint, state = joints[k], states[k]
        fill_truth(channels[:, k, 0], joint.a, state.a, state.pulley)
        if joint.pair:
            fill_truth(channels[:, k, 1], joint.b, state.b, compute_end_travel(arm, k, 1, travel))
    return channels
