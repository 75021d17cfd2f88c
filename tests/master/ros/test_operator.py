"""A ROS node as operator of a whole session: slave, master and receiver, through a router."""

import math
import signal
import threading
import time
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_tip_pose
from master.device import DeviceFault
from master.devices.ros_device import RosDevice, RosDeviceConfig
from studies.testbed.processes import START_S, Processes, wait_for_condition
from teleop import load_config
from teleop.messages.messages import Event, decode_text
from teleop.messages.topics import COMMAND, EVENT, STATE, TENDONS
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    JOINT_STATE,
    POINT,
    POSE,
    POSE_STAMPED,
    STRING_STAMPED,
    build_header,
    build_joint_state,
    build_message,
    encode,
    load_typestore,
)
from teleop.ros.node import RosNode
from teleop.session.state_machine import State
from tests.master.reading import said
from tests.root import ROOT
from tests.teleop.ros.peers import Heard, free_port, peer, router

PATIENCE_S = 20.0
STILL_M = 0.3e-3  # [m] of a tip that is held


class Operator:
    """A node that streams a command at 100 Hz; `send` is what it sends, None for nothing."""

    def __init__(self, node, topic="servo_jp", message=JOINT_STATE):
        self.servo = node.advertise(f"/master/{topic}", message, Qos(BEST_EFFORT, 1))
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


class PoseOperator(Operator):
    """The same with servo_cp: `goal` [m] is where the hand goes, at 40 mm/s at most."""

    def __init__(self, node):
        super().__init__(node, "servo_cp", POSE_STAMPED)
        self.place = self.goal = np.zeros(3)

    def hold(self):
        way = self.goal - self.place
        self.place = self.place + way * min(0.05, 4e-4 / max(np.linalg.norm(way), 1e-9))
        return build_pose(*self.place)

    def move(self):
        """Stay."""


def build_pose(x, y, z):
    place = build_message(POINT, x=float(x), y=float(y), z=float(z))
    return build_message(POSE_STAMPED, pose=build_message(POSE, position=place))


@contextmanager
def session(tmp_path, endpoint, config="demo.yaml", device="", *overrides):
    """A slave and a master whose device is a ROS node."""
    overrides = (
        f"master.device={{type: ros, router: {endpoint}, timeout: 0.5{device}}}",
        "master.operator.position_scale=1",
        "master.state_timeout=0.5",
        "master.delay_max=1.0",
        "realtime.priority=0",
        "rate_hz=250",
        "slave.command_timeout=0.5",
        *overrides,
    )
    with Processes(tmp_path, ROOT / "configs" / config, *overrides) as processes:
        processes.start("slave")
        processes.start("master")
        with processes.look() as link:
            events = link.listen((EVENT,))
            for topic in (STATE, COMMAND, TENDONS):
                there = partial(lambda topic: link.take_latest(topic).message is not None, topic)
                assert wait_for_condition(there, START_S), processes.outputs()
            yield link, events, processes


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
        session(tmp_path, endpoint) as (link, events, _),
        Operator(node) as operator,
    ):
        time.sleep(0.5)
        assert master_state(link) is State.READY  # a stream alone engages nothing
        before = tip(link)
        engage(operator, link, events)
        seen = [before]

        def moved():
            if master_state(link) is not State.ENGAGED:  # also after a stall of a busy machine
                engage(operator, link, events)
            seen.append(tip(link))
            return max(seen) - min(seen) > 3e-3

        assert wait_for_condition(moved, PATIENCE_S), texts(events)

        wrong = {
            "joint 1 is not finite": lambda: build_joint_state(
                build_header(0), position=(math.nan,)
            ),
            "silent for 0.5 s": lambda: None,
        }
        refuse(operator, link, events, wrong, tip)


