"""The couplings over an arbitrary network, between an arbitrary hand and an arbitrary tip."""

from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.compiled import jit_compile
from estimator.structs import U64, Field, Struct, view_struct
from teleop import coupling
from teleop.coupling import (
    Bilateral,
    BilateralSettings,
    DirectConfig,
    LedgerPublisher,
    PassivityConfig,
    Side,
    WaveConfig,
    to_bilateral_settings,
)
from teleop.messages.messages import MAX_JOINTS
from teleop.messages.topics import Role

DT = 0.001
LEVER = 0.05  # of scales 0.25 and 0.2
ROBUST = [
    PassivityConfig(),
    PassivityConfig(hand_damping=0.0, passive_tip=False),
    WaveConfig(),
    WaveConfig(play=0.1),
]
OLDEST = 30  # ticks


def record_of(config):
    return view_struct(to_bilateral_settings(Bilateral(coupling=config)))


def joints(*values):
    """The values of the first joints; those of the others are zero."""
    return np.array([*values, *[0.0] * (MAX_JOINTS - len(values))])


def told(side):
    """What the next message tells of energy and of waves."""
    return tuple(
        np.array([getattr(port, name) for port in side.ports])
        for name in ("passed_on", "sent_wave")
    )


def at_hand(rules, side, place, speed, written, force, coupled=True, axes=1):
    """Both phases of the master, at one joint or more: the forces that the hand feels."""
    inputs = [joints(*np.atleast_1d(value)) for value in (place, speed, written, force)]
    coupling.count_hand_work(rules, side, *inputs[:3], axes, LEVER, coupled, DT)
    rendered = joints()
    coupling.render_force(rules, side, inputs[3], axes, rendered)
    return rendered[0] if axes == 1 else rendered[:axes]


def at_tip(rules, side, requested, speed, force, coupled=True):
    """Where a single tip shall be, and how fast it goes."""
    place, velocity = joints(requested), joints(speed)
    coupling.compute_tip_motion(rules, side, place, velocity, joints(force), 1, coupled, DT)
    return place[0], velocity[0]


def copy_of(side):
    return view_struct(np.array([side.tolist()], Side.dtype))


def ticks(most):
    return st.lists(st.floats(-most, most), min_size=1, max_size=8)


FATES = st.lists(
    st.lists(st.integers(0, OLDEST), max_size=2), min_size=1, max_size=7
)  # when a message arrives: never, once, twice


class CentreLine:
    """One direction: what is told arrives when it is fated to."""

    def __init__(self, fates):
        self._fates, self._told = fates, {}

    def tell(self, tick, side):
        for late in self._fates[tick % len(self._fates)]:
            self._told.setdefault(tick + late, []).append(told(side))

    def receive(self, tick, side, sender):
        for energy, wave in self._told.pop(tick, ()):
            coupling.receive_totals(side, sender, energy, wave)


