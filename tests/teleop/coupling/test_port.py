"""The ledger of one port."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.coupling import port as ledger
from teleop.coupling.port import Port

ENERGY = st.floats(0.0, 10.0)


def balance(port):
    return (
        port.granted + port.put_in + port.heard - port.taken_out - port.passed_on - port.dissipated
    )


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just(ledger.worked), st.floats(-1.0, 1.0)),
        st.tuples(st.just(ledger.pass_on), st.floats(-1.0, 1.0)),
        st.tuples(st.just(ledger.capped), st.floats(0.0, 1.0)),
        st.tuples(st.just(ledger.rest), st.floats(0.0, 1.0)),
        st.tuples(st.just(lambda p, e: ledger.returned(p, e, passive=True)), st.floats(-1.0, 1.0)),
        st.tuples(st.just(lambda p, e: ledger.hear(p, e, 0.0)), ENERGY),
    ),
    max_size=40,
)


@given(STEPS)
def test_nothing_is_lost_without_being_counted(steps):
    port = Port()
    for step, energy in steps:
        port = step(port, energy)
        assert port.credit == pytest.approx(balance(port), abs=1e-9)


@given(st.lists(st.tuples(ENERGY, st.floats(-1.0, 1.0)), min_size=1, max_size=10), st.data())
def test_messages_lost_repeated_or_out_of_order_change_nothing_once_the_newest_is_heard(
    increments, data
):
    told, energy, wave = [(3.0, 4.0)], 3.0, 4.0
    for more, moved in increments:
        energy, wave = energy + more + 1e-3, wave + moved
        told.append((energy, wave))
    arrived = data.draw(st.lists(st.sampled_from(told), max_size=20))
    port = ledger.hear(Port(), *told[0])
    for message in [*arrived, told[-1], *arrived]:
        port = ledger.hear(port, *message)
    assert port.credit == pytest.approx(energy - 3.0)
    assert port.heard_wave == wave


@given(ENERGY, ENERGY)
def test_a_restarted_sender_is_counted_from_its_first_word_on(old, new):
    port = ledger.hear(ledger.hear(Port(), 0.0, 0.0), old, 0.0)
    credit = port.credit
    port = ledger.hear(ledger.forget(port), new, 0.0)
    assert port.credit == credit
    assert ledger.hear(port, new + 1.0, 0.0).credit == pytest.approx(credit + 1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_not_heard(bad):
    port = ledger.hear(Port(), 1.0, 1.0)
    assert ledger.hear(port, bad, 2.0) == port
    assert ledger.hear(port, 2.0, bad) == port


def test_what_is_passive_brings_back_no_more_than_it_took():
    port = ledger.returned(Port(credit=1.0), -0.3, passive=True)
    port = ledger.returned(port, 0.5, passive=True)
    assert port.credit == pytest.approx(1.0)
    assert port.dissipated == pytest.approx(0.2)
    assert ledger.returned(Port(), 0.5, passive=False).credit == 0.5


@given(ENERGY, st.floats(-50.0, 50.0), st.floats(-1e-3, 1e-3), st.floats(-1.0, 1.0))
def test_a_hand_that_turns_no_faster_than_stated_takes_no_more_than_the_credit(
    credit, force, way, turn
):
    give = 2e-5
    given_force = ledger.affordable(Port(credit=credit), force, way, 10.0, give)
    assert -given_force * (way + turn * give) <= credit * (1.0 + 1e-12) + 1e-15
    assert given_force * force >= 0.0
    assert abs(given_force) <= abs(force)


@given(st.floats(-1.0, 0.0), st.floats(0.0, 50.0))
def test_a_hand_that_presses_is_given_the_force_whatever_the_credit(credit, force):
    assert ledger.affordable(Port(credit=credit), force, 3e-5, 10.0, 2e-5) == force
    assert ledger.affordable(Port(credit=credit), force, 0.0, 10.0, 2e-5) == 0.0


@given(ENERGY, st.floats(-50.0, 50.0), st.floats(-0.01, 0.01))
def test_the_tip_goes_against_a_force_as_far_as_the_credit_lasts(credit, force, way):
    gone = ledger.affordable_way(Port(credit=credit), force, way, 1.0)
    assert gone * way >= 0.0
    assert abs(gone) <= abs(way)
    assert force * gone <= credit * (1.0 + 1e-12) + 1e-300
    if force * way <= 0.0 or force * way < 0.999 * credit:
        assert gone == way
