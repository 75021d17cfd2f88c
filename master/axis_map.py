"""From the axes of a device to the joints of a robot, and the forces back.

A map turns the hand h, one number for each axis of the device, into a hand y with an axis for each
joint, which operator, coupling and session then use as if it were the device's own:

    dy = M dh,   F_hand = M^T F_joint

with the velocity map M of the tick, so whatever M is, the power at the hand equals that at the
joints, and a map creates no energy. Without a map y is h, axis k moves joint k.
"""

import math
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import I64, Field, Flag, Struct, StructArray, view_struct
from master import feedback
from master.feedback import FeedbackConfig
from master.hand_input import Axes, HandInput
from master.mapping_config import AxisMapConfig
from teleop.messages.messages import MAX_JOINTS


class VelocityMap(Struct):
    """How the hand's motion moves the joints in a tick, and what else the map does to the hand."""

    is_active: Flag = False  # False: y is h
    # row: joint, column: axis of the device; of one that turns, its travel at the lever
    matrix: Annotated[Array, Field("f8", (MAX_JOINTS, MAX_JOINTS))]
    fixture_force: Axes  # [N] of virtual fixtures, on each axis
    # [m] at which the torque on an axis that turns counts as a force; 1 of others
    lever: Annotated[Array, Field("f8", MAX_JOINTS, fill=1.0)]


class HandMapper(Protocol):
    """What maps the hand of a tick, from a config."""

    joints: int  # how many axes y has
    mapped_hands: StructArray  # the mapped hand, a `HandInput`, shape (1,)
    maps: StructArray  # the `VelocityMap` of the tick, shape (1,)

    def step(
        self, hands: StructArray, memories: StructArray, position_scale: float, dt: float
    ) -> None:
        """Map the hand of this tick, `dt` [s] after the last.

        `hands` and `memories`, shape (1,), are `HandInput` and, after the last tick,
        `MasterMemory`; `position_scale` is tip travel per hand travel.
        """


@jit_compile
def compute_hand_force(
    velocity_map: VelocityMap, joint_force: Array, axes: int, joints: int, out: Array
) -> None:
    """Write the forces on the hand [N] of forces along y [N] to the first `axes` of `out`."""
    for k in range(axes):
        if not velocity_map.is_active:
            out[k] = joint_force[k]
            continue
        out[k] = 0.0
        for j in range(joints):
            out[k] += velocity_map.matrix[j, k] * joint_force[j]


@jit_compile
def limit_joint_force(
    config: FeedbackConfig,
    total_max: float,
    velocity_map: VelocityMap,
    last: Array,
    force: Array,
    axes: int,
    joints: int,
    dt: float,
) -> None:
    """Limit growth and size of a force along y [N], in place, so that the hand's stays in bounds.

    `total_max` [N] bounds the length of the force on the hand. The whole vector goes a part of the
    way from `last` and is then shortened, so that the force on the hand stays one that the joints
    feel too: limits of single axes would not be passive.
    """
    begin, end = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    compute_hand_force(velocity_map, last, axes, joints, begin)
    compute_hand_force(velocity_map, force, axes, joints, end)
    share, largest, total = 1.0, 0.0, 0.0
    for k in range(axes):
        if not math.isfinite(end[k]):
            return  # for the gate to refuse
        allowed = feedback.limit_slew(config.slew, begin[k], end[k], dt)
        if allowed != end[k]:
            share = min(share, (allowed - begin[k]) / (end[k] - begin[k]))
    for k in range(axes):
        reached = begin[k] + share * (end[k] - begin[k])
        largest = max(largest, abs(reached))
        total += reached * reached
    shorter = min(1.0, config.limit / largest) if largest > 0.0 else 1.0
    if total > 0.0:
        shorter = min(shorter, total_max / math.sqrt(total))
    for j in range(joints):
        force[j] = shorter * (last[j] + share * (force[j] - last[j]))


@jit_compile
def store_joint_force(
    velocity_map: VelocityMap,
    written: Array,
    local: Array,
    coupling_force: Array,
    force: Array,
    axes: int,
    joints: int,
    out: Array,
) -> None:
    """Write the part of the `written` force on the hand that is the coupling's, along y [N].

    `local` is the part that no joint feels, `coupling_force` what all of `force` along y would have
    been on the hand. What is missing of it on one axis is taken to be missing of all of `force`.
    """
    if not velocity_map.is_active:
        for k in range(MAX_JOINTS):
            out[k] = written[k] - local[k]
        return
    share, has_force = 1.0, False
    for k in range(axes):
        if not math.isfinite(coupling_force[k]):
            share = 0.0
        elif coupling_force[k] != 0.0:
            has_force = True
            share = min(share, max(0.0, (written[k] - local[k]) / coupling_force[k]))
    if not has_force:  # as before the map moves: its next motion is without a force
        share = 0.0
    for j in range(joints):
        out[j] = share * force[j] if share > 0.0 else 0.0


