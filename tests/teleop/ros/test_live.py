"""A session in the ROS graph, through a router, as plain Zenoh and `rosbags` see it."""

import threading
import time

import numpy as np
import pytest

from studies.testbed.processes import wait_for_condition
from teleop.config.arm import ArmConfig, BendingSectionConfig
from teleop.config.loading import ConfigDocument
from teleop.link import Link
from teleop.messages.messages import Hand, LoopReport, Sheath, SlaveState, TendonState, pad_values
from teleop.messages.topics import COMMAND, HAND, REPORT, SHEATH, STATE, TENDONS, Role
from teleop.ros.arms import load_ros_arms
from teleop.ros.config import RosConfig
from teleop.ros.graph import RELIABLE, Qos
from teleop.ros.message_types import JOINT_STATE, load_typestore
from teleop.ros.node import RosNode
from teleop.ros.publishers import Publishers
from teleop.session.state_machine import State
from tests.teleop.link.bench import free_config
from tests.teleop.ros.peers import Heard, peer, router

PATIENCE_S = 20.0


class Session:
    """A slave and a master that only send; the same values again and again."""

    def __init__(self, links):
        self._links = links
        self._over = threading.Event()
        self.thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self.thread.join()

    def _send(self):
        slave, master = self._links
        state = SlaveState(
            state=State.ENGAGED,
            joints=3,
            position=pad_values((0.002, 0.0, 0.02), 8),
            force=pad_values((1.5, 0.0, -2.5), 8),
            force_low=pad_values((1.0, 0.0, -3.0), 8),
            force_high=pad_values((2.0, 0.0, -2.0), 8),
        )
        tendons = TendonState(tendons=4, proximal_tension=pad_values((5, 6, 7, 8), 16))
        straight = Sheath(tendon=1, joint=0, sections=1, section_length=pad_values((0.5,), 16),
                          section_radius=pad_values((float("inf"),), 16))  # fmt: skip
        while not self._over.wait(0.004):
            slave.publish(STATE, state)
            slave.publish(TENDONS, tendons)
            slave.publish(SHEATH, straight)
            slave.publish(REPORT, LoopReport(role=Role.SLAVE, state=State.FAULT, reason=46))
            master.publish(HAND, Hand(joints=1, velocity=pad_values((0.5,), 8), force=(3.0,) * 8))
            master.publish(COMMAND, COMMAND.message(state=State.READY, velocity=(0.25,) * 8))


def load_arm():
    """A curved section of two bends, that the first two joints move."""
    section = BendingSectionConfig(name="bend", length=0.1)
    arm = ArmConfig(radii=((0.004, 0.0), (0.0, 0.004)), sections=(section,))
    return load_ros_arms(ConfigDocument(), (arm,))


@pytest.fixture(scope="module")
def heard():
    """What a peer heard of a session within a second and more; and the same peer's tokens."""
    said = []
    config = RosConfig(prefix="/lab")
    ends = free_config()
    with (
        router() as endpoint,
        peer(endpoint) as other,
        Link(ends, "seen", Role.SLAVE) as slave,
        Link(ends, "seen", Role.MASTER) as master,
        Link(ends, "seen", Role.VIEWER) as link,
        Session((slave, master)),
        RosNode(endpoint, 0, "tendon_teleop") as node,
        RosNode(endpoint, 0, "intruder") as intruder,
    ):
        heard = Heard(other)
        publishers = Publishers(link, node, config, said.append, load_arm())
        intruder.advertise("/lab/master/servo_jp", JOINT_STATE, Qos(RELIABLE, 10))
        begin = time.monotonic()

        def enough():
            diagnostics = heard.samples["/diagnostics"]
            return len(diagnostics) > 2 and len(heard.samples["/lab/slave/measured_js"]) > 50

        publishers.run(lambda: enough() or time.monotonic() - begin > PATIENCE_S)
        heard.said, heard.seconds = said, time.monotonic() - begin
        heard.tokens_then = set(heard.tokens)
        heard.node_there = lambda: any("/NN/%/%/tendon_teleop" in t for t in heard.tokens)
        assert heard.node_there()
        node.__exit__(None, None, None)
        heard.left = wait_for_condition(lambda: not heard.node_there(), PATIENCE_S)
    return heard


@pytest.fixture(scope="module")
def store():
    return load_typestore()


