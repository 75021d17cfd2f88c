"""The driver with devices that read its bytes on their own, by offsets written down by hand."""

import pytest

from master.device import DeviceFault
from master.devices.hid.driver import DriverError
from master.devices.hid.pid import PidConfig, PidDriver
from tests.hid.virtual.catalogue import DEVICES

# whether a device pushes where the driver, by the standard, believes it does
SIGNS = {"openffboard": 1, "openffboard-wheel": 1, "arduino": -1, "sidewinder": -1, "rhino": 1}
NEARLY = 0.01  # by which gain bytes and a direction of 8 bits miss the share asked for


class Cable:
    """`Features` of a virtual device, and the time there."""

    def __init__(self, device):
        self.device = device
        self.now = 0.0

    def write(self, report):
        self.device.output(self.now, report)

    def send_feature(self, report):
        self.device.set_feature(self.now, report)

    def get_feature(self, number, length):
        return self.device.get_feature(self.now, number)[:length]

    def get_input(self, number, length):
        report = self.device.get_input(self.now, number)
        if report is None:
            raise DeviceFault("it does not answer")
        return report[:length]

    def push(self, driver, force, arm=True):
        for report in driver.encode(force, arm):
            self.write(report)
        return self.device.force(self.now)


@pytest.fixture(params=SIGNS)
def plugged(request):
    device = DEVICES[request.param]()
    cable, driver = Cable(device), PidDriver(device.descriptor, PidConfig(spring=0.2, damper=0.1))
    driver.begin(cable)
    assert device.active
    return request.param, cable, driver


def zero(driver):
    return (0.0,) * len(driver.forces)


def test_every_force_is_felt_on_its_axis(plugged):
    name, cable, driver = plugged
    axes = len(driver.forces)
    assert cable.device.force(0.0) == zero(driver)
    for asked in ((0.5, 0.0), (0.0, -0.5), (-1.0, 0.25), (0.0, 0.0)):
        felt = cable.push(driver, asked[:axes])
        assert felt == pytest.approx([SIGNS[name] * share for share in asked[:axes]], abs=NEARLY)
    assert cable.device.refused == []


def test_a_force_lives_while_it_is_armed_and_dies_without(plugged):
    _, cable, driver = plugged
    asked = (0.5, 0.5)[: len(driver.forces)]
    for tick in range(1000):
        cable.now = tick * 1e-3
        assert all(cable.push(driver, asked, arm=tick % 50 == 0))
    last_arm, end = 0.950, cable.now
    cable.now = end + 1e-3
    assert any(cable.device.force(cable.now))
    for tick in range(250):  # a host that writes magnitudes but starts nothing is dead as well
        cable.now = end + tick * 1e-3
        cable.push(driver, asked, arm=False)
    assert cable.device.force(last_arm + 0.250) == zero(driver)
    assert cable.device.force(cable.now) == zero(driver)
    assert all(cable.push(driver, asked))


def test_a_spring_and_a_damper_reach_every_axis(plugged):
    _, cable, driver = plugged
    conditions = {e.kind: set(e.conditions) for e in cable.device.effects.values() if e.kind > 1}
    assert conditions == {8: set(range(len(driver.forces))), 9: set(range(len(driver.forces)))}


def test_a_spring_and_a_damper_act_only_while_there_is_a_force(plugged):
    _, cable, driver = plugged
    device = cable.device

    def acting():
        return {e.kind for e in device.effects.values() if e.kind > 1 and e.plays(cable.now)}

    asked = (0.1, 0.1)[: len(driver.forces)]
    for now, force, arm, kinds in (
        (0.00, zero(driver), True, set()),
        (0.05, asked, True, {8, 9}),
        (0.06, asked, False, {8, 9}),
        (0.07, zero(driver), False, set()),
        (0.10, zero(driver), True, set()),
        (0.15, asked, True, {8, 9}),
    ):
        cable.now = now
        cable.push(driver, force, arm)
        assert acting() == kinds
    cable.now = 0.36
    assert acting() == set()  # nobody armed it


def test_silence_leaves_nothing(plugged):
    _, cable, driver = plugged
    cable.push(driver, (1.0, 1.0)[: len(driver.forces)])
    for report in driver.silence():
        cable.write(report)
    assert cable.device.force(cable.now) == zero(driver)
    assert not cable.device.effects
    driver.begin(cable)
    assert any(cable.push(driver, (1.0, 1.0)[: len(driver.forces)]))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_device_with_one_effect_pushes_the_one_axis_that_is_used(axis):
    device = DEVICES["arduino"]()
    device.slots = 1
    cable = Cable(device)
    with pytest.raises(DriverError, match="memory for effects is full"):
        PidDriver(device.descriptor).begin(cable)
    driver = PidDriver(device.descriptor, pushed=("xy"[axis],))
    driver.begin(cable)
    assert (driver.axes, driver.forces) == (("x", "y"), ("xy"[axis],))
    felt = cable.push(driver, (0.5,))
    assert felt[axis] == pytest.approx(-0.5, abs=NEARLY)
    assert felt[1 - axis] == pytest.approx(0.0, abs=NEARLY)
    assert len(device.effects) == 1
    for report in driver.silence():
        cable.write(report)
    assert not device.effects


def test_without_an_axis_to_push_no_effect_is_made():
    device = DEVICES["openffboard"]()
    driver = PidDriver(device.descriptor, PidConfig(spring=0.5), pushed=())
    driver.begin(Cable(device))
    assert driver.forces == ()
    assert driver.encode((), arm=True) == ()
    assert not device.effects


def test_an_axis_that_it_cannot_push_is_named():
    with pytest.raises(DriverError, match="cannot push z, only x, y"):
        PidDriver(DEVICES["rhino"]().descriptor, pushed=("x", "z"))


def test_a_pool_that_another_program_filled_is_emptied(plugged):
    _, cable, _ = plugged
    device = cable.device
    while device.loaded[1] != 2:
        cable.send_feature(bytes([device.creation, 1, 0, 0]))
    assert len(device.effects) == device.slots
    again = PidDriver(device.descriptor)
    again.begin(cable)
    assert any(cable.push(again, (1.0, 1.0)[: len(again.forces)]))
