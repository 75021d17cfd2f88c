"""Forces on the joints of arms, from the tensions at the ends of the sheaths.

A tendon that passes a joint loads it, and loses or gains tension on the guide there. The joints'
angles are known from the motors, the friction from the config; `estimator.routing` does the rest.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import PreparedArm, prepare_arm
from estimator.kinematics.forward import write_weight_torque
from estimator.law.sheath import Sheath
from estimator.routing.routing import PreparedRouting, Routing, prepare
from estimator.routing.sheath_end import (
    SheathPair,
    drive_sheath_end,
    start_sheath_end,
    update_pair_travel,
)
from estimator.routing.tensions import (
    add_torques,
    advance,
    begin_advance,
    compute_excess,
    open_tensions,
)
from estimator.small_arrays import copy_values
from estimator.structs import StructArray
from slave.control.joint_estimate import SLACK_TENSION, TAUT_TENSION, JointEstimates, compute_weight
from slave.rig_layout import EstimatedTendon, EstimatedTendons, RigLayout, TendonGroup
from teleop.config.arm import (
    ArmConfig,
    assemble_bend_partners,
    assemble_lengths,
    assemble_tendon_rows,
    find_guides,
)
from teleop.messages.messages import MAX_JOINTS

ANGLE_ERROR = 2e-3  # [rad] of estimated joints: noise and the error of elongation
SPAN_MIN = 1e-6  # [m] of tendon between curved sections


class ArmEstimator(NamedTuple):
    """Routing of all tendons of a rig, with the state of their tensions and work arrays."""

    routing: PreparedRouting
    arms: StructArray  # PreparedArm of those with weight
    first: NDArray[np.int64]  # first joint of each of these
    gravity: Array  # [m/s^2] in their bases, shape (arms, 3)
    mass_error: Array  # relative, shape (arms,)
    pairs: StructArray  # SheathPair of each group of tendons
    memory: Array  # flat: what follows are views of it, for a checkpoint
    started: Array  # shape (1,), 1 once tensions are known
    tensions: Array  # [N] shape (3, rows): likeliest, least, largest
    angles: Array  # [rad] shape (2, joints)
    reported: Array  # [N] shape (3, rows)
    sheath_end: Array  # [N] shape (3, tendons)
    torque: Array  # [N m] shape (3, joints)
    new_angles: Array  # [rad] shape (2, joints): the likeliest, and of the interval
    excess: Array  # [m] of `compute_excess`, shape (tendons,)


def build_arm_estimator(
    joints: Sequence[Sequence[int]], arms: Sequence[ArmConfig]
) -> ArmEstimator | None:
    """Return the estimator of a rig's `joints`, the first of which are those of `arms`."""
    if not arms:
        return None
    routing = prepare(build_routing(joints, arms))
    rows, n, tendons = len(routing.joint), len(joints), len(routing.first) - 1
    shapes = ((1,), (3, rows), (2, n), (3, rows), (3, tendons), (3, n), (2, n), (tendons,))
    ends = np.cumsum([np.prod(shape, dtype=np.int64) for shape in shapes])
    memory = np.zeros(ends[-1])
    views = [
        part.reshape(shape) for part, shape in zip(np.split(memory, ends[:-1]), shapes, strict=True)
    ]
    firsts = np.cumsum([0, *(arm.joints for arm in arms)])
    heavy = [k for k, arm in enumerate(arms) if any(arm.gravity)]
    return ArmEstimator(
        routing,
        np.concatenate(
            [PreparedArm.array(0), *(prepare_arm(arms[k].load_kinematics()) for k in heavy)]
        ),
        firsts[heavy],
        np.array([arms[k].gravity for k in heavy]).reshape(-1, 3),
        np.array([arms[k].mass_error for k in heavy]),
        SheathPair.array(n),
        memory,
        *views,
    )


