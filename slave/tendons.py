"""Records of the tendons of a rig: layout, measurements and estimates."""

import math
from collections.abc import Sequence
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online.tendon_estimate import TendonEstimate
from estimator.records import F64, I64, Field, Flag, Struct, StructArray, view_struct
from teleop.config.arm import RoutingConfig, assemble_travel_ratios
from teleop.messages.messages import MAX_JOINTS

SIGNS = (1.0, -1.0)  # of a joint's travel at the tips of its tendons a and b


class JointTendons(Struct):
    """The tendons of one joint: `a`, or `a` and `b`."""

    count: I64 = 0
    tendon: Annotated[NDArray[np.int64], Field("i8", 2, fill=-1)]  # numbered over the whole rig


JointMatrix = Annotated[Array, Field("f8", (MAX_JOINTS, MAX_JOINTS))]
"""A field with a row and a column for each joint, zero beyond the joints of the rig."""


class RigLayout(Struct):
    """Which tendons a rig has and which joints they move, `Rig.joints`.

    In an arm the tendons of a joint also pass other joints: at the end of their sheaths they travel
    by the sum of `ratio[k, j]` times the travel of joint j.
    """

    joints: I64 = 0
    tendons: I64 = 0
    joint: Annotated[Sequence[JointTendons], Field(JointTendons, MAX_JOINTS)]
    is_coupled: Flag = False
    ratio: JointMatrix  # travel of the tendons of joint k over the travel of joint j
    inverse: JointMatrix  # of it
    radius: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] of each joint's own pulley, if coupled


class EstimatedTendon(Struct):
    """One tendon in one sample: measured, corrected and estimated."""

    tension: F64 = math.nan  # [N] measured at the housing
    displacement: F64 = math.nan  # [m] measured motor position; NaN without an encoder
    corrected_tension: F64 = math.nan  # [N] corrected for modelled sensor effects
    corrected_displacement: F64 = math.nan  # [m]
    valid: Flag = False  # whether the estimator accepted the sample
    estimate: TendonEstimate


EstimatedTendons: TypeAlias = Sequence[EstimatedTendon] | StructArray
"""The tendons of a rig in one sample, as a field of a record or as an array of records."""


def build_rig_layout(
    joints: Sequence[Sequence[int]], arms: Sequence[RoutingConfig] = ()
) -> StructArray:
    """Return the layout of `Rig.joints`, the first of which are those of `arms`, shape (1,)."""
    layout = RigLayout.array()
    record = view_struct(layout)
    record.joints = len(joints)
    record.tendons = sum(map(len, joints))
    for k, tendons in enumerate(joints):
        record.joint[k].count = len(tendons)
        record.joint[k].tendon[: len(tendons)] = tendons
    n = len(joints)
    ratio, record.radius[:n] = assemble_travel_ratios(arms, n)
    record.is_coupled = bool(arms)
    record.ratio[:n, :n], record.inverse[:n, :n] = ratio, np.linalg.inv(ratio)
    return layout


@jit_compile
def compute_joint_travel(layout: RigLayout, tendon_travel: Array, out: Array) -> None:
    """Write the travel of each joint [m] for the travels of their tendons [m]; not in place."""
    for j in range(layout.joints):
        out[j] = 0.0
        for k in range(layout.joints):
            if layout.inverse[j, k] != 0.0:
                out[j] += layout.inverse[j, k] * tendon_travel[k]
