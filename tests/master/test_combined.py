"""Several devices as one: order of axes, switches, faults, closing, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.config import MasterConfig
from master.device import DeviceFault, DeviceLost, HandState
from master.devices import open_device
from master.devices.combined import CombinedConfig, CombinedDevice
from master.devices.hid.device import HidDevice
from master.devices.hid.input_map import AxisConfig, HidConfig
from master.devices.virtual import VirtualConfig
from studies.hid import descriptors
from studies.hid.virtual.arduino import Arduino
from studies.hid.virtual.openffboard import OpenFFBoard
from studies.testbed.processes import wait_for_condition
from teleop.config.loading import load
from teleop.errors import UsageError
from tests.master.reading import comes_back

BUTTONS = ("clutch", "stop", "finer", "coarser", "weaker", "stronger")


class Stylus:
    """A device that says what it is told to, and notes what is done to it."""

    def __init__(self, axes, first=0.0):
        self.axes, self.first = axes, first
        self.held, self.buttons = False, {}
        self.read_fault = self.write_fault = self.close_fault = None
        self.written, self.closed = [], 0

    def read(self, _time_s):
        if self.read_fault is not None:
            raise self.read_fault
        positions = tuple(self.first + k for k in range(self.axes))
        return HandState(positions, tuple(-x for x in positions), self.held, **self.buttons)

    def write(self, force):
        if self.write_fault is not None:
            raise self.write_fault
        self.written.append(force)

    def close(self):
        self.closed += 1
        if self.close_fault is not None:
            raise self.close_fault


def combined(*devices, **scales):
    config = CombinedConfig(devices=tuple(VirtualConfig(axes=d.axes) for d in devices), **scales)
    given_out = iter(devices)
    return CombinedDevice(config, lambda _config: next(given_out))


def released(*devices):
    """Combine devices whose switches were seen open."""
    device = combined(*devices)
    assert not device.read(0.0).engage
    return device


@given(st.lists(st.integers(1, 4), min_size=2, max_size=8).filter(lambda axes: sum(axes) <= 8))
def test_axes_follow_one_another_and_each_device_gets_its_own_part_of_the_force(axes):
    firsts = [sum(axes[:k]) for k in range(len(axes))]
    styluses = [Stylus(n, float(first)) for n, first in zip(axes, firsts, strict=True)]
    device = combined(*styluses)
    assert device.axes == sum(axes)
    hand = device.read(0.0)
    assert hand.position == tuple(range(sum(axes)))
    assert hand.velocity == tuple(-x for x in range(sum(axes)))
    device.write(tuple(10.0 + k for k in range(sum(axes))))
    for stylus, first in zip(styluses, firsts, strict=True):
        assert stylus.written == [tuple(10.0 + first + k for k in range(stylus.axes))]


def test_each_device_has_scales_of_its_own():
    arm, gripper = Stylus(2, first=1.0), Stylus(1, first=3.0)
    device = combined(arm, gripper, position_scales=(1.0, 0.5), force_scales=(0.25, 1.0))
    hand = device.read(0.0)
    assert hand.position == (1.0, 2.0, 1.5)
    assert hand.velocity == (-1.0, -2.0, -1.5)
    device.write((2.0, -4.0, 3.0))  # the loop has applied those of force
    assert (arm.written, gripper.written) == ([(2.0, -4.0)], [(3.0,)])


@given(st.lists(st.booleans(), min_size=2, max_size=4))
def test_all_hands_must_hold_to_engage(held):
    styluses = [Stylus(1) for _ in held]
    device = released(*styluses)
    for stylus, holds in zip(styluses, held, strict=True):
        stylus.held = holds
    assert device.read(0.0).engage == all(held)


def test_any_other_button_of_one_device_counts_for_all():
    styluses = [Stylus(1) for _ in range(3)]
    device = combined(*styluses)
    for name in BUTTONS:
        for stylus in styluses:
            stylus.buttons = {name: True}
            hand = device.read(0.0)
            assert [n for n in BUTTONS if getattr(hand, n)] == [name]
            stylus.buttons = {}


def test_a_switch_that_was_never_seen_open_counts_as_held():
    left, right = Stylus(1), Stylus(1)
    left.held = True  # or not known yet, as of a HID device before its first report
    device = combined(left, right)
    assert device.read(0.0).engage
    right.held = True
    assert device.read(0.0).engage
    left.held = False
    assert device.read(0.0).engage
    left.held, right.held = True, False
    assert not device.read(0.0).engage  # each was seen open now


def test_after_one_was_lost_each_switch_has_to_be_let_go_of_anew():
    left, right = Stylus(1), Stylus(1)
    device = released(left, right)
    left.held = right.held = True
    assert device.read(0.0).engage
    left.read_fault = DeviceLost("unplugged")
    with pytest.raises(DeviceLost, match=r"^devices\.0: unplugged$"):
        device.read(0.0)
    left.read_fault, right.held = None, False
    assert device.read(0.0).engage  # the one that is back is still held
    left.held = False
    assert not device.read(0.0).engage
    left.held = True
    assert not device.read(0.0).engage
    right.held = True
    assert device.read(0.0).engage


def test_one_that_is_lost_is_a_loss_the_others_are_read_on_and_a_failure_is_a_failure():
    left, right = Stylus(1), Stylus(2)
    reads = []
    device = released(left, right)
    left.read_fault = DeviceLost("unplugged")
    right.read = lambda time_s: reads.append(time_s) or HandState((0.0, 0.0), (0.0, 0.0), False)
    for time_s in (1.0, 2.0):
        with pytest.raises(DeviceLost):
            device.read(time_s)
    assert reads == [1.0, 2.0]
    del right.read
    right.read_fault = DeviceFault("broken")
    with pytest.raises(DeviceFault, match=r"^devices\.1: broken$") as caught:
        device.read(0.0)
    assert not isinstance(caught.value, DeviceLost)


def test_a_failed_write_leaves_no_force_on_the_others():
    left, middle, right = Stylus(1), Stylus(1), Stylus(1)
    device = released(left, middle, right)
    middle.write_fault = DeviceFault("no longer accepts forces")
    with pytest.raises(DeviceFault, match=r"^devices\.1: no longer accepts forces$"):
        device.write((1.0, 2.0, 3.0))
    assert left.written[-1] == right.written[-1] == (0.0,)


def test_a_force_that_cannot_be_is_refused_and_not_split():
    left, right = Stylus(1), Stylus(1)
    for force in ((), (1.0,), (1.0, 2.0, 3.0), (1.0, math.nan)):
        with pytest.raises(DeviceFault, match="refuses"):
            combined(left, right).write(force)
    assert left.written == right.written == []


def test_closing_closes_all_even_if_one_cannot():
    styluses = [Stylus(1) for _ in range(3)]
    styluses[1].close_fault = RuntimeError("stuck")
    device = combined(*styluses)
    with pytest.raises(RuntimeError, match="stuck"):
        device.close()
    assert [stylus.closed for stylus in styluses] == [1, 1, 1]


def test_if_the_second_cannot_be_opened_the_first_is_closed_again():
    left, opened = Stylus(1), []

    def open_single(_config):
        if opened:
            raise DeviceFault("no such device")
        opened.append(left)
        return left

    with pytest.raises(DeviceFault, match=r"^devices\.1: no such device$"):
        CombinedDevice(CombinedConfig(), open_single)
    assert left.closed == 1


@pytest.mark.parametrize(
    ("devices", "complaint"),
    [
        ("[{type: virtual, axes: 5}, {type: virtual, axes: 4}]", "5 + 4 axes, must be at most 8"),
        ("[{type: virtual}]", "at least 2"),
        (
            "[{type: virtual}, {type: combined}]",
            "'combined' is unknown (allowed: hid, ros, virtual)",
        ),
        ("[{type: virtual}, {type: virtual, axis: 2}]", "unknown key; did you mean 'axes'"),
        (
            "[{type: virtual}, {type: hid, axes: [{travel: 0.1, joint: 7}]}]",
            "1 + 8 axes, must be at most 8",
        ),
    ],
)
def test_what_cannot_be_combined_is_one_line(devices, complaint):
    override = f"master.device={{type: combined, devices: {devices}}}"
    with pytest.raises(UsageError) as caught:
        load(None, MasterConfig, "master", [override])
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


PUSHED = HidConfig(axes=(AxisConfig("x", travel=0.1, force=2.0),), smoothing=0.0)


def arduino():
    """A device that reports so seldom that none is lost on a busy machine."""
    device = Arduino(descriptors.arduino())
    device.interval = 0.010
    return device


def hid(find):
    return HidConfig(find=find, axes=PUSHED.axes, smoothing=0.0)


def two_hids(first, second):
    return open_device(CombinedConfig(devices=(hid(first), hid(second))))


def test_two_of_a_kind_are_told_apart_by_their_paths_and_one_comes_back_as_itself(hidraw):
    nodes = [hidraw.plug(arduino()) for _ in range(2)]
    with pytest.raises(UsageError, match=r"devices\.0: several devices fit; set find to"):
        two_hids("", "")
    device = two_hids(*(str(node.path) for node in nodes))

    def reads_each():
        nodes[0].device.axes, nodes[1].device.axes = [0.5, 0.0], [-1.0, 0.0]
        expected = pytest.approx((0.05, -0.1), abs=1e-3)
        return wait_for_condition(lambda: device.read(0.0).position == expected, 30.0)

    assert reads_each()
    hidraw.unplug(nodes[0])
    nodes[1].path.chmod(0o600)  # as udev does, at any time
    assert "devices.0" in lost(device)
    nodes[0] = hidraw.plug(arduino())
    assert comes_back(device)
    assert reads_each()
    device.close()


def test_one_device_is_not_two_hands(hidraw):
    node = hidraw.plug(OpenFFBoard(descriptors.openffboard()))
    for find in ("", "1209:ffb0", str(node.path)):
        with pytest.raises(UsageError, match=r"devices\.1: .*already in use by another device"):
            two_hids(find, find)
    HidDevice(hid(""), lambda _line: None).close()  # the first was let go of


def lost(device):
    with pytest.raises(DeviceLost) as caught:
        wait_for_condition(lambda: device.read(0.0) and False, 30.0)
    return str(caught.value)


@pytest.mark.parametrize("returning", [1, 2])
def test_two_alike_that_were_lost_together_are_not_mixed_up(hidraw, returning):
    """Their serial numbers are the same, so either may be in the place of the other."""
    nodes = [hidraw.plug(arduino()) for _ in range(2)]
    device = two_hids(*(str(node.path) for node in nodes))
    for node in nodes:
        hidraw.unplug(node)
    lost(device)
    for _ in range(returning):
        hidraw.plug(arduino())
    assert wait_for_condition(lambda: "identity" in lost(device), 30.0)
    device.close()


def test_a_loss_that_was_not_noticed_yet_is_a_loss(hidraw):
    """The one that is missing may have come back in the place of the other."""
    nodes = [hidraw.plug(arduino()) for _ in range(2)]
    first, second = (HidDevice(hid(str(node.path)), lambda _line: None) for node in nodes)
    for node in nodes:
        hidraw.unplug(node)
    lost(first)  # nobody reads the second
    hidraw.plug(arduino())
    assert wait_for_condition(lambda: "identity" in lost(first), 30.0)
    first.close()
    second.close()