def refuse(operator, link, events, wrong, place):
    """Send what is wrong, by the words of its refusal: a fault said in one line; the tip holds."""
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
        assert all(text.count("\n") == 0 for text in said)
        time.sleep(0.2)
        held = place(link)
        time.sleep(0.2)
        assert np.abs(place(link) - held).max() < STILL_M, words
        assert master_state(link) is State.FAULT, words


def locate_tip(link):
    """Return where the bench sees the tip of configs/endoscope-tip.yaml [m], shape (3,)."""
    tendons = link.take_latest(TENDONS).message
    travel = np.linalg.solve(ENDOSCOPE.radii, tendons.bench_distal_displacement[:8:2])
    return compute_tip_pose(prepare_arm(ENDOSCOPE.load_kinematics())[0], travel)[:3, 3]


ENDOSCOPE = load_config(ROOT / "configs" / "endoscope-tip.yaml").arms[0]


def test_a_pose_moves_the_tip_of_an_arm_within_its_limits(tmp_path):
    """The tip is where `measured_cp` says and the bench sees it, by the way that the hand went."""
    with (
        router() as endpoint,
        peer(endpoint) as other,
        RosNode(endpoint, 0, "operator") as node,
        session(
            tmp_path, endpoint, "endoscope-tip.yaml", ", command: servo_cp, axes: 3",
            "slave.rig.arms.0.contacts=[]", f"ros.router={endpoint}", "ros.rate_hz=50",
        ) as (link, events, processes),
        PoseOperator(node) as operator,
    ):  # fmt: skip
        processes.start("ros")
        heard, store = Heard(other), load_typestore()
        poses = heard.samples["/slave/measured_cp"]
        assert wait_for_condition(lambda: len(poses) > 0, START_S), processes.outputs()

        def measure():
            place = store.deserialize_cdr(poses[-1][1], "geometry_msgs/msg/PoseStamped")
            return np.array([getattr(place.pose.position, axis) for axis in "xyz"])

        def is_there():
            if master_state(link) is not State.ENGAGED:  # also after a stall of a busy machine
                engage(operator, link, events)
            operator.goal = operator.place + goal - locate_tip(link)  # as one who sees the tip
            places = np.array([measure(), locate_tip(link)])
            return np.abs(places - goal).max() < 1e-3

        goal = np.add(locate_tip(link), (0.03, -0.015, -0.014))
        assert wait_for_condition(is_there, 3 * PATIENCE_S), (goal, locate_tip(link))

        operator.say("disable")  # the clutch: the hand goes back, and the tip stays
        assert wait_for_condition(lambda: master_state(link) is not State.ENGAGED, PATIENCE_S)
        held = locate_tip(link)
        operator.goal = np.zeros(3)
        time.sleep(1.0)
        assert np.abs(locate_tip(link) - held).max() < STILL_M
        engage(operator, link, events)
        assert np.abs(locate_tip(link) - held).max() < STILL_M

        largest = np.zeros(2)

        def is_at_limit():  # out of reach: the arm is 0.1 m long
            if master_state(link) is not State.ENGAGED:
                engage(operator, link, events)
            operator.goal = np.add(operator.place, (0.01, 0.0, 0.0))
            tendons = link.take_latest(TENDONS).message
            bend = np.linalg.solve(ENDOSCOPE.radii, tendons.bench_distal_displacement[:8:2])
            seen = np.abs(bend).max(), max(tendons.proximal_tension[:8])
            largest[:] = np.maximum(largest, seen)
            return operator.place[0] > 0.15

        assert wait_for_condition(is_at_limit, 3 * PATIENCE_S), (operator.place, largest)
        assert 1.0 < largest[0] < 1.8 + 0.05  # [rad] `bend_max`, and the error of elongation
        assert largest[1] < 25.0 + 0.5  # [N] `tension_max` of the gate

        wrong = {"faster than speed_max": lambda: build_pose(0.1, -0.1, 0.0)}
        refuse(operator, link, events, wrong, locate_tip)


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
    finally:
        device.close()
