"""What the driver writes: bytes of a firmware's table, and what virtual firmwares make of them."""

import struct

import pytest

from master.device import DeviceFault
from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import DriverError
from master.devices.hid.input_report import InputReportDecoder
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.pid_layout import build_layout
from studies.hid import descriptors as d
from studies.hid.descriptors import arduino, openffboard
from studies.hid.virtual.catalogue import DEVICES


class Memory:
    """A device that gives its effects the numbers 1, 2, ... and notes all that it is told.

    Reading the answer forgets it, as on the Arduino library. Answers in `before` come first.
    """

    def __init__(self, before=(), first=1):
        self.reported = []
        self.reads = 0
        self._next = first - 1
        self._answers = list(before)
        self._ready = False

    def write(self, report):
        self.reported.append(report.hex())

    def send_feature(self, report):
        self.reported.append("create " + report.hex())
        self._next += 1
        self._ready = True

    def get_input(self, _number, _length):
        raise DeviceFault("it answers no such request")

    def get_feature(self, number, length):
        assert length == 5
        self.reads += 1
        if self._answers:
            answer = self._answers.pop(0)
            self._ready = self._ready and answer[1] != 2
            return bytes([number, *answer, 0, 0])
        block, self._ready = self._next if self._ready else 0, False
        return bytes([number, block, 1, 0xFF, 0])


def begun(data, config=None, memory=None):
    driver, memory = PidDriver(data, config), memory or Memory()
    driver.begin(memory)
    return driver, memory.reported


def test_openffboard_is_begun_by_its_table():
    _, reported = begun(openffboard())
    assert reported == [
        "0c08",  # reset
        "0c04",  # stop all
        "0c20",  # continue
        "0c01",  # enable
        "0dff",  # gain
        "create 11010000",
        "01" "01" "01" "c800" "0000" "0000" "0000" "ff" "00" "04" "2823" "0000" "0000" "0000",
        "05010000",
        "create 11010000",
        "01" "02" "01" "c800" "0000" "0000" "0000" "ff" "00" "04" "0000" "0000" "0000" "0000",
        "05020000",
    ]  # fmt: skip


def test_arming_starts_every_effect_once_after_its_force():
    driver, _ = begun(arduino(), PidConfig(damper=0.5))
    reports = driver.encode((0.1, 0.0), arm=True)
    assert sorted(r.hex() for r in reports[2:]) == ["0a010101", "0a020101", "0a030101"]
    assert len(driver.encode((0.1, 0.0), arm=False)) == 2


def test_without_a_beginning_there_is_no_force():
    driver = PidDriver(openffboard())
    assert driver.encode((1.0, 1.0), arm=True) == ()
    assert [r.hex() for r in driver.silence()] == ["0c04", "0c02"]


def test_an_answer_that_is_not_ready_is_asked_for_again_but_not_for_ever():
    memory = Memory(before=[(0, 0), (9, 3), (0, 1)])
    driver, _ = begun(openffboard(), memory=memory)
    assert memory.reads == 5
    assert [report[1] for report in driver.encode((0.0, 0.0), arm=False)] == [1, 2]
    mute = Memory(before=[(0, 0)] * 1000)
    with pytest.raises(
        DriverError,
        match=r"did not create the effect \(constant force\); it answers .. 00 .*to Block Load",
    ):
        begun(openffboard(), memory=mute)
    assert 2 <= mute.reads <= 100


def test_a_second_effect_does_not_free_the_first():
    memory = Memory(before=[(1, 1), (0, 2)])
    _, reported = begun(openffboard(), memory=memory)
    assert "0b01" not in reported
    assert "0b02" in reported


def test_a_spring_and_a_damper_are_left_to_the_device():
    _, reported = begun(openffboard(), PidConfig(spring=0.2, damper=1.0))
    spring = "010308c800000000000000ff00042823000000000000"
    assert reported[11:16] == [
        "create 11080000",
        spring,
        "03" "03" "00" "0000" "9919" "9919" "9919" "9919" "0000",
        "03" "03" "01" "0000" "9919" "9919" "9919" "9919" "0000",
        spring,  # again, now that the device knows the parameters
    ]  # fmt: skip
    assert reported[16] == "create 11090000"
    assert reported[18] == "0304000000ff7fff7fff7fff7f0000"


def test_without_a_direction_bit_an_effect_has_its_axis_alone():
    data = openffboard().replace(d.field(d.OUTPUT, 1, 0, 1, 0x56), d.field(d.OUTPUT, 1, 0, 1, 0x2F))
    _, reported = begun(data)
    effects = [bytes.fromhex(r) for r in reported if len(r) == 44]
    assert [effect[13] for effect in effects] == [0b01, 0b10]


