"""Records of the tendons of a rig: layout, measurements and estimates."""

import math
from collections.abc import Sequence
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.online.tendon_estimate import TendonEstimate
from estimator.records import F64, I64, Field, Flag, Struct, StructArray, view_struct
from teleop.messages.messages import MAX_JOINTS

SIGNS = (1.0, -1.0)  # of a joint's travel at the tips of its tendons a and b


class JointTendons(Struct):
    """The tendons of one joint: `a`, or `a` and `b`."""

    count: I64 = 0
    tendon: Annotated[NDArray[np.int64], Field("i8", 2, fill=-1)]  # numbered over the whole rig


class RigLayout(Struct):
    """Which tendons a rig has and which joints they move, `Rig.joints`."""

    joints: I64 = 0
    tendons: I64 = 0
    joint: Annotated[Sequence[JointTendons], Field(JointTendons, MAX_JOINTS)]


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


def build_rig_layout(joints: Sequence[Sequence[int]]) -> StructArray:
    """Return the layout of `Rig.joints`, shape (1,)."""
    layout = RigLayout.array()
    record = view_struct(layout)
    record.joints = len(joints)
    record.tendons = sum(map(len, joints))
    for k, tendons in enumerate(joints):
        record.joint[k].count = len(tendons)
        record.joint[k].tendon[: len(tendons)] = tendons
    return layout