# --- axes of the device assigned to joints

RANGE_EASE = 0.1  # of the range at either end, in which a joint comes to rest


class AxisMap(Struct):
    """A `MappedJointConfig` for each joint, as a record."""

    joints: I64
    axis: Annotated[NDArray[np.int64], Field("i8", MAX_JOINTS, fill=-1)]
    scale: Axes
    dead_band: Axes  # [m], [rad]
    low: Axes  # [m], [rad]
    high: Axes  # [m], [rad]


@jit_compile
def map_axes(
    axis_maps: StructArray, hands: StructArray, mapped_hands: StructArray, maps: StructArray
) -> None:
    """Fill `mapped_hands` and `maps` from the hand; all of shape (1,)."""
    axis_map, hand, mapped_hand, velocity_map = axis_maps[0], hands[0], mapped_hands[0], maps[0]
    mapped_hand.present, mapped_hand.engage = hand.present, hand.engage
    mapped_hand.clutch, mapped_hand.stop = hand.clutch, hand.stop
    mapped_hand.axes = axis_map.joints if hand.present else 0
    velocity_map.is_active = True
    velocity_map.matrix[:] = 0.0
    for j in range(axis_map.joints):
        axis = axis_map.axis[j]
        mapped_hand.position[j] = mapped_hand.velocity[j] = 0.0
        if not 0 <= axis < hand.axes:
            continue
        x, end_slope = ease_range(hand.position[axis], axis_map.low[j], axis_map.high[j])
        moved, slope = pass_dead_band(x, axis_map.dead_band[j])
        slope *= end_slope
        velocity_map.matrix[j, axis] = axis_map.scale[j] * slope / velocity_map.lever[axis]
        mapped_hand.position[j] = axis_map.scale[j] * moved
        mapped_hand.velocity[j] = axis_map.scale[j] * slope * hand.velocity[axis]


@jit_compile
def ease_range(x: float, low: float, high: float) -> tuple[float, float]:
    """Return `x` [m] within a range about 0, and the slope of that.

    The slope falls from 1 to 0 over the last `RANGE_EASE` of the range at either end, so that the
    force ends without a step.
    """
    end = high if x > 0.0 else -low
    width = RANGE_EASE * end
    beyond = abs(x) - (end - width)
    if beyond <= 0.0:
        return x, 1.0
    beyond = min(beyond, width)
    moved = end - width + beyond - 0.5 * beyond * beyond / width
    return math.copysign(moved, x), 1.0 - beyond / width


@jit_compile
def pass_dead_band(x: float, width: float) -> tuple[float, float]:
    """Return what is left of `x` beyond `width` on either side of 0, and its slope.

    The slope rises from 0 to 1 within another `width`, so that the force begins without a step.
    """
    if width == 0.0:
        return x, 1.0
    beyond = abs(x) - width
    if beyond <= 0.0:
        return 0.0, 0.0
    moved, slope = beyond - 0.5 * width, 1.0
    if beyond < width:
        moved, slope = 0.5 * beyond * beyond / width, beyond / width
    return math.copysign(moved, x), slope


class AxisMapper:
    """A `HandMapper` by axes; a torque in a hand counts as the force at `torque_lever` [m]."""

    def __init__(self, config: AxisMapConfig, torque_lever: float) -> None:
        self.joints = len(config.joints)
        self.mapped_hands, self.maps = HandInput.array(), VelocityMap.array()
        self._axis_map = AxisMap.array()
        axis_map = view_struct(self._axis_map)
        axis_map.joints = len(config.joints)
        for j, joint in enumerate(config.joints):
            axis_map.axis[j] = -1 if joint.axis is None else joint.axis
            axis_map.scale[j], axis_map.dead_band[j] = joint.scale, joint.dead_band
            axis_map.low[j], axis_map.high[j] = joint.range
            if joint.axis is not None and joint.turns:
                self.maps["lever"][0, joint.axis] = torque_lever

    def step(
        self,
        hands: StructArray,
        memories: StructArray,  # noqa: ARG002 - of every map
        position_scale: float,  # noqa: ARG002
        dt: float,  # noqa: ARG002
    ) -> None:
        """Map the hand of this tick."""
        map_axes(self._axis_map, hands, self.mapped_hands, self.maps)