def session(config, turns, forces, shares, there, back, count=100, rested=()):
    """Return both sides after each tick, in place: a hand that turns, a tip that is pushed.

    `turns` are changes of the travel a tick [m], `forces` what the tip feels [N], `shares` how much
    of the force is rendered.
    """
    rules = record_of(config)
    master, slave = Side.new(), Side.new()
    to_slave, to_master = CentreLine(there), CentreLine(back)
    place, travel, written = 0.0, 0.0, 0.0
    for tick in range(count):
        coupled = tick not in rested
        travel += turns[tick % len(turns)]
        travel = min(max(travel, -0.001), 0.001)
        place += travel
        to_master.receive(tick, master, 7)
        force = forces[(tick // 3) % len(forces)]
        rendered = at_hand(rules, master, place, travel / DT, written, force, coupled)
        written = rendered * shares[tick % len(shares)] if coupled else 0.0
        to_slave.tell(tick, master)
        to_slave.receive(tick, slave, 8)
        at_tip(rules, slave, place, travel / DT, force, coupled)
        to_master.tell(tick, slave)
        yield master, slave


@pytest.mark.parametrize("config", ROBUST, ids=lambda c: f"{c.type}")
@settings(max_examples=40, deadline=None)
@given(
    turns=ticks(2e-5),
    forces=ticks(30.0),
    shares=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=4),
    there=FATES,
    back=FATES,
)
def test_no_more_comes_out_of_both_ports_than_went_in_whatever_hand_tip_and_network_do(
    config, turns, forces, shares, there, back
):
    place = hand = 0.0
    damping = getattr(config, "hand_damping", 0.0)
    for master, slave in session(config, turns, forces, shares, there, back):
        hand += (
            damping / LEVER * (master.requested[0] - place) ** 2 / DT
        )  # [J] it dissipates itself
        place = master.requested[0]
        near, far = master.ports[0], slave.ports[0]
        assert near.credit >= -1e-12
        assert far.credit >= -1e-12
        out = near.taken_out + far.taken_out
        assert out <= near.put_in + far.put_in + near.granted + far.granted + 1e-12
        assert near.granted + far.granted <= 2.0 * config.reserve + hand + 1e-12
        assert near.received <= far.passed_on + 1e-12
        assert far.received <= near.passed_on + 1e-12


def test_direct_lets_out_what_was_never_put_in():
    """A delayed spring, pressed and let go of: so that the property above can fail."""
    shape = ([1e-5] * 40 + [-1e-5] * 40, [0.0, 5.0, 10.0, 5.0], [1.0], [[20]], [[20]])
    *_, (master, slave) = session(DirectConfig(), *shape, count=400)
    assert min(master.ports[0].credit, slave.ports[0].credit) < -0.01


@settings(max_examples=30, deadline=None)
@given(ticks(2e-5), ticks(30.0), FATES, st.sets(st.integers(0, 99), max_size=30))
def test_each_engagement_grants_the_reserve_at_most(turns, forces, fates, rested):
    config, before = PassivityConfig(hand_damping=0.0), 0.0
    for master, _ in session(config, turns, forces, [1.0], fates, fates, rested=rested):
        granted = master.ports[0].granted
        assert granted - before <= config.reserve + 1e-12
        before = granted


@pytest.mark.parametrize("config", ROBUST, ids=lambda c: f"{c.type}")
def test_a_hand_that_jerks_overdraws_by_what_it_moved_further_and_makes_it_good(config):
    """300 mm/s the other way within a tick: more than `step_tolerance` allows for."""
    if isinstance(config, PassivityConfig):
        config = replace(config, hand_damping=0.0)
    *_, (side, _) = session(config, [0.0], [10.0], [1.0], [[1]], [[1]], count=20)
    rules = record_of(config)
    left_over, written, place = [], 10.0, 0.0
    for tick in range(100):
        travel = -3e-4 if tick < 3 else 3e-5
        place += travel
        written = at_hand(rules, side, place, travel / DT, written, 10.0)
        left_over.append(side.ports[0].credit)
    assert -10.0 * 3e-4 <= min(left_over) < 0.0
    assert left_over[-1] > 0.0


@pytest.mark.parametrize("config", [PassivityConfig(), WaveConfig(), DirectConfig()])
@given(force=st.floats(-20, 20), place=st.floats(-0.1, 0.1))
def test_engaging_moves_nothing(config, force, place):
    side = Side.new()
    assert at_tip(record_of(config), side, place, 0.0, force)[0] == place
    assert side.tip[0] == place
    assert side.coupled


@pytest.mark.parametrize("config", [PassivityConfig(), WaveConfig(), DirectConfig()])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_force_that_is_no_number_is_not_rendered_as_one(config, bad):
    """Not coupled, it reaches the gate as it is."""
    force = at_hand(record_of(config), Side.new(), 0.0, 0.0, 0.0, bad, coupled=False)
    assert force != force or force == bad


@pytest.mark.parametrize("config", [*ROBUST, DirectConfig()], ids=lambda c: f"{c.type}")
def test_what_is_told_is_known_before_the_force(config):
    """`count_hand` alone changes what is told; `render` takes nothing of it back."""
    *_, (side, _) = session(config, [1e-5, -3e-5], [9.0, -5.0], [1.0], [[3]], [[5]])
    rules = record_of(config)
    before = [values.tolist() for values in told(side)]
    coupling.count_hand_work(
        rules, side, joints(0.02), joints(5.0), joints(9.0), 1, LEVER, True, DT
    )
    counted = [values.tolist() for values in told(side)]
    assert counted != before
    for force in (0.0, 7.0, -7.0, 1e6):
        coupling.render_force(rules, side, joints(force), 1, joints())
        assert [values.tolist() for values in told(side)] == counted


@pytest.mark.parametrize("config", ROBUST, ids=lambda c: f"{c.type}")
def test_what_is_heard_between_the_two_phases_counts_in_the_second(config):
    """A hand that yields to 9 N, of which little is affordable until more is heard."""
    rules, side = record_of(config), Side.new()
    at_hand(rules, side, 0.0, -0.05, 0.0, 9.0)
    coupling.receive_totals(side, 7, joints(0.0), joints(0.0))
    coupling.count_hand_work(
        rules, side, joints(-5e-5), joints(-0.05), joints(0), 1, LEVER, True, DT
    )
    deaf, before, after = copy_of(side), joints(), joints()
    coupling.render_force(rules, deaf, joints(9.0), 1, before)
    coupling.receive_totals(side, 7, joints(1e-3), joints(-1e-4))
    coupling.render_force(rules, side, joints(9.0), 1, after)
    assert before[0] < after[0] <= 9.0


@pytest.mark.parametrize("config", [*ROBUST, DirectConfig()], ids=lambda c: f"{c.type}")
@pytest.mark.parametrize("coupled", [False, True])
def test_one_joint_never_leaks_into_another(config, coupled):
    """Three joints at once do what each of them does alone, and the others nothing."""
    rules, rng = record_of(config), np.random.default_rng(3)
    together, alone = (Side.new(), Side.new()), [(Side.new(), Side.new()) for _ in range(3)]
    place = np.zeros(3)
    for tick in range(60):
        travel = rng.normal(0.0, 3e-5, 3)
        place, speed, force = place + travel, travel / DT, rng.normal(0.0, 9.0, 3)
        on = coupled and tick != 30
        felt = at_hand(rules, together[0], place, speed, 0.8 * force, force, on, axes=3)
        requested, velocity = joints(*place), joints(*speed)
        coupling.compute_tip_motion(
            rules, together[1], requested, velocity, joints(*force), 3, on, DT
        )
        for k, (master, slave) in enumerate(alone):
            mine = place[k], speed[k]
            assert at_hand(rules, master, *mine, 0.8 * force[k], force[k], on) == felt[k]
            assert at_tip(rules, slave, *mine, force[k], on) == (requested[k], velocity[k])
            for side, single in ((together[0], master), (together[1], slave)):
                assert repr(side.ports[k].tolist()) == repr(single.ports[0].tolist())
        for side in together:
            idle = {repr(side.ports[k].tolist()) for k in range(3, MAX_JOINTS)}
            assert len(idle) == 1
            assert not any(told(side)[0][3:])
            assert not any(told(side)[1][3:])


def test_the_signature_tells_any_two_choices_apart():
    choices = [
        Bilateral(),
        Bilateral(coupling=PassivityConfig()),
        Bilateral(coupling=PassivityConfig(reserve=0.003)),
        Bilateral(coupling=WaveConfig()),
    ]
    assert len({choice.signature for choice in choices}) == len(choices)
    assert Bilateral(coupling=PassivityConfig()).signature == choices[1].signature
    for choice in choices:
        rules = view_struct(to_bilateral_settings(choice))
        assert rules.signature == choice.signature
        for number in (0, 1, 2**32 - 1, *(other.signature for other in choices)):
            differs = number not in (0, choice.signature)
            assert coupling.has_settings_mismatch(rules, number) == differs


def test_the_ledgers_message_balances():
    shape = ([1e-5, -1e-5, -1e-5, 1e-5], [8.0], [1.0], [[3]], [[4]])
    *_, (master, slave) = session(PassivityConfig(), *shape)
    for role, side in ((Role.MASTER, master), (Role.SLAVE, slave)):
        sides = Side.array()
        sides[0] = side
        publisher = LedgerPublisher(role, sides, 1)
        assert publisher.is_due(5)
        assert not publisher.is_due(6)
        message = publisher.fill().record
        assert (message.role, message.joints) == (role, 1)
        left = message.granted[0] + message.put_in[0] + message.received[0]
        left -= message.taken_out[0] + message.passed_on[0] + message.dissipated[0]
        assert message.credit[0] == pytest.approx(left, abs=1e-12)
        assert message.put_in[0] > 0.0


def test_nonces_that_differ_in_their_lowest_bit_are_told_apart():
    """Above 2^53 a number that went through a double would not be."""
    side = Side.new()
    for sender, energy in ((2**64 - 1, 5.0), (2**64 - 2, 3.0), (2**64 - 2, 3.5)):
        coupling.receive_totals(side, np.uint64(sender), np.full(MAX_JOINTS, energy), joints())
    assert side.ports[0].received == pytest.approx(0.5)
    assert side.sender == 2**64 - 2


class ReceivedMessage(Struct):
    sender: U64
    energy: Annotated[np.ndarray, Field("f8", MAX_JOINTS)]
    wave: Annotated[np.ndarray, Field("f8", MAX_JOINTS)]


class Memory(Struct):
    received: ReceivedMessage
    near: Side
    far: Side
    rules: BilateralSettings


@jit_compile
def tick_of_memory(memories, place, speed, force):
    """As a compiled tick has them: everything within one record, arrays of it too."""
    memory = memories[0]
    for side in (memory.near, memory.far):
        coupling.receive_totals(
            side, memory.received.sender, memory.received.energy, memory.received.wave
        )
    coupling.count_hand_work(memory.rules, memory.near, place, speed, force, 1, LEVER, True, DT)
    coupling.render_force(memory.rules, memory.near, force, 1, force)
    coupling.compute_tip_motion(memory.rules, memory.far, place, speed, force, 1, True, DT)
    return coupling.has_settings_mismatch(memory.rules, memory.near.sender)


@pytest.mark.parametrize("config", [PassivityConfig(), WaveConfig(play=0.1)])
def test_within_a_larger_record_a_side_is_the_same(config):
    rules, memories = record_of(config), Memory.array()
    memories["rules"] = to_bilateral_settings(Bilateral(coupling=config))
    near, far = Side.new(), Side.new()
    for tick in range(20):
        place, speed, force = 3e-5 * tick, 0.03, 9.0 * (-1.0) ** tick
        energy, wave = np.full(MAX_JOINTS, 1e-4 * tick), np.full(MAX_JOINTS, -1e-5 * tick)
        received = memories["received"]
        received["sender"], received["energy"], received["wave"] = 2**64 - 1, energy, wave
        arrays = joints(place), joints(speed), joints(force)
        tick_of_memory(memories, *arrays)
        for side in (near, far):
            coupling.receive_totals(side, np.uint64(2**64 - 1), energy, wave)
        felt = at_hand(rules, near, place, speed, force, force)
        gone, went = at_tip(rules, far, place, speed, felt)
        assert (arrays[0][0], arrays[1][0], arrays[2][0]) == (gone, went, felt)
        assert repr(memories[0]["near"].tolist()) == repr(near.tolist())
        assert repr(memories[0]["far"].tolist()) == repr(far.tolist())
    assert near.ports[0].received > 0.0


@pytest.mark.parametrize("kind", [DirectConfig, PassivityConfig, WaveConfig])
def test_no_tip_goes_faster_than_the_limit_nor_makes_up_for_what_was_dropped(kind):
    """Two joints of a hand that goes 40 times as fast as the tips may, then rests."""
    rules, side, limit = record_of(kind()), view_struct(Side.array()), 0.005
    reach, tips = 0.0, []
    for k in range(600):
        reach += 2e-4 if 0 < k < 300 else 0.0
        place, speed = joints(reach, -0.5 * reach), joints(0.2, -0.1)
        wave = joints(*(np.sqrt(2.0 * 100.0) * place[:2]))
        coupling.receive_totals(side, 1, joints(1e-2 * k, 1e-2 * k), wave)
        coupling.compute_tip_motion(rules, side, place, speed, joints(), 2, True, DT, limit)
        assert k == 0 or (np.abs(speed) <= limit + 1e-12).all()
        tips.append(place[:2])
    way = np.diff(tips, axis=0)
    assert np.abs(way).max() <= limit * DT * (1.0 + 1e-9)
    assert np.abs(way[:290]).max() > 0.5 * limit * DT
    if kind is not WaveConfig:  # whose tip follows the waves
        np.testing.assert_allclose(way[10:290, 1], -0.5 * way[10:290, 0], atol=1e-12)
        assert np.abs(way[310:]).max() == 0.0
