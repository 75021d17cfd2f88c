"""The process that receives ROS commands: its own Zenoh session, apart from the master's loop.

  python -m master.devices.ros.receiver PIPE CONFIG

It checks every command and writes the newest accepted one to a pipe, at most every
`RECORD_INTERVAL_MIN_S`: no flood of messages reaches the loop, and an end or a stall of this
process is noticed there.
"""

import json
import os
import queue
import sys
import time
from contextlib import suppress
from functools import partial

from master.devices.ros.config import RosDeviceConfig
from master.devices.ros.motion import CommandRecord
from master.devices.ros.stream import CommandStream, ReceivedMessage
from teleop.link.ros_session import is_router_listening
from teleop.ros.command_topics import SERVO_CV, SERVO_JP, STATE_COMMAND
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import JOINT_STATE, STRING_STAMPED, TWIST_STAMPED
from teleop.ros.node import RosNode
from teleop.ros.outputs import build_topic_name
from teleop.runtime.process import StopCondition, die_with_parent, lower_priority

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
    while not stop() and not is_router_listening(config.router):
        for _ in range(_ROUTER_POLL_RECORDS):
            write_record(pipe, stream)
            time.sleep(RECORD_INTERVAL_MAX_S)
    if stop():
        return

    def receive(motion: bool, data: bytes, publisher: bytes, sent_ns: int) -> None:
        with suppress(queue.Full):
            now = time.monotonic_ns()
            arrivals.put_nowait((motion, ReceivedMessage(data, publisher, sent_ns, now)))

    servo = SERVO_JP if config.command == "servo_jp" else SERVO_CV
    message = JOINT_STATE if config.command == "servo_jp" else TWIST_STAMPED
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
        stream.servo(motion)
        motion = []
        stream.state_command(sample.data, time.monotonic_ns())
    stream.servo(motion)


def main(pipe: str, config: str, parent: str) -> None:
    """Run with the arguments of the command line."""
    die_with_parent(int(parent))
    lower_priority()
    os.set_blocking(int(pipe), False)
    with suppress(BrokenPipeError):
        run(RosDeviceConfig(**json.loads(config)), int(pipe))


if __name__ == "__main__":
    main(*sys.argv[1:])
