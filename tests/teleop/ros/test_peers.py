"""What other implementations make of ours: `make test-ros` installs them.

`rclpy` and the generators of ROS 2 Jazzy, `ros2_pyterfaces`, and `zenoh-ros2-sdk` of ROBOTIS.
"""

import importlib
import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from studies.testbed.processes import wait_for_condition
from teleop.messages.messages import MESSAGES
from teleop.ros.command import write_package
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.message_types import (
    DIAGNOSTIC_ARRAY,
    JOINT_STATE,
    WRENCH_STAMPED,
    build_header,
    build_joint_state,
    compute_type_hash,
    decode,
    encode,
    format_definition,
    to_type_name,
)
from teleop.ros.node import RosNode
from tests.teleop.ros.peers import router
from tests.teleop.ros.values import STANDARD, as_tree, value_of

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
serialization = pytest.importorskip("rclpy.serialization", reason="make test-ros installs it")

PATIENCE_S = 20.0
SHARE = Path(sys.prefix) / "share"


def module_of(type_name, package):
    """The class of a type in another library; None if it has no such type."""
    name, _, short = type_name.partition("/msg/")
    try:
        module = importlib.import_module(package.format(name))
    except ModuleNotFoundError:
        return None
    return getattr(module, short, None)


OFFICIAL = [name for name in STANDARD if module_of(name, "{}.msg") is not None]
PYTERFACES = [
    name for name in STANDARD if module_of(name, "ros2_pyterfaces.cyclone.{}.msg") is not None
]


def official_tree(message):
    """An official message as lists and plain numbers."""
    if hasattr(message, "get_fields_and_field_types"):
        names = message.get_fields_and_field_types()
        return {name: official_tree(getattr(message, name)) for name in names}
    if isinstance(message, bytes):
        return message[0]  # rclpy has a `byte` as bytes
    if hasattr(message, "tolist"):
        return message.tolist()
    return [official_tree(one) for one in message] if isinstance(message, list) else message


def test_the_types_that_matter_are_compared():
    assert {JOINT_STATE, WRENCH_STAMPED, DIAGNOSTIC_ARRAY} <= set(OFFICIAL)


@pytest.mark.parametrize("name", OFFICIAL)
def test_rclpy_decodes_our_bytes_to_equal_values_and_we_decode_its_bytes(name):
    rng = np.random.default_rng(11)
    for _ in range(20):
        message = value_of(name, rng)
        data = encode(message)
        theirs = serialization.deserialize_message(data, module_of(name, "{}.msg"))
        assert official_tree(theirs) == as_tree(message)
        again = serialization.serialize_message(theirs)
        assert as_tree(decode(name, again)) == as_tree(message)


@pytest.mark.parametrize("name", OFFICIAL)
def test_our_hashes_are_those_that_ros_ships(name):
    package, _, short = name.partition("/msg/")
    shipped = json.loads((SHARE / package / "msg" / f"{short}.json").read_text())
    hashes = {one["type_name"]: one["hash_string"] for one in shipped["type_hashes"]}
    assert hashes[name] == compute_type_hash(name)


def test_the_generators_of_ros_read_our_package_and_compute_our_hashes(tmp_path):
    adapter = pytest.importorskip("rosidl_adapter.msg")
    generator = pytest.importorskip("rosidl_generator_type_description")
    root = write_package(tmp_path)
    for cls in MESSAGES:
        name = f"{cls.__name__}.msg"
        adapter.convert_msg_to_idl(root, "tendon_teleop", Path("msg") / name, tmp_path / "msg")
    arguments = {
        "package_name": "tendon_teleop",
        "output_dir": str(tmp_path / "out"),
        "idl_tuples": [f"{tmp_path}:msg/{cls.__name__}.idl" for cls in MESSAGES],
    }
    (tmp_path / "arguments.json").write_text(json.dumps(arguments))
    generator.generate_type_hash(str(tmp_path / "arguments.json"))
    for cls in MESSAGES:
        made = json.loads((tmp_path / "out" / "msg" / f"{cls.__name__}.json").read_text())
        hashes = {one["type_name"]: one["hash_string"] for one in made["type_hashes"]}
        assert hashes[to_type_name(cls)] == compute_type_hash(to_type_name(cls))


@pytest.mark.parametrize("name", PYTERFACES)
def test_ros2_pyterfaces_has_our_hashes_and_bytes(name):
    theirs = module_of(name, "ros2_pyterfaces.cyclone.{}.msg")
    assert theirs.hash_rihs01() == compute_type_hash(name)
    message = value_of(name, np.random.default_rng(12))
    assert as_tree(theirs.deserialize(encode(message))) == as_tree(message)


def test_the_sdk_of_robotis_receives_every_message_and_lists_the_topics():
    sdk = pytest.importorskip("zenoh_ros2_sdk")
    discovery = pytest.importorskip("zenoh_ros2_sdk.discovery")
    received = []
    with router() as endpoint, RosNode(endpoint, 0, "tendon_teleop") as node:
        where = {"router_ip": "127.0.0.1", "router_port": int(endpoint.rpartition(":")[2])}
        live = node.advertise("/lab/slave/measured_js", JOINT_STATE, Qos(BEST_EFFORT, 1))
        node.advertise("/diagnostics", DIAGNOSTIC_ARRAY, Qos(RELIABLE, 10))
        node.subscribe("/lab/servo", JOINT_STATE, Qos(), lambda *_: None)
        subscriber = sdk.ROS2Subscriber(
            topic="/lab/slave/measured_js",
            msg_type="sensor_msgs/msg/JointState",
            callback=received.append,
            msg_definition=format_definition(JOINT_STATE),
            type_hash=compute_type_hash(JOINT_STATE),
            domain_id=0,
            **where,
        )

        def heard():
            live.look()
            return live.wanted

        assert wait_for_condition(heard, PATIENCE_S)
        for k in range(1000):
            live.put(encode(build_joint_state(build_header(0), ("a", "b"), (k * 1e-3, -1.0))))
            time.sleep(0.001)
        assert wait_for_condition(lambda: len(received) == 1000, PATIENCE_S), len(received)
        assert [m.position[0] for m in received] == [k * 1e-3 for k in range(1000)]
        topics = dict(discovery.get_topic_names_and_types(domain_id=0, **where))
        assert topics["/lab/slave/measured_js"] == ["sensor_msgs/msg/JointState"]
        assert topics["/diagnostics"] == ["diagnostic_msgs/msg/DiagnosticArray"]
        about = discovery.get_topic_info(
            "/lab/slave/measured_js", domain_id=0, verbose=True, **where
        )
        assert (about.publisher_count, about.subscriber_count) == (1, 1)
        (publisher,) = about.publishers
        assert publisher.node_name.lstrip("/") == "tendon_teleop"
        assert publisher.type_hash == compute_type_hash(JOINT_STATE)
        assert publisher.qos == "2::,1:,:,:,,"
        subscriber.close()