def build_routing(joints: Sequence[Sequence[int]], arms: Sequence[ArmConfig]) -> Routing:
    """Return how the tendons of a rig's `joints` pass them."""
    rows = assemble_tendon_rows(arms, joints)
    table = rows.travel * rows.radius
    friction, wrap = np.zeros(len(joints)), np.zeros(len(joints))
    first = 0
    for arm in arms:
        part = slice(first, first + arm.joints)
        friction[part], wrap[part] = arm.list_friction(), arm.wrap
        first = part.stop
    partner = assemble_bend_partners(arms, len(joints))
    guides = ["proximal" if other < 0 else "spread" for other in partner]
    frictions = np.where(find_guides(table, partner), friction, 0.0)
    groups = [members for members, _ in rows.groups]
    length = assemble_lengths(arms, rows.travel)
    return Routing(
        table,
        friction=frictions,
        wrap=np.where(frictions > 0.0, wrap, 0.0),
        span=np.where(np.array(partner) < 0, length, 0.0).clip(SPAN_MIN),
        length=length,  # of a section
        spring_stiffness=[
            float(list(tendons) in groups and len(tendons) < 2) for tendons in joints
        ],
        guide=[guides] * len(table),
        partner=partner,
        pin_elements=1,  # in a tick of a session
        bend_elements=2,
        friction_error=max(arm.friction_error for arm in arms),
        angle_error=ANGLE_ERROR,
    )


def cut_sheaths(
    sheaths: Sequence[Sheath], joints: Sequence[Sequence[int]], arms: Sequence[ArmConfig]
) -> list[Sheath]:
    """Return the sheaths of tendons whose models go on straight by their lengths within arms."""
    lengths = assemble_lengths(arms, assemble_tendon_rows(arms, joints).travel).sum(axis=1)
    cut = []
    for sheath, length in zip(sheaths, lengths, strict=True):
        *sections, last = sheath.sections
        if last.length - length > SPAN_MIN:
            sections.append(replace(last, length=last.length - float(length)))
        is_cut = sections and last.bend_angle == 0.0
        cut.append(replace(sheath, sections=tuple(sections)) if is_cut else sheath)
    return cut


@jit_compile
def add_arm_stretch(arm: ArmEstimator, tendons: EstimatedTendons) -> None:
    """Add to elongations what friction at guides adds, as of the sample before.

    The model of a tendon in an arm has all of it, with the tension at the sheath's end behind it.
    """
    for i in range(len(arm.excess)):
        estimate = tendons[i].estimate
        estimate.elongation += arm.excess[i]
        estimate.distal_displacement -= arm.excess[i]


@jit_compile
def estimate_arm_forces(
    arm: ArmEstimator,
    layout: RigLayout,
    prepared: StructArray,
    estimators: StructArray,
    tendons: EstimatedTendons,
    elapsed: float,
    joint_estimates: JointEstimates,
    out_force: Array,
) -> None:
    """Take the next sample, and write the forces of the tendons on the joints.

    Parameters
    ----------
    arm : ArmEstimator
        Changed in place.
    prepared, estimators : Records
        Of the tendons, `PreparedTendon` and `EstimatorState` after this sample.
    tendons : EstimatedTendons
        The sample.
    elapsed : float
        [s] since the one before.
    joint_estimates : JointEstimates
        Of the sample; only positions are read.
    out_force : array, shape (3, MAX_JOINTS)
        Likeliest, least and largest force [N] at each joint's own pulley; NaN if an angle is not
        known, as before if a tendon's sample is invalid.
    """
    for k in range(layout.joints):
        arm.new_angles[:, k] = joint_estimates[k].position / layout.radius[k]
        if not np.isfinite(arm.new_angles[1, k]):
            out_force[:] = np.nan  # the last ones would be of other angles
            return
    for i in range(layout.tendons):
        estimate = tendons[i].estimate
        if not tendons[i].valid:
            return
        arm.sheath_end[0, i] = estimate.distal_tension
        arm.sheath_end[1, i] = estimate.low
        arm.sheath_end[2, i] = estimate.high
    is_paired = True
    for g in range(layout.groups):
        known, i = 0.0, layout.group[g].tendon[0]
        for j in range(layout.joints):
            known += layout.travel[i, j] * joint_estimates[j].position
        _update_pair(arm, layout.group[g], g, prepared, estimators, tendons, known, elapsed)
        is_paired = is_paired and arm.pairs[g].started
    for k in range(layout.joints if is_paired else 0):
        arm.new_angles[0, k] = 0.0
        for g in range(layout.groups):
            a, b = layout.group[g].tendon[0], layout.group[g].tendon[1]
            share = (layout.inverse[k, a] - layout.inverse[k, b]) / layout.radius[k]
            arm.new_angles[0, k] += share * arm.pairs[g].travel
    if arm.started[0] == 0.0:
        arm.started[0] = 1.0
        copy_values(arm.new_angles.ravel(), arm.angles.ravel())
        open_tensions(arm.routing, arm.sheath_end, arm.angles[1], arm.tensions)
    elements = begin_advance(arm.routing, arm.tensions, arm.angles, arm.new_angles)
    for g in range(layout.groups):
        for m in range(2 if arm.pairs[g].started else 0):
            i = layout.group[g].tendon[m]
            T = drive_sheath_end(
                prepared[i], arm.pairs[g].end[m], arm.routing, elements, i, arm.tensions[0]
            )
            arm.sheath_end[0, i] = min(max(T, arm.sheath_end[1, i]), arm.sheath_end[2, i])
    advance(
        arm.routing, elements, arm.tensions, arm.angles, arm.sheath_end, arm.new_angles,
        arm.reported,
    )  # fmt: skip
    add_torques(arm.routing, arm.reported, arm.torque)
    compute_excess(arm.routing, elements, arm.tensions[0], arm.excess)
    for k in range(layout.joints):
        for copy in range(3):
            out_force[copy, k] = arm.torque[copy, k] / layout.radius[k]
    _add_weight(arm, layout, out_force)


