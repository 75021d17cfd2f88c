"""PID State reports: what they say against a force, when, and to whom."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.device import DeviceLost
from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.device import HidDevice
from master.devices.hid.driver import ActuatorReports, ActuatorState
from master.devices.hid.mapping import AxisConfig, HidConfig
from teleop.launch.supervisor import wait_for_condition
from tests.hid import descriptors
from tests.hid.virtual.catalogue import DEVICES

BOARD = ActuatorReports(parse_descriptor(descriptors.openffboard()))
ARDUINO = ActuatorReports(parse_descriptor(descriptors.arduino()))
RHINO = ActuatorReports(parse_descriptor(descriptors.rhino()))
CONFIG = HidConfig(axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)

PAUSED, ENABLED, SAFETY, OVERRIDE, POWER = (1 << bit for bit in range(5))  # of the Arduino library
READY = ENABLED | SAFETY | POWER


def state(*flags):
    """Return what is known after reports with these flags."""
    known = ActuatorState()
    for value in flags:
        known = ARDUINO.decode(known, bytes((2, value, 0)))
    return known


@pytest.mark.parametrize(
    ("flags", "fault"),
    [
        (READY & ~POWER, "no power"),
        (READY & ~SAFETY, "safety switch is open"),
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


def test_several_are_named_together():
    assert len(state(READY, PAUSED).faults) == 4


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


def test_other_reports_say_nothing():
    known = state(READY)
    assert ARDUINO.decode(known, b"\x01" + bytes(10)) is known
    assert ARDUINO.decode(known, b"\x02") is known
    assert (
        ActuatorReports(parse_descriptor(descriptors.spacemouse())).decode(known, bytes(9)) is known
    )


def said(device, time_s=10.0):
    """Return what the device says against itself; empty if it is read."""
    try:
        device.read(time_s)
    except DeviceLost as error:
        return str(error)
    return ""


@pytest.fixture(params=["openffboard", "sidewinder", "rhino"])
def opened(request, hidraw):
    firmware = DEVICES[request.param]()
    firmware.interval = 0.010
    node = hidraw.plug(firmware)
    device = HidDevice(CONFIG, lambda _line: None)
    device.read(0.0)
    assert wait_for_condition(
        lambda: said(device, 0.0) == "" and device.read(0.0).position == (0.0,), 30.0
    )
    wait_for_condition(
        lambda: said(device, 0.0) != "", 0.1
    )  # until all that the beginning caused is read
    yield node, device
    device.close()


def test_how_it_was_reset_and_enabled_is_no_fault(opened):
    _, device = opened
    assert not wait_for_condition(lambda: said(device) != "", 0.1)


def test_power_that_goes_is_a_fault_that_names_the_device_until_it_is_back(opened):
    node, device = opened
    node.device.powered = False
    assert wait_for_condition(lambda: "no power" in said(device), 30.0)
    assert node.device.name in said(device)
    node.device.powered = True
    assert wait_for_condition(lambda: said(device) == "", 30.0)
    assert node.handles  # it was not closed meanwhile
    assert node.force() == (0.0,) * len(node.device.axes)


def test_another_program_that_pauses_it_is_a_fault(opened):
    node, device = opened
    pause = {"openffboard": b"\x0c\x10", "sidewinder": b"\x0c\x05", "rhino": b"\x70\x05"}
    kind = type(node.device).__name__.lower()
    node.device.output(node.bus.clock(), pause[kind])
    assert wait_for_condition(lambda: said(device) != "", 30.0)
    assert "close other programs" in said(device)
