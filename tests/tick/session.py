"""A whole session in one thread: both loops as they are, an arm of four joints, a scripted hand."""

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from master.config import MasterConfig
from master.devices import open_device
from master.devices.virtual import VirtualDevice
from master.process import MasterProcess, build_mapper
from slave import loop
from slave.config import SlaveConfig, load_tendon_configs
from slave.process import SlaveProcess
from slave.rigs import open_rig
from teleop.config.loading import load
from teleop.link.health import HealthConfig
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS, Role
from teleop.runtime.clock import EventClock, Grid
from teleop.session.config import SideConfig
from tests.tick.clock import StandingClock
from tests.tick.memory_link import MemoryLink
from tests.tick.profile import Calls

ARM = Path(__file__).parents[2] / "configs" / "arm.yaml"
HAND_ENGAGED = ("master.device.engage=[[0.05, 1e6]]", "master.device.engage_period=1e6")
BOUNDS = HealthConfig()
ON_THE_WAY = 1e-4  # [s] from one side to the other


def never() -> bool:
    return False


class Session:
    """A master and a slave; `tick` lets both have one, the slave's while the master waits.

    Messages are on the way for `delay_s` [s] in either direction, besides `ON_THE_WAY`.

    Attributes
    ----------
    master, slave : Master, SlaveProcess
        The two sides.
    master_calls, slave_calls : Calls
        On the critical path, while `counting`: from the begin of the master's tick to the write to
        its device, without the wait; from the arrival of a command at the slave until its state is
        published.
    sizes : dict
        Bytes of a message of each live topic that has been published.
    """

    def __init__(
        self,
        stack: ExitStack,
        overrides: tuple[str, ...] = HAND_ENGAGED,
        health: HealthConfig = BOUNDS,
        file: Path = ARM,
        delay_s: float = 0.0,
    ) -> None:
        self.master_calls, self.slave_calls = Calls(), Calls()
        self.counting = False
        self.sizes: dict[str, int] = {}
        self._clock = clock = StandingClock(stack.enter_context(pytest.MonkeyPatch.context()))
        self._at_master = stack.enter_context(MemoryLink(Role.MASTER))
        self._at_slave = stack.enter_context(MemoryLink(Role.SLAVE))
        launcher = stack.enter_context(MemoryLink(Role.LAUNCHER))
        for side in (self._at_master, self._at_slave):
            side.delay_ns, side.now = round(delay_s * 1e9), clock.now
        self._at_master.meet([self._at_slave, launcher])
        self._at_slave.meet([self._at_master, launcher])
        shared = load(file, SideConfig, None, overrides)

        config = load(file, SlaveConfig, "slave", overrides)
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        tendons = load_tendon_configs(config, rig.tendons, rig.joints)
        models = [tendon.build_model() for tendon in tendons]
        model = loop.build_rig_model(rig.joints, models, arms=shared.arms)
        wait = partial(self._at_slave.wait, COMMAND)
        events = EventClock(shared.rate_hz, never, wait, clock.now, clock.sleep)
        link, bilateral = self._at_slave, shared.bilateral
        self.slave = SlaveProcess(
            config, link, rig, model, events, bilateral=bilateral, health=health
        )

        config = load(file, MasterConfig, "master", overrides)
        device = open_device(config.device)
        stack.callback(device.close)
        grid = Grid(shared.rate_hz, never, now=clock.now, sleep=clock.sleep)
        mapper = build_mapper(config, shared.arms, device.axes)
        self.master = MasterProcess(
            config, self._at_master, device, grid, bilateral, health=health, mapper=mapper
        )

        self._at_master.world, self._at_master.calls = self._slave_ticks, self.master_calls
        self._events, self._grid = iter(events), iter(grid)
        self._sent = self._at_slave.putting(STATE)

    def alter(
        self,
        to_slave: Callable[[bytes], bytes | None] | None,
        to_master: Callable[[bytes], bytes | None] | None,
    ) -> None:
        """Change what becomes of messages on the way; see `MemoryLink.way`."""
        self._at_master.way, self._at_slave.way = to_slave, to_master

    def tick(self) -> None:
        """Let the master have a tick, and the slave the one that answers it."""
        tick = next(self._grid)
        if self.counting:
            self.master_calls.begin(VirtualDevice.write.__code__)
        self._slave_had_tick = False
        self.master.tick(tick)
        if not self._slave_had_tick:  # a master that has given up on answers in time does not wait
            self._slave_ticks()
        self._weigh(self._at_master, HAND)
        self._at_master.carry(self._at_slave)

    def _slave_ticks(self) -> None:
        if self._slave_had_tick:  # the master waits on, past an answer that is late
            return
        self._slave_had_tick = True
        self._weigh(self._at_master, COMMAND)
        self._at_master.carry(self._at_slave)
        self._clock.sleep(ON_THE_WAY)
        tick = next(self._events)
        if self.counting:
            self.slave_calls.begin(self._sent)
        self.slave.tick(tick)
        self._weigh(self._at_slave, STATE, TENDONS)
        self._at_slave.carry(self._at_master)
        self._clock.sleep(ON_THE_WAY)

    def _weigh(self, link: MemoryLink, *topics) -> None:
        for topic in topics:
            for data in link.sent(topic)[-1:]:
                self.sizes[topic.name] = len(data)
