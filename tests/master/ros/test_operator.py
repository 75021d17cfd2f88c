"""A ROS node as operator of a whole session: slave, master and receiver, through a router."""

import math
import signal
import threading
import time
from contextlib import contextmanager
from functools import partial

import pytest

from master.device import DeviceFault
from master.devices.ros_device import RosDevice, RosDeviceConfig
from studies.testbed.processes import START_S, Processes
from teleop.launch.supervisor import wait_for_condition
from teleop.messages.messages import Event, decode_text
from teleop.messages.topics import COMMAND, EVENT, STATE
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    JOINT_STATE,
    STRING_STAMPED,
    build_header,
    build_joint_state,
    build_message,
    encode,
)
from teleop.ros.node import RosNode
from teleop.session.state_machine import State
from tests.master.reading import said
from tests.root import ROOT
from tests.teleop.ros.peers import free_port, router

PATIENCE_S = 20.0
STILL_M = 0.3e-3  # [m] of a tip that is held


class Operator:
    """A node that streams servo_jp at 100 Hz; `send` is what it sends, None for nothing."""

    def __init__(self, node):
        self._node = node
        self.servo = node.advertise("/master/servo_jp", JOINT_STATE, Qos(BEST_EFFORT, 1))
        self._state = node.advertise("/master/state_command", STRING_STAMPED, Qos(RELIABLE, 10))
        self.begin_s = 0.0
        self.send = self.hold
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()

    def hold(self):
        return build_joint_state(build_header(0), position=(0.0,))

    def wave(self):
        """From where it held, to 10 mm and back."""
        phase = 3 * (time.monotonic() - self.begin_s)
        return build_joint_state(build_header(0), position=(0.005 * (1 - math.cos(phase)),))

    def move(self):
        self.begin_s = time.monotonic()
        self.send = self.wave

    def say(self, word):
        self._state.put(encode(build_message(STRING_STAMPED, string=word)))

    def _run(self):
        while not self._over.wait(0.01):
            message = self.send()
            if message is not None:
                self.servo.put(encode(message))


@contextmanager
def session(tmp_path, endpoint):
    """A slave and a master whose device is a ROS node."""
    overrides = (
        f"master.device={{type: ros, router: {endpoint}, timeout: 0.5}}",
        "master.operator.position_scale=1",
        "master.state_timeout=0.5",
        "master.delay_max=1.0",
        "realtime.priority=0",
    )
    with Processes(tmp_path, ROOT / "configs" / "demo.yaml", *overrides) as processes:
        processes.start("slave")
        processes.start("master")
        with processes.look() as link:
            events = link.listen((EVENT,))
            for topic in (STATE, COMMAND):
                there = partial(lambda topic: link.take_latest(topic).message is not None, topic)
                assert wait_for_condition(there, START_S), processes.outputs()
            yield link, events


def master_state(link):
    return State(link.take_latest(COMMAND).message.state)


def tip(link):
    return link.take_latest(STATE).message.position[0]


def texts(events):
    return [decode_text(Event.unpack(item.data).text) for item in events.drain()]


def engage(operator, link, events):
    """Stream, let go, and enable, until hand and tip are coupled; then move."""
    operator.send = operator.hold
    operator.say("disable")
    time.sleep(0.15)

    def coupled():
        operator.say("disable" if master_state(link) is State.FAULT else "enable")
        time.sleep(0.1)
        return master_state(link) is State.ENGAGED

    assert wait_for_condition(coupled, PATIENCE_S), texts(events)
    operator.move()


def test_a_ros_node_moves_the_tip_and_no_wrong_command_does(tmp_path):
    with (
        router() as endpoint,
        RosNode(endpoint, 0, "operator") as node,
        session(tmp_path, endpoint) as (link, events),
        Operator(node) as operator,
    ):
        time.sleep(0.5)
        assert master_state(link) is State.READY  # a stream alone engages nothing
        before = tip(link)
        engage(operator, link, events)
        seen = [before]

        def moved():
            seen.append(tip(link))
            return max(seen) - min(seen) > 3e-3

        assert wait_for_condition(moved, PATIENCE_S), texts(events)

        wrong = {
            "joint 1 is not finite": lambda: build_joint_state(
                build_header(0), position=(math.nan,)
            ),
            "silent for 0.5 s": lambda: None,
        }
        for words, send in wrong.items():
            if master_state(link) is not State.ENGAGED:
                engage(operator, link, events)
            events.drain()
            operator.send = send
            assert wait_for_condition(lambda: master_state(link) is State.FAULT, PATIENCE_S), words
            said = []

            def named(words=words, said=said):
                said += texts(events)
                return any(words in text for text in said)

            assert wait_for_condition(named, PATIENCE_S), f"{words}: {said}"
            time.sleep(0.2)
            held = tip(link)
            time.sleep(0.2)
            assert abs(tip(link) - held) < STILL_M, words
            assert master_state(link) is State.FAULT, words


def test_a_receiver_without_a_router_or_that_stops_or_ends_is_a_fault():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    device = RosDevice(RosDeviceConfig(router=endpoint))
    receiver = device._process
    try:
        for signal_number, loss in (
            (signal.SIGCONT, f"no router at {endpoint} yet: ros2 run rmw_zenoh_cpp rmw_zenohd"),
            (signal.SIGSTOP, "the receiver of ROS commands does not answer"),
        ):
            receiver.send_signal(signal_number)
            assert wait_for_condition(lambda loss=loss: said(device) == loss, PATIENCE_S)
        receiver.send_signal(signal.SIGCONT)
        with router(endpoint):
            assert wait_for_condition(lambda: not said(device), PATIENCE_S)
            assert not device.read(0.0).engage
        receiver.kill()
        with pytest.raises(DeviceFault, match="has ended"):
            wait_for_condition(lambda: said(device) and False, PATIENCE_S)
        with pytest.raises(DeviceFault, match="refuses"):
            device.write((math.nan,))
    finally:
        device.close()
