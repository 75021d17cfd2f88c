"""The process that receives ROS commands: its own Zenoh session, apart from the master's loop.

  python -m master.devices.ros_receiver PIPE CONFIG

It checks every command and writes the newest accepted one to a pipe, at most every
`RECORD_INTERVAL_MIN_S`: no flood of messages reaches the loop, and an end or a stall of this
process is noticed there.
"""

import json
import math
import os
import queue
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from master.devices.commands import CommandRecord
from master.devices.ros_device import TWIST_AXES, RosDeviceConfig
from teleop.link.ros_session import find_router_problem
from teleop.ros.command_topics import SERVO_TOPICS, STATE_COMMAND
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    JOINT_STATE,
    POSE_STAMPED,
    STRING_STAMPED,
    TWIST_STAMPED,
    CdrError,
    decode,
)
from teleop.ros.node import RosNode
from teleop.ros.output_topics import build_topic_name
from teleop.runtime.process import StopCondition, die_with_parent, lower_priority

_TYPES = {"servo_jp": JOINT_STATE, "servo_cv": TWIST_STAMPED, "servo_cp": POSE_STAMPED}

# --- checks of the commands of a ROS node. Pure: time is an argument
# A node streams `servo_jp` (or `servo_cv`, `servo_cp`) and engages by `state_command`: `enable` (or
# `resume`), `disable` (or `pause`). Whatever is wrong with the stream is a fault with a name: no
# more motion, and the switch is open. It stays until the node sends `disable`; then `enable`
# engages again.


_WINDOW_NS = 100_000_000  # [ns] over which messages are counted
_BURST_S = 0.02  # [s] of motion that may arrive at once: one period at 50 Hz, the slowest stream
_DRIFT_DIVISOR = 1000  # inverse of the largest drift between the clocks of sender and receiver
_UNIT_TOLERANCE = 1e-3  # of the length of a quaternion
_ENABLE, _DISABLE = ("enable", "resume"), ("disable", "pause")


class ReceivedMessage(NamedTuple):
    """A message as received."""

    data: bytes
    publisher: bytes  # its global id
    sent_ns: int  # on the clock of its sender
    received_ns: int  # monotonic, here


