"""What ROS nodes are shown: topics under CRTK names, from messages of the link. Pure.

Names and meaning of the topics are those of the Collaborative Robotics Toolkit
(crtk-robotics.readthedocs.io). Stamps are those of the senders. `slave/state` and `slave/tendons`
are the messages of the link, byte for byte, with the certified intervals.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from teleop.messages.messages import MAX_JOINTS, Command, Hand, SlaveState, TendonState
from teleop.messages.topics import COMMAND, HAND, REPORT, SHEATH, STATE, TENDONS, Topic
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    DIAGNOSTIC_ARRAY,
    JOINT_STATE,
    OPERATING_STATE,
    POSE_STAMPED,
    TF_MESSAGE,
    VECTOR3,
    WRENCH,
    WRENCH_STAMPED,
    build_header,
    build_joint_state,
    build_message,
    to_type_name,
)
from teleop.session.state_machine import State

if TYPE_CHECKING:
    from estimator.array_types import Array
    from teleop.ros.arms import RosArm

LIVE, EVENTS = Qos(BEST_EFFORT, 1), Qos(RELIABLE, 10)

# CRTK's states; the emergency stop is latched, as a fault is
_OPERATING_NAMES = {
    State.OFF: "DISABLED",
    State.READY: "ENABLED",
    State.ENGAGED: "ENABLED",
    State.CLUTCHED: "PAUSED",
    State.HOLDING: "PAUSED",
    State.FAULT: "FAULT",
    State.STOPPED: "FAULT",
}


@dataclass(frozen=True, slots=True)
class Sample:
    """One message for a topic below the prefix."""

    name: str  # such as slave/measured_js
    message: Any  # as `teleop.ros.message_types` builds it


@dataclass(frozen=True, slots=True)
class NamingContext:
    """What conversions know beside their message."""

    prefix: str = ""  # of frames
    joints: int = MAX_JOINTS  # of the slave, as far as known
    arms: "tuple[RosArm, ...]" = ()

    def describe_joints(self, count: int) -> "tuple[list[str], Array]":
        """Return the names of the slave's joints, and their travel over what ROS has of them.

        That is the angle [rad] of a joint of an arm, the travel [m] of others.
        """
        names, levers = list(build_joint_names(count)), np.ones(count)
        for arm in self.arms:
            for k, name, radius in zip(arm.space.joints, arm.joints, arm.space.radius, strict=True):
                if k < count:
                    names[k], levers[k] = name, radius
        return names, levers


@dataclass(frozen=True, slots=True)
class OutputTopic:
    """One line of the table: a topic, its type, and what it is made from.

    `name` is below the prefix unless it begins with a slash. `convert` takes a message of `source`;
    None = made elsewhere (`teleop.ros.frames`), or the message as it is.
    """

    name: str
    type: str  # such as sensor_msgs/msg/JointState
    source: Topic[Any]
    qos: Qos = LIVE
    convert: Callable[[Any, NamingContext], Iterator[Sample]] | None = None
    is_of_arms: bool = False  # only where there are arms with kinematics


def build_topic_name(name: str, prefix: str) -> str:
    """Return the full name of a topic below a prefix."""
    return name if name.startswith("/") else f"{prefix}/{name}"


def build_frame_name(prefix: str, name: str) -> str:
    """Return the name of a frame, which in tf has no leading slash."""
    return f"{prefix}/{name}".lstrip("/")


def build_joint_names(count: int) -> tuple[str, ...]:
    """Return the names of joints, counted from 1 as everywhere else."""
    return tuple(f"joint_{k + 1}" for k in range(count))


def build_tendon_names(count: int) -> tuple[str, ...]:
    """Return the names of tendons, numbered as in the columns of a table."""
    return tuple(f"tendon_{k + 1}" for k in range(count))


def _count_joints(message: SlaveState | Hand) -> int:
    return min(message.joints, len(message.position))


def to_slave_measured(state: SlaveState, naming: NamingContext) -> Iterator[Sample]:
    """Estimated tip travel [m] and distal force [N], positive against pulling; of arms joints."""
    n = _count_joints(state)
    names, lever = naming.describe_joints(n)
    position, effort = np.array(state.position[:n]) / lever, np.array(state.force[:n]) * lever
    message = build_joint_state(build_header(state.stamp_ns), names, position, effort=effort)
    yield Sample("slave/measured_js", message)


def to_slave_setpoint(command: Command, naming: NamingContext) -> Iterator[Sample]:
    """Commanded tip travel [m] and velocity [m/s]; a command does not say of how many joints."""
    n = naming.joints
    names, lever = naming.describe_joints(n)
    position, velocity = (np.array(of[:n]) / lever for of in (command.position, command.velocity))
    message = build_joint_state(build_header(command.stamp_ns), names, position, velocity)
    yield Sample("slave/setpoint_js", message)


def to_tip_poses(
    name: str, message: SlaveState | Command, naming: NamingContext
) -> Iterator[Sample]:
    """Estimated or commanded pose of each arm's tip in the frame of its base."""
    for number, arm in enumerate(naming.arms, 1):
        pose = arm.build_tip_pose(message.position, message.stamp_ns, naming.prefix)
        if pose is not None:
            yield Sample(_build_arm_name(number, name), pose)


def _build_arm_name(number: int, name: str) -> str:
    return f"slave/{name}" if number == 1 else f"slave/arm_{number}/{name}"


