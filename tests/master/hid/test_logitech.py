"""Logitech's classic wheels: commands by hand, the G29's input by its bytes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import DriverError, build_unknown_controls
from master.devices.hid.drivers import DRIVERS, AttachedNode
from master.devices.hid.pid import PidConfig
from master.devices.hid.wheels import LOGITECH_PRODUCTS, LogitechDriver
from tests.hid.descriptors import logitech_g29, spacemouse

DRIVER = LogitechDriver(parse_descriptor(logitech_g29()))
UNKNOWN = build_unknown_controls(len(DRIVER.axes))


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


# the table of hid-lg4ff.c and hid-ids.h of Linux; C24F and C266 of berarma/new-lg4ff
CLASSIC = [
    (0xC293, "WINGMAN_FFG"),
    (0xC294, "WHEEL"),
    (0xC295, "MOMO_WHEEL"),
    (0xC298, "DFP_WHEEL"),
    (0xC299, "G25_WHEEL"),
    (0xC29A, "DFGT_WHEEL"),
    (0xC29B, "G27_WHEEL"),
    (0xC29C, "WII_WHEEL"),
    (0xCA03, "MOMO_WHEEL2"),
    (0xC24F, "G29_WHEEL"),
    (0xC266, "G923_WHEEL"),
]


def written_by(product, release=0x0100):
    """Return what is written to a wheel at the beginning."""
    item = AttachedNode("p", 0x046D, product, release=release)
    data, written = logitech_g29(), []
    assert DRIVERS["logitech"].misfit(item, data) == ""
    device = type("Device", (), {"write": staticmethod(written.append)})
    DRIVERS["logitech"].make(item, data, PidConfig(), None).begin(device)
    return [report.hex() for report in written]


@pytest.mark.parametrize(("product", "_name"), CLASSIC)
def test_every_wheel_of_the_kernel_gets_the_classic_commands(product, _name):
    assert written_by(product) == ["00f5000000000000", "0013000000000000"]


def test_the_driver_fits_those_wheels_and_no_others():
    assert set(LOGITECH_PRODUCTS) == {product for product, _ in CLASSIC}


def test_formula_force_ex_has_a_centring_command_of_its_own():
    """The kernel tells it by its release, 21.00; others of this product take the usual one."""
    assert written_by(0xC294, 0x2100) == ["00fe030000000000", "0013000000000000"]
    assert written_by(0xC294, 0x1350)[0] == "00f5000000000000"
    assert written_by(0xC29B, 0x2100)[0] == "00f5000000000000"


@pytest.mark.parametrize(
    ("product", "interface", "why"),
    [
        (0xC267, 0, "a G923 in console mode"),
        (0xC266, 1, "another interface"),
        (0xC262, 0, "not a classic Logitech wheel"),  # G920, HID++
        (0xC26E, 0, "not a classic Logitech wheel"),  # G923 for Xbox, HID++
    ],
)
def test_what_does_not_speak_them_is_refused(product, interface, why):
    item = AttachedNode("p", 0x046D, product, interface=interface)
    assert why in DRIVERS["logitech"].misfit(item, logitech_g29())


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
        LogitechDriver(parse_descriptor(b"\x05\x01\x09\x02\xa1\x01\xc0"))
    LogitechDriver(
        parse_descriptor(spacemouse())
    )  # any x will do: the product says that it is a wheel


@given(st.binary(max_size=14), st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_comes_shares_are_shares_and_levels_levels(report, share):
    controls = DRIVER.decode(UNKNOWN, report)
    assert not any(abs(value) > 1.0 for value in controls.axes)
    (out,) = DRIVER.encode((share,), arm=True)
    assert out[:3] == b"\0\x11\x08"
    assert 0x01 <= out[3] <= 0xFF
    assert math.copysign(1, out[3] - 0x80) == math.copysign(1, share) or out[3] == 0x80
