"""What ROS nodes are shown: topics under CRTK names, from messages of the link. Pure.

Names and meaning of the topics are those of the Collaborative Robotics Toolkit
(crtk-robotics.readthedocs.io). Stamps are those of the senders. `slave/state` and `slave/tendons`
are the messages of the link, byte for byte, with the certified intervals.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from teleop.messages.messages import MAX_JOINTS, Command, Hand, Message, SlaveState, TendonState
from teleop.messages.topics import COMMAND, HAND, REPORT, SHEATH, STATE, TENDONS, Topic
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    DIAGNOSTIC_ARRAY,
    JOINT_STATE,
    OPERATING_STATE,
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

    def topic(self, prefix: str) -> str:
        """Return the full name of the topic."""
        return build_topic_name(self.name, prefix)


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


def to_slave_measured(state: SlaveState, _: NamingContext) -> Iterator[Sample]:
    """Estimated tip travel [m] and distal force [N], positive against pulling."""
    n = _count_joints(state)
    names, position, effort = build_joint_names(n), state.position[:n], state.force[:n]
    message = build_joint_state(build_header(state.stamp_ns), names, position, effort=effort)
    yield Sample("slave/measured_js", message)


def to_slave_setpoint(command: Command, naming: NamingContext) -> Iterator[Sample]:
    """Commanded tip travel [m] and velocity [m/s]; a command does not say of how many joints."""
    n = naming.joints
    position, velocity = command.position[:n], command.velocity[:n]
    header = build_header(command.stamp_ns)
    message = build_joint_state(header, build_joint_names(n), position, velocity)
    yield Sample("slave/setpoint_js", message)


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
    """Estimated force at each tip [N] along x of its frame, which points away from the housing."""
    for k in range(_count_joints(state)):
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


def to_slave_operating_state(state: SlaveState, _: NamingContext) -> Iterator[Sample]:
    """CRTK's state of the slave."""
    yield Sample("slave/operating_state", _build_operating_state(state, state.state))


def to_master_operating_state(command: Command, _: NamingContext) -> Iterator[Sample]:
    """CRTK's state of the master."""
    yield Sample("master/operating_state", _build_operating_state(command, command.state))


def _build_operating_state(message: Message, number: int) -> Any:
    state = State(number)
    busy = state in (State.ENGAGED, State.CLUTCHED, State.HOLDING)
    return build_message(
        OPERATING_STATE,
        header=build_header(message.stamp_ns),
        state=_OPERATING_NAMES[state],
        is_homed=state is not State.OFF,
        is_busy=busy,
    )


OUTPUTS: tuple[OutputTopic, ...] = (
    OutputTopic("slave/measured_js", JOINT_STATE, STATE, LIVE, to_slave_measured),
    OutputTopic("slave/setpoint_js", JOINT_STATE, COMMAND, LIVE, to_slave_setpoint),
    OutputTopic("slave/actuators/measured_js", JOINT_STATE, TENDONS, LIVE, to_actuators_measured),
    OutputTopic("slave/actuators/setpoint_js", JOINT_STATE, TENDONS, LIVE, to_actuators_setpoint),
    OutputTopic("slave/measured_cf", WRENCH_STAMPED, STATE, LIVE, to_slave_force),
    OutputTopic("slave/operating_state", OPERATING_STATE, STATE, EVENTS, to_slave_operating_state),
    OutputTopic("slave/state", to_type_name(SlaveState), STATE),
    OutputTopic("slave/tendons", to_type_name(TendonState), TENDONS),
    OutputTopic("master/measured_js", JOINT_STATE, HAND, LIVE, to_master_measured),
    OutputTopic("master/setpoint_js", JOINT_STATE, HAND, LIVE, to_master_setpoint),
    OutputTopic(
        "master/operating_state", OPERATING_STATE, COMMAND, EVENTS, to_master_operating_state
    ),
    OutputTopic("/diagnostics", DIAGNOSTIC_ARRAY, REPORT, EVENTS),
    OutputTopic("/tf", TF_MESSAGE, SHEATH, EVENTS),
)
