"""From a hand in space to the joints of an arm, by the arm's kinematics.

The axes of the device are translations and rotations of the hand, and its grip. The tip moves as
the hand does, scaled and turned (`estimator.kinematics.hand_map`), the joints by the differential
inverse kinematics (`estimator.kinematics.inverse`) at the commanded angles, and the matrix T of
that step is the map: the force in the hand is T^T times the torques of the joints. Virtual fixtures
are torques on the joints, which the same matrix brings to the hand.

Joint j of an arm has the travel q_j = r_j theta_j, and the mapped hand y moves the tips by
`position_scale` y: so M = diag(r) T / position_scale, with the device's angles roll, pitch, yaw
(about x, then y, then z) turned into an angular velocity.

A joint that comes to its limit is eased out: with a share g that falls from 1 to 0 as the distance
to the limit does over `stop_distance`, and rises again over as much motion inwards, the map is that
of all joints times g and that of the other joints times 1 - g. So neither motion nor force change
in a step, and a hand that trembles at the limit feels no blows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import MAX_COORDINATES, Arm, PreparedArm, prepare_arm
from estimator.kinematics.forward import write_kinematics
from estimator.kinematics.hand_map import (
    AXES,
    GRIP,
    HandMap,
    HandMapConfig,
    HandMapSettings,
    HandPose,
    build_hand_map_settings,
    step_hand_map,
    write_joint_map,
)
from estimator.kinematics.inverse import (
    InverseConfig,
    InverseSettings,
    InverseStep,
    build_inverse_settings,
    step_inverse,
)
from estimator.kinematics.rotations import multiply, to_quaternion
from estimator.kinematics.virtual_fixtures import Fixtures, build_fixtures, write_fixture_torque
from estimator.structs import F64, I64, Field, Struct, StructArray, view_struct
from master.axis_map import VelocityMap, pass_dead_band
from master.hand_input import Axes, HandInput
from master.loop import MasterMemory, init_master
from master.mapping_config import HAND_AXES, SpaceHandConfig, SpaceMapConfig
from teleop.messages.messages import MAX_JOINTS
from teleop.session.state_machine import State


def weigh_axes(hand: SpaceHandConfig) -> InverseConfig:
    """Return a hand's inverse kinematics; rotations of the tip are free if the hand has none."""
    if {"roll", "pitch", "yaw"} & set(hand.axes):
        return hand.inverse
    return replace(hand.inverse, weights=(*hand.inverse.weights[:3], 0.0, 0.0, 0.0))


def to_hand_map_config(hand: SpaceHandConfig, jaw_radius: float) -> HandMapConfig:
    """Return the hand's map of the estimator; its translation scale is set in every tick."""
    roll, pitch, yaw = hand.registration
    tilt = multiply(to_quaternion(0.0, pitch, 0.0), to_quaternion(roll, 0.0, 0.0))
    return HandMapConfig(
        rotation_scale=hand.rotation_scale,
        registration=multiply(to_quaternion(0.0, 0.0, yaw), tilt),
        lock=tuple(HAND_AXES.index(axis) for axis in hand.lock),
        align_orientation=hand.align_orientation,
        grip_scale=hand.grip_scale / jaw_radius,
    )


DT_MIN = 1e-6  # [s] what follows divides by it


class SpaceHand(Struct):
    """One hand and its arm: which axes and joints, and all that is needed in a tick."""

    first_axis: I64
    axes: I64
    axis: Annotated[NDArray[np.int64], Field("i8", MAX_JOINTS)]  # of `HAND_AXES`
    scale: Annotated[Array, Field("f8", MAX_JOINTS, fill=1.0)]  # of each axis
    dead_band: Axes  # [m], [rad]
    slope: Axes  # of each number of the pose over the device's, in this tick
    first_joint: I64
    joints: I64  # with the gripper's behind those of the arm, if there is one
    radius: Axes  # [m] of each joint's pulley
    arm: PreparedArm
    inverse: InverseSettings
    settings: HandMapSettings
    fixtures: Fixtures
    pose: HandPose
    map: HandMap
    step: InverseStep
    stop_distance: F64  # [rad]
    ease: Annotated[Array, Field("f8", MAX_JOINTS, fill=1.0)]  # g of each joint
    eased_map: Annotated[Array, Field("f8", (MAX_COORDINATES, 6))]
    reduced: Annotated[Array, Field("f8", (6, MAX_JOINTS))]  # Jacobian of the joints that move
    tip: Annotated[Array, Field("f8", (4, 4))]
    jacobian: Annotated[Array, Field("f8", (6, MAX_JOINTS))]
    angle: Axes  # [rad] or [m], commanded
    torque: Axes  # [N m] or [N] of the fixtures
    travel: Axes  # [m] y of the joints
    rates: Annotated[Array, Field("f8", (3, 3))]  # angular velocity over the rates of the angles


