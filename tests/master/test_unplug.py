"""The main job with a HID device: hand to slave and back, pulled out and plugged in again.

A virtual force-feedback wheel behind a fake `hidraw`, the real driver, device, master loop and
link, and a slave with its simulated rig in a process of its own.
"""

import pytest

from master.config import MasterConfig
from master.devices.hid import force_signs, search
from master.devices.hid.device import HidDevice
from master.devices.hid.force_signs import ForceSign, ForceSigns
from master.devices.hid.input_map import AxisConfig, ButtonsConfig, HidConfig
from master.feedback import FeedbackConfig
from master.process import MasterProcess
from studies.hid import descriptors
from studies.hid.virtual.openffboard import OpenFFBoardWheel
from studies.testbed.processes import START_S, Processes
from teleop.config.loading import load
from teleop.link import Link
from teleop.link.health import HealthConfig
from teleop.messages.topics import STATE, Role
from teleop.runtime.clock import Grid
from teleop.session.config import SideConfig
from teleop.session.state_machine import Reason, State
from tests.root import ROOT

FULL = 2.5  # [N]
RUN = load(ROOT / "configs" / "demo.yaml", SideConfig, None)
TRAVEL = 0.06  # [m]
SCALE = 0.25  # tip per hand, as in the demo
ENGAGE = 1
CONFIG = MasterConfig(
    device=HidConfig(
        axes=(AxisConfig("x", travel=TRAVEL, force=FULL),),
        buttons=ButtonsConfig(engage=1, clutch=2, stop=3),
    ),
    force=FeedbackConfig(scale=0.2),
    state_timeout=0.5,  # [s] on a busy machine a fault that is not meant would end the session
    delay_max=1.0,
)
# a slave whose processor is busy sends less than half of its states, which would scale motion down
TOLERANT = HealthConfig(loss=1.0, round_trip=10.0, jitter=10.0)


def wheel():
    """A wheel that reports so seldom that none is lost when a busy machine holds the loop up."""
    device = OpenFFBoardWheel(descriptors.openffboard(1))
    device.interval = 0.010
    return device


class Console:
    """A master that ticks in this process, and the hand on its wheel."""

    def __init__(self, hidraw, link):
        self.hidraw, self.node = hidraw, hidraw.plug(wheel())
        self.link = link
        self.device = HidDevice(CONFIG.device)
        self.grid = Grid(1000.0, lambda: False)
        self.master = MasterProcess(
            CONFIG, link, self.device, self.grid, RUN.bilateral, health=TOLERANT
        )
        self._ticks = iter(self.grid)

    def close(self):
        self.master.close()
        self.device.close()

    def tick(self):
        self.master.tick(next(self._ticks))

    def run(self, ticks):
        for _ in range(ticks):
            self.tick()

    def until(self, condition, ticks=5000):
        for count in range(1, ticks + 1):
            self.tick()
            if condition():
                return count
        raise AssertionError(f"not within {ticks} ticks; the session is {self.side}")

    def move(self, to, ticks=400):
        start = self.node.device.axes[0]
        for k in range(1, ticks + 1):
            self.node.device.axes[0] = start + (to / TRAVEL - start) * k / ticks
            self.tick()
        self.run(30)  # until the last of it has been reported

    def press(self, buttons):
        self.node.device.buttons = buttons

    def replug(self):
        self.node = self.hidraw.plug(wheel())

    @property
    def side(self):
        return self.master.memory.session

    @property
    def slave(self):
        return self.link.take_latest(STATE).message

    @property
    def tip(self):
        return self.slave.position[0]

    @property
    def asked(self):
        return self.master.memory.operator.tip[0]

    def both(self, state):
        return lambda: self.side.state == state and self.slave.state == state

    def engage(self):
        """Let go of everything, and engage; once more if a busy machine took too long over it."""
        for _ in range(5):
            self.press(0)
            self.until(lambda: self.both(State.READY)() and self.side.open_seen)
            self.press(ENGAGE)
            self.until(lambda: self.both(State.ENGAGED)() or self.side.state == State.FAULT)
            if self.side.state == State.ENGAGED:
                return
        raise AssertionError("it does not stay engaged")


@pytest.fixture
def console(hidraw, tmp_path):
    node = hidraw.plug(wheel())
    pusher = search.find_device("", "auto").pusher
    hidraw.unplug(node)
    force_signs.save(None, ForceSigns((ForceSign(*pusher, "x", 1),)))
    patient = "slave.command_timeout=0.5", "health.loss=1", "health.jitter=10"
    with Processes(tmp_path, ROOT / "configs" / "demo.yaml", *patient) as processes:
        processes.start("slave")
        with Link(processes.link_config, processes.session, Role.MASTER) as link:
            console = Console(hidraw, link)
            try:
                console.until(lambda: console.slave is not None, round(START_S * 1000))
                yield console
            finally:
                console.close()


def test_hand_to_slave_and_back_unplugged_and_plugged_in_again(console, capsys):
    console.engage()
    start = console.tip
    console.move(0.05)
    console.until(lambda: console.node.force()[0] < -0.05)
    console.until(lambda: console.tip == pytest.approx(start + SCALE * 0.05, abs=0.002))
    console.run(300)
    asked_for = console.master.memory.force[0]
    assert asked_for < -0.1  # the tissue pushes back
    assert console.node.force()[0] == pytest.approx(asked_for / FULL, abs=0.02)

    console.hidraw.unplug(console.node)  # still engaged
    assert console.until(lambda: console.side.state == State.FAULT) <= 2
    assert console.side.reason == Reason.DEVICE_FAULT
    console.until(lambda: console.slave.state == State.FAULT)
    held = console.asked
    console.run(300)
    rest = console.tip
    console.run(300)
    assert console.tip == pytest.approx(rest, abs=1e-4)

    console.replug()
    console.press(ENGAGE)  # the button was never released
    console.node.device.axes[0] = -1.0
    console.until(lambda: len(console.node.handles) > 0)
    console.run(300)
    assert (console.side.state, console.slave.state) == (State.FAULT, State.FAULT)
    assert console.asked == pytest.approx(held, abs=1e-9)
    assert console.tip == pytest.approx(rest, abs=1e-4)

    console.press(0)
    console.until(console.both(State.READY))
    console.move(0.0)
    assert console.asked == pytest.approx(held, abs=1e-9)
    assert console.tip == pytest.approx(rest, abs=1e-4)
    assert all(push.force == (0.0,) for push in console.node.device.pushes)

    console.engage()
    assert console.asked == pytest.approx(held, abs=1e-5)
    console.until(lambda: console.node.force()[0] < -0.05)
    console.move(-0.02)
    console.until(lambda: console.asked == pytest.approx(held - SCALE * 0.02, abs=1e-5))
    console.press(0)
    console.until(console.both(State.READY))
    assert console.node.device.refused == []

    told = capsys.readouterr().out.splitlines()
    assert sum("unplugged" in line and "waiting for the device" in line for line in told) == 1
    assert sum("it is back; let go of everything, then engage" in line for line in told) == 1
    assert sum(Reason.DEVICE_FAULT.text in line for line in told) == 1
    assert console.master.error is None
