"""The device as the loop sees it, against the fake: read, write, unplug, replug, close."""

import gc
import time
from dataclasses import replace

import pytest

from master.device import DeviceFault, DeviceLost
from master.devices import open_device
from master.devices.hid import force_signs, search
from master.devices.hid.device import HidDevice
from master.devices.hid.force_signs import ForceSign, ForceSigns
from master.devices.hid.input_map import AxisConfig, ButtonsConfig, HidConfig
from master.devices.hid.pid import PidConfig
from studies.hid import descriptors
from studies.hid.virtual.catalogue import DEVICES
from studies.hid.virtual.dualsense import DualSense
from studies.hid.virtual.openffboard import OpenFFBoard
from studies.hid.virtual.spacemouse import SpaceMouse
from studies.testbed.processes import wait_for_condition
from teleop.errors import UsageError

CONFIG = HidConfig(
    axes=(AxisConfig("x", travel=0.1, force=2.0), AxisConfig("y", travel=0.1, force=4.0)),
    buttons=ButtonsConfig(engage=1, clutch=2, stop=3),
    smoothing=0.0,
)


def board():
    return OpenFFBoard(descriptors.openffboard())


def know_signs(**found):
    pusher = search.find_device("", "auto").pusher
    force_signs.save(None, ForceSigns(tuple(ForceSign(*pusher, *item) for item in found.items())))


class Loop:
    """Reads and writes a device as the master's loop does, a tick at a time, in real time."""

    def __init__(self, device):
        self.device, self.force = device, (0.0,) * device.axes
        self.start = time.monotonic()
        self.hand = None

    def tick(self):
        """Read and write once; return what the device had to say against it."""
        time.sleep(0.001)
        try:
            self.hand = self.device.read(time.monotonic() - self.start)
            lost = ""
        except DeviceLost as error:
            self.hand, lost = None, str(error)
        self.device.write(self.force if self.hand else (0.0,) * self.device.axes)
        return lost

    def until(self, condition, ticks=3000):
        """Tick until `condition` holds; return how many it took."""
        for count in range(1, ticks):
            self.tick()
            if condition():
                return count
        raise AssertionError("it never came to that")


@pytest.fixture
def open_(request):

    def open_(config=CONFIG, said=None):
        device = HidDevice(config, (lambda _: None) if said is None else said.append)
        request.addfinalizer(device.close)
        return Loop(device)

    return open_


def test_it_reads_where_the_hand_is_and_which_buttons_it_holds(hidraw, open_):
    node = hidraw.plug(board())
    loop = open_()
    node.device.axes, node.device.buttons = [0.5, -1.0], 0b011
    loop.until(lambda: loop.hand.position == pytest.approx((0.05, -0.1), abs=1e-5))
    assert (loop.hand.engage, loop.hand.clutch, loop.hand.stop) == (True, True, False)


def test_a_force_is_felt_with_its_sign_and_share(hidraw, open_):
    node = hidraw.plug(board())
    know_signs(x=1, y=-1)
    loop = open_()
    loop.force = (1.0, 1.0)
    loop.until(lambda: node.force() == pytest.approx((0.5, -0.25), abs=1e-3))
    loop.force = (-1.0, 0.0)
    loop.until(lambda: node.force() == pytest.approx((-0.5, 0.0), abs=1e-3))
    assert node.device.refused == []


def test_a_force_lasts_as_long_as_it_is_written_and_no_longer(hidraw, open_):
    node = hidraw.plug(board())
    know_signs(x=1)
    loop = open_()
    loop.force = (2.0, 0.0)
    loop.until(lambda: node.force()[0] > 0.9)
    for _ in range(300):  # longer than an effect plays
        loop.tick()
    assert node.force()[0] > 0.9
    assert wait_for_condition(lambda: node.force() == (0.0, 0.0), 5.0)
    count = len(node.written)
    assert not wait_for_condition(lambda: len(node.written) > count, 0.2)