@jit_compile
def map_space(
    all_hands: StructArray,
    memories: StructArray,
    hands: StructArray,
    position_scale: float,
    dt: float,
    mapped_hands: StructArray,
    maps: StructArray,
) -> None:
    """Fill `mapped_hands` and `maps`, shape (1,), from the hand and the commanded travels.

    `all_hands`, a `SpaceHand` for each arm, are changed in place; for the others see `HandMapper`.
    """
    memory, hand, mapped_hand, velocity_map = memories[0], hands[0], mapped_hands[0], maps[0]
    dt = max(dt, DT_MIN)
    mapped_hand.present, mapped_hand.engage = hand.present, hand.engage
    mapped_hand.clutch, mapped_hand.stop = hand.clutch, hand.stop
    velocity_map.is_active = True
    velocity_map.matrix[:] = 0.0
    velocity_map.fixture_force[:] = 0.0
    joints = 0
    for i in range(len(all_hands)):
        space = all_hands[i]
        _step_hand(space, memory, hand, position_scale, dt)
        _fill_map(space, hand, position_scale, dt, mapped_hand, velocity_map)
        joints += space.joints
    mapped_hand.axes = joints if hand.present else 0


@jit_compile
def _step_hand(
    space: SpaceHand, memory: MasterMemory, hand: HandInput, position_scale: float, dt: float
) -> None:
    """Step one hand and its arm."""
    arm, n = space.arm, space.arm.coordinates
    for j in range(space.joints):
        space.angle[j] = memory.operator.tip[space.first_joint + j] / space.radius[j]
    write_kinematics(arm, space.angle, space.tip, space.jacobian)
    _read_pose(space, hand)
    for axis in range(3):
        if space.settings.scale[axis] != 0.0:
            space.settings.scale[axis] = position_scale
    engaged = hand.present and memory.session.state == State.ENGAGED
    jaw = space.angle[n] if space.joints > n else 0.0
    step_hand_map(space.settings, space.pose, engaged, space.tip, jaw, dt, space.map)
    _solve(space, space.jacobian, dt)
    _ease_joints(space, dt)
    write_joint_map(arm, space.step, space.map)
    write_fixture_torque(
        space.fixtures,
        arm,
        space.inverse,
        space.angle,
        space.tip,
        space.jacobian,
        space.torque,
    )


@jit_compile
def _solve(space: SpaceHand, jacobian: Array, dt: float) -> None:
    """Write the inverse kinematics of this tick to `space.step`."""
    twist, error = space.map.twist, space.map.error
    step_inverse(space.arm, space.inverse, jacobian, space.angle, twist, error, dt, space.step)


@jit_compile
def _ease_joints(space: SpaceHand, dt: float) -> None:
    """Blend the map of all joints with those without the joints that are at their limits."""
    arm, step, ease, eased = space.arm, space.step, space.ease, space.eased_map
    is_easing = False
    for j in range(arm.coordinates):
        margin = space.stop_distance
        if arm.is_linear[j]:
            margin *= space.inverse.rotation_length
        velocity = step.joint_velocity[j]
        outwards = step.held[j] if step.held[j] != 0 else np.sign(velocity)
        if outwards != 0.0:
            end = arm.upper[j] if outwards > 0.0 else arm.lower[j]
            target = min(max(outwards * (end - space.angle[j]), 0.0) / margin, 1.0)
            fastest = abs(velocity) * dt / margin
            ease[j] += min(max(target - ease[j], -fastest), fastest)
            if step.held[j] != 0:
                ease[j] = min(ease[j], target)
        is_easing = is_easing or ease[j] < 1.0
    if not is_easing:
        return
    space.reduced[:] = space.jacobian
    eased[:] = 0.0
    level = -1.0
    while level < 1.0:  # once for each joint that is eased, from the lowest share up, and at last
        last, level = level, 1.0
        for j in range(arm.coordinates):
            if last < ease[j] < level:
                level = ease[j]
        eased += (level - max(last, 0.0)) * step.velocity_map
        for j in range(arm.coordinates):
            if ease[j] <= level < 1.0:
                space.reduced[:, j] = 0.0
        if level < 1.0:
            _solve(space, space.reduced, dt)
    step.velocity_map[:] = eased


