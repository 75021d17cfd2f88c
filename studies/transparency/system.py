"""The system between hand and tip: both live loops, a simulated network, a hand's runs."""

from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.law.sheath import Sheath
from estimator.online.online import TendonModel
from estimator.structs import view_struct
from master import hand_input
from master import loop as master_loop
from master.axis_map import VelocityMap
from master.config import MasterConfig
from master.device import HandState
from master.feedback import FeedbackConfig
from master.operator import OperatorConfig
from master.settings_record import build_master_settings
from slave import loop as slave_loop
from slave.config import SlaveConfig
from slave.gate import GateConfig
from slave.loop_records import SlaveMemory, TickInput
from slave.rig import RigSample
from slave.samples import estimate, to_sample_rows
from slave.tendon_config import TendonConfig
from studies.transparency.hand import DT, Encoder, Hand
from studies.transparency.rig import TestRig
from teleop.coupling import Bilateral
from teleop.link.reception import LatestMessage
from teleop.messages.messages import MAX_JOINTS, Command, Message, SlaveState
from teleop.messages.packet import Packet
from teleop.messages.topics import COMMAND, STATE, Topic
from teleop.session.state_machine import State

# --- a network with delay, jitter and loss, by seed, in front of the live reception

M = TypeVar("M", bound=Message)