def test_an_axis_whose_sign_is_not_known_stays_without_force_and_is_named(hidraw, open_):
    node, said = hidraw.plug(board()), []
    know_signs(y=1)
    loop = open_(said=said)
    loop.force = (2.0, 2.0)
    loop.until(lambda: node.force()[1] != 0.0)
    for _ in range(50):
        loop.tick()
    assert node.force()[0] == 0.0
    assert all(push.force[0] == 0.0 for push in node.device.pushes)
    assert any("no force on x: force sign unknown" in line for line in said)
    assert "1209:ffb0" in said[0]


def test_an_unplugged_device_is_lost_at_the_next_read_and_found_when_it_is_back(hidraw, open_):
    node = hidraw.plug(board())
    know_signs(x=1)
    loop = open_()
    loop.force = (2.0, 0.0)
    loop.until(lambda: node.force()[0] > 0.9)
    hidraw.unplug(node)
    lost = loop.tick()
    assert "was unplugged; waiting for the device" in lost
    assert all(loop.tick() == lost for _ in range(60))  # and says the same all the time
    back = hidraw.plug(board())
    back.device.axes = [-0.5, 0.0]
    loop.force = (0.0, 0.0)
    loop.until(lambda: loop.hand is not None)
    loop.until(lambda: loop.hand.position[0] == pytest.approx(-0.05, abs=1e-5))
    assert all(push.force == (0.0, 0.0) for push in back.device.pushes)
    loop.force = (2.0, 0.0)
    loop.until(lambda: back.force()[0] > 0.9)


def test_a_device_that_takes_no_forces_is_lost(hidraw, open_):
    node = hidraw.plug(board())
    know_signs(x=1)
    loop = open_()
    node.refuses = True
    loop.force = (1.0, 0.0)
    loop.until(lambda: loop.hand is None)
    assert "rejects reports" in loop.tick()


def test_reports_that_may_have_been_missed_are_a_loss_and_then_the_switch_counts_as_held(
    hidraw, open_
):
    node = hidraw.plug(board())
    node.device.axes = [0.5, 0.0]
    loop = open_()
    loop.until(lambda: loop.hand is not None and not loop.hand.engage)
    node.talking = False
    loop.tick()
    moved = board()
    moved.axes = [1.0, 0.0]
    node.push(*[moved.build_report()] * 70)
    assert "reports were lost" in loop.tick()
    assert loop.tick() == ""
    assert loop.hand.engage
    assert (loop.hand.position[0], loop.hand.velocity[0]) == (pytest.approx(0.05, abs=1e-5), 0.0)
    node.push(moved.build_report())
    loop.tick()
    assert not loop.hand.engage
    assert loop.hand.position[0] == pytest.approx(0.1)
    assert loop.hand.velocity[0] == 0.0


def test_one_that_comes_back_with_another_layout_is_refused(hidraw, open_):
    node = hidraw.plug(board())
    loop = open_()
    hidraw.unplug(node)
    loop.tick()
    changed = board()
    changed.descriptor = changed.descriptor.replace(descriptors.block_free(0x0B), b"")
    hidraw.plug(changed)
    assert wait_for_condition(lambda: "its report descriptor has changed" in loop.tick(), 10.0)


@pytest.mark.parametrize("known", [{"x": 1}, {"x": 1, "y": -1}, {"x": 1, "y": 1}])
def test_a_device_pushes_by_itself_only_if_it_is_known_to_push_as_it_should(hidraw, open_, known):
    node, said = hidraw.plug(board()), []
    know_signs(**known)
    loop = open_(replace(CONFIG, pid=PidConfig(spring=0.5)), said)
    loop.force = (1.0, 1.0)
    for _ in range(50):
        loop.tick()
    springs = [effect for effect in node.device.effects.values() if effect.kind > 1]
    trusted = known == {"x": 1, "y": 1}
    assert len(springs) == trusted
    assert any("pid.spring and pid.damper are off" in line for line in said) is not trusted
    if trusted:
        loop.until(lambda: springs[0].started is not None)
        loop.force = (0.0, 0.0)
        loop.until(lambda: springs[0].started is None)


