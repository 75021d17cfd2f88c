"""DualSense: bytes by hand, checksums by a CRC written out here."""

import math
from types import SimpleNamespace

import pytest

from master.devices.hid.driver import Controls
from master.devices.hid.dualsense import DualSenseDriver

REST = Controls((0.0,) * 6, 0, 0)
FEEDBACK_8 = bytes((0x21, 0xFF, 0x03, 0xFF, 0xFF, 0xFF, 0x3F, 0, 0, 0, 0))  # ten zones, 8 - 1 = 7
FEEDBACK_1 = bytes((0x21, 0xFF, 0x03, 0, 0, 0, 0, 0, 0, 0, 0))
OFF = bytes((0x05,) + (0,) * 10)


def crc32(data):
    """The usual reflected CRC-32, polynomial EDB88320, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return (crc ^ 0xFFFFFFFF).to_bytes(4, "little")


def payload(l2=0, r2=0, sticks=(128, 128, 128, 128), b8=8, b9=0, b10=0):
    """What byte 1 of a USB report begins."""
    return bytes((*sticks, l2, r2, 77, b8, b9, b10))


def usb(**settings):
    return (b"\x01" + payload(**settings)).ljust(64, b"\0")


def bluetooth(**settings):
    covered = (b"\x31\x10" + payload(**settings)).ljust(74, b"\0")
    return covered + crc32(b"\xa1" + covered)


def trigger_effects(report, bluetooth=False):
    """Right and left, bytes 11 to 21 and 22 to 32; two further on over Bluetooth, from byte 3."""
    at = 13 if bluetooth else 11
    return report[at : at + 11], report[at + 11 : at + 22]


@pytest.mark.parametrize("form", [usb, bluetooth])
def test_triggers_run_from_0_to_1_in_bytes_5_and_6_and_sticks_rest_at_128(form):
    driver = DualSenseDriver()
    assert driver.decode(REST, form(l2=255)).axes[4:] == (1.0, 0.0)
    assert driver.decode(REST, form(r2=51)).axes == (0.0, 0.0, 0.0, 0.0, 0.0, 0.2)
    assert driver.decode(REST, form(sticks=(0, 255, 255, 0))).axes[:4] == (-1.0, 1.0, 1.0, -1.0)


@pytest.mark.parametrize(
    ("byte", "value", "button"),
    [("b8", 0x18, 1), ("b8", 0x88, 4), ("b9", 0x01, 5), ("b9", 0x80, 12), ("b10", 0x10, 17)],
)  # square and triangle with the hat at rest, L1, R3, the Edge's last
def test_each_button_is_its_own_bit(byte, value, button):
    assert DualSenseDriver().decode(REST, usb(**{byte: value})).buttons == 1 << (button - 1)


def test_what_is_no_full_report_or_has_a_wrong_checksum_changes_nothing():
    driver = DualSenseDriver(bluetooth=True)
    for report in (b"", b"\x01", usb()[:63], b"\x02" + usb()[1:], b"\x31" * 77):
        assert DualSenseDriver().decode(REST, report) is driver.decode(REST, report) is REST
    good = bluetooth(l2=255)
    assert driver.decode(REST, good) != REST
    for place in (2, 6, 40, 77):
        bad = bytearray(good)
        bad[place] ^= 1
        assert driver.decode(REST, bytes(bad)) is REST


def test_a_force_against_the_pull_is_resistance_in_eight_steps():
    driver = DualSenseDriver()
    (report,) = driver.encode((-1.0, 0.0), arm=False)
    assert len(report) == 48
    assert report[:3] == b"\x02\x0c\x00"  # both triggers are valid, nothing else is
    assert trigger_effects(report) == (OFF, FEEDBACK_8)
    (report,) = driver.encode((0.0, -0.01), arm=False)
    assert trigger_effects(report) == (FEEDBACK_1, OFF)
    assert report[33:] == bytes(15)
    steps = {
        trigger_effects(report)[0]
        for k in range(1, 101)
        for report in driver.encode((0.0, -k / 100), arm=False)
    }
    assert len(steps) == 7  # of eight: the first one is in force already


@pytest.mark.parametrize("force", [0.5, 1.0, math.nan, math.inf])
def test_it_never_pulls_and_what_is_no_number_is_no_force(force):
    (report,) = DualSenseDriver().encode((force, force), arm=False)
    assert trigger_effects(report) == (OFF, OFF)


def test_it_is_told_what_changes_and_to_arm_it_everything_again():
    driver = DualSenseDriver()
    (first,) = driver.encode((-0.50, 0.0), arm=True)
    assert driver.encode((-0.45, 0.0), arm=False) == ()  # the same step
    assert driver.encode((-0.45, 0.0), arm=True) == (first,)  # it may have been lost
    assert driver.encode((-0.30, 0.0), arm=False)
    assert driver.encode((-0.30, 0.1), arm=False) == ()


def test_over_bluetooth_reports_are_numbered_and_signed():
    driver = DualSenseDriver(bluetooth=True)
    for number in range(18):
        (report,) = driver.encode((-1.0 if number % 2 else 0.0, 0.0), arm=False)
        assert len(report) == 78
        assert report[:5] == bytes((0x31, number % 16 << 4, 0x10, 0x0C, 0x00))
        assert report[74:] == crc32(b"\xa2" + report[:74])
        assert trigger_effects(report, bluetooth=True)[1] == (FEEDBACK_8 if number % 2 else OFF)


def test_setting_up_lets_go_and_over_bluetooth_asks_for_full_reports():
    for over_bluetooth, asked_for in ((False, []), (True, [(0x05, 41)])):
        asked, written = [], []
        device = SimpleNamespace(
            write=written.append,
            get_feature=lambda *what, asked=asked: asked.append(what) or bytes(what[1]),
        )
        driver = DualSenseDriver(over_bluetooth)
        driver.begin(device)
        assert asked == asked_for
        for (report,) in (written, driver.silence()):
            assert trigger_effects(report, over_bluetooth) == (OFF, OFF)