@dataclass(slots=True)
class CommandStream:
    """State of the commands of ROS nodes.

    Attributes
    ----------
    engage : bool
        Whether the switch counts as closed.
    fault : str
        What is wrong; empty if nothing is.
    values : tuple of float
        Newest accepted positions [m] or velocities [m/s], one for each axis.
    received_ns : int
        When they were received; 0 = never.
    number : int
        Count of accepted commands.
    engagements : int
        How often the switch was closed.
    """

    config: RosDeviceConfig
    engage: bool = False
    fault: str = ""
    values: tuple[float, ...] = ()
    received_ns: int = 0
    number: int = 0
    engagements: int = 0
    _allowed_m: float = 0.0  # [m] by which the next command may differ
    _publisher: bytes = b""
    _least_ns: int = 0  # least delay of the publisher, with the offset of the clocks
    _window_ns: int = 0
    _count: int = 0

    def take_servo_commands(self, samples: list[ReceivedMessage]) -> None:
        """Take the commands since the last call, oldest first, as far as they are good."""
        if not samples:
            return
        self._count_messages(len(samples), samples[-1].received_ns)
        for sample in samples:
            self.step(sample.received_ns)  # the silence before it
            if self.fault:
                return
            self._accept(sample)

    def take_state_command(self, data: bytes, now_ns: int) -> None:
        """Take a command of state at `now_ns` [ns]."""
        try:
            word = decode(STRING_STAMPED, data).string
        except CdrError as error:
            self.engage, self.fault = False, f"ROS state_command: invalid message: {error}"
            return
        if word in _DISABLE:
            self.engage, self.fault = False, ""
            self._publisher, self.received_ns = b"", 0
        elif word not in _ENABLE:
            shown = "".join(c for c in word[:20] if c.isprintable())
            self.engage, self.fault = False, f"ROS state_command: unknown command {shown!r}"
        elif not self.fault:
            if self._is_silent(now_ns):
                self._fail("enabled without it; stream it first, then disable, then enable")
            else:
                self.engagements += not self.engage
                self.engage = True

    def step(self, now_ns: int) -> None:
        """Check for silence at `now_ns` [ns]."""
        if self.engage and self._is_silent(now_ns):
            self._fail(f"silent for {self.config.timeout:g} s")
        if not self.engage and self._is_silent(now_ns):
            self._publisher, self._least_ns = b"", 0  # another node may begin

    def _accept(self, sample: ReceivedMessage) -> None:
        """Take a command, or fail."""
        try:
            values = self._decode(sample.data)
        except CdrError as error:
            self._fail(f"invalid message: {error}")
            return
        fault = self._find_sender_fault(sample) or self._find_value_fault(
            values, sample.received_ns
        )
        if fault:
            self._fail(fault)
            return
        self.values, self.received_ns = values, sample.received_ns
        self.number += 1

    def _is_silent(self, now_ns: int) -> bool:
        return now_ns - self.received_ns > self.config.timeout * 1e9 or not self.received_ns

    def _fail(self, fault: str) -> None:
        self.engage, self.fault = False, f"ROS {self.config.command}: {fault}"
        self.values = ()

    def _count_messages(self, count: int, now_ns: int) -> None:
        if now_ns - self._window_ns > _WINDOW_NS:
            self._window_ns, self._count = now_ns, 0
        self._count += count
        if self._count > self.config.rate_max * _WINDOW_NS * 1e-9 and not self.fault:
            self._fail(f"flood of more than {self.config.rate_max:g} messages per second")

    def _decode(self, data: bytes) -> tuple[float, ...]:
        if self.config.command == "servo_jp":
            return tuple(decode(JOINT_STATE, data).position.tolist())
        if self.config.command == "servo_cp":
            return self._decode_pose(decode(POSE_STAMPED, data).pose)
        linear = decode(TWIST_STAMPED, data).twist.linear
        return (linear.x, linear.y, linear.z)[: self.config.axes]

    def _decode_pose(self, pose: Any) -> tuple[float, ...]:
        """Return x, y, z [m] and, nearest to the last ones, roll, pitch, yaw [rad] of a pose."""
        place, q = pose.position, pose.orientation
        values = (place.x, place.y, place.z)
        if self.config.axes == len(values):
            return values
        x, y, z, w = q.x, q.y, q.z, q.w
        if not abs(math.hypot(x, y, z, w) - 1.0) < _UNIT_TOLERANCE:
            raise CdrError("its orientation is no unit quaternion")
        angles = (
            math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
            math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0)),
            math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
        )
        before = self.values[len(values) :] or angles
        turns = (round((old - new) / math.tau) for old, new in zip(before, angles, strict=True))
        return (*values, *(new + math.tau * n for new, n in zip(angles, turns, strict=True)))

    def _find_sender_fault(self, sample: ReceivedMessage) -> str:
        """Return what is wrong with origin and delay of a sample; empty if nothing is."""
        late_s = self._compute_lateness_ns(sample) * 1e-9
        if sample.publisher != self._publisher:
            return "from two nodes at the same time"
        if late_s > self.config.timeout:
            return f"{late_s:.3f} s late (timeout {self.config.timeout:g} s)"
        return ""

    def _compute_lateness_ns(self, sample: ReceivedMessage) -> int:
        """Return the delay of a sample in excess of the least of its publisher."""
        delay = sample.received_ns - sample.sent_ns
        if not self._publisher:
            self._publisher, self._least_ns = sample.publisher, delay
        risen = self._least_ns + max(0, sample.received_ns - self.received_ns) // _DRIFT_DIVISOR
        self._least_ns = min(risen if self.received_ns else delay, delay)
        return delay - self._least_ns

    def _find_value_fault(self, values: tuple[float, ...], now_ns: int) -> str:
        """Return what is wrong with commanded values; empty if nothing is."""
        config = self.config
        if len(values) != config.axes:
            return f"{len(values)} joints, must be {config.axes}"
        for k, value in enumerate(values):
            if not math.isfinite(value):
                return f"joint {k + 1} is not finite"
        if config.command == "servo_cv":
            if max(map(abs, values)) > config.speed_max:
                return f"faster than {config.speed_max:g} m/s"
            return ""
        placed = values[:TWIST_AXES] if config.command == "servo_cp" else values
        if max(map(abs, placed)) > config.position_max:
            return f"beyond {config.position_max:g} m"
        return self._find_motion_fault(values, now_ns)

    def _find_motion_fault(self, values: tuple[float, ...], now_ns: int) -> str:
        """Return what is wrong with positions after the last ones; empty if nothing is.

        What may be moved grows with time at `speed_max`; what was not moved is kept for the length
        of a bunch, as messages that were sent one by one can arrive together.
        """
        speed_max = self.config.speed_max
        if not self.values or self._is_silent(now_ns):  # a stream begins
            self._allowed_m = speed_max * _BURST_S
            return ""
        passed_s = (now_ns - self.received_ns) * 1e-9
        most_m = speed_max * max(passed_s, _BURST_S)
        self._allowed_m = min(self._allowed_m + speed_max * passed_s, most_m)
        steps = [abs(a - b) for a, b in zip(values, self.values, strict=True)]
        first_angle = TWIST_AXES if self.config.command == "servo_cp" else len(values)
        ratio = speed_max / self.config.turn_speed_max  # [m/rad]
        moves = [step * ratio if k >= first_angle else step for k, step in enumerate(steps)]
        moved_m = max(moves)
        if moved_m > self._allowed_m:
            k = moves.index(moved_m)
            unit, limit = ("rad", "turn_speed_max") if k >= first_angle else ("m", "speed_max")
            return f"jump of {steps[k]:.3g} {unit} in {passed_s:.3g} s, faster than {limit}"
        self._allowed_m -= moved_m
        return ""


