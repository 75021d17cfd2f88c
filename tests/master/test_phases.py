"""What comes between command and force: a newer state of the slave, and time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from master import loop
from master.config import MasterConfig
from master.device import HandState
from master.gate import GateConfig, GateFlags
from teleop.coupling import Bilateral, PassivityConfig, WaveConfig
from teleop.messages.messages import Command
from teleop.session import state_machine
from teleop.session.state_machine import Reason, State
from tests.master.records import message_records
from tests.master.run import CONFIG, MS, Run, answer, hand


def later(run, state=State.ENGAGED, **more):
    """What the slave answers while the master waits."""
    return replace(answer(run.now + MS, state, **more), stamp_ns=run.now + MS + MS // 10)


def both(run, the_hand, newer, **more):
    """A tick whose first phase knows of an answer in order, and the second one of a newer one."""
    return run.tick(the_hand, answer(run.now + MS), later=newer, wait=MS // 5, **more)


def test_the_force_is_that_of_the_newest_state():
    run = Run().engaged()
    output = both(run, hand(), later(run, force=10.0))
    assert output.force == pytest.approx((-2.0,))
    assert output.command.echo_stamp_ns == run.now  # what was known when it was sent


@pytest.mark.parametrize(
    ("state", "after"),
    [
        (State.FAULT, (State.FAULT, Reason.PEER_FAULT)),
        (State.READY, (State.FAULT, Reason.PEER_LEFT)),
        (State.OFF, (State.READY, Reason.PEER_ENDED)),
    ],
)
def test_what_ended_on_the_other_side_meanwhile_ends_the_force_at_once(state, after):
    run = Run().engaged()
    run.answered(hand())
    output = both(run, hand(), later(run, state))
    assert output.force == (0.0,)
    assert output.verdict & GateFlags.NOT_ENGAGED
    assert run.session == after
    assert output.command.state == State.ENGAGED  # was sent before; the next one tells
    assert run.answered(hand(), state).command.state == after[0]


def test_a_slave_that_holds_meanwhile_makes_the_force_fade():
    run = Run().engaged()
    felt = run.answered(hand(), force=10.0).force[0]
    force = both(run, hand(), later(run, State.HOLDING)).force[0]
    assert felt < force < 0.0
    assert run.session == (State.HOLDING, Reason.PEER_HOLDS)


def test_a_slave_that_is_engaged_before_the_press_is_not_felt_in_the_tick_of_the_press():
    run = Run().engaged()
    run.answered(hand(), force=10.0)
    both(run, hand(engage=False), later(run, State.READY))
    assert run.answered(hand(), State.ENGAGED, force=10.0).force == (0.0,)
    assert run.state == State.ENGAGED
    assert run.answered(hand(), State.ENGAGED, force=10.0).force[0] < 0.0


def test_a_slave_that_was_replaced_meanwhile_is_not_felt():
    run = Run().engaged()
    run.answered(hand())
    assert both(run, hand(), later(run, sender=8)).force == (0.0,)
    assert run.session == (State.FAULT, Reason.PEER_RESTARTED)


def test_a_state_that_grows_too_old_during_the_wait_makes_the_force_fade():
    run = Run().engaged()
    felt = run.answered(hand(), force=10.0).force[0]
    output = run.tick(hand(), answer(run.now + MS), 30 * MS - 10, wait=20)
    assert output.verdict & GateFlags.STALE_STATE
    assert felt < output.force[0] < 0.0
    assert run.session == (State.HOLDING, Reason.PEER_SILENT)


@pytest.mark.parametrize("coupling", [PassivityConfig(), WaveConfig()])
def test_a_slave_that_engages_meanwhile_is_felt_from_the_next_tick_on(coupling):
    """Not before the coupling has counted a tick of the hand."""
    bilateral = Bilateral(coupling=coupling)
    run = Run(bilateral=bilateral)

    def told(state):
        return replace(answer(run.now + MS, state), coupling=bilateral.signature)

    for engage in (False, False, True):
        run.tick(hand(engage=engage), told(State.READY))
    assert run.state == State.ENGAGED
    output = run.tick(hand(), told(State.READY), later=told(State.ENGAGED))
    assert state_machine.may_render(run.memory.session)
    assert output.force == (0.0,)
    assert output.verdict & GateFlags.NOT_ENGAGED
    assert not run.memory.coupling.coupled
    run.tick(hand(), told(State.ENGAGED))
    assert run.memory.coupling.coupled


def test_where_the_first_force_was_no_number_a_newer_one_waits_for_a_tick_that_counts():
    run = Run()
    for engage in (False, False, True):
        run.answered(hand(engage=engage), State.READY)
    broken = answer(run.now + MS, force=math.nan)
    assert run.tick(hand(), broken, later=later(run)).force == (0.0,)
    assert not run.memory.coupling.coupled


def test_a_reset_has_its_effect_once():
    run = Run().engaged()
    run.answered(hand(stop=True))
    output = run.tick(
        hand(engage=False),
        answer(run.now + MS, State.READY),
        reset=True,
        later=later(run, State.STOPPED),
    )
    assert output.command.state == State.READY
    assert run.state == State.READY
    run = Run().engaged()
    run.tick(hand(), answer(run.now + MS), reset=True, later=later(run, State.STOPPED))
    assert run.session == (State.STOPPED, Reason.PEER_STOPPED)


def test_a_stop_counts_once_in_both_phases():
    run = Run().engaged()
    before = int(run.memory.session.stops)
    both(run, hand(stop=True), later(run))
    assert run.session == (State.STOPPED, Reason.EMERGENCY_STOP)
    assert run.memory.session.stops == before + 1


def test_an_answer_that_comes_during_the_wait_is_one_to_the_command_of_this_tick():
    run = Run().engaged()
    sent = run.now + MS + 100
    newer = replace(later(run), echo_stamp_ns=sent)
    assert both(run, hand(), newer).answer_ns == sent
    assert run.answered(hand(), echo=sent).answer_ns == 0
    assert run.memory.answered_command_ns == sent


def test_a_sample_age_beyond_every_limit_is_not_fresh():
    run = Run().engaged()
    run.answered(hand())
    for age in (2**63 - 1, 2**62):
        state = replace(answer(run.now + MS), sample_age_ns=age)
        assert run.tick(hand(), state, 2**62).verdict & GateFlags.STALE_STATE


def test_a_command_is_written_whole_whatever_was_in_it():
    """Two commands of the same tick, over zeros and over something else, but for the head."""
    found = []
    for filled in (0, 1):
        run = Run().engaged()
        out = message_records(Command)
        for name in out.dtype.names:
            out[name] = filled
        loop.compute_command(*run.inputs, out)
        found.append([out[name].tolist() for name in out.dtype.names[5:]])
    assert found[0] == found[1]


ANY = st.floats(allow_nan=True, allow_infinity=True)
ANSWERS = st.builds(
    lambda *told: told,
    st.sampled_from([2, 2, 2, 2, 2, 0, 1, 3, 5, 6, 9]),
    st.floats(-50.0, 50.0) | ANY,
    st.sampled_from([0, 0, 0, MS, 29 * MS, 31 * MS, 2**62]),
    st.sampled_from([7, 7, 7, 7, 8]),
    ANY,
)
HANDS = st.one_of(
    *[st.builds(hand, st.floats(-0.1, 0.1), st.just(True), st.floats(-1.0, 1.0))] * 4,
    st.none(),
    st.builds(hand, ANY, st.booleans(), ANY),
)
COUPLINGS = st.sampled_from([Bilateral(), Bilateral(coupling=PassivityConfig()),
                             Bilateral(coupling=WaveConfig())])  # fmt: skip


@settings(max_examples=200, deadline=None)
@given(
    COUPLINGS,
    st.lists(st.tuples(HANDS, ANSWERS, st.none() | ANSWERS, st.booleans()), max_size=40),
)
def test_whatever_comes_between_the_phases_the_force_is_safe(bilateral, script):
    run = Run(MasterConfig(gate=GateConfig(axis_max=1.5, slew_max=4e3)), bilateral)

    def told(spec):
        state, force, age, sender, energy = spec
        state = answer(run.now + MS, state, force, sender=sender)
        return replace(state, coupling=bilateral.signature, energy=(energy,) * 8), age

    for engage in (False, False, True):
        run.tick(hand(engage=engage), told((1, 0.0, 0, 7, 0.0))[0])
    for _ in range(2):
        run.tick(hand(), told((2, 5.0, 0, 7, 0.0))[0])
    assert state_machine.may_render(run.memory.session)
    faulted, tip = False, None  # in fault, and the switch not open since
    for the_hand, first, second, faulty in script:
        fault = Reason.DEVICE_FAULT if faulty and the_hand is None else Reason.NONE
        state, age = told(first)
        before, was = run.state, run.memory.force[0]
        newer, newer_age = (None, 0) if second is None else told(second)
        output = run.tick(
            the_hand, state, age, fault, later=newer, later_age=newer_age, wait=MS // 5
        )
        (force,) = output.force
        assert math.isfinite(force)
        assert abs(force) <= 1.5
        assert all(map(math.isfinite, (*output.command.position, *output.command.velocity)))
        known, limit = (first, age + MS // 5) if second is None else (second, newer_age)
        right = (
            the_hand is not None
            and the_hand.engage
            and fault is Reason.NONE
            and limit <= 30 * MS
            and known[0] == State.ENGAGED
            and math.isfinite(known[1])
        )
        if run.state == State.HOLDING:
            assert abs(force) < abs(was) or force == 0.0
        elif not right or before != State.ENGAGED:
            assert force == 0.0
        elif force and bilateral == Bilateral():
            assert math.copysign(1.0, force) == -math.copysign(1.0, known[1])

        pressed = the_hand is not None and the_hand.engage
        if (faulted and pressed) or fault is not Reason.NONE:
            assert run.state in (State.FAULT, State.STOPPED)
        faulted = run.state == State.FAULT and (faulted or before != State.FAULT)
        if the_hand is not None and not pressed:
            faulted = False
            assert run.state != State.ENGAGED
        command = output.command
        if command.state != State.ENGAGED:
            assert not any(command.velocity)
            assert tip is None or first[3] != 7 or command.position == tip
        tip = command.position if first[3] == 7 else None


def test_axes_of_a_device_do_not_leak_into_each_other():
    """Three axes with a hand and a force of their own each do as three devices of one."""
    run = Run(CONFIG, axes=3)
    singles = [Run(CONFIG) for _ in range(3)]
    way = np.random.default_rng(1).uniform(-0.01, 0.01, (60, 3))
    for k, position in enumerate(way.cumsum(axis=0) * 0.05):
        state = State.READY if k < 4 else State.ENGAGED
        forces = (1.0, -2.0, 3.0)
        whole = answer(run.now + MS, state)
        alone = [answer(run.now + MS, state, force) for force in forces]
        whole = replace(whole, joints=3, **{
            name: tuple(getattr(a, name)[0] for a in alone) + (0.0,) * 5
            for name in ("force", "force_low", "force_high")
        })  # fmt: skip
        together = run.tick(HandState(tuple(position), (0.0,) * 3, k > 2), whole)
        for axis, single in enumerate(singles):
            output = single.tick(hand(position[axis], engage=k > 2), alone[axis])
            assert together.force[axis] == output.force[0]
            assert together.command.position[axis] == output.command.position[0]
    assert any(together.force)