@jit_compile
def _add_weight(arm: ArmEstimator, layout: RigLayout, force: Array) -> None:
    """Add the weight of links to the forces on the joints, so that those of contact are left."""
    pose, jacobian, torque = np.empty((4, 4)), np.empty((6, MAX_JOINTS)), np.empty((2, MAX_JOINTS))
    for i in range(len(arm.arms)):
        first, prepared = arm.first[i], arm.arms[i]
        angles = arm.new_angles[1, first:]
        write_weight_torque(prepared, angles, arm.gravity[i], pose, jacobian, torque)
        for j in range(prepared.coordinates):
            radius, error = layout.radius[first + j], arm.mass_error[i] * torque[1, j]
            force[0, first + j] += torque[0, j] / radius
            force[1, first + j] += (torque[0, j] - error) / radius
            force[2, first + j] += (torque[0, j] + error) / radius


@jit_compile
def _compute_tip_weight(tendon: EstimatedTendon) -> float:
    """Return the weight [1/m^2] of a tendon's travel; less where it is nearly slack at its tip."""
    tip = (tendon.estimate.distal_tension - SLACK_TENSION) / (TAUT_TENSION - SLACK_TENSION)
    return compute_weight(tendon) * min(max(tip, 0.0), 1.0)


@jit_compile
def _update_pair(
    arm: ArmEstimator,
    group: TendonGroup,
    g: int,
    prepared: StructArray,
    estimators: StructArray,
    tendons: EstimatedTendons,
    known_travel: float,
    elapsed: float,
) -> None:
    """Take the likeliest travel of a pair from both of its tendons.

    `known_travel` [m] is that of its tips by the joints' positions.
    Other than two tendons, without encoders or with dynamic effects keep those of each by itself.
    """
    pair, i, j = arm.pairs[g], group.tendon[0], group.tendon[1]
    if group.count != 2 or abs(group.balance[0] - group.balance[1]) > 1e-6:
        pair.started = False
        return
    a, b = tendons[i], tendons[j]
    if (
        prepared[i].has_dynamics
        or prepared[j].has_dynamics
        or not math.isfinite(a.corrected_displacement + b.corrected_displacement)
    ):
        pair.started = False
        return
    if not pair.started:
        start_sheath_end(pair.end[0], estimators[i].profile[:], a.corrected_tension)
        start_sheath_end(pair.end[1], estimators[j].profile[:], b.corrected_tension)
    of_a, of_b = _compute_tip_weight(a), _compute_tip_weight(b)
    update_pair_travel(
        pair,
        prepared[i],
        prepared[j],
        (a.corrected_tension, a.corrected_displacement - arm.excess[i]),
        (b.corrected_tension, b.corrected_displacement - arm.excess[j]),
        of_a / (of_a + of_b) if of_a + of_b > 0.0 else 0.5,
        known_travel,
        elapsed,
    )
