"""A G923 in console mode: its one report as bytes, what follows it, and what is not switched."""

import pytest

from master.device import DeviceFault, DeviceLost
from master.devices.hid import search
from master.devices.hid.device import HidDevice
from master.devices.hid.mapping import AxisConfig, HidConfig
from teleop.launch.supervisor import wait_for_condition
from tests.hid import descriptors
from tests.hid.virtual.logitech import Logitech
from tests.hid.virtual.openffboard import OpenFFBoard

SWITCH = bytes.fromhex("30 f8 09 07 01 01 00 00")  # berarma/new-lg4ff: report 30, then 7 bytes
CENTRE_OFF = bytes.fromhex("00 f5 00 00 00 00 00 00")
STOP = bytes.fromhex("00 13 00 00 00 00 00 00")


class Wheel(Logitech):
    """A G923 in PC mode."""

    name, product = "Logitech G923 Racing Wheel", 0xC266


class ConsoleWheel(Logitech):
    """A G923 in console mode, which takes one report and is then another device."""

    name, product = "Logitech G923 Racing Wheel", 0xC267

    def __init__(self, bus, leaves=True):
        super().__init__(descriptors.logitech_g29())
        self.bus, self.leaves, self.now = bus, leaves, None

    def output(self, _now, report):
        if report != SWITCH:
            self.refused.append(report)
        elif self.leaves:
            node = next(node for node in self.bus.nodes.values() if node.device is self)
            self.bus.unplug(node)
            self.now = self.bus.plug(wheel())


def wheel():
    device = Wheel(descriptors.logitech_g29())
    device.interval = 0.010
    return device


def config(find=""):
    return HidConfig(find=find, axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)


def reads(device):
    try:
        device.read(0.0)
    except DeviceLost:
        return False
    return True


@pytest.mark.parametrize("find", ["", "046d:c267", "046d:c266"])
def test_it_is_switched_over_with_the_one_report_and_driven_by_classic_commands(hidraw, find):
    before = ConsoleWheel(hidraw)
    node, said = hidraw.plug(before), []
    device = HidDevice(config(find), said.append)
    assert node.written == [SWITCH]
    assert before.now.written[:2] == [CENTRE_OFF, STOP]
    assert "switched from console to PC mode" in said[0]
    assert wait_for_condition(lambda: reads(device), 30.0)
    device.close()
    assert before.now.device.refused == []


def test_back_in_console_mode_after_a_replug_it_is_switched_over_again(hidraw):
    node = hidraw.plug(wheel())
    device = HidDevice(config(), lambda _line: None)
    hidraw.unplug(node)
    assert not reads(device)
    back = ConsoleWheel(hidraw)
    hidraw.plug(back)
    assert wait_for_condition(lambda: reads(device), 30.0)
    assert CENTRE_OFF in back.now.written
    device.close()


def test_another_one_in_console_mode_is_left_alone_by_a_replug(hidraw):
    node, other = hidraw.plug(wheel()), hidraw.plug(ConsoleWheel(hidraw))
    device = HidDevice(config(str(node.path)), lambda _line: None)
    hidraw.unplug(node)
    assert not reads(device)
    assert not wait_for_condition(lambda: other.written or reads(device), 0.5)
    device.close()


def test_beside_another_device_it_must_be_selected(hidraw):
    node = hidraw.plug(ConsoleWheel(hidraw))
    hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    assert search.leave_console_mode("", "auto") == ""
    assert search.leave_console_mode("1209:ffb0", "auto") == ""
    assert search.leave_console_mode("046d:c267", "joystick") == ""
    assert node.written == []
    assert search.find_device("", "auto").kind == "pid"
    assert search.leave_console_mode("046d:c267", "auto")
    assert node.written == [SWITCH]


def test_one_that_stays_in_console_mode_is_said(hidraw, monkeypatch):
    monkeypatch.setattr(search, "MODE_SWITCH_TIMEOUT_S", 0.1)
    hidraw.plug(ConsoleWheel(hidraw, leaves=False))
    with pytest.raises(DeviceFault, match="does not leave its console mode"):
        HidDevice(config(), lambda _line: None)


def test_one_that_may_not_be_opened_is_said_with_the_remedy(hidraw, monkeypatch):
    hidraw.plug(ConsoleWheel(hidraw))
    monkeypatch.setattr(search.os, "access", lambda *_: False)
    with pytest.raises(DeviceFault, match="no permission to open"):
        HidDevice(config(), lambda _line: None)