RECORD_INTERVAL_MIN_S = 0.002  # [s] least time between two records
RECORD_INTERVAL_MAX_S = 0.02  # [s] largest time between two records
_ROUTER_POLL_RECORDS = 25  # between two looks for the router
# messages that wait; more are dropped, and counted as far as that shows a flood
_QUEUE_LENGTH = 5000
NODE = "tendon_teleop_master"

Arrival = tuple[bool, ReceivedMessage]  # whether it is a motion command


def run(config: RosDeviceConfig, pipe: int) -> None:
    """Receive until told to end."""
    stop, arrivals = StopCondition(), queue.Queue[Arrival](_QUEUE_LENGTH)
    stream = CommandStream(config)
    while not stop() and (problem := find_router_problem(config.router)):
        for _ in range(_ROUTER_POLL_RECORDS):
            write_record(pipe, CommandStream(config, fault=problem))
            time.sleep(RECORD_INTERVAL_MAX_S)
    if stop():
        return

    def receive(motion: bool, data: bytes, publisher: bytes, sent_ns: int) -> None:
        with suppress(queue.Full):
            now = time.monotonic_ns()
            arrivals.put_nowait((motion, ReceivedMessage(data, publisher, sent_ns, now)))

    servo, message = SERVO_TOPICS[config.command], _TYPES[config.command]
    topic, state_topic = (build_topic_name(name, config.prefix) for name in (servo, STATE_COMMAND))
    with RosNode(config.router, config.domain, NODE) as node:
        node.subscribe(topic, message, Qos(BEST_EFFORT, 1), partial(receive, True))
        node.subscribe(state_topic, STRING_STAMPED, Qos(RELIABLE, 10), partial(receive, False))
        while not stop():
            process_messages(stream, collect_arrivals(arrivals))
            stream.step(time.monotonic_ns())
            write_record(pipe, stream)
            time.sleep(RECORD_INTERVAL_MIN_S)


def write_record(pipe: int, stream: CommandStream) -> None:
    """Write the state of the commands."""
    record = CommandRecord(
        written_ns=time.monotonic_ns(),
        received_ns=stream.received_ns,
        number=stream.number,
        engagement=stream.engagements if stream.engage else 0,
        fault=stream.fault,
        values=stream.values,
    )
    with suppress(BlockingIOError):  # the loop is held up: it reads the older ones first
        os.write(pipe, record.pack())


def collect_arrivals(arrivals: "queue.Queue[Arrival]") -> list[Arrival]:
    """Return the messages that have arrived, after a wait of at most `RECORD_INTERVAL_MAX_S`."""
    found: list[Arrival] = []
    with suppress(queue.Empty):
        found.append(arrivals.get(timeout=RECORD_INTERVAL_MAX_S))
        while len(found) < _QUEUE_LENGTH:
            found.append(arrivals.get_nowait())
    return found


def process_messages(stream: CommandStream, arrivals: list[Arrival]) -> None:
    """Take messages in their order."""
    motion: list[ReceivedMessage] = []
    for is_motion, sample in arrivals:
        if is_motion:
            motion.append(sample)
            continue
        stream.take_servo_commands(motion)
        motion = []
        stream.take_state_command(sample.data, time.monotonic_ns())
    stream.take_servo_commands(motion)


def main(pipe: str, config: str, parent: str) -> None:
    """Run with the arguments of the command line."""
    die_with_parent(int(parent))
    lower_priority()
    os.set_blocking(int(pipe), False)
    with suppress(BrokenPipeError):
        run(RosDeviceConfig(**json.loads(config)), int(pipe))


if __name__ == "__main__":
    main(*sys.argv[1:])
