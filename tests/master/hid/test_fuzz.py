"""Anything a device may send, and any force: one exception only, and never a force out of range.

HID_FUZZ=50000 in the environment makes as many examples of each test.
"""

import math
import os

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from master.device import DeviceFault
from master.devices.hid.descriptor import (
    DescriptorError,
    ReportDescriptor,
    compute_limits,
    parse_descriptor,
)
from master.devices.hid.driver import DriverError, build_unknown_controls
from master.devices.hid.dualsense import DualSenseDriver
from master.devices.hid.input_report import InputReportDecoder
from master.devices.hid.joystick import SpaceMouseDriver
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.pid_layout import build_layout
from master.devices.hid.usages import MAGNITUDE, describe_descriptor
from master.devices.hid.wheels import FFBeastDriver, LogitechDriver
from studies.hid.descriptors import LAYOUTS

fuzz = settings(
    max_examples=int(os.environ.get("HID_FUZZ", "60")),
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
FORCE = st.floats() | st.floats(-1.0, 1.0)
PREFIXES = st.sampled_from(
    [tag | size for tag in range(0, 256, 4) for size in range(4)]
    + [0x05, 0x09, 0x0B, 0x15, 0x16, 0x25, 0x26, 0x75, 0x95, 0x81, 0x91, 0xB1, 0xA1, 0xC0] * 20
)
ITEM = st.builds(
    lambda prefix, data: bytes([prefix]) + data[: (0, 1, 2, 4)[prefix & 3]],
    PREFIXES,
    st.binary(min_size=4, max_size=4),
)
ITEMS = st.lists(ITEM, max_size=60).map(b"".join)


@st.composite
def mutated(draw):
    """A real descriptor with some of its bytes changed, cut out, doubled or put in."""
    data = bytearray(LAYOUTS[draw(st.sampled_from(sorted(LAYOUTS)))])
    for _ in range(draw(st.integers(1, 6))):
        at, length = draw(st.integers(0, len(data))), draw(st.integers(0, 12))
        how = draw(st.sampled_from(["change", "change", "flip", "cut", "double", "insert"]))
        if how == "change":
            data[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif how == "flip" and at < len(data):
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif how == "cut":
            del data[at : at + length]
        elif how == "double":
            data[at:at] = data[at : at + length]
        else:
            data[at:at] = draw(ITEM)
    return bytes(data)


class Whatever:
    """A device that answers anything, and sometimes is gone."""

    def __init__(self, data):
        self._data = data

    def write(self, report):
        assert report
        self._perhaps_gone()

    def send_feature(self, report):
        assert report
        self._perhaps_gone()

    def get_input(self, _number, length):
        self._perhaps_gone()
        return self._data.draw(st.binary(max_size=length))

    def get_feature(self, number, length):
        self._perhaps_gone()
        if self._data.draw(st.integers(0, 3)):
            block = self._data.draw(st.integers(0, 255))
            return (bytes([number, block, 1]) + bytes(length))[:length]
        return self._data.draw(st.binary(max_size=length + 1))

    def _perhaps_gone(self):
        if not self._data.draw(st.integers(0, 200)):
            raise DeviceFault("unplugged")


def read(data):
    try:
        return parse_descriptor(data)
    except DescriptorError:
        return None


def check(descriptor):
    """What holds for every descriptor that is taken."""
    assert isinstance(descriptor, ReportDescriptor)
    assert sum(len(report.fields) for report in descriptor.reports) <= 8192
    for report in descriptor.reports:
        assert report.length <= 16385
        for field in report.fields:
            assert field.offset >= 0
            assert field.offset + field.size * field.count <= 8 * report.length
            assert field.constant or field.minimum <= field.maximum
    assert all(isinstance(line, str) for line in describe_descriptor(descriptor))


def feel(inputs, reports):
    controls = build_unknown_controls(len(inputs.axes))
    for report in reports:
        controls = inputs.decode(controls, report)
        assert len(controls.axes) == len(inputs.axes)
        assert all(-1.0 <= value <= 1.0 for value in controls.axes if value == value)
        assert 0 <= controls.buttons | controls.known < 1 << inputs.buttons
        assert not controls.buttons & ~controls.known


def push(data, config, device, forces):
    """Drive a device if it can be driven; no magnitude may leave its range or turn around."""
    try:
        driver = PidDriver(data, config)
    except DriverError:
        return
    try:
        driver.begin(device)
    except (DriverError, DeviceFault):
        driver.silence()
        return
    descriptor = parse_descriptor(data)
    field = build_layout(descriptor, InputReportDecoder(descriptor)).constant_force.get_field(
        MAGNITUDE
    )
    low, high = compute_limits(field)
    for force in forces:
        reports = driver.encode(force[: len(driver.forces)], arm=bool(len(forces) % 2))
        for axis, share, report in zip(driver.forces, force, reports, strict=False):
            raw = int.from_bytes(report, "little") >> field.offset & (1 << field.size) - 1
            value = raw - (raw >> field.size - 1 << field.size)
            assert low <= value <= high
            sign = {"x": -1, "y": 1}[axis]
            assert value == 0 if share != share else value * share * sign >= 0
    driver.silence()


@fuzz
@given(st.binary(max_size=300) | ITEMS, st.lists(st.binary(max_size=70), max_size=3))
def test_any_bytes(data, reports):
    descriptor = read(data)
    if descriptor is not None:
        check(descriptor)
        feel(InputReportDecoder(descriptor), reports)


@fuzz
@given(mutated(), st.lists(st.tuples(FORCE, FORCE), max_size=3), st.data())
def test_descriptors_that_are_nearly_right(data, forces, choose):
    descriptor = read(data)
    if descriptor is not None:
        check(descriptor)
    push(data, PidConfig(spring=choose.draw(st.sampled_from([0.0, 0.3]))), Whatever(choose), forces)


@fuzz
@given(
    st.sampled_from(sorted(LAYOUTS)),
    st.lists(
        st.tuples(
            st.sampled_from([0, 1, 2, 3, 0x12, 0x17, 0xA1, 0xA3]), st.binary(max_size=70)
        ).map(lambda drawn: bytes([drawn[0]]) + drawn[1]),
        max_size=6,
    ),
    st.lists(st.tuples(FORCE, FORCE), max_size=6),
    st.data(),
)
def test_right_descriptors_and_any_reports(name, reports, forces, choose):
    data = LAYOUTS[name]
    feel(InputReportDecoder(parse_descriptor(data)), reports)
    push(data, None, Whatever(choose), forces)


def effect_modes(report):
    return {report[11], report[22]} if report[0] == 0x02 else {report[13], report[24]}


def check_logitech(report, share):
    assert report[:3] == b"\0\x11\x08"
    assert 0x01 <= report[3] <= 0xFF
    assert math.copysign(1, report[3] - 0x80) == math.copysign(1, share) or report[3] == 0x80


OWN_REPORTS = [  # of the drivers without a descriptor's help, and what each may write
    (DualSenseDriver(), lambda report, _: effect_modes(report) <= {0x05, 0x21}),
    (DualSenseDriver(bluetooth=True), lambda report, _: effect_modes(report) <= {0x05, 0x21}),
    (
        FFBeastDriver(),
        lambda report, _: abs(int.from_bytes(report[4:6], "little", signed=True)) <= 10_000,
    ),
    (
        LogitechDriver(parse_descriptor(LAYOUTS["logitech g29"])),
        lambda report, share: check_logitech(report, share) is None,
    ),
    (SpaceMouseDriver(), lambda *_: False),
]


@fuzz
@given(st.sampled_from(OWN_REPORTS), st.binary(max_size=90), st.tuples(FORCE, FORCE))
def test_drivers_of_one_kind_of_device(driver_and_rule, report, force):
    driver, may_write = driver_and_rule
    feel(driver, [start + report for start in (b"", b"\x01", b"\x31", b"\xa3")])
    for out in driver.encode(force[: len(driver.forces)], arm=True):
        assert may_write(out, force[0])
