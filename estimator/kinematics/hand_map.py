"""From the hand to the arm: clutch, scale, registration, locks, and the force back.

A device has up to seven axes: translation, rotation, grip. The hand's velocity h, shape (7,), is
taken from two successive poses in the frame of the device. Of a tick, the tip's twist is B h, with

    B = diag(scale_t R, scale_r R) lock,

R the registration: the rotation from the frame of the device to that of the base, or of the camera.
With the velocity map J# of `inverse.step_inverse` the joints move by dq/dt = T h, T = J# B, and the
force in the hand is T^T tau: by the matrix of that very tick, so that hand and joints have the same
power, whatever is changed between ticks. While not engaged T is zero.

The pose that the tip should have, the target, starts at the tip when engaging, so nothing jumps.
It follows the hand, and the difference to the tip is the error that `step_inverse` corrects while
the hand moves. With `align_orientation` the target's orientation is that of the hand itself: a
difference at engagement vanishes little by little, without a jump.
"""

import math
from dataclasses import dataclass
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import MAX_COORDINATES, ArmError, PreparedArm
from estimator.kinematics.inverse import InverseStep, Twist
from estimator.kinematics.rotations import (
    Quaternion,
    compute_rotation_between,
    from_rotation_matrix,
    make_canonical,
    multiply,
    to_quaternion,
    to_rotation_matrix,
)
from estimator.structs import F64, Field, Flag, Struct, StructArray, view_struct

AXES = 7
"""Axes of a hand: translation, rotation, grip."""

MAX_ROWS = MAX_COORDINATES + 1
"""Rows of a joint map: the arm's coordinates, and behind them the jaw that the grip moves."""

GRIP = 6  # the axis