@jit_compile
def _read_pose(space: SpaceHand, hand: HandInput) -> None:
    """Read the hand's pose from its axes, and their slopes; those that it has not stay at 0."""
    numbers = np.zeros(AXES)
    for k in range(space.axes):
        moved, slope = pass_dead_band(hand.position[space.first_axis + k], space.dead_band[k])
        numbers[space.axis[k]] = space.scale[k] * moved
        space.slope[k] = space.scale[k] * slope
    for k in range(3):
        space.pose.position[k] = numbers[k]
    roll, pitch, yaw = numbers[3], numbers[4], numbers[5]
    about_y_and_x = multiply(to_quaternion(0.0, pitch, 0.0), to_quaternion(roll, 0.0, 0.0))
    turned = multiply(to_quaternion(0.0, 0.0, yaw), about_y_and_x)
    for k in range(4):
        space.pose.orientation[k] = turned[k]
    space.pose.grip = numbers[GRIP]
    cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    rates = space.rates
    rates[0, 0], rates[1, 0], rates[2, 0] = cy * cp, sy * cp, -sp  # roll
    rates[0, 1], rates[1, 1], rates[2, 1] = -sy, cy, 0.0  # pitch
    rates[0, 2], rates[1, 2], rates[2, 2] = 0.0, 0.0, 1.0  # yaw


@jit_compile
def _fill_map(
    space: SpaceHand,
    hand: HandInput,
    position_scale: float,
    dt: float,
    mapped_hand: HandInput,
    velocity_map: VelocityMap,
) -> None:
    """Write the rows and columns of one hand, and its mapped motion."""
    for j in range(space.joints):
        row = space.first_joint + j
        lever = space.radius[j] / position_scale
        mapped_hand.velocity[row] = 0.0
        for k in range(space.axes):
            axis, column = space.axis[k], space.first_axis + k
            gain = space.map.joint_map[j, axis]
            if 3 <= axis < GRIP:  # an angle of the device
                gain = 0.0
                for m in range(3):
                    gain += space.map.joint_map[j, 3 + m] * space.rates[m, axis - 3]
            gain *= space.slope[k]
            force_gain = gain / velocity_map.lever[column]
            velocity_map.matrix[row, column] = lever * force_gain
            velocity_map.fixture_force[column] += force_gain * space.torque[j]
            mapped_hand.velocity[row] += lever * gain * hand.velocity[column]
        space.travel[j] += lever * space.map.joint_velocity[j] * dt
        mapped_hand.position[row] = space.travel[j]


class SpaceMapper:
    """A `HandMapper` by kinematics.

    Each hand of the config has one of `arms`, with the pulley radii [m] of its joints, and of a
    gripper behind them if there is one. A torque in a hand counts as the force at `torque_lever`
    [m].
    """

    def __init__(
        self,
        config: SpaceMapConfig,
        arms: Sequence[Arm],
        radii: Sequence[Array],
        torque_lever: float = 0.05,
    ) -> None:
        self.mapped_hands, self.maps = HandInput.array(), VelocityMap.array()
        self._hands = SpaceHand.array(len(arms))
        first_axis = first_joint = 0
        for i, (hand, arm, radius) in enumerate(zip(config.hands, arms, radii, strict=True)):
            space = view_struct(self._hands, i)
            axes = [HAND_AXES.index(axis) for axis in hand.axes]
            space.first_axis, space.axes = first_axis, len(axes)
            for k, axis in enumerate(axes, first_axis):
                self.maps["lever"][0, k] = torque_lever if 3 <= axis < GRIP else 1.0
            space.axis[: len(axes)] = axes
            if hand.scales:
                space.scale[: len(axes)] = hand.scales
            if hand.dead_bands:
                space.dead_band[: len(axes)] = hand.dead_bands
            space.first_joint, space.joints = first_joint, len(radius)
            space.radius[: len(radius)] = radius
            space.stop_distance = hand.stop_distance
            for name, records in (
                ("arm", prepare_arm(arm)),
                ("inverse", build_inverse_settings(weigh_axes(hand))),
                ("settings", build_hand_map_settings(to_hand_map_config(hand, radius[-1]))),
                ("fixtures", build_fixtures(hand.fixtures)),
            ):
                self._hands[name][i] = records[0]
            first_axis, first_joint = first_axis + len(axes), first_joint + len(radius)
        self.axes, self.joints = first_axis, first_joint
        self.step(HandInput.array(), init_master(self.axes, 0, self.joints), 1.0, 1e-3)  # compiles

    def step(
        self, hands: StructArray, memories: StructArray, position_scale: float, dt: float
    ) -> None:
        """Map the hand of this tick, `dt` [s] after the last."""
        map_space(self._hands, memories, hands, position_scale, dt, self.mapped_hands, self.maps)
