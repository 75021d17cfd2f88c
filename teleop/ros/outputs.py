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
from teleop.ros.standard import (
    DiagnosticArray,
    Header,
    JointState,
    OperatingState,
    TFMessage,
    Time,
    Vector3,
    Wrench,
    WrenchStamped,
)
from teleop.session.state_machine import State

LIVE, EVENTS = Qos(BEST_EFFORT, 1), Qos(RELIABLE, 10)

# CRTK's states; the emergency stop is latched, as a fault is
_OPERATING = {
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
    message: Any  # of a declared type


@dataclass(frozen=True, slots=True)
class Naming:
    """What conversions know beside their message."""

    prefix: str = ""  # of frames
    joints: int = MAX_JOINTS  # of the slave, as far as known


@dataclass(frozen=True, slots=True)
class Output:
    """One line of the table: a topic, its type, and what it is made from.

    `name` is below the prefix unless it begins with a slash. `convert` takes a message of `source`;
    None = made elsewhere (`teleop.ros.reports`, `teleop.ros.frames`), or
    the message as it is.
    """

    name: str
    type: type[Any]
    source: Topic[Any]
    qos: Qos = LIVE
    convert: Callable[[Any, Naming], Iterator[Sample]] | None = None

    def topic(self, prefix: str) -> str:
        """Return the full name of the topic."""
        return full_name(self.name, prefix)


def full_name(name: str, prefix: str) -> str:
    """Return the full name of a topic below a prefix."""
    return name if name.startswith("/") else f"{prefix}/{name}"


def frame(prefix: str, name: str) -> str:
    """Return the name of a frame, which in tf has no leading slash."""
    return f"{prefix}/{name}".lstrip("/")


def joint_names(count: int) -> tuple[str, ...]:
    """Return the names of joints, counted from 1 as everywhere else."""
    return tuple(f"joint_{k + 1}" for k in range(count))


def tendon_names(count: int) -> tuple[str, ...]:
    """Return the names of tendons, numbered as in the columns of a table."""
    return tuple(f"tendon_{k + 1}" for k in range(count))


def _header(message: Message, frame_id: str = "") -> Header:
    return Header(Time.of(message.stamp_ns), frame_id)


def _count(message: SlaveState | Hand) -> int:
    return min(message.joints, len(message.position))


def slave_measured(state: SlaveState, _: Naming) -> Iterator[Sample]:
    """Estimated tip travel [m] and distal force [N], positive against pulling."""
    n = _count(state)
    names, position, effort = joint_names(n), state.position[:n], state.force[:n]
    message = JointState(_header(state), names, position, effort=effort)
    yield Sample("slave/measured_js", message)


def slave_setpoint(command: Command, naming: Naming) -> Iterator[Sample]:
    """Commanded tip travel [m] and velocity [m/s]; a command does not say of how many joints."""
    n = naming.joints
    position, velocity = command.position[:n], command.velocity[:n]
    message = JointState(_header(command), joint_names(n), position, velocity)
    yield Sample("slave/setpoint_js", message)


def actuators_measured(state: TendonState, _: Naming) -> Iterator[Sample]:
    """Travel [m] and tension [N] of the tendons at the housing, as measured."""
    n = min(state.tendons, len(state.proximal_tension))
    position, effort = state.proximal_displacement[:n], state.proximal_tension[:n]
    message = JointState(_header(state), tendon_names(n), position, effort=effort)
    yield Sample("slave/actuators/measured_js", message)


def actuators_setpoint(state: TendonState, _: Naming) -> Iterator[Sample]:
    """Commanded travel of the motors [m], NaN before the first engagement."""
    n = min(state.tendons, len(state.commanded_displacement))
    message = JointState(_header(state), tendon_names(n), state.commanded_displacement[:n])
    yield Sample("slave/actuators/setpoint_js", message)


def slave_force(state: SlaveState, naming: Naming) -> Iterator[Sample]:
    """Estimated force at each tip [N] along x of its frame, which points away from the housing."""
    for k in range(_count(state)):
        name = "slave/measured_cf" if k == 0 else f"slave/joint_{k + 1}/measured_cf"
        wrench = Wrench(Vector3(x=state.force[k]))
        yield Sample(
            name, WrenchStamped(_header(state, frame(naming.prefix, f"tip_{k + 1}")), wrench)
        )


def master_measured(hand: Hand, _: Naming) -> Iterator[Sample]:
    """Position [m] and velocity [m/s] of the device; its force is not measured."""
    n = _count(hand)
    message = JointState(_header(hand), joint_names(n), hand.position[:n], hand.velocity[:n])
    yield Sample("master/measured_js", message)


def master_setpoint(hand: Hand, _: Naming) -> Iterator[Sample]:
    """Force [N] that the gate let through to the device; it is moved by nothing else."""
    n = _count(hand)
    yield Sample(
        "master/setpoint_js", JointState(_header(hand), joint_names(n), effort=hand.force[:n])
    )


def slave_operating_state(state: SlaveState, _: Naming) -> Iterator[Sample]:
    """CRTK's state of the slave."""
    yield Sample("slave/operating_state", _operating(state, state.state))


def master_operating_state(command: Command, _: Naming) -> Iterator[Sample]:
    """CRTK's state of the master."""
    yield Sample("master/operating_state", _operating(command, command.state))


def _operating(message: Message, number: int) -> OperatingState:
    state = State(number)
    busy = state in (State.ENGAGED, State.CLUTCHED, State.HOLDING)
    return OperatingState(_header(message), _OPERATING[state], state is not State.OFF, busy)


OUTPUTS: tuple[Output, ...] = (
    Output("slave/measured_js", JointState, STATE, LIVE, slave_measured),
    Output("slave/setpoint_js", JointState, COMMAND, LIVE, slave_setpoint),
    Output("slave/actuators/measured_js", JointState, TENDONS, LIVE, actuators_measured),
    Output("slave/actuators/setpoint_js", JointState, TENDONS, LIVE, actuators_setpoint),
    Output("slave/measured_cf", WrenchStamped, STATE, LIVE, slave_force),
    Output("slave/operating_state", OperatingState, STATE, EVENTS, slave_operating_state),
    Output("slave/state", SlaveState, STATE),
    Output("slave/tendons", TendonState, TENDONS),
    Output("master/measured_js", JointState, HAND, LIVE, master_measured),
    Output("master/setpoint_js", JointState, HAND, LIVE, master_setpoint),
    Output("master/operating_state", OperatingState, COMMAND, EVENTS, master_operating_state),
    Output("/diagnostics", DiagnosticArray, REPORT, EVENTS),
    Output("/tf", TFMessage, SHEATH, EVENTS),
)