@dataclass(frozen=True, slots=True)
class HandMapConfig:
    """How hand motion becomes motion of the tip."""

    translation_scale: float = 0.25  # of the tip per that of the hand
    rotation_scale: float = 1.0
    registration: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # device to base, xyzw
    lock: tuple[int, ...] = ()  # axes of the hand, 0 to 6, that move nothing
    align_orientation: bool = False  # the tip turns until it has the hand's orientation
    error_max: float = 0.02  # [m] between target and tip; a target further off is drawn along
    angle_error_max: float = 0.3  # [rad]
    grip_scale: float = 1.0  # jaw per grip, in their units
    jaw_limits: tuple[float, float] = (-math.inf, math.inf)  # [rad] or [m]

    def __post_init__(self) -> None:
        """Check the values; raises `ArmError`."""
        for name, upper_bound in (("translation_scale", 10.0), ("rotation_scale", 10.0)):
            if not 0.0 < getattr(self, name) <= upper_bound:
                raise ArmError(
                    f"{name}: {getattr(self, name)}, must be above 0 and at most {upper_bound}"
                )
        if not math.isfinite(self.grip_scale):
            raise ArmError(f"grip_scale: {self.grip_scale}, must be finite")
        length = math.hypot(*self.registration)
        if len(self.registration) != 4 or not abs(length - 1.0) < 1e-3:
            raise ArmError(
                f"registration: {self.registration}, must be a unit quaternion (x, y, z, w)"
            )
        if not all(0 <= axis < AXES for axis in self.lock):
            raise ArmError(f"lock: {self.lock}, axes are 0 to {AXES - 1}")
        if self.align_orientation and (self.rotation_scale != 1.0 or {3, 4, 5} & set(self.lock)):
            raise ArmError(
                "align_orientation: needs rotation_scale 1 and no locked rotation; turn it off"
            )
        for name in ("error_max", "angle_error_max"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArmError(f"{name}: {getattr(self, name)}, must be positive and finite")
        if not self.jaw_limits[0] < self.jaw_limits[1]:
            raise ArmError(f"jaw_limits: {self.jaw_limits}, must rise")


class HandMapSettings(Struct):
    """A `HandMapConfig` as a record."""

    scale: Annotated[Array, Field("f8", AXES)]  # of each axis, 0 where it is locked
    registration: Annotated[Array, Field("f8", 4)]
    align_orientation: Flag
    error_max: F64
    angle_error_max: F64
    jaw_low: F64
    jaw_high: F64


def build_hand_map_settings(config: HandMapConfig) -> StructArray:
    """Return the record of a config as an array of one."""
    records = HandMapSettings.array()
    settings: HandMapSettings = view_struct(records)
    settings.scale[:3], settings.scale[3:6] = config.translation_scale, config.rotation_scale
    settings.scale[GRIP] = config.grip_scale
    settings.scale[list(config.lock)] = 0.0
    settings.registration[:] = config.registration
    settings.align_orientation = config.align_orientation
    settings.error_max, settings.angle_error_max = config.error_max, config.angle_error_max
    settings.jaw_low, settings.jaw_high = config.jaw_limits
    return records


class HandPose(Struct):
    """Where the hand is, in the frame of the device; axes that a device has not are constant."""

    position: Annotated[Array, Field("f8", 3)]  # [m]
    orientation: Annotated[Array, Field("f8", 4)]  # unit quaternion x, y, z, w
    grip: F64  # [rad] or [m]


class HandMap(Struct):
    """State between ticks, and what a tick gives."""

    engaged: Flag = False
    hand_position: Annotated[Array, Field("f8", 3)]  # of the last tick
    hand_orientation: Annotated[Array, Field("f8", 4)]
    grip: F64
    target_position: Annotated[Array, Field("f8", 3)]  # [m] in the frame of the base
    target_orientation: Annotated[Array, Field("f8", 4)]

    velocity: Annotated[Array, Field("f8", AXES)]  # h: of the hand, in the frame of the device
    hand_matrix: Annotated[Array, Field("f8", (6, AXES))]  # B
    twist: Twist  # B h
    error: Twist  # of the tip's pose, target less tip [m], [rad]
    grip_gain: F64  # jaw per grip
    joint_map: Annotated[Array, Field("f8", (MAX_ROWS, AXES))]  # T
    joint_velocity: Annotated[Array, Field("f8", MAX_ROWS)]  # T h


@jit_compile
def step_hand_map(
    settings: HandMapSettings,
    hand: HandPose,
    engaged: bool,
    pose: Array,
    jaw: float,
    dt: float,
    state: HandMap,
) -> None:
    """Write the twist that the hand asks of the tip and the error of its pose, for one tick.

    Parameters
    ----------
    hand : HandPose
        Newest pose; one that is not finite disengages.
    engaged : bool
        Whether the hand moves the tip in this tick; false while it is clutched out.
    pose : array, shape (4, 4)
        Of the tip at the beginning of the tick.
    jaw : float
        Coordinate of the jaw at the beginning of the tick; any where there is none.
    dt : float
        Length of the tick [s], positive.
    state : HandMap
        Changed in place: all but `joint_map` and `joint_velocity`, which `write_joint_map` adds.
    """
    engaged = engaged and _is_valid(hand)
    coupled = engaged and state.engaged  # of the first tick, only the pose is known
    for row in range(6):
        state.error[row] = 0.0
    if coupled:
        _write_error(settings, pose, state)
    _write_velocity(hand, state, coupled, dt)
    _write_hand_matrix(settings, state, coupled)
    for row in range(6):
        state.twist[row] = 0.0
        for axis in range(6):
            state.twist[row] += state.hand_matrix[row, axis] * state.velocity[axis]
    state.grip_gain = settings.scale[GRIP] if coupled else 0.0
    travel = state.grip_gain * state.velocity[GRIP] * dt
    if (travel > 0.0 and jaw + travel > settings.jaw_high) or (
        travel < 0.0 and jaw + travel < settings.jaw_low
    ):
        state.grip_gain = 0.0
    if coupled:
        _move_target(state, dt)
    elif engaged:
        _set_target(pose, state)
    state.engaged = engaged


@jit_compile
def write_joint_map(arm: PreparedArm, step: InverseStep, state: HandMap) -> None:
    """Write T = J# B and the velocities T h of the arm's coordinates, and in row n of the jaw."""
    n = arm.coordinates
    for j in range(MAX_ROWS):
        state.joint_velocity[j] = 0.0
        for axis in range(AXES):
            total = 0.0
            if j < n:
                for row in range(6):
                    total += step.velocity_map[j, row] * state.hand_matrix[row, axis]
            elif j == n and axis == GRIP:
                total = state.grip_gain
            state.joint_map[j, axis] = total
            state.joint_velocity[j] += total * state.velocity[axis]


@jit_compile
def _is_valid(hand: HandPose) -> bool:
    """Return whether a pose is finite, with an orientation."""
    total = hand.grip
    length = 0.0
    for k in range(3):
        total += hand.position[k]
    for k in range(4):
        length += hand.orientation[k] * hand.orientation[k]
    return math.isfinite(total) and 0.25 < length < 4.0


@jit_compile
def _to_tuple(q: Array) -> Quaternion:
    return q[0], q[1], q[2], q[3]


@jit_compile
def _write_velocity(hand: HandPose, state: HandMap, coupled: bool, dt: float) -> None:
    """Write the hand's velocity since the last tick, zero if not coupled; remember its pose."""
    orientation = make_canonical(_to_tuple(hand.orientation))
    turn = compute_rotation_between(make_canonical(_to_tuple(state.hand_orientation)), orientation)
    for k in range(3):
        state.velocity[k] = (hand.position[k] - state.hand_position[k]) / dt
        state.velocity[3 + k] = turn[k] / dt
        state.hand_position[k] = hand.position[k]
    for k in range(4):
        state.hand_orientation[k] = orientation[k]
    state.velocity[GRIP] = (hand.grip - state.grip) / dt
    state.grip = hand.grip
    if not coupled:
        for axis in range(AXES):
            state.velocity[axis] = 0.0


@jit_compile
def _write_hand_matrix(settings: HandMapSettings, state: HandMap, coupled: bool) -> None:
    """Write B, zero if not coupled."""
    matrix = state.hand_matrix
    for row in range(6):
        for axis in range(AXES):
            matrix[row, axis] = 0.0
    if not coupled:
        return
    to_rotation_matrix(make_canonical(_to_tuple(settings.registration)), matrix)
    for row in range(3):
        for axis in range(3):
            rotation = matrix[row, axis]
            matrix[row, axis] = rotation * settings.scale[axis]
            matrix[3 + row, 3 + axis] = rotation * settings.scale[3 + axis]


@jit_compile
def _set_target(pose: Array, state: HandMap) -> None:
    """Start the target at the tip."""
    orientation = from_rotation_matrix(pose)
    for k in range(3):
        state.target_position[k] = pose[k, 3]
    for k in range(4):
        state.target_orientation[k] = orientation[k]


@jit_compile
def _write_error(settings: HandMapSettings, pose: Array, state: HandMap) -> None:
    """Write the error of the tip's pose before the hand's motion of this tick.

    A target that is too far away is drawn along.
    """
    tip = from_rotation_matrix(pose)
    if settings.align_orientation:
        registration = make_canonical(_to_tuple(settings.registration))
        aligned = multiply(registration, _to_tuple(state.hand_orientation))
        for k in range(4):
            state.target_orientation[k] = aligned[k]
    error = compute_rotation_between(tip, _to_tuple(state.target_orientation))
    distance, angle = 0.0, 0.0
    for k in range(3):
        state.error[k] = state.target_position[k] - pose[k, 3]
        state.error[3 + k] = error[k]
        distance += state.error[k] * state.error[k]
        angle += error[k] * error[k]
    distance, angle = math.sqrt(distance), math.sqrt(angle)
    if distance > settings.error_max:
        for k in range(3):
            state.error[k] *= settings.error_max / distance
            state.target_position[k] = pose[k, 3] + state.error[k]
    if angle > settings.angle_error_max:
        ratio = settings.angle_error_max / angle
        for k in range(3, 6):
            state.error[k] *= ratio
        turn = to_quaternion(ratio * error[0], ratio * error[1], ratio * error[2])
        drawn = multiply(turn, tip)
        for k in range(4):
            state.target_orientation[k] = drawn[k]


@jit_compile
def _move_target(state: HandMap, dt: float) -> None:
    """Move the target by the twist."""
    twist = state.twist
    for k in range(3):
        state.target_position[k] += twist[k] * dt
    turn = to_quaternion(twist[3] * dt, twist[4] * dt, twist[5] * dt)
    moved = make_canonical(multiply(turn, _to_tuple(state.target_orientation)))
    for k in range(4):
        state.target_orientation[k] = moved[k]
