"""Wheels: Logitech's classic ones and FFBeast, commands and inputs by their bytes."""

import math
from types import SimpleNamespace

import pytest

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import build_unknown_controls
from master.devices.hid.driver_table import DRIVERS, AttachedNode
from master.devices.hid.pid import PidConfig
from master.devices.hid.wheels import LOGITECH_PRODUCTS, FFBeastDriver, LogitechDriver
from studies.hid.descriptors import logitech_g29

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


# the table of hid-lg4ff.c and hid-ids.h of Linux; C24F and C266 of berarma/new-lg4ff
CLASSIC = {
    0xC293, 0xC294, 0xC295, 0xC298, 0xC299, 0xC29A, 0xC29B, 0xC29C, 0xCA03, 0xC24F, 0xC266,
}  # fmt: skip


def written_by(product, release=0x0100):
    item = AttachedNode("p", 0x046D, product, release=release)
    data, written = logitech_g29(), []
    assert DRIVERS["logitech"].misfit(item, data) == ""
    driver = DRIVERS["logitech"].make(item, data, PidConfig(), None)
    driver.begin(SimpleNamespace(write=written.append))
    assert driver.silence() == (written[-1],)  # stops the slot
    return [report.hex() for report in written]


def test_every_wheel_of_the_kernel_and_no_other_gets_the_classic_commands():
    assert set(LOGITECH_PRODUCTS) == CLASSIC
    for product in CLASSIC:
        assert written_by(product) == ["00f5000000000000", "0013000000000000"]


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
        (0xC26E, 0, "not a classic Logitech wheel"),  # G923 for Xbox, HID++
    ],
)
def test_what_does_not_speak_them_is_refused(product, interface, why):
    item = AttachedNode("p", 0x046D, product, interface=interface)
    assert why in DRIVERS["logitech"].misfit(item, logitech_g29())


@pytest.mark.parametrize(
    ("count", "share"), [(0, -1.0), (65535, 1.0), (0x8000, 0.0), (0xBFFF, 0.5)]
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


FFBEAST = FFBeastDriver()
ONE_UNKNOWN = build_unknown_controls(1)


def ffbeast_state(position):
    """A3, firmware 1 2 3 4, registered, position, torque 0x0102, padding: 65 bytes."""
    return (bytes((0xA3, 1, 2, 3, 4, 1)) + position + b"\x02\x01").ljust(65, b"\0")


@pytest.mark.parametrize(
    ("bytes_", "share"),
    [
        (b"\x00\x00", 0.0),
        (b"\x10\x27", 1.0),  # 10000
        (b"\xf0\xd8", -1.0),  # -10000
        (b"\xff\x7f", 1.0),  # beyond
        (b"\x00\x80", -1.0),
    ],
)
def test_the_position_is_two_bytes_from_the_sixth(bytes_, share):
    assert FFBEAST.decode(ONE_UNKNOWN, ffbeast_state(bytes_)).axes == (share,)
    for other in (b"", b"\xa3", ffbeast_state(bytes_)[:7], b"\x01" + ffbeast_state(bytes_)[1:]):
        assert FFBEAST.decode(ONE_UNKNOWN, other) is ONE_UNKNOWN


@pytest.mark.parametrize(
    ("share", "force"),
    [
        (0.0, b"\x00\x00"),
        (0.5, b"\x88\x13"),
        (7.0, b"\x10\x27"),
        (-math.inf, b"\xf0\xd8"),
        (math.nan, b"\x00\x00"),
    ],
)
def test_the_force_is_the_constant_one_of_direct_control(share, force):
    (report,) = FFBEAST.encode((share,), arm=False)
    assert report == (b"\xa3\x10" + b"\0\0" + force + b"\0\0" + b"\0").ljust(65, b"\0")


def test_ffbeast_is_set_up_and_silenced_by_direct_control_without_force():
    written, zero = [], b"\xa3\x10".ljust(65, b"\0")
    FFBEAST.begin(SimpleNamespace(write=written.append))
    assert written == [zero] == list(FFBEAST.silence())
