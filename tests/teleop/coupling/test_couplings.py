"""The couplings over an arbitrary network, between an arbitrary hand and an arbitrary tip."""

from dataclasses import fields, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop import coupling
from teleop.coupling import Bilateral, DirectConfig, PassivityConfig, Side, WaveConfig
from teleop.coupling.side import LAWS, ledger_message
from teleop.messages import MAX_JOINTS, NO_JOINTS, padded
from teleop.topics import Role

DT = 0.001
LEVER = 0.05  # of scales 0.25 and 0.2
ROBUST = [
    PassivityConfig(),
    PassivityConfig(hand_damping=0.0, passive_tip=False),
    WaveConfig(),
    WaveConfig(play=0.1),
]
OLDEST = 30  # ticks


def ticks(most):
    return st.lists(st.floats(-most, most), min_size=1, max_size=8)


FATES = st.lists(
    st.lists(st.integers(0, OLDEST), max_size=2), min_size=1, max_size=7
)  # when a message arrives: never, once, twice


class Line:
    """One direction: what is told arrives when it is fated to."""

    def __init__(self, fates):
        self._fates, self._told = fates, {}

    def tell(self, tick, side):
        for late in self._fates[tick % len(self._fates)]:
            self._told.setdefault(tick + late, []).append((side.energy, side.wave))

    def hear(self, tick, side, sender):
        for energy, wave in self._told.pop(tick, ()):
            side = coupling.hear(side, sender, energy, wave)
        return side