def last(heard, store, topic):
    (name, _), data, _ = heard.samples[topic][-1]
    return store.deserialize_cdr(data, name.replace("::msg::dds_::", "/msg/").rstrip("_"))


def test_every_topic_is_heard_with_hash_and_numbers(heard, store):
    names = {
        "/lab/slave/measured_js", "/lab/slave/setpoint_js", "/lab/slave/actuators/measured_js",
        "/lab/slave/actuators/setpoint_js", "/lab/slave/measured_cf",
        "/lab/slave/joint_3/measured_cf", "/lab/slave/measured_cp", "/lab/slave/setpoint_cp",
        "/lab/slave/operating_state", "/lab/slave/state",
        "/lab/slave/tendons", "/lab/master/measured_js", "/lab/master/setpoint_js",
        "/lab/master/operating_state", "/diagnostics", "/tf",
    }  # fmt: skip
    assert set(heard.samples) == names
    for samples in heard.samples.values():
        numbers = [int.from_bytes(attachment[:8], "little") for *_, attachment in samples]
        assert numbers == list(range(numbers[0], numbers[0] + len(samples)))
        (name, type_hash), _, _ = samples[-1]
        assert type_hash == store.hash_rihs01(name.replace("::msg::dds_::", "/msg/").rstrip("_"))


def test_values_and_units_are_those_of_the_session(heard, store):
    measured = last(heard, store, "/lab/slave/measured_js")
    assert measured.name == ["bend.x", "bend.y", "joint_3"]
    assert measured.position.tolist() == [0.5, 0.0, 0.02]  # [rad] of the arm, [m]
    assert measured.effort.tolist() == pytest.approx([0.006, 0.0, -2.5])  # [N m], [N]
    assert measured.velocity.size == 0
    of_joint = last(heard, store, "/lab/slave/joint_3/measured_cf")
    assert (of_joint.wrench.force.x, of_joint.header.frame_id) == (-2.5, "lab/tip_3")
    setpoint = last(heard, store, "/lab/slave/setpoint_js")
    assert setpoint.name == measured.name
    assert setpoint.velocity.tolist() == [62.5, 62.5, 0.25]
    assert last(heard, store, "/lab/slave/actuators/measured_js").effort.tolist() == [5, 6, 7, 8]
    assert last(heard, store, "/lab/master/measured_js").velocity.tolist() == [0.5]
    assert last(heard, store, "/lab/master/setpoint_js").effort.tolist() == [3.0]
    np.testing.assert_array_equal(last(heard, store, "/lab/slave/state").force_low[:3], [1, 0, -3])
    slave, master = (last(heard, store, f"/lab/{s}/operating_state") for s in ("slave", "master"))
    assert (slave.state, slave.is_busy, master.state, master.is_busy) == (
        "ENABLED", True, "ENABLED", False,
    )  # fmt: skip


def test_a_fault_and_a_refused_command_are_in_the_diagnostics(heard, store):
    master, slave, refused = last(heard, store, "/diagnostics").status
    assert (slave.level, slave.name) == (2, "teleop: slave")
    assert slave.message == "tendon has no tension although it is wound in"
    assert (master.level, master.message) == (3, "no reports")
    assert refused.level == 1
    assert "/intruder publishes /lab/master/servo_jp" in refused.message
    assert heard.said == [refused.message]


def collect_transforms(heard, store):
    """The newest of each frame, of all messages."""
    return {
        transform.child_frame_id: transform
        for _, data, _ in heard.samples["/tf"]
        for transform in store.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms
    }


def test_the_ends_of_a_sheath_are_frames(heard, store):
    transforms = collect_transforms(heard, store)
    assert set(transforms) == {
        "lab/sheath_2_housing", "lab/sheath_2_tip", "lab/tip_1", "lab/bend", "lab/tip",
    }  # fmt: skip
    tip = transforms["lab/sheath_2_tip"].transform
    assert (tip.translation.x, tip.translation.y, tip.rotation.w) == (0.5, 0.0, 1.0)


def test_the_graph_has_node_and_endpoints_until_the_process_ends(heard):
    ours = [t for t in heard.tokens_then if "/tendon_teleop" in t]
    assert sum("/NN/" in t for t in ours) == 1
    assert sum("/MP/" in t for t in ours) == len(heard.samples)
    assert heard.left
