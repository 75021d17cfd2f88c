"""Logitech's classic wheels: commands by hand, the G29's input by its bytes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid.descriptor import parse
from master.devices.hid.driver import DriverError, unknown
from master.devices.hid.logitech import LogitechDriver
from tests.hid.descriptors import logitech_g29, spacemouse

DRIVER = LogitechDriver(parse(logitech_g29()))
UNKNOWN = unknown(len(DRIVER.axes))


def g29(steering=0x8000, buttons=0, accelerator=255, brake=255, clutch=255):
    """Hat at rest and buttons in bytes 0 to 3, steering in 4 and 5, then the pedals."""
    return (8 | buttons << 4).to_bytes(4, "little") + bytes(
        (steering & 255, steering >> 8, accelerator, brake, clutch, 0, 0, 0)
    )


@pytest.mark.parametrize(
    ("share", "level"),
    [(0.0, 0x80), (1.0, 0xFF), (-1.0, 0x01), (0.5, 0xC0), (9.0, 0xFF), (math.nan, 0x80)],
)
def test_a_force_is_played_in_slot_one_behind_a_zero(share, level):
    assert DRIVER.encode((share,), arm=False) == (bytes((0, 0x11, 8, level, 0x80, 0, 0, 0)),)


def test_setting_up_turns_centring_off_and_silence_stops_the_slot():
    written = []

    class Device:
        write = staticmethod(written.append)

    DRIVER.begin(Device())
    stop = bytes((0, 0x13, 0, 0, 0, 0, 0, 0))
    assert written == [bytes((0, 0xF5, 0, 0, 0, 0, 0, 0)), stop]
    assert DRIVER.silence() == (stop,)


@pytest.mark.parametrize(
    ("count", "share"), [(0, -1.0), (65535, 1.0), (0x8000, 0.0), (0xBFFF, 0.5), (0x4000, -0.5)]
)
def test_steering_is_sixteen_bits(count, share):
    x = DRIVER.axes.index("x")
    assert DRIVER.decode(UNKNOWN, g29(count)).axes[x] == pytest.approx(share, abs=2e-5)


def test_pedals_and_buttons_are_told_apart():
    rest = DRIVER.decode(UNKNOWN, g29()).axes
    for pedal in ("accelerator", "brake", "clutch"):
        moved = DRIVER.decode(UNKNOWN, g29(**{pedal: 0})).axes
        assert sum(a != b for a, b in zip(moved, rest, strict=True)) == 1
    assert DRIVER.decode(UNKNOWN, g29(buttons=0b101)).buttons == 0b101


def test_a_device_without_steering_is_refused():
    with pytest.raises(DriverError, match="steering"):
        LogitechDriver(parse(b"\x05\x01\x09\x02\xa1\x01\xc0"))
    LogitechDriver(parse(spacemouse()))  # any x will do: the product says that it is a wheel


@given(st.binary(max_size=14), st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_comes_shares_are_shares_and_levels_levels(report, share):
    controls = DRIVER.decode(UNKNOWN, report)
    assert not any(abs(value) > 1.0 for value in controls.axes)
    (out,) = DRIVER.encode((share,), arm=True)
    assert out[:3] == b"\0\x11\x08"
    assert 0x01 <= out[3] <= 0xFF
    assert math.copysign(1, out[3] - 0x80) == math.copysign(1, share) or out[3] == 0x80
