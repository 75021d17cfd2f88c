"""What the driver writes, byte by byte, against the tables of the firmwares."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.device import DeviceFault
from master.devices.hid.driver import DriverError, build_unknown_controls
from master.devices.hid.pid import PidConfig, PidDriver
from tests.hid import descriptors as d
from tests.hid.descriptors import LAYOUTS, arduino, ffbeast_pid, openffboard, rhino


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


def test_openffboard_with_one_axis_has_its_direction_bit_elsewhere():
    driver, reported = begun(openffboard(1))
    assert driver.forces == ("x",)
    assert reported[6] == "010101c800000000000000ff000228230000"


def test_arduino_is_begun_by_its_table():
    _, reported = begun(arduino())
    assert reported == [
        "0c04",
        "0c03",
        "0c06",
        "0c01",
        "0dff",
        "create 05010000",
        "01" "01" "01" "c800" "0000" "0000" "ff" "00" "04" "40" "00" "0000" "0000",
        "05010000",
        "create 05010000",
        "01" "02" "01" "c800" "0000" "0000" "ff" "00" "04" "00" "00" "0000" "0000",
        "05020000",
    ]  # fmt: skip


def test_rhino_is_begun_by_its_table():
    _, reported = begun(rhino())
    assert reported[:5] == ["7004", "7003", "7006", "7002", "71ff"]
    assert reported[5:8] == [
        "create 05010000",
        "65" "01" "01" "c800" "0000" "0000" "0010" "00" "04" "40" "00" "0000",
        "69010000",
    ]  # fmt: skip


def magnitudes(reports, number):
    return {r[1]: struct.unpack("<h", r[2:4])[0] for r in reports if r[0] == number}


@pytest.mark.parametrize(
    ("data", "number", "full"),
    [(openffboard(), 0x05, 32767), (arduino(), 0x05, 10000), (rhino(), 105, 4096)],
)
def test_a_force_is_its_share_of_full_scale(data, number, full):
    driver, _ = begun(data)
    for x, y in ((0.5, 0.25), (1.0, -1.0), (-0.1, 0.0)):
        reports = driver.encode((x, y), arm=False)
        assert all(len(report) == 4 for report in reports)
        # from +x means towards -x, from -y towards +y
        assert magnitudes(reports, number) == {1: round(-x * full), 2: round(y * full)}


@pytest.mark.parametrize(
    ("share", "magnitude"),
    [(2.0, -4096), (-7.0, 4096), (math.inf, -4096), (-math.inf, 4096), (math.nan, 0)],
)
def test_what_is_no_share_is_an_end_or_nothing(share, magnitude):
    driver, _ = begun(rhino())
    assert magnitudes(driver.encode((share, 0.0), arm=False), 105) == {1: magnitude, 2: 0}


def test_arming_starts_every_effect_once_after_its_force():
    driver, _ = begun(arduino(), PidConfig(damper=0.5))
    reports = driver.encode((0.1, 0.0), arm=True)
    assert sorted(r.hex() for r in reports[2:]) == ["0a010101", "0a020101", "0a030101"]
    assert len(driver.encode((0.1, 0.0), arm=False)) == 2


@pytest.mark.parametrize("force", [(0.0, 0.0), (-0.0, math.nan)])
@pytest.mark.parametrize("arm", [False, True])
def test_without_a_force_a_condition_is_stopped_and_never_started(force, arm):
    driver, _ = begun(arduino(), PidConfig(damper=0.5))
    reports = [r.hex() for r in driver.encode(force, arm)]
    assert "0a030300" in reports  # its stop
    assert "0a030101" not in reports


def test_nothing_is_started_before_it_is_armed():
    for data in (openffboard(), arduino(), rhino()):
        _, reported = begun(data, PidConfig(spring=1.0))
        assert not [report for report in reported if report[:2] in ("0a", "6e")]


def test_without_a_beginning_there_is_no_force():
    driver = PidDriver(openffboard())
    assert driver.encode((1.0, 1.0), arm=True) == ()
    assert [r.hex() for r in driver.silence()] == ["0c04", "0c02"]


def test_silence_takes_away_all_that_was_made():
    driver, _ = begun(rhino(), PidConfig(spring=0.5))
    assert [r.hex() for r in driver.silence()] == [
        "69010000", "69020000",
        "6e010300", "6e020300", "6e030300",
        "6f01", "6f02", "6f03",
        "7003", "7001",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("openffboard 2", 1),
        ("openffboard 1", 1),
        ("arduino", 1),
        ("rhino", 101),
        ("ffbeast pid", 17),
    ],
)
def test_every_effect_ends_by_itself_before_a_quarter_of_a_second(name, number):
    _, reported = begun(LAYOUTS[name], PidConfig(spring=0.1, damper=0.1))
    reports = [bytes.fromhex(report) for report in reported if not report.startswith("create")]
    effects = {r[1]: struct.unpack("<H", r[3:5])[0] for r in reports if r[0] == number}
    assert set(effects.values()) == {200}
    assert len(effects) == sum(report.startswith("create") for report in reported)


def test_beginning_again_starts_from_nothing():
    driver, _ = begun(openffboard())
    driver.begin(Memory(first=7))
    reports = driver.encode((0.0, 0.0), arm=True)
    assert [report[1] for report in reports] == [7, 8, 7, 8]


def test_the_answer_is_read_once_when_it_is_good():
    memory = Memory()
    begun(arduino(), memory=memory)
    assert memory.reads == 2


def test_an_answer_that_is_not_ready_is_asked_for_again():
    memory = Memory(before=[(0, 0), (9, 3), (0, 1)])
    driver, _ = begun(openffboard(), memory=memory)
    assert memory.reads == 5
    assert [report[1] for report in driver.encode((0.0, 0.0), arm=False)] == [1, 2]


def test_a_device_that_never_answers_is_refused():
    class Mute(Memory):
        def get_feature(self, number, _length):
            self.reads += 1
            return bytes([number])

    memory = Mute()
    with pytest.raises(DriverError, match="did not create the effect"):
        begun(openffboard(), memory=memory)
    assert 2 <= memory.reads <= 100


def test_full_memory_is_freed_and_tried_once_more():
    memory = Memory(before=[(0, 2)])
    _, reported = begun(openffboard(1), memory=memory)
    freed = [report for report in reported if report.startswith("0b")]
    assert freed == [f"0b{block:02x}" for block in range(1, 41)]
    assert reported.count("create 11010000") == 2


def test_memory_that_stays_full_is_said():
    with pytest.raises(DriverError, match="full"):
        begun(openffboard(), memory=Memory(before=[(0, 2), (0, 2)]))


def test_a_second_effect_does_not_free_the_first():
    memory = Memory(before=[(1, 1), (0, 2)])
    _, reported = begun(openffboard(), memory=memory)
    assert "0b01" not in reported
    assert "0b02" in reported


def test_a_number_that_other_reports_cannot_hold_is_said():
    small = d.pid_report(
        0x77,
        0x0A,
        d.field(d.OUTPUT, 4, 1, 15, 0x22),
        d.pad(d.OUTPUT, 4),
        d.named_array(d.OUTPUT, 0x78, (0x79, 0x7A, 0x7B)),
    )
    data = openffboard().replace(d.operation(0x0A), small)
    with pytest.raises(DriverError, match="Effect Operation: effect block index cannot hold 16"):
        begun(data, memory=Memory(first=16))


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


def test_one_axis_has_one_condition():
    _, reported = begun(ffbeast_pid(), PidConfig(spring=1.0))
    conditions = [report for report in reported if report.startswith("13")]
    assert conditions == ["1302000000" + "1027" * 4 + "0000"]


@pytest.mark.parametrize(
    ("remove", "why"),
    [
        (d.condition(0x03, 32767), "no Set Condition report, so neither spring nor damper"),
        (d.field(d.OUTPUT, 4, 0, 3, 0x23), "Set Condition has no parameter block offset"),
    ],
)
def test_a_condition_that_cannot_be_rendered_is_refused(remove, why):
    data = openffboard().replace(remove, b"")
    PidDriver(data)
    with pytest.raises(DriverError, match=why):
        PidDriver(data, PidConfig(spring=0.5))


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan, math.inf])
def test_a_config_takes_shares(share):
    with pytest.raises(ValueError, match=r"damper: must be within 0 \.\.\. 1"):
        PidConfig(damper=share)


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


def test_a_control_that_cannot_be_set_is_found_before_it_is_needed():
    bits = (d.ENABLE, d.DISABLE, d.STOP_ALL, d.RESET, d.PAUSE, d.CONTINUE)
    declared = d.field(d.OUTPUT, 1, 1, 6, *bits, count=8)
    signed = d.field(d.OUTPUT, 1, -128, 6, *bits, count=8)
    with pytest.raises(DriverError, match="device reset cannot hold 1"):
        PidDriver(openffboard().replace(declared, signed))


def test_what_is_no_descriptor_is_a_driver_error():
    with pytest.raises(DriverError, match="descriptor cannot be read: byte 0"):
        PidDriver(b"\xc0")
    with pytest.raises(DriverError, match="no force feedback"):
        PidDriver(LAYOUTS["dualsense"])


def test_inputs_are_read_too():
    driver, _ = begun(ffbeast_pid())
    assert (driver.axes, driver.buttons) == (("x",), 32)
    report = struct.pack("<BIH", 1, 5, 0)
    controls = driver.decode(build_unknown_controls(1), report)
    assert (controls.axes, controls.buttons, controls.known) == ((-1.0,), 5, (1 << 32) - 1)


@given(
    st.sampled_from([(openffboard(), 32767), (arduino(), 10000), (rhino(), 4096)]),
    st.tuples(st.floats(), st.floats()),
    st.booleans(),
)
def test_no_force_leaves_its_range_or_turns_around(device, force, arm):
    data, full = device
    driver, _ = begun(data)
    reports = driver.encode(force, arm)
    for report, share, sign in zip(reports[:2], force, (-1, 1), strict=True):
        (magnitude,) = struct.unpack("<h", report[2:4])
        assert -full <= magnitude <= full
        assert magnitude == 0 if math.isnan(share) else magnitude * sign * share >= 0