def test_a_write_that_hangs_is_a_fault_and_stops_neither_the_loop_nor_the_end(hidraw):
    node = hidraw.plug(board())
    know_signs(x=1)
    device = HidDevice(CONFIG, lambda _: None)
    loop = Loop(device)
    loop.force = (1.0, 0.0)
    loop.until(lambda: node.force()[0] > 0.4)
    node.stalled.set()
    loop.force = (2.0, 0.0)
    loop.until(node.inside.is_set)
    slowest, lost = 0.0, ""
    while not lost:
        begin = time.perf_counter()
        lost = loop.tick()
        slowest = max(slowest, time.perf_counter() - begin)
    assert "no longer accepts forces" in lost
    assert slowest < 1.0  # not the 5 s of the write
    begin = time.perf_counter()
    device.close()
    assert time.perf_counter() - begin < 4.5
    node.stalled.clear()
    assert wait_for_condition(lambda: not node.handles, 5.0)


def test_force_feedback_that_no_driver_can_use_is_said_with_what_to_do(hidraw, open_):
    unknown, said = board(), []
    unknown.descriptor = unknown.descriptor.replace(descriptors.operation(0x0A), b"")
    hidraw.plug(unknown)
    with pytest.raises(DeviceFault, match=r"no Effect Operation.*teleop devices dump 1209:ffb0"):
        HidDevice(CONFIG, lambda _: None)
    unpushed = tuple(replace(axis, force=0.0) for axis in CONFIG.axes)
    open_(replace(CONFIG, axes=unpushed), said)  # as a joystick
    assert any("WARNING: it has force feedback, but no driver" in line for line in said)


def test_closing_while_it_is_away_ends_the_search(hidraw):
    node = hidraw.plug(board())
    device = HidDevice(CONFIG, lambda _: None)
    loop = Loop(device)
    loop.tick()
    hidraw.unplug(node)
    assert loop.tick()
    device.close()
    back = hidraw.plug(board())
    assert not wait_for_condition(lambda: back.handles, 0.3)


def test_the_buttons_may_be_on_another_device(hidraw, open_):
    stick, mouse = (
        hidraw.plug(board()),
        hidraw.plug(SpaceMouse(descriptors.spacemouse()), ((1, 8),)),
    )
    config = HidConfig(
        find="1209:ffb0",
        axes=(AxisConfig("x", travel=0.1),),
        buttons=ButtonsConfig(engage=2, find="256f:c62e"),
    )
    loop = open_(config)
    stick.device.buttons = 0b10
    for _ in range(20):
        loop.tick()
    assert loop.hand.engage  # the mouse has not spoken yet
    mouse.device.buttons = 0b01
    loop.until(lambda: not loop.hand.engage)
    mouse.device.buttons = 0b10
    loop.until(lambda: loop.hand.engage)
    hidraw.unplug(mouse)
    assert "SpaceMouse" in loop.tick()


def test_a_dualsense_resists_and_lets_go_when_its_host_dies(hidraw, open_):
    node = hidraw.plug(DualSense(descriptors.dualsense_usb()), ((1, 5),))
    know_signs(l2=1)
    config = HidConfig(axes=(AxisConfig("l2", travel=0.02, force=2.0),))
    loop = open_(config)
    node.device.axes[4] = 1.0
    loop.until(lambda: loop.hand.position == pytest.approx((0.02,)))
    loop.force = (-1.0,)  # against closing
    loop.until(lambda: node.force() == (-0.5, 0.0))
    loop.force = (1.0,)
    loop.until(lambda: node.force() == (0.0, 0.0))
    # the guard of a killed process writes to the node itself: here, a file
    loop.device.close()
    assert node.path.read_bytes()[:2] == b"\x02\x0c"


