"""Whatever bytes come over the line, what reaches the hand and the motors is within its limits.

Both loops as they are, each alone with a line on which now and then anything at all arrives: fields
of every bit pattern under a right checksum, damaged bytes, wrong lengths, stamps and senders. The
limits are written down here once more, not taken from the gates.

    GATE_CASES=1000000 pytest tests/teleop/coupling/test_any_bytes.py     1.2 million ticks
"""

import math
import random

import numpy as np
import pytest

from estimator.law.sheath import Sheath
from estimator.online.online import TendonModel
from master.config import MasterConfig
from master.device import HandState
from master.operator import OperatorConfig
from slave import loop as slave_loop
from slave.config import SlaveConfig
from slave.gate import GateConfig
from slave.loop_records import TickInput
from slave.rig import RigSample
from slave.tendon_config import TendonConfig
from teleop.coupling import Bilateral, DirectConfig, PassivityConfig, WaveConfig
from teleop.link import NEVER_NS, LatestMessage
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState
from teleop.messages.topics import COMMAND, STATE
from teleop.session.state_machine import State
from tests.anything import CASES, Anything
from tests.master.run import EPOCH, MS, Run
from tests.slave.slave_bench import SlaveBench

DT = 0.001  # [s]
COUPLINGS = [DirectConfig(), PassivityConfig(), WaveConfig()]
HEAD_FIELDS = 5  # which the link fills in
TICKS = CASES // 5  # of each of six runs
ATTEMPT = 400  # ticks with one line, then it begins anew


class Noise:
    """A line with a well-behaved peer on it, and everything else."""

    def __init__(self, topic, seed):
        self.draw, self.topic = Anything(seed), topic
        self.wires = topic.message.schema.wires
        self.latest = LatestMessage(topic, lambda _: 1)
        self.sequence, self.quiet = 0, 0

    def garbage(self, message):
        """Return `message` with some fields of every kind there is."""
        names = list(self.wires)[HEAD_FIELDS:]
        chosen = self.draw.random.sample(names, k=self.draw.random.randint(1, 3))
        changed = {name: self.field(self.wires[name]) for name in chosen}
        return type(message)(**{n: getattr(message, n) for n in names} | changed)

    def field(self, wire):
        drawn = [self.value(wire) for _ in range(wire.count)]
        return drawn[0] if wire.count == 1 else tuple(drawn)

    def value(self, wire):
        if wire.code == "d":
            return self.draw.number(-1.0, 1.0)
        if wire.code == "q":
            return self.draw.random.randint(-(2**63), 2**63 - 1)
        return self.draw.random.randint(0, 8 if self.draw.flag() else 2 ** (8 * wire.size) - 1)

    def bytes(self, message, now):
        """Return what arrives in a tick at whose begin the peer sent `message`."""
        dice = self.draw.random
        self.sequence += 1
        if self.quiet > 0:
            self.quiet -= 1
            return []
        if dice.random() < 0.004:
            self.quiet = dice.choice([1, 10, 29, 31, 100])
        arrived = []
        odd = dice.random() < 0.05
        if odd and self.draw.flag(0.7):
            message = self.garbage(message)
        sender = dice.choice([0, 8, 2**64 - 1]) if odd and self.draw.flag(0.1) else 7
        stamp = now - dice.choice([0, 0, 50, 10_000, -50, -(10**9)]) * MS * (
            odd and self.draw.flag(0.2)
        )
        data = message.pack(sender, self.sequence, stamp)
        arrived.append(data)
        if odd and self.draw.flag(0.3):
            arrived.append(self.damaged(data))
        if odd and self.draw.flag(0.1):
            arrived.append(data)
        return arrived

    def damaged(self, data):
        raw, dice = bytearray(data), self.draw.random
        for _ in range(dice.randint(1, 8)):
            raw[dice.randrange(len(raw))] = dice.randrange(256)
        return bytes(raw[: dice.choice([0, 3, len(raw) - 1, len(raw), len(raw)])])

    def tick(self, message, now):
        arrived = [(data, now) for data in self.bytes(message, now)]
        self.latest.take(arrived, overflowed=self.draw.flag(0.001))
        return self.latest


def assert_force_within(config, before, force, dt):
    assert all(map(math.isfinite, force))
    assert all(abs(f) <= config.gate.axis_max + 1e-12 for f in force)
    assert math.hypot(*force) <= config.gate.total_max + 1e-9
    grown = config.gate.slew_max * min(dt, 0.005) + 1e-9
    for was, now in zip(before, force, strict=True):
        assert min(was, 0.0) - grown <= now <= max(was, 0.0) + grown