def session(config, turns, forces, shares, there, back, count=100, rested=()):
    """Return both sides after each tick: a hand that turns, a tip that is pushed.

    `turns` are changes of the way a tick [m], `forces` what the tip feels [N], `shares` how much
    of the force is rendered.
    """
    bilateral = Bilateral(coupling=config)
    master, slave = Side(), Side()
    to_slave, to_master = Line(there), Line(back)
    place, way, written = 0.0, 0.0, 0.0
    for tick in range(count):
        coupled = tick not in rested
        way += turns[tick % len(turns)]
        way = min(max(way, -0.001), 0.001)
        place += way
        master = to_master.hear(tick, master, 7)
        felt = forces[(tick // 3) % len(forces)]
        tip, speed = padded((place,), MAX_JOINTS), padded((way / DT,), MAX_JOINTS)
        (rendered,), master = coupling.at_hand(
            bilateral, master, tip, speed, (written,), (felt,), LEVER, coupled, DT
        )
        written = rendered * shares[tick % len(shares)] if coupled else 0.0
        to_slave.tell(tick, master)
        slave = to_slave.hear(tick, slave, 8)
        _, _, slave = coupling.at_tip(bilateral, slave, (place,), (way / DT,), (felt,), coupled, DT)
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
        hand += damping / LEVER * (master.asked[0] - place) ** 2 / DT  # [J] it dissipates itself
        place = master.asked[0]
        one, other = master.ports[0], slave.ports[0]
        assert one.credit >= -1e-12
        assert other.credit >= -1e-12
        out = one.taken_out + other.taken_out
        assert out <= one.put_in + other.put_in + one.granted + other.granted + 1e-12
        assert one.granted + other.granted <= 2.0 * config.reserve + hand + 1e-12
        assert one.heard <= other.passed_on + 1e-12
        assert other.heard <= one.passed_on + 1e-12


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
    """300 mm/s the other way within a tick: more than `give` allows for."""
    if isinstance(config, PassivityConfig):
        config = replace(config, hand_damping=0.0)
    still = [*session(config, [0.0], [10.0], [1.0], [[1]], [[1]], count=20)][-1][0]
    bilateral = Bilateral(coupling=config)
    left_over, written, place = [], 10.0, 0.0
    side = still._replace(asked=padded((0.0,), MAX_JOINTS))
    for tick in range(100):
        way = -3e-4 if tick < 3 else 3e-5
        place += way
        tip, speed = padded((place,), MAX_JOINTS), padded((way / DT,), MAX_JOINTS)
        (force,), side = coupling.at_hand(
            bilateral, side, tip, speed, (written,), (10.0,), LEVER, True, DT
        )
        left_over.append(side.ports[0].credit)
        written = force
    assert -10.0 * 3e-4 <= min(left_over) < 0.0
    assert left_over[-1] > 0.0


def test_direct_changes_nothing():
    """What the hand feels, and where the tip goes, is what was told."""
    bilateral, side = Bilateral(), Side()
    for tick in range(50):
        place = 1e-4 * tick
        tip = padded((place,), MAX_JOINTS)
        (force,), side = coupling.at_hand(
            bilateral, side, tip, tip, (5.0,), (7.0,), LEVER, tick > 0, DT
        )
        assert force == 7.0
    side = Side()
    for tick in range(50):
        place = 1e-4 * tick**1.5
        where, speed, side = coupling.at_tip(bilateral, side, (place,), (0.1,), (9.0,), True, DT)
        assert where == pytest.approx((place,), abs=1e-15)
        assert speed == (0.1,)


@pytest.mark.parametrize("config", [PassivityConfig(), WaveConfig(), DirectConfig()])
@given(force=st.floats(-20, 20), place=st.floats(-0.1, 0.1))
def test_engaging_moves_nothing(config, force, place):
    where, _, side = coupling.at_tip(
        Bilateral(coupling=config), Side(), (place,), (0.0,), (force,), True, DT
    )
    assert where == (place,)
    assert side.tip == (place,)


@pytest.mark.parametrize("config", [PassivityConfig(), WaveConfig(), DirectConfig()])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_force_that_is_no_number_is_not_rendered_as_one(config, bad):
    """Not coupled or coupled, it reaches the gate as it is."""
    bilateral, side, tip = Bilateral(coupling=config), Side(), (0.0,) * MAX_JOINTS
    (force,), side = coupling.at_hand(bilateral, side, tip, tip, (0.0,), (bad,), LEVER, False, DT)
    assert force != force or force == bad


def test_the_signature_tells_any_two_choices_apart():
    choices = [
        Bilateral(),
        Bilateral(coupling=PassivityConfig()),
        Bilateral(coupling=PassivityConfig(reserve=0.003)),
        Bilateral(coupling=WaveConfig()),
    ]
    assert len({choice.signature for choice in choices}) == len(choices)
    assert Bilateral(coupling=PassivityConfig()).signature == choices[1].signature
    assert choices[0].differs(choices[1].signature)
    assert not choices[0].differs(choices[0].signature)
    assert not choices[0].differs(0)


def test_every_coupling_of_the_config_is_there():
    assert set(LAWS) == {PassivityConfig, WaveConfig, DirectConfig}


def test_the_ledgers_message_balances():
    shape = ([1e-5, -1e-5, -1e-5, 1e-5], [8.0], [1.0], [[3]], [[4]])
    *_, (master, slave) = session(PassivityConfig(), *shape)
    for role, side in ((Role.MASTER, master), (Role.SLAVE, slave)):
        told = ledger_message(role, side, 1)
        assert told.joints == 1
        left = told.granted[0] + told.put_in[0] + told.heard[0]
        left -= told.taken_out[0] + told.passed_on[0] + told.dissipated[0]
        assert told.credit[0] == pytest.approx(left, abs=1e-12)
        assert told.put_in[0] > 0.0


WRONG = {
    "reserve": [0.0, 0.2, float("nan")],
    "credit_max": [1e-4, 2.0],
    "give": [0.0, 0.1],
    "catch_up": [0.0, 11.0],
    "spend": [0.0, 1.0],
    "hand_damping": [-1.0, 101.0],
    "play": [0.0, 1.0],
    "impedance": [0.0, 1e5],
}


@pytest.mark.parametrize("kind", [PassivityConfig, WaveConfig])
def test_bad_values_are_refused(kind):
    checked = {field.name for field in fields(kind)} - {"type", "passive_tip"}
    for name in checked:
        for value in WRONG[name]:
            with pytest.raises(ValueError, match=name):
                kind(**{name: value})


def test_a_side_that_was_started_anew_is_counted_from_its_first_word():
    side = Side()
    for sender, energy in ((7, 5.0), (7, 6.0), (8, 3.0), (8, 3.5), (8, 3.2), (7, 9.0)):
        side = coupling.hear(side, sender, (energy,) * MAX_JOINTS, NO_JOINTS)
    assert side.ports[0].heard == pytest.approx(1.5)
    assert side.ports[0].credit == pytest.approx(1.5)
