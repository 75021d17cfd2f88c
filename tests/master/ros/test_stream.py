"""What the receiver makes of commands of ROS nodes, without a network."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from master.devices.ros_device import RosDeviceConfig
from master.devices.ros_receiver import CommandStream, ReceivedMessage
from teleop.ros.message_types import (
    POINT,
    POSE,
    POSE_STAMPED,
    QUATERNION,
    STRING_STAMPED,
    TWIST,
    TWIST_STAMPED,
    VECTOR3,
    build_header,
    build_joint_state,
    build_message,
    encode,
)

MS = 1_000_000
BEGIN = 10**12
ONE, OTHER = b"1" * 16, b"2" * 16
OFFSET = 7 * 10**15  # of the sender's clock


def joints(*positions):
    return encode(build_joint_state(build_header(0), position=positions))


def twist(x, y=0.0):
    twist = build_message(TWIST, linear=build_message(VECTOR3, x=x, y=y))
    return encode(build_message(TWIST_STAMPED, twist=twist))


def pose(x=0.01, turn=(0.0, 0.0, 0.0), stretch=1.0):
    """A pose with the rotations about x, then y, then z [rad] of the fixed frame."""
    q = stretch * Rotation.from_euler("xyz", turn).as_quat()
    orientation = build_message(QUATERNION, **dict(zip("xyzw", q.tolist(), strict=True)))
    place = build_message(POINT, x=x, y=0.01, z=0.01)
    built = build_message(POSE, position=place, orientation=orientation)
    return encode(build_message(POSE_STAMPED, pose=built))


def posed(axes=6):
    """A stream of poses that was enabled."""
    stream = CommandStream(RosDeviceConfig(command="servo_cp", axes=axes))
    for k in range(10):
        stream.take_servo_commands([sample(pose(), 10 * k)])
    command(stream, "enable", 91)
    assert (stream.engage, stream.fault) == (True, "")
    return stream


def sample(data, at_ms, publisher=ONE, late_ms=0):
    at_ns = BEGIN + at_ms * MS
    return ReceivedMessage(data, publisher, at_ns - late_ms * MS + OFFSET, at_ns)


def command(stream, word, at_ms):
    stream.take_state_command(
        encode(build_message(STRING_STAMPED, string=word)), BEGIN + at_ms * MS
    )


def engaged(**config):
    """A stream of 100 Hz at 0.01 m that was enabled; the last command came at 90 ms."""
    stream = CommandStream(RosDeviceConfig(**config))
    data = joints(*(0.01,) * stream.config.axes)
    if config.get("command") == "servo_cv":
        data = twist(0.01)
    for k in range(10):
        stream.take_servo_commands([sample(data, 10 * k)])
    command(stream, "enable", 91)
    assert (stream.engage, stream.fault, stream.values) == (
        True, "", (0.01,) * stream.config.axes,
    )  # fmt: skip
    return stream


def test_nothing_engages_without_enable_or_without_a_stream():
    stream = CommandStream(RosDeviceConfig())
    stream.take_servo_commands([sample(joints(0.01), 0)])
    assert not stream.engage
    silent = CommandStream(RosDeviceConfig())
    command(silent, "enable", 0)
    assert not silent.engage
    assert "enabled without it" in silent.fault


@pytest.mark.parametrize(
    ("samples", "words"),
    [
        ([sample(joints(math.nan), 100)], "joint 1 is not finite"),
        ([sample(joints(), 100)], "0 joints, must be 1"),
        ([sample(joints(0.01, 0.01), 100)], "2 joints, must be 1"),
        ([sample(joints(1.5), 100)], "beyond 1 m"),
        ([sample(joints(0.3), 100)], "jump of 0.29 m in 0.01 s"),
        ([sample(joints(0.01)[:-3], 100)], "invalid message"),
        ([sample(b"\0\1\0\0" + b"\xff" * 60, 100)], "invalid message"),
        ([sample(joints(0.01), 100, OTHER)], "two nodes"),
        ([sample(joints(0.01), 100), sample(joints(0.01), 100, OTHER)], "two nodes"),
        ([sample(joints(0.01), 190, late_ms=150)], "0.150 s late"),
        ([sample(joints(0.01), 100)] * 300, "flood of more than 2000 messages per second"),
        ([sample(joints(0.01), 100 + k) for k in (0, 101)], "silent for 0.1 s"),
        ([sample(joints(x), 100) for x in (math.nan, 0.01)], "joint 1 is not finite"),
    ],
)
def test_whatever_is_wrong_is_a_fault_with_a_name_until_disabled(samples, words):
    stream = engaged()
    stream.take_servo_commands(samples)
    assert words in stream.fault
    assert stream.fault.startswith("ROS servo_jp: ")
    assert not stream.engage
    assert stream.values == ()
    number, fault = stream.number, stream.fault
    stream.take_servo_commands([sample(joints(0.01), 300)])  # nothing good makes up for it
    command(stream, "enable", 301)
    assert (stream.number, stream.fault, stream.engage) == (number, fault, False)
    command(stream, "disable", 302)
    assert not stream.fault
    stream.take_servo_commands([sample(joints(0.01), 410)])
    assert not stream.engage
    command(stream, "enable", 411)
    assert stream.engage


@pytest.mark.parametrize(
    ("joint", "value", "words"),
    [
        (8, math.nan, "joint 8 is not finite"),
        (8, -1.5, "beyond 1 m"),
        (8, 0.1, "jump of 0.09 m"),
    ],
)
def test_one_wrong_joint_of_eight_is_a_fault(joint, value, words):
    stream = engaged(axes=8)
    positions = [0.01] * 8
    positions[joint - 1] = value
    stream.take_servo_commands([sample(joints(*positions), 100)])
    assert words in stream.fault
    assert (stream.engage, stream.values) == (False, ())
    for count in (7, 9):
        stream = engaged(axes=8)
        stream.take_servo_commands([sample(joints(*(0.01,) * count), 100)])
        assert f"{count} joints, must be 8" in stream.fault


@pytest.mark.parametrize(
    ("period_ms", "bunch", "speed", "is_fault"),
    [(10, 1, 0.45, False), (2, 1, 0.45, False), (2, 1, 0.75, True), (10, 1, 0.75, True),
     (20, 2, 0.3, False), (40, 4, 0.1, False), (20, 2, 0.75, True)],
)  # fmt: skip
def test_the_speed_is_limited_at_any_rate(period_ms, bunch, speed, is_fault):
    """Of `bunch` messages for each period, one millisecond apart on arrival."""
    stream = engaged()
    for k in range(100):
        at_ms = 100 + period_ms * (k // bunch) + k % bunch
        moved = 0.01 + speed * 1e-3 * period_ms * k / bunch
        stream.take_servo_commands([sample(joints(moved), at_ms, late_ms=0)])
    assert ("faster than speed_max" in stream.fault) == is_fault, stream.fault


def test_silence_is_a_fault_while_enabled_only():
    stream = engaged(timeout=0.05)
    stream.step(BEGIN + 139 * MS)
    assert stream.engage
    stream.step(BEGIN + 141 * MS)
    assert (stream.engage, stream.fault) == (False, "ROS servo_jp: silent for 0.05 s")
    idle = CommandStream(RosDeviceConfig())
    idle.take_servo_commands([sample(joints(0.01), 0)])
    idle.step(BEGIN + 10_000 * MS)
    assert not idle.fault
    idle.take_servo_commands(
        [sample(joints(0.5), 20_000, OTHER)]
    )  # after silence another node may begin
    assert not idle.fault


@pytest.mark.parametrize(("word", "is_fault"), [("disable", False), ("pause", False), ("go", True)])
def test_other_state_commands_open_the_switch(word, is_fault):
    stream = engaged()
    command(stream, word, 95)
    assert not stream.engage
    assert bool(stream.fault) == is_fault


def test_invalid_bytes_of_a_state_command_open_the_switch():
    stream = engaged()
    stream.take_state_command(b"\1", BEGIN + 95 * MS)
    assert not stream.engage
    assert "state_command: invalid" in stream.fault


@pytest.mark.parametrize("x", [math.nan, -0.6])
def test_a_velocity_is_finite_and_limited(x):
    stream = engaged(command="servo_cv")
    stream.take_servo_commands([sample(twist(x), 100)])
    assert not stream.engage
    assert stream.fault.startswith("ROS servo_cv: ")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (pose(math.nan), "joint 1 is not finite"),
        (pose(1.5), "beyond 1 m"),
        (pose(0.3), "jump of 0.29 m in 0.01 s, faster than speed_max"),
        (pose(turn=(0.0, 0.0, 0.4)), "jump of 0.4 rad in 0.01 s, faster than turn_speed_max"),
        (pose(stretch=0.9), "no unit quaternion"),
        (pose(stretch=math.nan), "no unit quaternion"),
        (joints(0.01), "invalid message"),
    ],
)
def test_a_wrong_pose_is_a_fault(data, words):
    stream = posed()
    stream.take_servo_commands([sample(data, 100)])
    assert words in stream.fault
    assert stream.fault.startswith("ROS servo_cp: ")
    assert (stream.engage, stream.values) == (False, ())


def test_a_pose_is_a_place_and_angles_that_go_on_beyond_half_a_turn():
    stream = posed()
    for k in range(1, 201):
        turn = (0.01 * k, -0.005 * k, 0.02 * k)
        stream.take_servo_commands([sample(pose(0.01 + 1e-4 * k, turn), 90 + 10 * k)])
        assert stream.values == pytest.approx((0.01 + 1e-4 * k, 0.01, 0.01, *turn), abs=1e-9)
    assert stream.values[5] > math.pi
    assert posed(axes=3).values == (0.01, 0.01, 0.01)


@given(st.lists(st.binary(max_size=120), max_size=20), st.booleans())
def test_no_bytes_move_anything(datas, encapsulated):
    stream = engaged()
    head = b"\0\1\0\0" if encapsulated else b""
    for k, data in enumerate(datas):
        stream.take_servo_commands([sample(head + data, 100 + k)])
    for value in stream.values:
        assert abs(value) <= 1.0
    assert stream.engage == (not stream.fault)
