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

from teleop.launch.supervisor import wait_for_condition
from teleop.messages.messages import MESSAGES
from teleop.ros import cdr
from teleop.ros.command import write_package
from teleop.ros.graph import BEST_EFFORT, RELIABLE, Qos
from teleop.ros.interface import find_interface, format_definition
from teleop.ros.node import RosNode
from teleop.ros.standard import DiagnosticArray, JointState
from teleop.ros.type_hash import compute_type_hash
from tests.teleop.ros.peers import router
from tests.teleop.ros.values import STANDARD, as_tree, value_of

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
serialization = pytest.importorskip("rclpy.serialization", reason="make test-ros installs it")

PATIENCE_S = 20.0
SHARE = Path(sys.prefix) / "share"


def module_of(cls, package):
    """The module of a type's package in another library; None if it has no such type."""
    name, _, short = find_interface(cls).name.partition("/msg/")
    try:
        module = importlib.import_module(package.format(name))
    except ModuleNotFoundError:
        return None
    return getattr(module, short, None)


OFFICIAL = [cls for cls in STANDARD if module_of(cls, "{}.msg") is not None]
PYTERFACES = [
    cls for cls in STANDARD if module_of(cls, "ros2_pyterfaces.cyclone.{}.msg") is not None
]


def name_of(cls):
    return find_interface(cls).name


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
    names = {name_of(cls) for cls in OFFICIAL}
    assert {"sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"} <= names
    assert "diagnostic_msgs/msg/DiagnosticArray" in names


@pytest.mark.parametrize("cls", OFFICIAL, ids=name_of)
def test_rclpy_decodes_our_bytes_to_equal_values_and_we_decode_its_bytes(cls):
    rng = np.random.default_rng(11)
    for _ in range(20):
        message = value_of(cls, rng)
        data = cdr.encode(message)
        theirs = serialization.deserialize_message(data, module_of(cls, "{}.msg"))
        assert official_tree(theirs) == as_tree(message)
        again = serialization.serialize_message(theirs)
        assert cdr.decode(cls, again) == message


@pytest.mark.parametrize("cls", OFFICIAL, ids=name_of)
def test_our_hashes_are_those_that_ros_ships(cls):
    package, _, short = name_of(cls).partition("/msg/")
    shipped = json.loads((SHARE / package / "msg" / f"{short}.json").read_text())
    hashes = {one["type_name"]: one["hash_string"] for one in shipped["type_hashes"]}
    assert hashes[name_of(cls)] == compute_type_hash(cls)


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
        assert hashes[f"tendon_teleop/msg/{cls.__name__}"] == compute_type_hash(cls)


@pytest.mark.parametrize("cls", PYTERFACES, ids=name_of)
def test_ros2_pyterfaces_has_our_hashes_and_bytes(cls):
    theirs = module_of(cls, "ros2_pyterfaces.cyclone.{}.msg")
    assert theirs.hash_rihs01() == compute_type_hash(cls)
    message = value_of(cls, np.random.default_rng(12))
    assert as_tree(theirs.deserialize(cdr.encode(message))) == as_tree(message)


def test_the_sdk_of_robotis_receives_every_message_and_lists_the_topics():
    sdk = pytest.importorskip("zenoh_ros2_sdk")
    discovery = pytest.importorskip("zenoh_ros2_sdk.discovery")
    received = []
    with router() as endpoint, RosNode(endpoint, 0, "tendon_teleop") as node:
        where = {"router_ip": "127.0.0.1", "router_port": int(endpoint.rpartition(":")[2])}
        live = node.advertise("/lab/slave/measured_js", JointState, Qos(BEST_EFFORT, 1))
        node.advertise("/diagnostics", DiagnosticArray, Qos(RELIABLE, 10))
        node.subscribe("/lab/servo", JointState, Qos(), lambda *_: None)
        subscriber = sdk.ROS2Subscriber(
            topic="/lab/slave/measured_js",
            msg_type="sensor_msgs/msg/JointState",
            callback=received.append,
            msg_definition=format_definition(find_interface(JointState)),
            type_hash=compute_type_hash(JointState),
            domain_id=0,
            **where,
        )

        def heard():
            live.look()
            return live.wanted

        assert wait_for_condition(heard, PATIENCE_S)
        for k in range(1000):
            live.put(cdr.encode(JointState(name=("a", "b"), position=(k * 1e-3, -1.0))))
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
        assert publisher.type_hash == compute_type_hash(JointState)
        assert publisher.qos == "2::,1:,:,:,,"
        subscriber.close()
