"""Reports packed by the byte tables, read through the descriptor."""

import struct

import pytest

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import Controls, build_unknown_controls
from master.devices.hid.input_report import InputReportDecoder
from master.devices.hid.joystick import SpaceMouseDriver
from studies.hid import descriptors as d
from studies.hid.descriptors import LAYOUTS, arduino, ffbeast_pid, logitech_g29, openffboard, rhino


def inputs(data):
    return InputReportDecoder(parse_descriptor(data))


def test_openffboard_by_its_table():
    device = inputs(openffboard())
    assert device.axes == ("x", "y", "z", "rx", "ry", "rz", "dial", "slider")
    assert device.buttons == 64
    values = (32767, -32767, 0, 16384, -1, 1, 0, 0)
    report = struct.pack("<BQ8h", 1, 1 << 63 | 5, *values)
    controls = device.decode(build_unknown_controls(len(device.axes)), report)
    assert controls.buttons == 1 << 63 | 5
    assert controls.axes == pytest.approx([value / 32767 for value in values], abs=1e-12)


def test_the_reports_of_others_change_nothing():
    device = inputs(openffboard())
    held = Controls((0.5,) * 8, 3, 3)
    for report in (b"", b"\x01", bytes(24), b"\x02\x1f", b"\x63" + bytes(24), b"\xa1" + bytes(24)):
        assert device.decode(held, report) == held


@pytest.mark.parametrize(("raw", "share"), [(0, -1.0), (65535, 1.0), (32768, 0.5 / 32767.5)])
def test_an_unsigned_wheel_is_centred(raw, share):
    device = inputs(ffbeast_pid())
    report = struct.pack("<BIH", 1, 2, raw) + bytes(57)  # padded
    controls = device.decode(build_unknown_controls(1), report)
    assert controls.axes == pytest.approx((share,), abs=1e-9)
    assert (controls.buttons, controls.known) == (2, (1 << 32) - 1)


def test_pedals_are_one_sided_and_numbers_are_not_needed():
    device = inputs(logitech_g29())
    assert device.axes == ("x", "z", "rz", "y")
    report = struct.pack("<IHBBB3x", 0x08 | 1 << 4, 65535, 255, 0, 255)
    controls = device.decode(build_unknown_controls(len(device.axes)), report)
    assert controls.axes == (1.0, 1.0, 0.0, 1.0)
    assert controls.buttons == 1


@pytest.mark.parametrize(("hat", "pressed"), [(0, "u"), (3, "rd"), (6, "l"), (7, "lu")])
def test_a_hat_is_four_buttons_after_the_others(hat, pressed):
    device = inputs(arduino(n_buttons=12))
    assert device.buttons == 16
    report = struct.pack("<BHBhh", 1, 1 << 11, hat, 0, 0)
    expected = 1 << 11 | sum(1 << 12 + "urdl".index(way) for way in pressed)
    assert device.decode(build_unknown_controls(len(device.axes)), report).buttons == expected


def test_a_hat_at_rest_presses_nothing():
    device = inputs(arduino(n_buttons=8))
    for rest in (8, 15):
        report = struct.pack("<BBBhh", 1, 0, rest, 0, 0)
        assert device.decode(Controls((0.0, 0.0), 1 << 8, 0), report).buttons == 0