class Channel(Generic[M]):
    """One direction of one topic: message bytes with delay, reordering and loss.

    Parameters
    ----------
    topic : Topic
        Topic of the messages.
    sender : int
        Nonce of the sender.
    delay, jitter : float
        A message is under way for `delay` +- `jitter` [s], evenly spread, and not below 0.
    loss : float
        Share of the messages that never arrive.
    seed : int
        Of jitter and loss.
    """

    def __init__(
        self,
        topic: Topic[M],
        sender: int,
        delay: float,
        jitter: float = 0.0,
        loss: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._sender, self._delay, self._jitter, self._loss = sender, delay, jitter, loss
        self._rng = np.random.default_rng(seed)
        self._under_way: list[tuple[int, int, bytes]] = []  # (arrives [ns], number, bytes)
        self._latest = LatestMessage(topic, lambda _nonce: 1)
        self._sent = 0

    def send(self, packet: Packet[M], now_ns: int) -> None:
        """Fill in the head of a message and send it at `now_ns`."""
        self._sent += 1
        data = packet.seal(self._sender, self._sent, now_ns)
        late = self._delay + self._rng.uniform(-self._jitter, self._jitter)
        if self._rng.random() >= self._loss:
            arrives = now_ns + round(max(late, 0.0) * 1e9)
            self._under_way.append((arrives, self._sent, data))

    def take_newest(self, now_ns: int) -> LatestMessage[M]:
        """Return the live `Latest` at `now_ns`."""
        arrived = sorted(item for item in self._under_way if item[0] <= now_ns)
        self._under_way = [item for item in self._under_way if item[0] > now_ns]
        self._latest.take([(data, now_ns) for *_, data in arrived])
        return self._latest


TICK_NS = round(DT * 1e9)
EPOCH = 1_700_000_000 * 10**9  # [ns] the time of the first tick
MASTER, SLAVE = 11, 22  # senders
SLACK = 0.05  # [s] of the watchdogs besides delay and jitter


class Answer(NamedTuple):
    """Output of a system at a tick; tip and load are half a tick later."""

    force: float  # [N] on the hand, held until the next tick
    tip: float  # [m] true
    load: float  # [N] true, on the tip
    commanded: float = 0.0  # [m] of the tip by the master
    followed: float = 0.0  # [m] where the slave sent it; NaN while it is not engaged
    credit_hand: float = 0.0  # [J] of the master's port
    credit_tip: float = 0.0  # [J] of the slave's
    engaged: bool = True  # whether forces may be rendered


class System(Protocol):
    """A two-port between a hand and a tip."""

    def tick(self, hand: HandState, push: float) -> Answer:
        """Go on by a tick, the tip pushed by `push` [N] besides what it meets."""


class Network(NamedTuple):
    """The network between the loops."""

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


def build_settings(
    force_scale: float = 0.2, position_scale: float = 0.25, network: Network | None = None
) -> Settings:
    """Return the configs of a session over a `network`, by default the slowest one."""
    network = network or Network(0.3, 0.05)
    slow = network.jitter + 2.0 * SLACK
    master = MasterConfig(
        operator=OperatorConfig(position_scale=position_scale),
        force=FeedbackConfig(scale=force_scale),
        state_timeout=slow,
        delay_max=min(2.0 * network.round_trip + slow, 1.0),
    )
    slave = SlaveConfig(
        tendons=(TendonConfig(effective_friction=0.02, tension_noise=0.01),),
        gate=GateConfig(displacement_min=-0.05, displacement_max=0.05, tension_max=40.0),
        command_timeout=slow,
    )
    return Settings(master, slave)


def build_rig_model(friction: float = 0.02) -> slave_loop.RigModel:
    """Return what the slave knows of `studies.transparency.rig.Rig`.

    `friction` is the effective one, K, of the sheath in its model; the rig has none.
    """
    sheath = Sheath.uniform(friction, 1.5, 9000.0)
    return slave_loop.build_rig_model(((0,),), [TendonModel(sheath, tension_noise=0.01)])


class Teleoperator:
    """Master, network, slave and rig, without clocks.

    The slave's tick is half a tick after the master's. The master waits for no answer: both phases
    of its tick go by the state that has arrived when it begins.

    Parameters
    ----------
    bilateral : Bilateral
        The coupling.
    rig : TestRig
        The slave's rig.
    network : Network
        Between the two.
    configs : Settings
        Of both sides; by default those of `build_settings`.
    model : RigModel
        What the slave knows of the rig; by default `build_rig_model`.
    slave_bilateral : Bilateral
        The coupling of the slave if it is not the same.

    The states of the two sides are `master` and `slave`.
    """

    def __init__(
        self,
        bilateral: Bilateral,
        rig: TestRig,
        network: Network = AT_ONCE,
        configs: Settings | None = None,
        model: slave_loop.RigModel | None = None,
        slave_bilateral: Bilateral | None = None,
    ) -> None:
        self._rig, configs, model = rig, configs or build_settings(), model or build_rig_model()
        self._tendons = len(model.models)
        self._master_settings = build_master_settings(configs.master, bilateral)
        self._master = master_loop.init_master(1, EPOCH)
        self.master: master_loop.MasterMemory = view_struct(self._master)
        self._hands = hand_input.HandInput.array()
        self._maps = VelocityMap.array()
        self._force = np.zeros(MAX_JOINTS)  # [N]
        self._slave = slave_loop.init_slave(
            model, configs.slave, slave_bilateral or bilateral, False
        )
        self.slave: SlaveMemory = view_struct(self._slave.memory)
        self._timeout_ns = round(configs.slave.command_timeout * 1e9)
        self._command, self._state = Packet(Command), Packet(SlaveState)
        delay, jitter, loss, seed = network
        self._commands = Channel(COMMAND, MASTER, delay / 2, jitter / 2, loss, 2 * seed)
        self._states = Channel(STATE, SLAVE, delay / 2, jitter / 2, loss, 2 * seed + 1)
        self._now = EPOCH

    def tick(self, hand: HandState, push: float = 0.0) -> Answer:
        """See `System`."""
        now, half_tick = self._now, self._now + TICK_NS // 2
        self._now += TICK_NS
        self._tick_master(hand, now)
        self._rig.advance(push)
        self._tick_slave(self._rig.read(), half_tick)
        master, slave = self.master, self.slave
        followed = float(slave.coupling.tip[0]) if slave.coupling.coupled else float("nan")
        return Answer(
            float(self._force[0]),
            self._rig.tip,
            self._rig.load(),
            float(self._command.record.position[0]),
            followed,
            float(master.coupling.ports[0].credit),
            float(slave.coupling.ports[0].credit),
            bool(master.session.state == slave.session.state == State.ENGAGED),
        )

    def _tick_master(self, hand: HandState, now: int) -> None:
        latest = self._states.take_newest(now)
        hand_input.fill_hand_input(self._hands, hand)
        tick_input = master_loop.TickInput(DT, now, latest.is_there, latest.compute_age_ns(now))
        known = (
            self._master_settings, self._master, self._hands, self._hands,
            latest.packet.records, tick_input,
        )  # fmt: skip
        master_loop.compute_command(*known, self._command.records)
        master_loop.compute_force(*known, self._maps, False, self._force)
        self._commands.send(self._command, now)

    def _tick_slave(self, samples: Sequence[RigSample], now: int) -> None:
        slave, latest = self._slave, self._commands.take_newest(now)
        rows = to_sample_rows(samples)
        estimate(*slave.estimate_arguments, rows, len(samples))
        fresh = latest.is_fresh(now, self._timeout_ns)
        tick_input = TickInput(DT, latest.is_there, fresh)
        records = latest.packet.records, self._state.records
        slave_loop.run_tick(*slave.tick_arguments, rows, len(samples), tick_input, *records)
        slave_loop.monitor_calibration(*slave.monitor_arguments, rows, len(samples))
        if self.slave.has_gated_position:
            self._rig.wanted = tuple(self.slave.gated_position[: self._tendons].tolist())
        self._states.send(self._state, now)


# --- simulate a hand on a system

SETTLED = 0.4  # [s] after which a session over a network without delay may engage


class RunData(NamedTuple):
    """Signals of a run, one value per tick."""

    time: Array  # [s]
    hand: Array  # [m] true
    velocity: Array  # [m/s] true, of the hand
    force: Array  # [N] on the hand, held until the next tick
    tip: Array  # [m] true, half a tick later
    load: Array  # [N] true, on the tip, half a tick later
    commanded: Array  # [m] of the tip
    followed: Array  # [m]
    credit: Array  # [J] of master and slave, shape (n, 2)
    engaged: NDArray[np.bool_]
    work: Array  # [J] done on the hand so far
    dragged: Array  # [m^2/s] times a damping at the hand: what that has dissipated [J]


def cut_run(record: RunData, begin: int, end: int) -> RunData:
    """Return the ticks from `begin` to before `end`."""
    span = slice(begin, end)
    return record._replace(**{name: column[span] for name, column in record._asdict().items()})


def push_nothing(_time: float) -> float:
    """Push nothing."""
    return 0.0


def run_hand(
    system: System,
    hand: Hand,
    seconds: float,
    engage: float = SETTLED,
    push: Callable[[float], float] = push_nothing,
) -> RunData:
    """Simulate for `seconds` [s].

    Parameters
    ----------
    system : System
        What is between hand and tip.
    hand : Hand
        What holds the device.
    engage : float
        When the operator engages [s].
    push : callable
        Force on the tip [N] besides all that it meets, at a time [s].
    """
    encoder, rows = Encoder(hand.device), []
    for k in range(round(seconds / DT)):
        time = k * DT
        position, velocity = encoder.read(hand.position, hand.velocity)
        seen = HandState((position,), (velocity,), engage=time > engage)
        answer = system.tick(seen, push(time + DT / 2))
        rows.append((time, hand.position, hand.velocity, *answer))
        hand.advance(answer.force)
    time, x, v, f, tip, load, commanded, followed, *credit, engaged = np.array(rows, float).T
    work = np.concatenate([[0.0], np.cumsum(f[:-1] * np.diff(x))])
    dragged = np.concatenate([[0.0], np.cumsum(np.square(v[1:]) + np.square(v[:-1])) * DT / 2])
    return RunData(
        time, x, v, f, tip, load, commanded, followed, np.array(credit).T, engaged > 0, work,
        dragged,
    )  # fmt: skip
