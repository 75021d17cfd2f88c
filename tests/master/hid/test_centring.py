"""A device that centres by itself pushes nobody once it was opened, whatever happens then."""

import pytest

from master.device import DeviceFault, DeviceLost
from master.devices.hid.device import HidDevice
from master.devices.hid.mapping import AxisConfig, HidConfig
from master.devices.hid.pid import PidDriver
from teleop.launch.supervisor import wait_for_condition
from tests.hid import descriptors
from tests.hid.virtual.sidewinder import CENTRING, SideWinder
from tests.master.hid.test_pid_devices import Cable

CONFIG = HidConfig(axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)
NONE = (0.0, 0.0)


def stick():
    """A stick that is held to the side, so that its spring pushes back."""
    device = SideWinder(descriptors.arduino())
    device.axes = [1.0, -0.5]
    device.interval = 0.010
    return device


def open_device():
    return HidDevice(CONFIG, lambda _line: None)


def reads(device):
    try:
        device.read(0.0)
    except DeviceLost:
        return False
    return True


def test_it_centres_from_power_on_and_from_each_reset_until_stop_all():
    device = stick()
    assert device.force(0.0) == (-CENTRING, 0.5 * CENTRING)
    device.output(0.0, b"\x0c\x03")
    assert device.force(0.0) == NONE
    device.output(0.0, b"\x0c\x04")
    assert device.force(0.0) == (-CENTRING, 0.5 * CENTRING)


def test_opened_and_closed_it_does_not_push(hidraw):
    node = hidraw.plug(stick())
    assert any(node.force())
    device = open_device()
    assert node.force() == NONE
    device.close()
    assert node.force() == NONE


def test_back_from_a_replug_it_does_not_push(hidraw):
    node = hidraw.plug(stick())
    device = open_device()
    hidraw.unplug(node)
    assert not reads(device)
    back = hidraw.plug(stick())
    assert any(back.force())
    assert wait_for_condition(lambda: reads(device), 30.0)
    assert back.force() == NONE
    device.close()
    assert back.force() == NONE


def test_after_a_fault_it_does_not_push(hidraw):
    node = hidraw.plug(stick())
    device = open_device()
    assert wait_for_condition(
        lambda: device.read(0.0).position == (0.1,), 30.0
    )  # so its state is known
    node.device.powered = False
    assert wait_for_condition(lambda: not reads(device), 30.0)
    node.device.powered = True
    assert wait_for_condition(lambda: reads(device), 30.0)
    assert node.force() == NONE
    device.close()
    assert node.force() == NONE


@pytest.mark.parametrize("said", [b"\x06\x00\x02\x00\x00", b"\x06\x00\x03\x00\x00"])
def test_a_beginning_that_fails_does_not_leave_it_pushing(hidraw, said, monkeypatch):
    node = hidraw.plug(stick())
    monkeypatch.setattr(node.device, "get_feature", lambda _now, _number: said)
    with pytest.raises(DeviceFault):
        open_device()
    assert node.force() == NONE
    assert node.handles == []


def test_a_beginning_that_fails_right_after_the_reset_does_not_leave_it_pushing(hidraw):
    class Flaky(SideWinder):
        """Refuses the first Stop All Effects."""

        refusals = 1

        def device_control(self, report):
            if report[1] == 3 and self.refusals:
                self.refusals -= 1
                raise OSError("stalled")
            super().device_control(report)

    device = Flaky(descriptors.arduino())
    device.axes = [1.0, 0.0]
    node = hidraw.plug(device)
    with pytest.raises(DeviceFault):
        open_device()
    assert node.force() == NONE


def test_left_by_a_process_that_was_killed_it_does_not_push_nor_at_the_next_start():
    device = stick()
    cable, driver = Cable(device), PidDriver(device.descriptor)
    driver.begin(cable)
    assert any(cable.push(driver, (0.5, 0.0)))
    cable.now = 0.25  # and not a byte more
    assert device.force(cable.now) == NONE
    again = PidDriver(device.descriptor)
    again.begin(cable)
    assert device.force(cable.now) == NONE
    for report in again.silence():
        cable.write(report)
    assert device.force(cable.now) == NONE
