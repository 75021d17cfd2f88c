"""The ledger of one port."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.coupling import energy_ledger
from teleop.coupling.energy_ledger import Port

ENERGY = st.floats(0.0, 10.0)


def values(port):
    """All fields; NaN as None, which equals itself."""
    return [None if math.isnan(v) else v for v in port.tolist()]


def balance(port):
    return (
        port.granted
        + port.put_in
        + port.received
        - port.taken_out
        - port.passed_on
        - port.dissipated
    )


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just(energy_ledger.count_work), st.floats(-1.0, 1.0)),
        st.tuples(st.just(energy_ledger.grant_energy), ENERGY),
        st.tuples(st.just(energy_ledger.pass_on_energy), st.floats(-1.0, 1.0)),
        st.tuples(st.just(energy_ledger.cap_credit), st.floats(0.0, 1.0)),
        st.tuples(st.just(energy_ledger.keep_reserve), st.floats(0.0, 1.0)),
        st.tuples(
            st.just(lambda p, e: energy_ledger.count_tip_work(p, e, True)), st.floats(-1.0, 1.0)
        ),
        st.tuples(st.just(lambda p, e: energy_ledger.receive_totals(p, e, 0.0)), ENERGY),
    ),
    max_size=40,
)


@given(STEPS)
def test_nothing_is_lost_without_being_counted(steps):
    port = Port.new()
    for step, energy in steps:
        step(port, energy)
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
    port = Port.new()
    for message in [told[0], *arrived, told[-1], *arrived]:
        energy_ledger.receive_totals(port, *message)
    assert port.credit == pytest.approx(energy - 3.0)
    assert port.received_wave == wave


@given(ENERGY, ENERGY)
def test_a_restarted_sender_is_counted_from_its_first_word_on(old, new):
    port = Port.new()
    energy_ledger.receive_totals(port, 0.0, 0.0)
    energy_ledger.receive_totals(port, old, 0.0)
    credit = port.credit
    energy_ledger.reset_received_totals(port)
    energy_ledger.receive_totals(port, new, 0.0)
    assert port.credit == credit
    energy_ledger.receive_totals(port, new + 1.0, 0.0)
    assert port.credit == pytest.approx(credit + 1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_not_heard(bad):
    port = Port.new()
    energy_ledger.receive_totals(port, 1.0, 1.0)
    before = values(port)
    energy_ledger.receive_totals(port, bad, 2.0)
    assert values(port) == before
    energy_ledger.receive_totals(port, 2.0, bad)
    assert values(port) == before


def test_a_weight_returns_what_it_took_and_the_allowance_besides():
    """3 N, moved back and forth by 2 mm, then let down for good."""
    port = Port.new(credit=1.0)
    for _ in range(3):
        for travel in [2e-5] * 100 + [-2e-5] * 100:
            energy_ledger.count_tip_work_under_load(port, 3.0, travel, 0.005, 0.05, 0.001)
    assert port.dissipated == pytest.approx(0.0, abs=1e-12)
    for _ in range(200):
        energy_ledger.count_tip_work_under_load(port, 3.0, -2e-5, 0.005, 0.05, 0.001)
    assert port.credit == pytest.approx(1.0 + 0.005)
    assert port.dissipated == pytest.approx(200 * 6e-5 - 0.005)


def test_a_force_that_swings_returns_no_more_than_it_took():
    """10 N on the way back and none on the way in: an engine, 10 times a second."""
    port = Port.new(credit=1.0)
    for _ in range(20):
        for force, travel in [(0.0, 2e-5)] * 50 + [(10.0, -2e-5)] * 50:
            energy_ledger.count_tip_work_under_load(port, force, travel, 0.005, 0.05, 0.001)
    assert port.put_in == pytest.approx(20 * 50 * 2e-4)
    assert port.credit <= 1.0 + 0.005 + 1e-9


@given(ENERGY, st.lists(st.tuples(st.floats(-30.0, 30.0), st.floats(-1e-3, 1e-3)), max_size=30))
def test_what_is_given_up_at_the_tip_is_never_more_than_there_is(credit, steps):
    port = Port.new(credit=credit)
    for force, travel in steps:
        before = port.credit - force * travel
        energy_ledger.count_tip_work_under_load(port, force, travel, 0.005, 0.05, 0.001)
        assert min(before, 0.0) - 1e-15 <= port.credit <= before + 1e-15


@given(ENERGY, st.floats(-50.0, 50.0), st.floats(-1e-3, 1e-3), st.floats(-1.0, 1.0))
def test_a_hand_that_turns_no_faster_than_stated_takes_no_more_than_the_credit(
    credit, force, travel, turn
):
    tolerance = 2e-5
    given_force = energy_ledger.limit_force_to_credit(
        Port.new(credit=credit), force, travel, 10.0, tolerance
    )
    assert -given_force * (travel + turn * tolerance) <= credit * (1.0 + 1e-12) + 1e-15
    assert given_force * force >= 0.0
    assert abs(given_force) <= abs(force)


@given(ENERGY, st.floats(-50.0, 50.0), st.floats(-0.01, 0.01))
def test_the_tip_goes_against_a_force_as_far_as_the_credit_lasts(credit, force, travel):
    gone = energy_ledger.limit_travel_to_credit(Port.new(credit=credit), force, travel, 1.0)
    assert gone * travel >= 0.0
    assert abs(gone) <= abs(travel)
    assert force * gone <= credit * (1.0 + 1e-12) + 1e-300
    if force * travel <= 0.0 or force * travel < 0.999 * credit:
        assert gone == travel


@given(st.floats(-1.0, 0.0), st.floats(0.0, 50.0))
def test_a_hand_that_presses_is_given_the_force_whatever_the_credit(credit, force):
    port = Port.new(credit=credit)
    assert energy_ledger.limit_force_to_credit(port, force, 3e-5, 10.0, 2e-5) == force
    assert energy_ledger.limit_force_to_credit(port, force, 0.0, 10.0, 2e-5) == 0.0