def test_a_direction_bit_that_is_declared_as_filling_is_set():
    named = d.usage(0x56) + d.logical(0, 1) + d.shape(1) + d.main(d.OUTPUT, d.CONSTANT)
    data = arduino().replace(d.field(d.OUTPUT, 1, 0, 1, 0x56), named)
    _, reported = begun(data)
    assert reported[6] == begun(arduino())[1][6]


def test_time_is_counted_as_the_device_says():
    def with_clock(exponent):
        ms = d.unit(*d.MILLISECONDS) + d.field(d.OUTPUT, 16, 0, 32767, 0x50, 0x54, 0x51, 0xA7)
        other = d.unit(0x1003, exponent) + d.field(d.OUTPUT, 16, 0, 32767, 0x50, 0x54, 0x51, 0xA7)
        return openffboard().replace(ms, other)

    for exponent, ticks in ((0xFC, 2000), (0x0E, 20), (0x0F, 2)):
        _, reported = begun(with_clock(exponent))
        assert bytes.fromhex(reported[6])[3:5] == struct.pack("<H", ticks)
    for exponent in (0x00, 0x03, 0x09, 0xF0):
        with pytest.raises(DriverError, match="cannot have a duration of"):
            PidDriver(with_clock(exponent))


def layout(data):
    descriptor = parse_descriptor(data)
    return build_layout(descriptor, InputReportDecoder(descriptor))


def joystick(*reports):
    """A device with one axis and the given PID reports."""
    return (
        d.page(d.DESKTOP)
        + d.usage(d.JOYSTICK)
        + d.collection(
            d.APPLICATION, d.report(1), d.field(d.INPUT, 16, -32767, 32767, d.X), *reports
        )
    )


def set_effect(*inside):
    return d.pid_report(
        0x21,
        1,
        d.block_index(),
        d.named_array(d.OUTPUT, 0x25, d.EFFECT_TYPES),
        d.field(d.OUTPUT, 16, 0, 32767, 0x50),
        *inside,
    )


COMPLETE = {
    "Set Effect": set_effect(),
    "Set Constant Force": d.constant_force(5, 1000),
    "Effect Operation": d.operation(10),
    "Device Control": d.control_mask(12),
    "Create New Effect": d.creation(17, d.EFFECT_TYPES),
    "Block Load": d.block_load(18),
}


def test_what_is_missing_is_named():
    for name in COMPLETE:
        reports = [report for key, report in COMPLETE.items() if key != name]
        with pytest.raises(DriverError, match=f"^no {name} report$"):
            layout(joystick(*reports))
    with pytest.raises(DriverError, match=r"no Set Effect .*; no Set Constant .*; no Block Load"):
        layout(joystick(COMPLETE["Device Control"]))


# whether a device pushes where the driver, by the standard, believes it does
SIGNS = {"openffboard": 1, "openffboard-wheel": 1, "arduino": -1, "sidewinder": -1, "rhino": 1}
NEARLY = 0.01  # by which gain bytes and a direction of 8 bits miss the share asked for


class Cable:
    """`Features` of a virtual device, and the time there."""

    def __init__(self, device):
        self.device = device
        self.now = 0.0

    def write(self, report):
        self.device.take_output(self.now, report)

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
        return self.device.compute_force(self.now)


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
    assert cable.device.compute_force(0.0) == zero(driver)
    assert not any(effect.is_playing(0.0) for effect in cable.device.effects.values())
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
    assert any(cable.device.compute_force(cable.now))
    for tick in range(250):  # a host that writes magnitudes but starts nothing is dead as well
        cable.now = end + tick * 1e-3
        cable.push(driver, asked, arm=False)
    assert cable.device.compute_force(last_arm + 0.250) == zero(driver)
    assert cable.device.compute_force(cable.now) == zero(driver)
    assert all(cable.push(driver, asked))


def test_a_spring_and_a_damper_act_on_every_axis_while_there_is_a_force(plugged):
    _, cable, driver = plugged
    device, axes = cable.device, set(range(len(driver.forces)))
    conditions = {e.kind: set(e.conditions) for e in device.effects.values() if e.kind > 1}
    assert conditions == {8: axes, 9: axes}

    def acting():
        return {e.kind for e in device.effects.values() if e.kind > 1 and e.is_playing(cable.now)}

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
    assert cable.device.compute_force(cable.now) == zero(driver)
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


def test_a_pool_that_another_program_filled_is_emptied(plugged):
    _, cable, _ = plugged
    device = cable.device
    while device.loaded[1] != 2:
        cable.send_feature(bytes([device.creation, 1, 0, 0]))
    assert len(device.effects) == device.slots
    again = PidDriver(device.descriptor)
    again.begin(cable)
    assert any(cable.push(again, (1.0, 1.0)[: len(again.forces)]))