@pytest.mark.parametrize("coupling", COUPLINGS, ids=lambda c: c.type)
def test_no_bytes_from_a_slave_put_a_force_on_the_hand_that_is_not_within_limits(coupling):
    config = MasterConfig(operator=OperatorConfig(workspace=((-0.05, 0.05), (-0.05, 0.05))))
    bilateral = Bilateral(coupling=coupling)
    rendered = 0
    now = EPOCH
    for case in range(TICKS):
        if case % ATTEMPT == 0:
            line = Noise(STATE, case)
            run = Run(config, bilateral, axes=2)
            run.now, newest, age = now, None, NEVER_NS
            peer, echo = State.READY, 0
            reach = random.Random(case)  # noqa: S311
        now += MS
        engage = case % ATTEMPT > 5 and not reach.random() < 0.01
        position = 0.06 * math.sin(0.02 * case)
        hand = HandState((position, -position), (0.5, -0.5), engage=engage)
        force = (3.0 + 2.0 * math.sin(0.01 * case), -4.0)
        answer = SlaveState(
            state=peer,
            joints=2,
            echo_stamp_ns=echo,
            force=(*force, *(0.0,) * (MAX_JOINTS - 2)),
            force_low=tuple(f - 0.3 for f in (*force, *(0.0,) * (MAX_JOINTS - 2))),
            force_high=tuple(f + 0.3 for f in (*force, *(0.0,) * (MAX_JOINTS - 2))),
            coupling=bilateral.signature,
            energy=(1e-3 * case,) * MAX_JOINTS,
        )
        dt = DT * reach.choice([1, 1, 1, 1, 1, 4, 50])
        before = tuple(run.memory.force[:2])
        latest = line.tick(answer, now)
        if reach.random() < 0.5:  # it comes between command and force
            known, known_age = newest, min(age + MS, NEVER_NS)
            later, later_age = latest.message, latest.compute_age_ns(now)
        else:
            known, known_age = latest.message, latest.compute_age_ns(now)
            later, later_age = None, 0
        output = run.tick(hand, known, known_age, later=later, later_age=later_age, dt=dt)
        newest, age = latest.message, latest.compute_age_ns(now)
        echo = now
        peer = run.state if run.state in (1, 2) else State.READY
        assert_force_within(config, before, output.force, dt)
        assert all(map(math.isfinite, (*output.command.position, *output.command.velocity)))
        assert all(map(math.isfinite, (*output.command.energy, *output.command.wave)))
        if run.state not in (State.ENGAGED, State.HOLDING):
            assert output.force == (0.0, 0.0)
        rendered += any(output.force)
    assert rendered > TICKS / 20  # sessions do come about


@pytest.mark.parametrize("coupling", COUPLINGS, ids=lambda c: c.type)
def test_no_bytes_from_a_master_move_a_motor_beyond_its_limits(coupling):
    limits = GateConfig(
        displacement_min=-0.002, displacement_max=0.02, speed_max=0.05, tension_max=25.0
    )
    config = SlaveConfig(tendons=(TendonConfig(effective_friction=0.8),), gate=limits)
    model = slave_loop.build_rig_model(
        ((0,),), [TendonModel(Sheath.uniform(0.8, 1.5, 9000.0), tension_noise=0.01)]
    )
    bilateral = Bilateral(coupling=coupling)
    moved = 0
    now = EPOCH
    for case in range(TICKS):
        if case % ATTEMPT == 0:
            line = Noise(COMMAND, case)
            slave = SlaveBench(model, config, bilateral=bilateral)
            motor = 0.005
            reach = random.Random(case)  # noqa: S311
        now += MS
        engage = case % ATTEMPT > 20 and not reach.random() < 0.005
        requested = 0.004 + 0.01 * math.sin(0.01 * case)
        told = Command(
            state=State.ENGAGED if engage else State.READY,
            position=(requested,) * MAX_JOINTS,
            coupling=bilateral.signature,
            force_max=10.0,
            energy=(1e-3 * case,) * MAX_JOINTS,
        )
        latest = line.tick(told, now)
        tension = 2.0 + 1800.0 * max(motor, 0.0) + reach.gauss(0.0, 0.01)
        sample = RigSample(case * DT, np.array([tension]), np.array([motor]))
        dt = DT * reach.choice([1, 1, 1, 1, 1, 4, 50])
        fresh = latest.is_fresh(now, 28 * MS)
        given = TickInput(dt, latest.is_there, fresh)
        output = slave.step((sample,), latest.packet.records, given)
        assert all(map(math.isfinite, (*output.state.energy, *output.state.wave)))
        if not output.motor:
            continue
        (requested,) = output.motor
        assert math.isfinite(requested)
        assert (
            min(limits.displacement_min, motor) <= requested <= max(limits.displacement_max, motor)
        )
        assert abs(requested - motor) <= limits.speed_max * min(dt, 0.005) + 1e-12
        if slave.state is State.HOLDING:
            assert requested <= motor
        elif slave.state is not State.ENGAGED:
            assert requested == motor
        if tension > limits.tension_max:
            assert requested <= motor
        moved += requested != motor
        motor = requested
    assert moved > TICKS / 20
