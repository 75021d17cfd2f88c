"""Bytes and hashes of messages, against `mcap_ros2`, which shares no code with `rosbags`.

What ROS itself makes of them is in test_peers.py.
"""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from master.device import DeviceFault
from master.devices import ros_device
from master.devices.ros_device import RosDeviceConfig
from teleop.errors import UsageError
from teleop.messages.messages import SlaveState
from teleop.ros import message_types
from teleop.ros.message_types import (
    JOINT_STATE,
    STRING_STAMPED,
    TF_MESSAGE,
    CdrError,
    build_header,
    build_joint_state,
    build_message,
    compute_type_hash,
    decode,
    encode,
    format_definition,
    load_typestore,
    to_stamp_ns,
    to_type_name,
)
from tests.teleop.ros.values import TYPES, as_tree, value_of

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.mark.parametrize("name", TYPES)
def test_another_reader_has_the_same_values_by_the_definition_in_a_bag(name):
    schema = Schema(1, format_definition(name).encode(), "ros2msg", name)
    read = DecoderFactory().decoder_for("cdr", schema)
    rng = np.random.default_rng(3)
    for _ in range(5):
        message = value_of(name, rng)
        data = encode(message)
        assert as_tree(read(data)) == as_tree(message)
        assert as_tree(decode(name, data)) == as_tree(message)


def test_hashes_that_ros_jazzy_ships():
    """Source: the .json files beside the messages in sensor_msgs and std_msgs of Jazzy."""
    assert compute_type_hash("std_msgs/msg/String") == STRING_HASH
    assert compute_type_hash(JOINT_STATE).endswith(
        "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )


def test_bytes_of_the_link_are_cdr_as_they_are():
    data = SlaveState(joints=2, force_low=(1.0,) * 8).pack(7, 1, 5)
    message = decode(to_type_name(SlaveState), data)
    assert (message.joints, message.force_low.tolist()) == (2, [1.0] * 8)
    assert encode(message) == data


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_read(data):
    for name in (JOINT_STATE, STRING_STAMPED, TF_MESSAGE):
        for encapsulated in (data, b"\0\1\0\0" + data):
            with contextlib.suppress(CdrError):
                decode(name, encapsulated)


def test_every_cut_of_a_message_is_refused():
    data = encode(value_of(JOINT_STATE, np.random.default_rng(1)))
    for end in range(len(data) - 1):
        with pytest.raises(CdrError):
            decode(JOINT_STATE, data[:end])
    with pytest.raises(CdrError, match="too long"):
        decode(JOINT_STATE, data + bytes(17))


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (lambda: build_joint_state(build_header(0), position=np.zeros(100_001)), "length 100001"),
        (lambda: build_message(STRING_STAMPED, string="x" * (1 << 22)), "at most 4194304"),
    ],
)
def test_a_message_beyond_the_bounds_is_refused(message, words):
    sent = message()
    with pytest.raises(CdrError, match=words):
        decode(sent.__msgtype__, encode(sent))


def test_the_further_bytes_of_rclpy_are_ignored():
    """Source: rclpy.serialization.serialize_message (Jazzy) of a JointState with effort alone."""
    data = bytes.fromhex(
        "00010000000000000000000001000000006f736900000000000000000000000001000000000000000000f03f"
        "632e736f00000000"
    )
    expected = build_joint_state(build_header(0), effort=(1.0,))
    assert as_tree(decode(JOINT_STATE, data)) == as_tree(expected)


@given(st.integers(-(2**62), 2**62))
def test_a_time_is_that_of_its_stamp_or_zero(stamp_ns):
    header = build_header(stamp_ns)
    assert to_stamp_ns(header) == (stamp_ns if abs(stamp_ns) < 2**31 * 10**9 else 0)
    encode(header)


def test_without_the_extra_one_line_names_the_remedy(monkeypatch, refused):
    monkeypatch.setattr(message_types, "find_spec", lambda _: None)
    monkeypatch.setattr(ros_device, "find_spec", lambda _: None)
    for words in (["ros"], ["recordings", "to-ros2", "a.mcap", "--out", "b"]):
        assert "pip install 'tendon-teleop[ros]'" in refused(*words)
    with pytest.raises(UsageError, match=r"tendon-teleop\[ros\]"):
        load_typestore.__wrapped__()
    with pytest.raises(DeviceFault, match=r"tendon-teleop\[ros\]"):
        ros_device.RosDevice(RosDeviceConfig())
