"""Keys, tokens, ids and attachments, against what rmw_zenoh documents and others implement."""

import pytest

from teleop.ros import graph
from teleop.ros.graph import BEST_EFFORT, EndpointKind, Node, Qos
from teleop.ros.message_types import JOINT_STATE

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def talker():
    return Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "talker")


def test_keys_are_those_of_the_design_page_of_rmw_zenoh(talker):
    """Source: github.com/ros2/rmw_zenoh, docs/design.md, "Graph Cache"."""
    assert graph.build_topic_key(0, "/chatter", STRING) == (
        f"0/chatter/std_msgs::msg::dds_::String_/{STRING_HASH}"
    )
    assert talker.key == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/talker"
    key = talker.build_endpoint_key(10, EndpointKind.PUBLISHER, "/chatter", STRING, Qos())
    assert key == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%chatter/"
        f"std_msgs::msg::dds_::String_/{STRING_HASH}/::,10:,:,:,,"
    )


def test_an_endpoint_is_read_back_from_its_token(talker):
    qos = Qos(BEST_EFFORT, 100)
    key = talker.build_endpoint_key(
        3, EndpointKind.SUBSCRIBER, "/lab/measured_js", JOINT_STATE, qos
    )
    assert key.endswith("/2::,100:,:,:,,")
    assert graph.parse_endpoint(key) == graph.GraphEndpoint(
        "/talker", EndpointKind.SUBSCRIBER, "/lab/measured_js", "sensor_msgs/msg/JointState"
    )
    assert graph.parse_endpoint(talker.key) is None
    assert graph.parse_endpoint("@ros2_lv/0/nonsense") is None


def test_a_gid_is_xxh3_with_the_low_word_first():
    """Source: the self-test of xxHash 0.8: XXH3_128bits of no bytes, without a seed."""
    low, high = 0x6001C324468D497F, 0x99AA06D3014798D8
    assert graph.compute_gid("") == low.to_bytes(8, "little") + high.to_bytes(8, "little")


def test_an_attachment_has_33_bytes_and_is_read_back():
    gid = bytes(range(16))
    data = graph.pack_attachment(5, 1_700_000_000_000_000_001, gid)
    assert len(data) == 33
    assert data[16] == 16
    assert graph.parse_attachment(data) == (5, 1_700_000_000_000_000_001, gid)
    assert graph.parse_attachment(data[:-1]) is None
    assert graph.parse_attachment(data[:16] + b"\x0f" + data[17:]) is None


@pytest.mark.parametrize(
    ("name", "is_one"), [("/a/b_1", True), ("a", False), ("/a//b", False), ("/1", False)]
)
def test_names_of_topics(name, is_one):
    assert graph.is_name(name) == is_one
