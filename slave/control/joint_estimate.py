"""Estimate of joints from their tendons.

A joint's travel q [m] is positive in the pulling direction of its first tendon, `a`; the tip of the
second one, `b`, travels by -q. Each tendon measures the travel of its tip as q_p less its
elongation, with an error that grows with the elongation: the slack-side tendon is the better sensor
as long as it is taut. What tendons that work against each other say is made to agree.
"""

from collections.abc import Sequence
from math import isfinite, nan
from typing import TypeAlias

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.structs import F64, I64, Struct, StructArray
from slave.rig_layout import EstimatedTendon, EstimatedTendons, RigLayout, TendonGroup

SLACK_TENSION = 0.05  # [N] at the housing: below, a tendon does not measure its joint
TAUT_TENSION = 0.15  # [N] full weight from here on

ERROR_FLOOR = 1e-5  # [m] added to the elongation in the weight: no tendon is a perfect sensor


class JointEstimate(Struct):
    """Estimate of one joint at one instant."""

    position: F64 = nan  # [m] travel, up to a constant; NaN without encoders
    force: F64 = nan  # [N] of the environment on the tendons, positive against pulling by `a`
    low: F64 = nan  # [N] ends of the certified interval of the force
    high: F64 = nan  # [N]
    margin: F64 = 0.0  # [N] by which |force| is less with adapted K at the ends of their intervals
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
def fuse_travels(group: TendonGroup, tendons: EstimatedTendons, travel: Array) -> None:
    """Make the measured travels of the tips of a group agree, in place, [m] by tendon of the rig.

    Least squares with the weights of `compute_weight`. Tendons of no weight are not believed; equal
    weights if no tendon has any.
    """
    if group.count == 1:
        return
    doubted, last = 0, -1
    for n in range(group.count):
        if compute_weight(tendons[group.tendon[n]]) == 0.0:
            doubted, last = doubted + 1, group.tendon[n]
    if doubted == 1:
        travel[last] = 0.0  # it follows from the others
    excess, scale = 0.0, 0.0
    for n in range(group.count):
        i, t = group.tendon[n], group.balance[n]
        excess += t * travel[i]
        scale += t * t * _compute_doubt(tendons[i], doubted)
    for n in range(group.count):
        i, t = group.tendon[n], group.balance[n]
        doubt = _compute_doubt(tendons[i], doubted)
        if doubt != 0.0:
            travel[i] -= doubt / scale * t * excess


@jit_compile
def _compute_doubt(tendon: EstimatedTendon, doubted: int) -> float:
    """Return one over the weight; with `doubted` tendons of none 1 for these, 0 for the others."""
    weight = compute_weight(tendon)
    if doubted:
        return 1.0 if weight == 0.0 else 0.0
    return 1.0 / weight


@jit_compile
def compute_offset(group: TendonGroup, tendons: EstimatedTendons) -> float:
    """Return the common offset [m] of the travels measured by the tendons of a group.

    The travels x_i = q_p - e of their tips have a constant sum t_i x_i. The offset of each is this
    number times its t_i, at present.
    """
    if group.count == 1:
        return 0.0
    excess, scale = 0.0, 0.0
    for n in range(group.count):
        t = group.balance[n]
        excess += t * tendons[group.tendon[n]].estimate.distal_displacement
        scale += t * t
    return excess / scale


@jit_compile
def compute_offsets(layout: RigLayout, tendons: EstimatedTendons, out_offsets: Array) -> bool:
    """Write the offset of each tendon [m] if all of them are finite; return whether they are."""
    for g in range(layout.groups):
        if not isfinite(compute_offset(layout.group[g], tendons)):
            return False
    for g in range(layout.groups):
        group = layout.group[g]
        offset = compute_offset(group, tendons)
        for n in range(group.count):
            out_offsets[group.tendon[n]] = group.balance[n] * offset
    return True


@jit_compile
def estimate_joints(
    layout: RigLayout,
    tendons: EstimatedTendons,
    offsets: Array,
    arm_force: Array,
    out_estimates: JointEstimates,
) -> None:
    """Write the estimate of every joint of a rig.

    The force is that of the tendons, T_out,a - T_out,b, between low_a - high_b and high_a - low_b.

    Parameters
    ----------
    tendons : EstimatedTendons
        All of the rig in one sample, shape (tendons,) or longer.
    offsets : array, shape (tendons,)
        Of the tendons [m], from `compute_offsets` at the time that defines the positions.
    arm_force : array, shape (3, MAX_JOINTS)
        Of `estimate_arm_forces` [N]; not read unless joints share tendons.
    out_estimates : JointEstimates
        Overwritten.
    """
    travel = np.empty(layout.tendons)
    for i in range(layout.tendons):
        travel[i] = tendons[i].estimate.distal_displacement - offsets[i]
    for g in range(layout.groups):
        fuse_travels(layout.group[g], tendons, travel)
    for j in range(layout.joints):
        position, force, low, high, status = 0.0, 0.0, 0.0, 0.0, 0
        adapted_low, adapted_high = 0.0, 0.0
        for i in range(layout.tendons):
            share, ratio, tendon = layout.inverse[j, i], layout.travel[i, j], tendons[i].estimate
            if share != 0.0:
                position += share * travel[i]
            if share != 0.0 or ratio != 0.0:
                status |= tendon.status
            if ratio != 0.0 and not layout.is_coupled:
                force += ratio * tendon.distal_tension
                low += ratio * (tendon.low if ratio > 0.0 else tendon.high)
                high += ratio * (tendon.high if ratio > 0.0 else tendon.low)
                adapted_low += ratio * (tendon.adapted_low if ratio > 0.0 else tendon.adapted_high)
                adapted_high += ratio * (tendon.adapted_high if ratio > 0.0 else tendon.adapted_low)
        if layout.is_coupled:
            force, low, high = arm_force[0, j], arm_force[1, j], arm_force[2, j]
            adapted_low = adapted_high = force
            if not isfinite(force):
                status |= INVALID_INPUT
        joint = out_estimates[j]
        joint.position, joint.status = position, status
        joint.force, joint.low, joint.high = force, low, high
        margin = force - adapted_low if force > 0.0 else adapted_high - force
        joint.margin = 0.0 if margin < 0.0 else margin  # by rounding; NaN stays, renders nothing