def build_arm_frames(state: SlaveState, naming: NamingContext) -> Any | None:
    """Return the frames of all arms as a TFMessage; None if there are none."""
    transforms = [
        transform
        for arm in naming.arms
        for transform in arm.build_transforms(state.position, state.stamp_ns, naming.prefix)
    ]
    return build_message(TF_MESSAGE, transforms=transforms) if transforms else None


def to_actuators_measured(state: TendonState, _: NamingContext) -> Iterator[Sample]:
    """Travel [m] and tension [N] of the tendons at the housing, as measured."""
    n = min(state.tendons, len(state.proximal_tension))
    position, effort = state.proximal_displacement[:n], state.proximal_tension[:n]
    header = build_header(state.stamp_ns)
    message = build_joint_state(header, build_tendon_names(n), position, effort=effort)
    yield Sample("slave/actuators/measured_js", message)


def to_actuators_setpoint(state: TendonState, _: NamingContext) -> Iterator[Sample]:
    """Commanded travel of the motors [m], NaN before the first engagement."""
    n = min(state.tendons, len(state.commanded_displacement))
    position = state.commanded_displacement[:n]
    message = build_joint_state(build_header(state.stamp_ns), build_tendon_names(n), position)
    yield Sample("slave/actuators/setpoint_js", message)


def to_slave_force(state: SlaveState, naming: NamingContext) -> Iterator[Sample]:
    """Estimated force at each tip [N]: on that of an arm, in its frame.

    Of a joint of its own along x of its frame, which points away from the housing.
    """
    moved: set[int] = set()
    for number, arm in enumerate(naming.arms, 1):
        moved |= {*arm.space.joints[: arm.space.coordinates]}
        wrench = arm.build_tip_force(state, naming.prefix)
        if wrench is not None:
            yield Sample(_build_arm_name(number, "measured_cf"), wrench)
    for k in range(_count_joints(state)):
        if k in moved:
            continue
        name = "slave/measured_cf" if k == 0 else f"slave/joint_{k + 1}/measured_cf"
        header = build_header(state.stamp_ns, build_frame_name(naming.prefix, f"tip_{k + 1}"))
        wrench = build_message(WRENCH, force=build_message(VECTOR3, x=state.force[k]))
        yield Sample(name, build_message(WRENCH_STAMPED, header=header, wrench=wrench))


def to_master_measured(hand: Hand, _: NamingContext) -> Iterator[Sample]:
    """Position [m] and velocity [m/s] of the device; its force is not measured."""
    n = _count_joints(hand)
    position, velocity = hand.position[:n], hand.velocity[:n]
    header = build_header(hand.stamp_ns)
    message = build_joint_state(header, build_joint_names(n), position, velocity)
    yield Sample("master/measured_js", message)


def to_master_setpoint(hand: Hand, _: NamingContext) -> Iterator[Sample]:
    """Force [N] that the gate let through to the device; it is moved by nothing else."""
    n = _count_joints(hand)
    header, names = build_header(hand.stamp_ns), build_joint_names(n)
    yield Sample("master/setpoint_js", build_joint_state(header, names, effort=hand.force[:n]))


def to_operating_state(
    name: str, message: SlaveState | Command, _: NamingContext
) -> Iterator[Sample]:
    """CRTK's state of a side."""
    state = State(message.state)
    operating = build_message(
        OPERATING_STATE,
        header=build_header(message.stamp_ns),
        state=_OPERATING_NAMES[state],
        is_homed=state is not State.OFF,
        is_busy=state in (State.ENGAGED, State.CLUTCHED, State.HOLDING),
    )
    yield Sample(name, operating)


def _build_pose_topic(name: str, source: Topic[Any]) -> OutputTopic:
    convert = partial(to_tip_poses, name)
    return OutputTopic(f"slave/{name}", POSE_STAMPED, source, LIVE, convert, is_of_arms=True)


def _build_state_topic(name: str, source: Topic[Any]) -> OutputTopic:
    return OutputTopic(name, OPERATING_STATE, source, EVENTS, partial(to_operating_state, name))


OUTPUTS: tuple[OutputTopic, ...] = (
    OutputTopic("slave/measured_js", JOINT_STATE, STATE, LIVE, to_slave_measured),
    OutputTopic("slave/setpoint_js", JOINT_STATE, COMMAND, LIVE, to_slave_setpoint),
    OutputTopic("slave/actuators/measured_js", JOINT_STATE, TENDONS, LIVE, to_actuators_measured),
    OutputTopic("slave/actuators/setpoint_js", JOINT_STATE, TENDONS, LIVE, to_actuators_setpoint),
    OutputTopic("slave/measured_cf", WRENCH_STAMPED, STATE, LIVE, to_slave_force),
    _build_pose_topic("measured_cp", STATE),
    _build_pose_topic("setpoint_cp", COMMAND),
    _build_state_topic("slave/operating_state", STATE),
    OutputTopic("slave/state", to_type_name(SlaveState), STATE),
    OutputTopic("slave/tendons", to_type_name(TendonState), TENDONS),
    OutputTopic("master/measured_js", JOINT_STATE, HAND, LIVE, to_master_measured),
    OutputTopic("master/setpoint_js", JOINT_STATE, HAND, LIVE, to_master_setpoint),
    _build_state_topic("master/operating_state", COMMAND),
    OutputTopic("/diagnostics", DIAGNOSTIC_ARRAY, REPORT, EVENTS),
    OutputTopic("/tf", TF_MESSAGE, SHEATH, EVENTS),
)
