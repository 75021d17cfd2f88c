"""Joints of an arm that share tendons: a tendon of a distal joint passes the joints before it.

Joint j turns by theta_j; its travel is q_j = r_j theta_j with its own pulley radius r_j, so that
the body and the environment of a coupled joint read as those of a single one. At the end of its
sheath a tendon travels towards the housing by

    x_i = sum_j ratio_ij q_j,   ratio_ij = radii_ij / r_j

of tendons of a pair with either sign.

Within the arm a tendon is a chain of springs between guides, as in its sheath: at each joint that
it passes it goes round a pin on the link before it, with Coulomb friction of two beads,

    f = T_before - T_behind,   |f| <= mu wrap / 2 * (T_before + T_behind) / 2   each

With u the displacement of the tendon at a guide (positive towards the housing, 0 at its anchor),

    u_e - u_(e+1) = c_e (T_e - T_0) + sum_j shortening_ej q_j,   ratio_j = sum_e shortening_ej

so what slides at a guide is what stretches and what turns behind it. The wrap is |wrap_0 -+
theta_j|, less where the joint pulls the tendon in; a curved section, of two bends, has guides all
along it and the wrap of both bends together. Tensions turn the joints by sum_e shortening_ej T_e.

The tension that the arm asks for rises with the place of the sheath's end, that of the sheath falls
with it, both piecewise linearly: they meet once. All joints are solved together, by Newton's method
with the exact slopes (implicit Euler). The mass matrix of the links and their weight are those at
the start of a step; what their motion throws is that at the speed in the middle of it, extrapolated
from two steps.
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
from slave.simulation.friction_nodes import Curve, Response, find_corner
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
from teleop.config.arm import (
    LinkedArmConfig,
    assemble_bend_partners,
    assemble_lengths,
    assemble_tendon_rows,
    find_guides,
)

STOP_STIFFNESS = 1e6  # [N/m] of end stops and of stuck joints, soft enough to be solved
FORCE_TOLERANCE = 1e-9  # [N] of balance
MAX_ITERATIONS = 40  # of Newton's method; three are needed
MEETING_TOLERANCE, MEETING_ITERATIONS = 1e-13, 60  # of a tension; about four are needed
SECTION_GUIDES = 2  # along a curved section


@dataclass(frozen=True, slots=True)
class ArmPlantConfig(LinkedArmConfig):
    """An arm as it is: tendons that pass joints, their friction there, and what the tip meets."""

    contacts: tuple[SurfaceConfig, ...] = ()  # of the tip, in the base

    def __post_init__(self) -> None:
        LinkedArmConfig.__post_init__(self)
        if self.contacts and not self.has_kinematics:
            raise ValueError("contacts: need the arm's kinematics, urdf or sections")


class Arm(NamedTuple):
    """An arm's constants, for n joints.

    Tendon `side` of joint k has `stretches[k, side]` stretches, from its sheath's end to its
    anchor, with a guide between each and the next.
    """

    ratio: Array  # shape (n, 2, n): travel of tendons a and b of joint k over that of joint j
    stretches: NDArray[np.int64]  # shape (n, 2)
    shortening: Array  # shape (n, 2, stretches, n): of a stretch over the travel of joint j
    compliance: Array  # [m/N] shape (n, 2, stretches)
    guide: NDArray[np.int64]  # joint of the guide before a stretch, shape (n, 2, stretches)
    friction: Array  # mu there, times the part of the joint's wrap, shape (n, 2, stretches)
    radius: Array  # [m] shape (n,)
    wrap: Array  # [rad] shape (n,)
    partner: NDArray[np.int64]  # the other bend of a joint's curved section, -1: it is a pin
    contacts: SpaceContacts
    links: Links


def build_arm(
    configs: Sequence[ArmPlantConfig],
    joints: Sequence[Sequence[int]],
    axial_stiffness: Sequence[float],
) -> Arm:
    """Return the arms that `configs` describe as one, of a rig's joints; may raise `UsageError`.

    `axial_stiffness` [N] is that of each tendon.
    """
    rows, n = assemble_tendon_rows(configs, joints), len(joints)
    friction, wrap, lengths = np.zeros(n), np.zeros(n), assemble_lengths(configs, rows.travel)
    first = 0
    for config in configs:
        part = slice(first, first + config.joints)
        friction[part], wrap[part] = config.list_friction(), config.wrap
        first = part.stop
    contacts = build_space_contacts([(config, config.contacts) for config in configs])
    partner = assemble_bend_partners(configs, n)
    rubs = find_guides(rows.travel, partner)
    room = 1 + n * SECTION_GUIDES
    ratio, stretches = np.zeros((n, 2, n)), np.ones((n, 2), dtype=np.int64)
    shortening, compliance = np.zeros((n, 2, room, n)), np.zeros((n, 2, room))
    guide, mu = np.zeros((n, 2, room), dtype=np.int64), np.zeros((n, 2, room))
    for k, side, tendon in [(k, s, t) for k, row in enumerate(joints) for s, t in enumerate(row)]:
        ratio[k, side], stiffness = rows.travel[tendon], axial_stiffness[tendon]
        last = 0
        for j in np.flatnonzero(ratio[k, side]):
            bends = np.array([j, partner[j] if partner[j] >= 0 else j])
            turned = np.where(np.isin(np.arange(n), bends), ratio[k, side], 0.0)
            if partner[j] >= 0 and partner[j] < j and ratio[k, side, partner[j]] != 0.0:
                continue  # a section counts once
            on_pin = wrap[j] * rows.radius[j] * abs(ratio[k, side, j])
            count = (1 if partner[j] < 0 else SECTION_GUIDES) if rubs[tendon, j] else 0
            new, ends = slice(last + 1, last + 1 + count), slice(last, last + 1 + count)
            guide[k, side, new], mu[k, side, new] = j, friction[j] / max(count, 1)
            share = np.ones(1)
            if count > 1:
                share = np.array([0.5, *[1.0] * (count - 1), 0.5]) / count
            elif count == 1:  # the pin is on the link before the joint
                share = np.array([0.0, 1.0])
                compliance[k, side, ends] += 0.5 * on_pin / stiffness
            shortening[k, side, ends] += np.outer(share, turned)
            compliance[k, side, ends] += share * lengths[tendon, np.unique(bends)].sum() / stiffness
            last += count
        stretches[k, side] = last + 1
    most = stretches.max()
    return Arm(
        ratio, stretches, shortening[:, :, :most], compliance[:, :, :most], guide[:, :, :most],
        mu[:, :, :most], rows.radius, wrap, np.array(partner), contacts,
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

    place: Array  # [m] of the tendons before each stretch, shape (n, 2, stretches)
    tension: Array  # [N] of each stretch, the same shape
    joints: Array  # [N] dry friction of the joints, shape (n,)
    speed: Array  # [m/s] of the joints before the last step, shape (n,)


@jit_compile
def init_arm(arm: Arm, pretensions: Array) -> ArmState:
    """Return the state of an arm with all joints straight, one tension [N] all along a tendon."""
    shape, n = arm.compliance.shape, len(arm.radius)
    tension = np.zeros(shape)
    for e in range(shape[2]):
        tension[:, :, e] = pretensions
    return ArmState(np.zeros(shape), tension, np.zeros(n), np.zeros(n))


@jit_compile
def compute_grips(arm: Arm, travel: Array) -> Array:
    """Return the tension behind each guide over that before it, sliding towards the housing."""
    grips = np.ones(arm.friction.shape)
    for k, side, e in np.ndindex(grips.shape):
        j = arm.guide[k, side, e]
        sign = np.sign(arm.ratio[k, side, j])
        bend = math.fabs(arm.wrap[j] - sign * travel[j] / arm.radius[j])
        if arm.partner[j] >= 0:
            bend = math.hypot(bend, travel[arm.partner[j]] / arm.radius[arm.partner[j]])
        bead = 0.25 * arm.friction[k, side, e] * bend
        grips[k, side, e] = ((1.0 - bead) / (1.0 + bead)) ** 2
    return grips


@jit_compile
def evaluate_curve(curve: Curve, place: float) -> tuple[float, float]:
    """Return the tension [N] of a response at `place` [m] and its slope [N/m]."""
    upper = find_corner(curve, place)
    if upper == 0:
        return 0.0, 0.0
    base, tension = curve.place[upper - 1], curve.tension[upper - 1]
    slope = 1.0 / curve.ray
    if upper < len(curve.place):
        slope = (curve.tension[upper] - tension) / (curve.place[upper] - base)
    return tension + slope * (place - base), slope


@jit_compile
def meet_curve(curve: Curve, place: float, tension: float, ray: float) -> float:
    """Return the tension [N] at which a response meets a line upwards from a point, not above it.

    The line is at `place` + `ray` (T - `tension`) [m].
    """
    T, most = tension, evaluate_curve(curve, place)[0]
    least = T
    for _ in range(MEETING_ITERATIONS):
        drawn, slope = evaluate_curve(curve, place + ray * (T - tension))
        if abs(T - drawn) <= MEETING_TOLERANCE * T:
            break
        least, most = (T, most) if drawn > T else (least, T)
        T -= (T - drawn) / (1.0 - ray * slope)
        if not least < T < most:
            T = 0.5 * (least + most)
    return T


@jit_compile
def pull_through_arm(
    arm: Arm,
    k: int,
    side: int,
    curve: Curve,
    pretension: float,
    grips: Array,
    stay: Array,
    travel: Array,
    out_place: Array,
    out_tension: Array,
    out_slope: Array,
) -> None:
    """Compute a tendon of joint k within the arm with its joints at `travel` [m], shape (n,).

    Parameters
    ----------
    side : int
        0 for tendon `a`, 1 for `b`.
    curve : Curve
        Response of the tendon at its sheath's end.
    pretension : float
        [N] in each stretch while all displacements are zero.
    grips, stay : array, shape (stretches,)
        Of `compute_grips`, and the places before the stretches before the step [m].
    out_place, out_tension : array, shape (stretches,)
        The places [m], and the tensions of the stretches [N].
    out_slope : array, shape (stretches, n)
        Of the tensions over the travels [N/m].
    """
    count, c = arm.stretches[k, side], arm.compliance[k, side]
    shortening = arm.shortening[k, side]
    held, gain, rest = np.empty(count), np.empty(count), np.empty(count)
    # corners of the tension that the arm asks for before a stretch, over the place there, rising
    x, T = np.zeros(2 * count + 1), np.zeros(2 * count + 1)
    corners, ray = 1, 0.0
    for e in range(count - 1, -1, -1):
        rest[e] = -c[e] * pretension
        for j in range(len(travel)):
            rest[e] += shortening[e, j] * travel[j]
        for i in range(corners):
            x[i] += c[e] * T[i] + rest[e]
        ray += c[e]
        if e == 0:
            break
        i = 0
        while i < corners and x[i] < stay[e]:
            i += 1
        held[e], new = 0.0, 0  # slack where it stays
        if i > 0:
            along = ray if i == corners else (x[i] - x[i - 1]) / (T[i] - T[i - 1])
            held[e], new = T[i - 1] + (stay[e] - x[i - 1]) / along, 2
        for m in range(corners - 1, i - 1, -1):
            x[m + new], T[m + new] = x[m], T[m] / grips[e]
        for m in range(i):
            T[m] *= grips[e]
        for m in range(new):
            x[i + m], T[i + m] = stay[e], held[e] * (grips[e] if m == 0 else 1.0 / grips[e])
        corners, ray = corners + new, ray * grips[e]
    i = 1
    while i < corners and T[i] < evaluate_curve(curve, x[i])[0]:
        i += 1
    along = ray if i == corners else (x[i] - x[i - 1]) / (T[i] - T[i - 1])
    out_tension[0] = meet_curve(curve, x[i - 1], T[i - 1], along)
    for e in range(1, count):
        before = out_tension[e - 1]
        if before >= held[e] / grips[e]:
            gain[e] = grips[e]
        elif before <= held[e] * grips[e]:
            gain[e] = 1.0 / grips[e]
        else:
            gain[e], out_tension[e] = 0.0, held[e]
            continue
        out_tension[e] = before * gain[e]
    place = 0.0
    for e in range(count - 1, -1, -1):
        place += c[e] * out_tension[e] + rest[e]
        if e > 0 and gain[e] == 0.0:
            place = stay[e]
        out_place[e] = place
    compute_tension_slopes(shortening, c, gain[:count], evaluate_curve(curve, place)[1], out_slope)


@jit_compile
def compute_tension_slopes(
    shortening: Array, compliance: Array, gain: Array, slope: float, out_slope: Array
) -> None:
    """Compute how the tensions of a tendon's stretches rise with the travel of the joints [N/m].

    `gain` is the tension of each stretch over that before it, 0 where the guide between them
    sticks; `slope` [N/m] is that of the sheath's response.
    """
    begin, count = 0, len(gain)
    while begin < count:
        end, ratio, give = begin, 1.0, 0.0
        out_slope[begin] = 0.0
        while end == begin or (end < count and gain[end] != 0.0):
            ratio *= 1.0 if end == begin else gain[end]
            give += ratio * compliance[end]
            out_slope[begin] += shortening[end]
            end += 1
        out_slope[begin] *= slope / (1.0 - slope * give) if begin == 0 else -1.0 / give
        for e in range(begin + 1, end):
            for j in range(out_slope.shape[1]):
                out_slope[e, j] = gain[e] * out_slope[e - 1, j]
        begin = end


@jit_compile
def compute_residual(
    arm: Arm,
    joints: list[Joint],
    states: list[JointState],
    curves: list[Curve],
    before: ArmState,
    grips: Array,
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
    start, tension_slope = np.empty(n), np.empty((arm.compliance.shape[2], n))
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
            chain = joints[k].a.chain if side == 0 else joints[k].b.chain
            pull_through_arm(
                arm,
                k,
                side,
                curves[2 * k + side],
                chain.pretension,
                grips[k, side],
                before.place[k, side],
                travel,
                after.place[k, side],
                after.tension[k, side],
                tension_slope,
            )
            for e in range(arm.stretches[k, side]):
                for j in range(n):
                    shortening = arm.shortening[k, side, e, j]
                    out_residual[j] -= shortening * after.tension[k, side, e]
                    if shortening != 0.0:
                        for i in range(n):
                            out_slope[j, i] -= shortening * tension_slope[e, i]


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
    after = init_arm(arm, np.zeros((n, 2)))
    travel, residual, slope = np.empty(n), np.empty(n), np.empty((n, n))
    for j in range(n):
        travel[j] = states[j].travel
    speed = np.empty(n)
    for j in range(n):
        speed[j] = 1.5 * states[j].speed - 0.5 * before.speed[j]
    motion, grips = compute_link_motion(arm.links, travel, speed), compute_grips(arm, travel)
    depth, depth_slope = locate_surfaces(arm.contacts, motion)
    for j in range(n):
        after.speed[j] = states[j].speed
        travel[j] += states[j].speed * dt
    compute_residual(
        arm, joints, states, curves, before, grips, after, motion, depth, depth_slope, travel, dt,
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
                arm, joints, states, curves, before, grips, after, motion, depth, depth_slope,
                trial, dt, trial_residual, trial_slope,
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
        copy_values(after.place.ravel(), arm_state.place.ravel())
        copy_values(after.joints, arm_state.joints)
        copy_values(after.tension.ravel(), arm_state.tension.ravel())
        copy_values(after.speed, arm_state.speed)
        for k in range(n):
            joint, state = joints[k], states[k]
            tendons = [state.a, state.b]
            for side in range(2 if joint.pair else 1):
                chain = joint.a.chain if side == 0 else joint.b.chain
                tendons[side] = TendonState(
                    motors[2 * k + side],
                    recover_state(
                        chain, tendons[side].chain, responses[2 * k + side], ends[k, side],
                        after.place[k, side, 0], after.tension[k, side, 0], dt,
                    ),
                )  # fmt: skip
            speed = (travel[k] - state.travel) / dt
            states[k] = JointState(
                tendons[0], tendons[1], travel[k], speed, after.place[k, 0, 0], state.time + dt
            )
    return compute_arm_truth(arm_state, joints, states)


@jit_compile
def compute_arm_truth(arm_state: ArmState, joints: list[Joint], states: list[JointState]) -> Array:
    """Return the true values of the sensors, shape (4, joints, 2); see `advance_arm`."""
    channels = np.zeros((len(CHANNELS), len(joints), 2))
    for k in range(len(joints)):
        joint, state = joints[k], states[k]
        fill_truth(channels[:, k, 0], joint.a, state.a, arm_state.place[k, 0, 0])
        if joint.pair:
            fill_truth(channels[:, k, 1], joint.b, state.b, arm_state.place[k, 1, 0])
    return channels
