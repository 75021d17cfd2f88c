import pytest

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.usages import describe_descriptor
from tests.hid.descriptors import LAYOUTS


def block(lines, headline):
    """The lines that belong to a report."""
    start = lines.index(headline) + 1
    end = next((k for k in range(start, len(lines)) if lines[k][0] != " "), len(lines))
    return lines[start:end]


def test_a_force_feedback_device_in_words():
    lines = describe_descriptor(parse_descriptor(LAYOUTS["rhino"]))
    assert lines[0] == "joystick"
    assert block(lines, "output report 105 (0x69), 4 bytes: Set Constant Force") == [
        "  byte 1: effect block index, 8 bits, 1 ... 64",
        "  byte 2: magnitude, 16 bits, -4096 ... 4096",
    ]
    assert block(lines, "output report 112 (0x70), 2 bytes: Device Control") == [
        "  byte 1: Device Control, 8 bits, 1 ... 6: 1 disable actuators, 2 enable actuators, "
        "3 stop all effects, 4 device reset, 5 device pause, 6 device continue",
    ]


def test_bits_units_and_rows():
    lines = describe_descriptor(parse_descriptor(LAYOUTS["openffboard 2"]))
    effect = block(lines, "output report 1 (0x01), 22 bytes: Set Effect")
    assert "  byte 3: duration, 16 bits, 0 ... 32767 (times 1e-3 s)" in effect
    assert "  byte 13 bit 2: direction enable, 1 bit, 0 ... 1" in effect
    inputs = block(lines, "input report 1 (0x01), 25 bytes")
    assert inputs[0] == "  byte 1 bit 0: button 1 ... button 64, 64 times 1 bit, 0 ... 1"
    assert len(inputs) == 9
    hat = "  byte 8 bit 0: hat, 4 bits, 0 ... 7 (physical 0 ... 315 deg), may be none"
    assert hat in describe_descriptor(parse_descriptor(LAYOUTS["dualsense"]))


def test_a_row_of_buttons_ends_at_a_gap():
    some = bytes.fromhex("05010904a1010509150025017501950409010902090409058102c0")
    assert [line for line in describe_descriptor(parse_descriptor(some)) if line[0] == " "] == [
        "  byte 0 bit 0: button 1 ... button 2, 2 times 1 bit, 0 ... 1",
        "  byte 0 bit 2: button 4 ... button 5, 2 times 1 bit, 0 ... 1",
    ]


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_report_has_its_block(name):
    descriptor = parse_descriptor(LAYOUTS[name])
    headlines = [
        line for line in describe_descriptor(descriptor) if " report" in line and line[0] != " "
    ]
    assert len(headlines) == len(descriptor.reports)
    for report, headline in zip(descriptor.reports, headlines, strict=True):
        assert headline.startswith(f"{report.kind.value} report")
        assert f"{report.length} bytes" in headline
