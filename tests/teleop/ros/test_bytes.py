"""CDR bytes and type hashes, against `rosbags`, which shares no code with them."""

import contextlib
import dataclasses
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from teleop.messages.messages import SlaveState
from teleop.ros import cdr
from teleop.ros.interface import Text, find_interface, format_definition
from teleop.ros.standard import DiagnosticArray, JointState, StringStamped, TFMessage, Time
from teleop.ros.type_hash import compute_type_hash
from tests.teleop.ros.values import TYPES, as_theirs, as_tree, typestore, value_of


@pytest.fixture(scope="module")
def store():
    return typestore()


def name_of(cls):
    return find_interface(cls).name


@pytest.mark.parametrize("cls", TYPES, ids=name_of)
def test_a_message_has_the_bytes_that_others_write_and_both_read_them(cls, store):
    rng = np.random.default_rng(3)
    for _ in range(5):
        message = value_of(cls, rng)
        data = cdr.encode(message)
        theirs = as_theirs(store, find_interface(cls), message)
        assert bytes(store.serialize_cdr(theirs, name_of(cls))) == data
        assert as_tree(store.deserialize_cdr(data, name_of(cls))) == as_tree(message)
        assert cdr.decode(cls, data) == message


@pytest.mark.parametrize("cls", TYPES, ids=name_of)
def test_a_type_has_the_hash_that_others_compute(cls, store):
    assert compute_type_hash(cls) == store.hash_rihs01(name_of(cls))


def test_hashes_that_ros_jazzy_ships():
    """Source: the .json files beside the messages in sensor_msgs and std_msgs of Jazzy."""

    @dataclasses.dataclass(frozen=True)
    class String:
        ros_name: ClassVar[str] = "std_msgs/msg/String"
        data: Text = ""

    assert compute_type_hash(String).endswith(
        "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    assert compute_type_hash(JointState).endswith(
        "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )


def test_a_definition_contains_all_types_that_it_refers_to(store):
    for cls in (TFMessage, DiagnosticArray):
        types = get_types_from_msg(format_definition(find_interface(cls)), name_of(cls))
        assert {k: store.fielddefs[k][1] for k in types} == {k: v[1] for k, v in types.items()}


def test_bytes_of_the_link_are_cdr_as_they_are():
    state = SlaveState(joints=2, force_low=(1.0,) * 8)
    sent = SlaveState.unpack(state.pack(7, 1, 5))
    assert cdr.encode(sent) == sent.pack(7, 1, 5)


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_read(data):
    for cls in (JointState, StringStamped, TFMessage):
        for encapsulated in (data, b"\0\1\0\0" + data):
            with contextlib.suppress(cdr.CdrError):
                cdr.decode(cls, encapsulated)


def test_every_cut_of_a_message_is_refused():
    data = cdr.encode(value_of(JointState, np.random.default_rng(1)))
    for end in range(len(data) - 1):
        with pytest.raises(cdr.CdrError):
            cdr.decode(JointState, data[:end])
    with pytest.raises(cdr.CdrError, match="too long"):
        cdr.decode(JointState, data + bytes(17))


def test_the_further_bytes_of_rclpy_are_ignored():
    """Source: rclpy.serialization.serialize_message (Jazzy) of a JointState with effort alone."""
    data = bytes.fromhex(
        "00010000000000000000000001000000006f736900000000000000000000000001000000000000000000f03f"
        "632e736f00000000"
    )
    assert cdr.decode(JointState, data) == JointState(effort=(1.0,))


@given(st.integers(-(2**62), 2**62))
def test_a_time_is_that_of_its_stamp_or_zero(stamp_ns):
    time = Time.of(stamp_ns)
    assert time.ns == (stamp_ns if abs(stamp_ns) < 2**31 * 10**9 else time.ns)
    cdr.encode(time)
