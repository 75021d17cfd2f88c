"""Records of the tendons of a rig: layout, measurements and estimates."""

import math
from collections.abc import Sequence
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.online.tendon_estimate import TendonEstimate
from estimator.structs import F64, I64, Field, Flag, Struct, StructArray, view_struct
from teleop.config.arm import RoutingConfig, assemble_tendon_rows
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS


class TendonGroup(Struct):
    """Tendons that work against each other: a single one, a pair, n + 1 of an arm of n joints.

    `balance` are their tensions t_i in balance, so that their tips travel by sum t_i x_i = const.
    """

    count: I64 = 0
    tendon: Annotated[NDArray[np.int64], Field("i8", MAX_JOINTS + 1, fill=-1)]  # over the rig
    balance: Annotated[Array, Field("f8", MAX_JOINTS + 1)]


class RigLayout(Struct):
    """Which tendons a rig has and which joints they move, `Rig.joints`.

    At the end of its sheath tendon i travels by the sum of `travel[i, j]` times the travel of joint
    j; in an arm tendons also pass other joints. Matrices are zero beyond the rig.
    """

    joints: I64 = 0
    tendons: I64 = 0
    groups: I64 = 0
    group: Annotated[Sequence[TendonGroup], Field(TendonGroup, MAX_JOINTS)]
    is_coupled: Flag = False
    travel: Annotated[Array, Field("f8", (MAX_TENDONS, MAX_JOINTS))]
    inverse: Annotated[Array, Field("f8", (MAX_JOINTS, MAX_TENDONS))]  # of it
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
    rows = assemble_tendon_rows(arms, joints)
    tendons, n = rows.travel.shape
    record.joints, record.tendons, record.groups = n, tendons, len(rows.groups)
    for group, (members, balance) in zip(record.group, rows.groups, strict=False):
        group.count = len(members)
        group.tendon[: len(members)], group.balance[: len(members)] = members, balance
    record.is_coupled = bool(arms)
    record.radius[:n] = rows.radius
    record.travel[:tendons, :n], record.inverse[:n, :tendons] = rows.travel, rows.inverse
    return layout
