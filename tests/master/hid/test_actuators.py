"""PID State reports: what they say against a force, when, and to whom."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.device import DeviceFault
from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.device import HidDevice
from master.devices.hid.driver import ActuatorReports, ActuatorState
from master.devices.hid.input_map import AxisConfig, HidConfig
from studies.hid import descriptors
from studies.hid.virtual.catalogue import DEVICES
from studies.hid.virtual.sidewinder import SideWinder
from studies.testbed.processes import wait_for_condition
from tests.master.reading import comes_back, reads, said

BOARD = ActuatorReports(parse_descriptor(descriptors.openffboard()))
ARDUINO = ActuatorReports(parse_descriptor(descriptors.arduino()))
RHINO = ActuatorReports(parse_descriptor(descriptors.rhino()))
CONFIG = HidConfig(axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)

PAUSED, ENABLED, SAFETY, _, POWER = (1 << bit for bit in range(5))  # of the Arduino library
READY = ENABLED | SAFETY | POWER


def state(*flags):
    known = ActuatorState()
    for value in flags:
        known = ARDUINO.decode(known, bytes((2, value, 0)))
    return known


@pytest.mark.parametrize(
    ("flags", "fault"),
    [
        (READY & ~POWER, "no power"),
        (READY & ~ENABLED, "actuators are disabled"),
        (READY | PAUSED, "it is paused"),
    ],
)
def test_what_goes_off_is_named_until_it_is_on_again(flags, fault):
    off = state(READY, flags)
    assert len(off.faults) == 1
    assert fault in off.faults[0]
    assert off.read().faults == off.faults
    on = state(READY, flags, READY)
    assert on.faults == off.faults  # it was off meanwhile: however short, that is said once
    assert on.read().faults == ()


def test_a_condition_that_was_never_met_says_nothing_but_to_be_met_is_a_surprise():
    assert state(0).faults == ()
    never = state(ENABLED | POWER, ENABLED | POWER)  # OpenFFBoard's safety switch
    assert never.faults == ()
    met = ARDUINO.decode(never, bytes((2, READY, 0)))
    assert "safety switch" in met.faults[0]
    assert met.read().faults == ()


@pytest.mark.parametrize(
    ("reports", "ready", "off"),
    [
        (BOARD, "020a", "0209"),  # power and enabled; power and paused
        (ARDUINO, "021600", "021500"),
        (RHINO, "02001c", "02001a"),
    ],
)
def test_each_firmware_has_its_own_place_for_them(reports, ready, off):
    known = reports.decode(ActuatorState(), bytes.fromhex(ready))
    assert known.faults == ()
    faults = reports.decode(known, bytes.fromhex(off)).faults
    assert any("disabled" in fault for fault in faults)
    assert any("paused" in fault for fault in faults)


@given(st.sampled_from([BOARD, ARDUINO, RHINO]), st.lists(st.binary(max_size=4), max_size=5))
def test_no_bytes_are_too_strange(reports, given_reports):
    known = ActuatorState()
    for report in given_reports:
        known = reports.decode(known, report)
        assert known.interrupted & ~known.known == 0
    assert reports.decode(known, b"\x01" + bytes(10)) is known
    assert reports.decode(known, b"\x02") is known


@pytest.fixture(params=["openffboard", "sidewinder", "rhino"])
def opened(request, hidraw):
    firmware = DEVICES[request.param]()
    firmware.interval = 0.010
    node = hidraw.plug(firmware)
    device = HidDevice(CONFIG, lambda _line: None)
    device.read(0.0)
    assert wait_for_condition(
        lambda: said(device) == "" and device.read(0.0).position == (0.0,), 30.0
    )
    wait_for_condition(
        lambda: said(device) != "", 0.1
    )  # until all that the beginning caused is read
    yield node, device
    device.close()


def test_power_that_goes_and_a_pause_by_another_program_are_faults_that_name_the_device(opened):
    node, device = opened
    assert not wait_for_condition(lambda: said(device) != "", 0.1)  # how it was reset and enabled
    node.device.powered = False
    assert wait_for_condition(lambda: "no power" in said(device), 30.0)
    assert node.device.name in said(device)
    node.device.powered = True
    assert comes_back(device)
    assert node.handles  # it was not closed meanwhile
    assert not any(node.force())
    pause = {"openffboard": b"\x0c\x10", "sidewinder": b"\x0c\x05", "rhino": b"\x70\x05"}
    node.device.take_output(node.bus.clock(), pause[type(node.device).__name__.lower()])
    assert wait_for_condition(lambda: "close other programs" in said(device), 30.0)


NONE = (0.0, 0.0)


def stick():
    """A stick that is held to the side, so that its spring pushes back."""
    device = SideWinder(descriptors.arduino())
    device.axes = [1.0, -0.5]
    device.interval = 0.010
    return device


def open_device():
    return HidDevice(CONFIG, lambda _line: None)


def test_opened_replugged_and_after_a_fault_it_does_not_push(hidraw):
    node = hidraw.plug(stick())
    assert any(node.force())
    device = open_device()
    assert node.force() == NONE
    hidraw.unplug(node)
    assert not reads(device)
    back = hidraw.plug(stick())
    assert any(back.force())
    assert comes_back(device)
    assert back.force() == NONE
    at_its_end = 0.1  # so its state is known
    assert wait_for_condition(lambda: device.read(0.0).position == (at_its_end,), 30.0)
    back.device.powered = False
    assert wait_for_condition(lambda: not reads(device), 30.0)
    back.device.powered = True
    assert comes_back(device)
    assert back.force() == NONE
    device.close()
    assert back.force() == NONE


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

        def control_device(self, report):
            if report[1] == 3 and self.refusals:
                self.refusals -= 1
                raise OSError("stalled")
            super().control_device(report)

    device = Flaky(descriptors.arduino())
    device.axes = [1.0, 0.0]
    node = hidraw.plug(device)
    with pytest.raises(DeviceFault):
        open_device()
    assert node.force() == NONE
