import struct

import pytest

from master.devices.hid.descriptor import DescriptorError
from master.devices.hid.driver import DriverError, build_unknown_controls
from master.devices.hid.joystick import JoystickDriver
from tests.hid.descriptors import openffboard

DRIVER = JoystickDriver(openffboard())
UNKNOWN = build_unknown_controls(len(DRIVER.axes))


def test_axes_and_buttons_are_read_and_nothing_is_ever_written():
    # OpenFFBoard: id 1, 64 bits of buttons, eight axes of 16 bits
    report = struct.pack("<BQ8h", 1, 0b101, 32767, -32767, 0, 0, 0, 0, 0, 0)
    controls = DRIVER.decode(UNKNOWN, report)
    assert controls.axes[:3] == (1.0, -1.0, 0.0)
    assert controls.buttons == 0b101
    assert DRIVER.encode((), arm=True) == DRIVER.silence() == DRIVER.forces == ()


def test_what_has_no_inputs_is_refused():
    with pytest.raises(DriverError, match="no axes and no buttons"):
        JoystickDriver(b"\x05\x01\x09\x04\xa1\x01\xc0")
    with pytest.raises(DescriptorError):
        JoystickDriver(b"")
