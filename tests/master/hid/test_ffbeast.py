"""FFBeast: bytes written by hand from the maker's page."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid.driver import build_unknown_controls
from master.devices.hid.wheels import FFBeastDriver

DRIVER = FFBeastDriver()
UNKNOWN = build_unknown_controls(len(DRIVER.axes))


def state(position):
    """A3, firmware 1 2 3 4, registered, position, torque 0x0102, padding: 65 bytes."""
    return (bytes((0xA3, 1, 2, 3, 4, 1)) + position + b"\x02\x01").ljust(65, b"\0")


@pytest.mark.parametrize(
    ("bytes_", "share"),
    [
        (b"\x00\x00", 0.0),
        (b"\x10\x27", 1.0),  # 10000
        (b"\xf0\xd8", -1.0),  # -10000
        (b"\x88\x13", 0.5),  # 5000
        (b"\xff\x7f", 1.0),  # beyond
        (b"\x00\x80", -1.0),
    ],
)
def test_the_position_is_two_bytes_from_the_sixth(bytes_, share):
    assert DRIVER.decode(UNKNOWN, state(bytes_)).axes == (share,)


@pytest.mark.parametrize("report", [b"", b"\xa3", state(b"\1\1")[:7], b"\x01" + state(b"\1\1")[1:]])
def test_another_report_changes_nothing(report):
    assert DRIVER.decode(UNKNOWN, report) is UNKNOWN


@pytest.mark.parametrize(
    ("share", "force"),
    [
        (0.0, b"\x00\x00"),
        (1.0, b"\x10\x27"),
        (-1.0, b"\xf0\xd8"),
        (0.5, b"\x88\x13"),
        (7.0, b"\x10\x27"),
        (-math.inf, b"\xf0\xd8"),
        (math.nan, b"\x00\x00"),
    ],
)
def test_the_force_is_the_constant_one_of_direct_control(share, force):
    (report,) = DRIVER.encode((share,), arm=False)
    assert report == (b"\xa3\x10" + b"\0\0" + force + b"\0\0" + b"\0").ljust(65, b"\0")


def test_setting_up_and_silence_are_direct_control_without_force():
    written = []

    class Device:
        write = staticmethod(written.append)

    DRIVER.begin(Device())
    zero = b"\xa3\x10".ljust(65, b"\0")
    assert written == [zero]
    assert DRIVER.silence() == (zero,)


@given(st.binary(max_size=80), st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_comes_in_shares_are_shares_and_forces_forces(report, share):
    for sent in (report, b"\xa3" + report):
        (axis,) = DRIVER.decode(UNKNOWN, sent).axes
        assert not abs(axis) > 1.0
    (out,) = DRIVER.encode((share,), arm=True)
    assert len(out) == 65
    assert abs(int.from_bytes(out[4:6], "little", signed=True)) <= 10_000