@pytest.mark.parametrize(
    ("name", "sign", "silence"),
    [("ffbeast", 1, b"\xa3\x10".ljust(65, b"\0")), ("logitech", -1, b"\0\x13".ljust(8, b"\0"))],
)
def test_a_wheel_that_forgets_nothing_is_pushed_and_let_go_of(hidraw, open_, name, sign, silence):
    usages = ((0xFF00, 1),) if name == "ffbeast" else ((1, 4),)
    node = hidraw.plug(DEVICES[name](), usages)
    pedal = hidraw.plug(board(), interface=1)
    pusher = search.find_device(str(node.path), name).pusher
    force_signs.save(None, ForceSigns((ForceSign(*pusher, "x", sign),)))
    config = HidConfig(
        find=str(node.path),
        driver=name,
        axes=(AxisConfig("x", travel=0.1, force=2.0),),
        buttons=ButtonsConfig(find=str(pedal.path)),
    )
    loop = open_(config)
    node.device.axes[0] = -0.5
    loop.until(lambda: loop.hand.position == pytest.approx((-0.05,), abs=1e-4))
    for force, share in (((1.0,), 0.5), ((-2.0,), -1.0), ((0.0,), 0.0)):
        loop.force = force
        loop.until(lambda share=share: node.force() == pytest.approx((share,), abs=0.01))
    loop.force = (1.0,)
    loop.until(lambda: node.force()[0] > 0.4)
    assert wait_for_condition(lambda: node.force() == (0.0,), 5.0)  # nobody writes any more
    loop.device.close()
    assert node.device.refused == []
    assert node.path.read_bytes().endswith(silence)  # of the guard


def test_a_device_whose_guard_has_died_is_lost(hidraw, open_):
    node = hidraw.plug(DEVICES["logitech"]())
    know_signs(x=1)
    loop = open_(HidConfig(axes=(AxisConfig("x", travel=0.1, force=2.0),)))
    loop.force = (1.0,)
    loop.until(lambda: node.force()[0] < -0.4)
    (line,) = loop.device._opened.lines
    line._guard.process.kill()
    lost = set()
    loop.until(lambda: lost.add(loop.tick()) or loop.hand is None)
    assert node.force() == (0.0,)
    assert any("force watchdog process has died" in words for words in lost)
    loop.force = (0.0,)
    loop.until(lambda: loop.hand is not None)  # with another guard


def test_one_that_always_talks_and_falls_silent_is_lost_and_back_when_it_talks(hidraw, open_):
    node = hidraw.plug(DualSense(descriptors.dualsense_usb()), ((1, 5),))
    loop = open_(HidConfig(axes=(AxisConfig("l2", travel=0.02),)))
    for _ in range(60):
        assert not loop.tick()
    node.talking = False
    loop.until(lambda: loop.hand is None)
    assert "stopped sending" in loop.tick()
    for _ in range(60):
        assert "stopped sending" in loop.tick()
    node.talking = True
    loop.until(lambda: loop.hand is not None)


def test_what_the_config_asks_for_in_vain_is_one_line_and_lets_go_of_the_device(hidraw):
    node = hidraw.plug(board())
    with pytest.raises(UsageError, match=r"^master\.device: axes: the device has no axis 'l2'"):
        open_device(HidConfig(axes=(AxisConfig("l2", travel=0.1),)))
    assert wait_for_condition(lambda: not node.handles, 5.0)


def test_a_device_that_stays_away_costs_no_memory(hidraw, open_):
    node = hidraw.plug(board())
    device = open_().device
    hidraw.unplug(node)
    gc.collect()
    gc.disable()  # as in the loop
    try:
        for tick in range(1500):
            with pytest.raises(DeviceLost):
                device.read(tick * 1e-3)
        assert gc.collect() < 1000
    finally:
        gc.enable()
