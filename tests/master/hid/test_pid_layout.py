import pytest

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import DriverError
from master.devices.hid.joystick import Inputs
from master.devices.hid.pid_reports import build_layout, has_pid_collection
from tests.hid import descriptors as d
from tests.hid.descriptors import LAYOUTS

PID_LAYOUTS = ("openffboard 2", "openffboard 1", "arduino", "rhino", "ffbeast pid")


def layout(data):
    descriptor = parse_descriptor(data)
    return build_layout(descriptor, Inputs(descriptor))


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("openffboard 2", (0x01, 0x05, 0x0A, 0x0C, 0x11, 0x12, 0x0B, 0x0D, 0x03)),
        ("arduino", (0x01, 0x05, 0x0A, 0x0C, 0x05, 0x06, 0x0B, 0x0D, 0x03)),
        ("rhino", (101, 105, 110, 112, 5, 6, 111, 113, 103)),
        ("ffbeast pid", (0x11, 0x15, 0x1A, 0x1C, 0x11, 0x12, 0x1B, 0x1D, 0x13)),
    ],
)
def test_reports_are_found_by_their_meaning(name, numbers):
    found = layout(LAYOUTS[name])
    parts = (
        found.set_effect,
        found.constant_force,
        found.operation,
        found.control,
        found.creation,
        found.block_load,
        found.block_free,
        found.gain,
        found.condition,
    )
    assert tuple(part.number for part in parts) == numbers


@pytest.mark.parametrize(
    ("name", "forces"),
    [("openffboard 2", ("x", "y")), ("openffboard 1", ("x",)), ("ffbeast pid", ("x",))],
)
def test_axes_that_can_be_pushed(name, forces):
    assert layout(LAYOUTS[name]).forces == forces


@pytest.mark.parametrize(
    ("name", "enable", "disable"),
    [("openffboard 2", 0x01, 0x02), ("arduino", 1, 2), ("rhino", 2, 1), ("ffbeast pid", 1, 2)],
)
def test_control_is_a_mask_or_an_index_in_the_order_of_the_device(name, enable, disable):
    control = layout(LAYOUTS[name]).control
    assert control.packed([control.choose(0x0F0097)])[1] == enable
    assert control.packed([control.choose(0x0F0098)])[1] == disable


def test_who_speaks_it():
    assert all(
        has_pid_collection(parse_descriptor(LAYOUTS[name])) == (name in PID_LAYOUTS)
        for name in LAYOUTS
    )


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


@pytest.mark.parametrize("name", COMPLETE)
def test_what_is_missing_is_named(name):
    reports = [report for key, report in COMPLETE.items() if key != name]
    with pytest.raises(DriverError, match=f"^no {name} report$"):
        layout(joystick(*reports))


def test_everything_missing_is_named_at_once():
    with pytest.raises(DriverError, match=r"no Set Effect .*; no Set Constant .*; no Block Load"):
        layout(joystick(COMPLETE["Device Control"]))


@pytest.mark.parametrize(
    ("name", "instead", "why"),
    [
        (
            "Set Effect",
            d.pid_report(0x21, 1, d.block_index(), d.named_array(d.OUTPUT, 0x25, (0x40,))),
            "Set Effect has no constant force, duration",
        ),
        (
            "Set Constant Force",
            d.pid_report(0x73, 5, d.block_index(), d.field(d.OUTPUT, 16, 0, 1000, 0x70)),
            "one direction only",
        ),
        (
            "Set Constant Force",
            d.pid_report(0x73, 5, d.field(d.OUTPUT, 16, -1000, 1000, 0x70)),
            "Set Constant Force has no effect block index",
        ),
        (
            "Effect Operation",
            d.pid_report(0x77, 10, d.block_index(), d.named_array(d.OUTPUT, 0x78, (0x79,))),
            "Effect Operation has no stop",
        ),
        (
            "Create New Effect",
            d.creation(17, (0x40, 0x41)),
            "Create New Effect has no constant force",
        ),
        (
            "Set Effect",
            set_effect(
                d.usage(0x55) + d.collection(2, d.page(1), d.field(d.OUTPUT, 1, 0, 1, d.RZ))
            ),
            "no force on any axis",
        ),
    ],
)
def test_what_a_report_lacks_is_named(name, instead, why):
    reports = [instead if key == name else report for key, report in COMPLETE.items()]
    with pytest.raises(DriverError, match=why):
        layout(joystick(*reports))


def test_a_device_that_names_no_axes_has_the_first():
    found = layout(joystick(*COMPLETE.values()))
    assert found.forces == ("x",)
    assert not found.polar


def test_what_is_not_needed_may_be_missing_or_odd():
    found = layout(joystick(*COMPLETE.values()))
    assert (found.block_free, found.gain, found.condition) == (None, None, None)
    odd = d.pid_report(0x90, 11, d.field(d.OUTPUT, 8, 0, 1, 0x2F))
    assert layout(joystick(*COMPLETE.values(), odd)).block_free is None


def test_what_goes_the_wrong_way_is_missing():
    data = joystick(*COMPLETE.values())
    asked = data.replace(d.creation(17, d.EFFECT_TYPES), b"")
    sent = d.pid_report(0xAB, 17, d.named_array(d.OUTPUT, 0x25, d.EFFECT_TYPES))
    layout(data)
    with pytest.raises(DriverError, match=r"^no Create New Effect report$"):
        layout(asked[:-1] + sent + asked[-1:])


def test_a_controller_alone_without_its_outer_collection():
    alone = (
        d.page(d.PID)
        + d.usage(0x95)
        + d.collection(
            d.LOGICAL,
            d.report(12),
            d.field(d.OUTPUT, 8, 1, 2, d.DISABLE, d.ENABLE, flags=d.DATA_ARRAY, count=1),
        )
    )
    reports = [alone if key == "Device Control" else r for key, r in COMPLETE.items()]
    control = layout(joystick(*reports)).control
    assert control.packed([control.choose(0x0F0097)]) == b"\x0c\x02"