def test_rows_of_buttons_apart_and_several_hats():
    device = inputs(rhino())
    assert device.buttons == 80
    report = struct.pack(
        "<B3h4BIHBBH13x", 1, 4096, -4096, 0, 0, 0, 0, 255, 1 << 31, 1, 0xF2, 0x0F, 1 << 15
    )
    assert len(report) == 34
    controls = device.decode(build_unknown_controls(len(device.axes)), report)
    assert controls.axes == (1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    right_of_first, up_of_fourth = 1 << 65, 1 << 76
    assert controls.buttons == 1 << 31 | 1 << 32 | 1 << 63 | right_of_first | up_of_fourth


def test_halves_of_a_device_are_merged():
    device = inputs(LAYOUTS["spacemouse old"])
    first = device.decode(
        build_unknown_controls(len(device.axes)), struct.pack("<B3h", 1, 500, -500, 0)
    )
    both = device.decode(first, struct.pack("<B3h", 2, 250, 0, 0))
    pressed = device.decode(both, b"\x03\x02\x00")
    assert (pressed.axes, pressed.buttons) == ((1.0, -1.0, 0.0, 0.5, 0.0, 0.0), 2)
    assert first.known == 0 != pressed.known
    assert device.decode(pressed, struct.pack("<B3h", 1, 0, 0, 0)).buttons == 2


def test_what_is_out_of_range_is_held_to_the_end():
    device = inputs(LAYOUTS["spacemouse"])
    controls = device.decode(
        build_unknown_controls(len(device.axes)), struct.pack("<B6h", 1, 400, -400, 0, 0, 0, 0)
    )
    assert controls.axes[:2] == (1.0, -1.0)


def test_an_axis_that_says_none_keeps_its_value():
    data = bytes.fromhex("05010904a101150125647508950109308142c0")
    device = inputs(data)
    held = device.decode(build_unknown_controls(len(device.axes)), b"\x64")
    assert held.axes == (1.0,)
    assert device.decode(held, b"\x00") == held


def test_a_second_axis_of_a_kind_has_a_number():
    data = bytes.fromhex("05010904a1011581257f75089503093609360930 8102c0")
    assert inputs(data).axes == ("slider", "slider2", "x")


def pedals(*ids):
    """A device of three buttons, or of three in each of several reports; then an axis x."""
    rows = [(d.report(n) if n else b"") + d.buttons(3 * k + 1, 3 * k + 3) + d.pad(d.INPUT, 5)
            for k, n in enumerate(ids)]  # fmt: skip
    axis = d.page(d.DESKTOP) + d.field(d.INPUT, 8, -127, 127, d.X)
    device = d.collection(d.APPLICATION, *rows, axis)
    return inputs(d.page(d.DESKTOP) + d.usage(d.JOYSTICK) + device)


@pytest.mark.parametrize("held", [0, 0b101])
def test_from_the_first_report_on_every_button_is_known(held):
    device = pedals(0)
    controls = device.decode(build_unknown_controls(1), bytes([held, 0]))
    assert controls == Controls((0.0,), held, 0b111)


def test_the_buttons_of_a_report_that_has_not_come_are_neither_held_nor_known():
    device = pedals(1, 2)
    first = device.decode(build_unknown_controls(1), bytes([1, 0b111]))
    assert (first.buttons, first.known) == (0b111, 0b111)
    second = device.decode(first, bytes([2, 0b001, 127]))
    assert second == Controls((1.0,), 0b001_111, 0b111_111)


DRIVER = SpaceMouseDriver()
REST = Controls((0.0,) * 6, 0, 0)


def decoded(*reports, start=REST):
    controls = start
    for report in reports:
        controls = DRIVER.decode(controls, bytes(report))
    return controls


def test_the_newer_form_has_six_axes_in_one_report():
    # 350 = 5E 01, -350 = A2 FE, 175 = AF 00, -175 = 51 FF
    report = (1, 0x5E, 1, 0xA2, 0xFE, 0xAF, 0, 0x51, 0xFF, 0, 0, 0x5E, 1)
    assert decoded(report).axes == (1.0, -1.0, 0.5, -0.5, 0.0, 1.0)


def test_the_older_form_has_three_and_three():
    moved = decoded((1, 0x5E, 1, 0xA2, 0xFE, 0xAF, 0))
    assert moved.axes == (1.0, -1.0, 0.5, 0.0, 0.0, 0.0)
    turned = decoded((2, 0x51, 0xFF, 0, 0, 0x5E, 1), start=moved)
    assert turned.axes == (1.0, -1.0, 0.5, -0.5, 0.0, 1.0)
    assert decoded((1, 0, 0, 0, 0, 0, 0), start=turned).axes == (0.0, 0.0, 0.0, -0.5, 0.0, 1.0)


def test_buttons_come_alone_and_leave_the_axes():
    held = decoded((1, 0x5E, 1, 0, 0, 0, 0), (3, 0b10, 0b1))
    assert held == Controls((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0b1_0000_0010, (1 << 32) - 1)
    assert decoded((3, 0, 0), start=held).buttons == 0


@pytest.mark.parametrize("report", [(), (1,), (1, 1, 1, 1), (2, 9), (3,), (0x17, 80, 1), (9,) * 13])
def test_what_is_none_of_these_changes_nothing(report):
    assert decoded(report) is REST
