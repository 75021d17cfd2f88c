"""What is between hand and tip: both live loops, and the messages' bytes on a network."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from estimator.online import TendonModel
from estimator.sheath import Sheath
from master import loop as master_loop
from master.config import MasterConfig
from master.device import HandState
from master.feedback import FeedbackConfig
from master.operator import OperatorConfig
from slave import loop as slave_loop
from slave import outbox
from slave.config import SlaveConfig
from slave.gate import GateConfig
from slave.rig import RigSample
from slave.tendon_config import TendonConfig
from teleop.coupling import Bilateral
from teleop.session import Reason, State
from teleop.topics import COMMAND, STATE
from teleop.transparency.channel import Channel
from teleop.transparency.hand import DT
from teleop.transparency.rig import Bench

TICK_NS = round(DT * 1e9)
EPOCH = 1_700_000_000 * 10**9  # [ns] the time of the first tick
MASTER, SLAVE = 11, 22  # senders
SLACK = 0.05  # [s] of the watchdogs besides delay and jitter


class Answer(NamedTuple):
    """What a system did in a tick; tip and load are those of half a tick later."""

    force: float  # [N] on the hand, held until the next tick
    tip: float  # [m] true
    load: float  # [N] true, on the tip
    asked: float = 0.0  # [m] of the tip by the master
    followed: float = 0.0  # [m] where the slave sent it; NaN before it engaged
    credit_hand: float = 0.0  # [J] of the master's port
    credit_tip: float = 0.0  # [J] of the slave's
    engaged: bool = True  # whether forces may be rendered


class System(Protocol):
    """A two-port between a hand and a tip."""

    def tick(self, hand: HandState, push: float) -> Answer:
        """Go on by a tick, the tip pushed by `push` [N] besides what it meets."""


class Network(NamedTuple):
    """What is between the loops."""

    round_trip: float = 0.0  # [s] half of it each way
    jitter: float = 0.0  # [s] of the round trip, evenly spread to both sides
    loss: float = 0.0  # share of the messages, each way
    seed: int = 0

    @property
    def constant(self) -> bool:
        """Whether every message is under way for the same time."""
        return self.jitter == 0.0 and self.loss == 0.0


AT_ONCE = Network()


class Settings(NamedTuple):
    """Configs of both sides."""

    master: MasterConfig
    slave: SlaveConfig


def settings(
    force_scale: float = 0.2, position_scale: float = 0.25, network: Network | None = None
) -> Settings:
    """Return the configs of a session over a `network`, by default the slowest one."""
    network = network or Network(0.3, 0.05)
    slow = network.jitter + 2.0 * SLACK
    master = MasterConfig(
        operator=OperatorConfig(position_scale=position_scale),
        force=FeedbackConfig(scale=force_scale),
        freshness=slow,
        delay_max=min(2.0 * network.round_trip + slow, 1.0),
    )
    slave = SlaveConfig(
        tendons=(TendonConfig(effective_friction=0.02, tension_noise=0.01),),
        gate=GateConfig(displacement_min=-0.05, displacement_max=0.05, tension_max=40.0),
        command_timeout=slow,
    )
    return Settings(master, slave)


def known(friction: float = 0.02) -> slave_loop.Known:
    """Return what the slave knows of `teleop.transparency.rig.Rig`.

    `friction` is the effective one, K, of the sheath that it believes in; the rig has none.
    """
    sheath = Sheath.uniform(friction, 1.5, 9000.0)
    return slave_loop.know(((0,),), [TendonModel(sheath, tension_noise=0.01)])


class Teleoperator:
    """Master, network, slave and rig, without clocks.

    The slave's tick is half a tick after the master's.

    Parameters
    ----------
    bilateral : Bilateral
        The coupling.
    rig : Bench
        The slave's rig.
    network : Network
        Between the two.
    configs : Settings
        Of both sides; by default those of `settings`.
    rig_known : Known
        What the slave knows of the rig; by default `known`.
    slave_bilateral : Bilateral
        The coupling of the slave if it is not the same.
    """

    def __init__(
        self,
        bilateral: Bilateral,
        rig: Bench,
        network: Network = AT_ONCE,
        configs: Settings | None = None,
        rig_known: slave_loop.Known | None = None,
        slave_bilateral: Bilateral | None = None,
    ) -> None:
        self._bilateral, self._slave_bilateral = bilateral, slave_bilateral or bilateral
        self._rig, self._configs = rig, configs or settings()
        self._known = rig_known or known()
        self.master = master_loop.start(1, EPOCH)
        self.slave = slave_loop.start(self._known, False)
        delay, jitter, loss, seed = network
        self._commands = Channel(COMMAND, MASTER, delay / 2, jitter / 2, loss, 2 * seed)
        self._states = Channel(STATE, SLAVE, delay / 2, jitter / 2, loss, 2 * seed + 1)
        self._now = EPOCH

    def tick(self, hand: HandState, push: float = 0.0) -> Answer:
        """See `System`."""
        now, half_tick = self._now, self._now + TICK_NS // 2
        self._now += TICK_NS
        latest = self._states.newest(now)
        age = latest.age_ns(now)
        output, self.master = master_loop.step(
            self._configs.master,
            self.master,
            hand,
            latest.message,
            age,
            now,
            DT,
            Reason.NONE,
            self._bilateral,
        )
        self._commands.send(output.command, now)
        self._rig.advance(push)
        self._slave_tick(self._rig.read(), half_tick)
        tip = self.slave.port.tip
        return Answer(
            output.force[0],
            self._rig.tip,
            self._rig.load(),
            output.command.position[0],
            tip[0] if tip else float("nan"),
            self.master.port.ports[0].credit,
            self.slave.port.ports[0].credit,
            self.master.session.state is self.slave.session.state is State.ENGAGED,
        )

    def _slave_tick(self, samples: Sequence[RigSample], now: int) -> None:
        config, bilateral = self._configs.slave, self._slave_bilateral
        told = self._commands.newest(now)
        moved, self.slave = slave_loop.step(
            self._known,
            config,
            self.slave,
            samples,
            told.message,
            told.is_fresh(now, round(config.command_timeout * 1e9)),
            Reason.NONE,
            DT,
            bilateral,
        )
        if moved.motor:
            self._rig.wanted = moved.motor
        state = outbox.slave_state(
            self.slave.session,
            told.message.stamp_ns if told.message else 0,
            slave_loop.joint_estimates(self._known, self.slave),
            self.slave.silence,
            self.slave.port,
            bilateral.signature,
        )
        self._states.send(state, now)
