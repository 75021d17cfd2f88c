"""Estimate of a joint from its one or two tendons.

A joint's travel q [m] is positive in the pulling direction of its first tendon, `a`; the tip of the
second one, `b`, travels by -q. Each tendon measures the joint's travel as q_p less its elongation,
with an error that grows with the elongation: the slack-side tendon is the better sensor as long as
it is taut.
"""

from collections.abc import Sequence
from math import isfinite, nan
from typing import TypeAlias

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.records import F64, I64, Struct, StructArray
from slave.tendons import SIGNS, EstimatedTendon, EstimatedTendons, JointTendons, RigLayout

SLACK_TENSION = 0.05  # [N] at the housing: below, a tendon does not measure its joint
TAUT_TENSION = 0.15  # [N] full weight from here on

ERROR_FLOOR = 1e-5  # [m] added to the elongation in the weight: no tendon is a perfect sensor


class JointEstimate(Struct):
    """Estimate of one joint at one instant."""

    position: F64 = nan  # [m] travel, up to a constant; NaN without encoders
    force: F64 = nan  # [N] of the environment on the tendons, positive against pulling by `a`
    low: F64 = nan  # [N] ends of the certified interval of the force
    high: F64 = nan  # [N]
    status: I64 = 0  # bits of estimator.online.tendon_estimate.Status, of all its tendons


JointEstimates: TypeAlias = Sequence[JointEstimate] | StructArray
"""The joints of a rig at one instant, as a field of a record or as an array of records."""


@jit_compile
def compute_weight(tendon: EstimatedTendon) -> float:
    """Return the weight of a tendon's measurement of its joint's travel [1/m^2].

    1/e^2 with e the elongation; reduced if the tendon is nearly slack, zero if its estimate is
    invalid.
    """
    if not (tendon.valid and tendon.tension > SLACK_TENSION):
        return 0.0
    error = ERROR_FLOOR + max(tendon.estimate.elongation, 0.0)
    return min((tendon.tension - SLACK_TENSION) / (TAUT_TENSION - SLACK_TENSION), 1.0) / (
        error * error
    )


@jit_compile
def fuse_travel(
    joint: JointTendons, tendons: EstimatedTendons, travel_a: float, travel_b: float
) -> float:
    """Return a joint's travel [m], the weighted mean of its tendons' measurements.

    Equal weights if both are zero. `travel_b` is ignored for a joint of one tendon.
    """
    if joint.count == 1:
        return travel_a
    of_a, of_b = compute_weight(tendons[joint.tendon[0]]), compute_weight(tendons[joint.tendon[1]])
    if of_a == of_b:
        return 0.5 * (travel_a + travel_b)
    if of_a == 0.0 or of_b == 0.0:
        return travel_a if of_b == 0.0 else travel_b
    return (of_a * travel_a + of_b * travel_b) / (of_a + of_b)


@jit_compile
def compute_offset(joint: JointTendons, tendons: EstimatedTendons) -> float:
    """Return the common offset [m] of the travel measured by the tendons of a joint.

    The travels q_p - e of both tips sum to a constant; this is half its present value.
    """
    if joint.count == 1:
        return 0.0
    a, b = tendons[joint.tendon[0]], tendons[joint.tendon[1]]
    both: float = a.estimate.distal_displacement + b.estimate.distal_displacement
    return 0.5 * both


@jit_compile
def compute_joint_offsets(layout: RigLayout, tendons: EstimatedTendons, out_offsets: Array) -> bool:
    """Write the offset of each joint [m] if all of them are finite; return whether they are."""
    for k in range(layout.joints):
        if not isfinite(compute_offset(layout.joint[k], tendons)):
            return False
    for k in range(layout.joints):
        out_offsets[k] = compute_offset(layout.joint[k], tendons)
    return True


@jit_compile
def estimate_joint(
    joint: JointTendons, tendons: EstimatedTendons, offset: float, out: JointEstimate
) -> None:
    """Estimate a joint.

    The force is T_out,a - T_out,b, between low_a - high_b and high_a - low_b.

    Parameters
    ----------
    tendons : EstimatedTendons
        All of the rig in one sample, shape (tendons,) or longer.
    offset : float
        Of its tendons [m], from `compute_offset` at the time that defines the position.
    out : JointEstimate
        Overwritten.
    """
    a = tendons[joint.tendon[0]].estimate
    travel_a, travel_b = a.distal_displacement - offset, nan
    force, low, high, status = a.distal_tension, a.low, a.high, a.status
    if joint.count > 1:
        b = tendons[joint.tendon[1]].estimate
        travel_b = SIGNS[1] * (b.distal_displacement - offset)
        force, low, high = force - b.distal_tension, low - b.high, high - b.low
        status |= b.status
    out.position = fuse_travel(joint, tendons, travel_a, travel_b)
    out.force, out.low, out.high, out.status = force, low, high, status


@jit_compile
def estimate_joints(
    layout: RigLayout,
    tendons: EstimatedTendons,
    offsets: Array,
    arm_force: Array,
    out_estimates: JointEstimates,
) -> None:
    """Write the estimate of every joint of a rig.

    Parameters
    ----------
    offsets : array, shape (joints,)
        Of the joints' tendons [m].
    arm_force : array, shape (3, MAX_JOINTS)
        Of `estimate_arm_forces` [N]; not read unless joints share tendons.
    """
    for k in range(layout.joints):
        estimate_joint(layout.joint[k], tendons, offsets[k], out_estimates[k])
    if layout.is_coupled:
        _decouple_joints(layout, arm_force, out_estimates)


@jit_compile
def _decouple_joints(layout: RigLayout, force: Array, estimates: JointEstimates) -> None:
    """Turn the estimates of the joints' own tendons into those of the joints, in place."""
    n = layout.joints
    travel, status = np.empty(n), np.empty(n, np.int64)
    for k in range(n):
        travel[k], status[k] = estimates[k].position, estimates[k].status
    for j in range(n):
        joint = estimates[j]
        joint.position = 0.0
        joint.force, joint.low, joint.high = force[0, j], force[1, j], force[2, j]
        for k in range(n):
            if layout.inverse[j, k] != 0.0:
                joint.position += layout.inverse[j, k] * travel[k]
                joint.status |= status[k]
            if layout.ratio[k, j] != 0.0:
                joint.status |= status[k]
        if not isfinite(joint.force):
            joint.status |= INVALID_INPUT
