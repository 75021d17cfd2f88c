import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from master.gate import FADE_S, GateFlags
from teleop.coupling import Bilateral, PassivityConfig, WaveConfig
from teleop.session.state_machine import Reason, State
from tests.master.run import EPOCH, MS, Run, answer, hand


def test_releasing_lets_go_at_once_and_pressing_again_resumes_without_a_jump():
    run = Run().engaged()
    run.answered(hand(0.02))
    there = run.output.command.position
    assert there[0] == pytest.approx(0.005)
    assert run.answered(hand(0.02, engage=False)).force == (0.0,)
    assert run.state == State.READY
    run.answered(hand(-0.1, engage=False), State.READY)
    run.answered(hand(-0.1), State.READY)
    assert run.state == State.ENGAGED
    assert run.output.command.position == pytest.approx(there)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=20), st.floats(-0.2, 0.2))
def test_the_clutch_frees_the_hand_and_letting_it_go_resumes_without_a_jump(way, before):
    run = Run().engaged()
    run.answered(hand(before))
    there = run.output.command.position
    for position in way:
        output = run.answered(hand(position, clutch=True), State.CLUTCHED)
        assert output.force == (0.0,)
        assert output.command.position == there
        assert not any(output.command.velocity)
        assert run.session == (State.CLUTCHED, Reason.CLUTCH_HELD)
    output = run.answered(hand(way[-1]), State.CLUTCHED)
    assert run.state == State.ENGAGED
    assert output.command.position == pytest.approx(there, abs=1e-15)
    assert output.force == (0.0,)  # until the slave has engaged again too
    assert run.answered(hand(way[-1])).force != (0.0,)


def test_the_emergency_stop_lasts_until_it_is_reset_and_then_everything_is_let_go_of():
    run = Run().engaged()
    assert run.answered(hand(stop=True)).force == (0.0,)
    stopped = (State.STOPPED, Reason.EMERGENCY_STOP)
    assert run.session == stopped
    for engage, clutch, stop in itertools.product((True, False), repeat=3):
        if engage or clutch or stop:
            run.answered(hand(engage=engage, clutch=clutch, stop=stop))
            assert run.session == stopped
            assert run.output.force == (0.0,)
    for _ in range(5):
        run.answered(hand(engage=False), State.STOPPED)
        assert run.session == stopped
    run.tick(hand(), answer(run.now + MS, State.READY), reset=True)
    assert run.session == (State.READY, Reason.RESET)
    run.answered(hand(), State.READY)
    assert run.session == (State.READY, Reason.RELEASE_FIRST)
    run.answered(hand(engage=False), State.READY)
    run.answered(hand(), State.READY)
    assert run.state == State.ENGAGED


@pytest.mark.parametrize("how", ["silent", "old answer", "unheard", "gone", "rig"])
def test_after_a_stale_state_the_force_fades_and_nothing_couples_until_let_go(how):
    run = Run().engaged()
    for _ in range(5):
        run.answered(hand(), force=11.0)
    felt = run.output.force[0]
    assert felt < 0.0
    now = run.now + MS
    state, age = answer(now), 0
    if how == "silent":
        age = 30 * MS + 1
    elif how == "old answer":
        state = answer(now, echo=now - 100 * MS - 1)
    elif how == "unheard":
        state = answer(now, echo=0)
    elif how == "rig":
        state, age = answer(now, sample_age=20 * MS + 1), 10 * MS
    else:
        state = None
    for _ in range(math.ceil(FADE_S / 1e-3)):
        output = run.tick(hand(), state, age)
        assert output.verdict & GateFlags.STALE_STATE
        assert felt < output.force[0] <= 0.0 or felt == output.force[0] == 0.0
        felt = output.force[0]
    assert felt == 0.0
    assert run.session == (State.HOLDING, Reason.PEER_SILENT)
    for _ in range(5):  # it comes back, but the switch was never released
        assert run.answered(hand()).force == (0.0,)
        assert run.session == (State.HOLDING, Reason.RELEASE_FIRST)
    run.answered(hand(engage=False), State.READY)
    assert run.state == State.READY


def test_just_young_enough_is_felt():
    run = Run().engaged()
    now = run.now + MS
    assert run.tick(hand(), answer(now, echo=now - 100 * MS), 30 * MS).force != (0.0,)
    now = run.now + MS
    at_82_hz = answer(now, sample_age=13 * MS)
    assert run.tick(hand(), at_82_hz, 17 * MS).force != (0.0,)


@pytest.mark.parametrize("broken", [hand(velocity=math.nan), hand(1e9)])
def test_a_hand_that_cannot_be_is_a_fault_and_does_not_reach_the_slave(broken):
    run = Run().engaged()
    before = run.answered(hand(0.01)).command.position
    output = run.answered(broken)
    assert output.force == (0.0,)
    assert (output.command.state, output.command.reason) == (State.FAULT, Reason.NOT_FINITE)
    assert output.command.position == before
    assert not any(output.command.velocity)


@pytest.mark.parametrize(
    ("bad", "coupling"), [(math.nan, PassivityConfig()), (math.inf, WaveConfig())]
)
def test_a_hand_that_was_no_number_once_leaves_no_trace_in_the_ledger(bad, coupling):
    """Once engaged again the sums are numbers, and the coupling's limits hold as before."""
    bilateral = Bilateral(coupling=coupling)
    forces = []
    for broken in (0.0, bad):
        run = Run(bilateral=bilateral)

        def told(state, run=run):
            return replace(answer(run.now + MS, state), coupling=bilateral.signature)

        for position in (0.0, broken, 0.0):
            run.tick(hand(position, engage=False), told(State.READY))
        for k in range(100):
            run.tick(hand(-1e-4 * k), told(State.ENGAGED if k else State.READY))
            assert all(map(math.isfinite, (*run.output.command.energy, *run.output.command.wave)))
            assert math.isfinite(run.memory.coupling.ports[0].credit)
        assert run.state == State.ENGAGED
        forces.append(run.output.force[0])
    assert forces[0] == forces[1]


def test_a_hand_that_cannot_be_read_is_never_engaged():
    run = Run()
    for _ in range(3):
        run.answered(None, State.READY)
        assert run.state == State.OFF
    run = Run().engaged()
    assert run.answered(None).force == (0.0,)
    assert run.session == (State.FAULT, Reason.NOT_USABLE)


def test_an_estimate_that_is_no_number_is_a_fault_when_it_would_be_felt():
    run, idle = Run().engaged(), Run()
    assert run.answered(hand(), force=math.nan).force == (0.0,)
    assert run.session == (State.FAULT, Reason.NOT_FINITE)
    for _ in range(3):
        idle.answered(hand(engage=False), State.READY, force=math.nan)
    assert idle.state == State.READY


def test_each_command_is_counted_as_answered_once_and_only_our_own():
    run = Run()
    sent = [EPOCH + k * MS + 1 for k in range(6)]
    echoes = [EPOCH - 5 * MS, sent[0], sent[0], sent[2], sent[1], sent[3], EPOCH + 10**12]
    answers = [
        run.answered(hand(), State.READY, echo=echo).answer_ns for echo in echoes if run.now or echo
    ]
    assert answers == [0, sent[0], 0, sent[2], 0, sent[3], 0]
