"""The session state machine, over every input it can meet."""

import itertools
from collections import deque
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from estimator.compiled import jit_compile
from teleop.session.state_machine import (
    FOLLOW_LIMIT_S,
    HOLD_LIMIT_S,
    Reason,
    Session,
    SessionInputs,
    SessionOutline,
    State,
    is_force_fading,
    is_switch_closed,
    may_move,
    may_render,
    may_yield,
    step,
    to_known_state,
    to_outline,
)

DT = 0.001
OWN_FAULTS = (Reason.RIG_FAULT, Reason.DEVICE_FAULT)
STOP = Reason.STOP_CALLED


class Known(NamedTuple):
    """The fields of `SessionInputs`, as values."""

    usable: bool
    peer_fresh: bool
    peer_state: State
    engage: bool
    fault: Reason = Reason.NONE
    clutch: bool = False
    stop: Reason = Reason.NONE
    reset: bool = False
    not_ready_reason: Reason = Reason.NONE
    peer: int = 0


class Now(NamedTuple):
    """The fields of `Session`, as values, and what it allows."""

    state: State = State.OFF
    reason: Reason = Reason.NOT_USABLE
    open_seen: bool = False
    peer_seen: bool = False
    followed: bool = False
    waited_s: float = 0.0
    peer: int = 0
    calling: bool = False
    stops: int = 0
    may_move: bool = False
    may_yield: bool = False
    may_render: bool = False
    fades: bool = False

    @property
    def outline(self):
        return SessionOutline(self.state, self.reason)


FIELDS = Session.dtype.names or ()


def sessions_of(now, count=1):
    sessions = Session.array(count)
    sessions[:] = tuple(getattr(now, name) for name in FIELDS)
    return sessions


def inputs_of(known):
    inputs = SessionInputs.array(len(known))
    for name in Known._fields:
        inputs[name] = [getattr(item, name) for item in known]
    return inputs


@jit_compile
def step_each(sessions, inputs, dt, allowed):
    for k in range(len(sessions)):
        step(sessions[k], inputs[k], dt)
        allowed[k, 0] = may_move(sessions[k])
        allowed[k, 1] = may_yield(sessions[k])
        allowed[k, 2] = may_render(sessions[k])
        allowed[k, 3] = is_force_fading(sessions[k])


def after_each(before, inputs, dt):
    """What a session becomes with each of many inputs."""
    sessions = sessions_of(before, len(inputs))
    allowed = np.zeros((len(inputs), 4), bool)
    step_each(sessions, inputs, dt, allowed)
    return [
        Now(State(values[0]), Reason._value2member_map_[values[1]], *values[2:], *flags)
        for values, flags in zip(sessions.tolist(), allowed.tolist(), strict=True)
    ]


def advance(before, known, dt=DT):
    return after_each(before, inputs_of([known]), dt)[0]


EVERY_INPUT = [
    Known(usable, fresh, peer, engage, fault, clutch, stop, reset, not_ready_reason, nonce)
    for usable, fresh, peer, engage, fault, clutch, stop, reset, (not_ready_reason, nonce) in (
        itertools.product(
            *((False, True), (False, True), State, (False, True), (Reason.NONE, *OWN_FAULTS)),
            *((False, True), (Reason.NONE, STOP), (False, True)),
            ((Reason.NONE, 0), (Reason.NONE, 1), (Reason.ALIGN_FIRST, 0)),
        )
    )
    if not (stop and fault)
]
COUPLES = (State.ENGAGED, State.CLUTCHED)
CALM = Known(usable=True, peer_fresh=True, peer_state=State.READY, engage=False)
PRESS = Known(usable=True, peer_fresh=True, peer_state=State.READY, engage=True)
COUPLED = Known(usable=True, peer_fresh=True, peer_state=State.ENGAGED, engage=True)


def whole(session):
    """All fields, also those that the outline leaves out; the wait by whether it has run out.

    But for the count of stops, on which nothing depends.
    """
    values = {name: getattr(session, name) for name in FIELDS}
    del values["stops"], values["calling"]
    limit_s = FOLLOW_LIMIT_S if session.state == State.ENGAGED else HOLD_LIMIT_S
    values["waited_s"] = values["waited_s"] > 0.5 * limit_s
    return tuple(values.values())


def run(session, *inputs):
    for item in inputs:
        session = advance(session, item)
    return session


def explore(dt=FOLLOW_LIMIT_S * 0.6):
    """Every transition that any sequence of inputs can cause."""
    every = inputs_of(EVERY_INPUT)
    todo, seen, transitions = deque([Now()]), {whole(Now())}, []
    while todo:
        before = todo.popleft()
        for inputs, after in zip(EVERY_INPUT, after_each(before, every, dt), strict=True):
            transitions.append((before, inputs, after))
            if whole(after) not in seen:
                seen.add(whole(after))
                todo.append(after)
    return transitions


@cache
def short_ticks():
    return explore()


@cache
def transitions():
    return short_ticks() + explore(HOLD_LIMIT_S * 0.6)


def test_all_states_and_the_peer_reasons_are_reachable():
    reached = {(after.state, after.reason) for _, _, after in transitions()}
    assert {state for state, _ in reached} == set(State)
    faults = {reason for state, reason in reached if state == State.FAULT}
    peer = {
        Reason.PEER_SILENT,
        Reason.PEER_FAULT,
        Reason.PEER_LEFT,
        Reason.PEER_DECLINED,
        Reason.PEER_RESTARTED,
    }
    assert faults == peer | set(OWN_FAULTS) | {Reason.NOT_USABLE}
    holds = {reason for state, reason in reached if state == State.HOLDING}
    assert holds == {Reason.PEER_SILENT, Reason.PEER_HOLDS, Reason.RELEASE_FIRST}
    stops = {reason for state, reason in reached if state == State.STOPPED}
    assert stops == {STOP, Reason.PEER_STOPPED}


def test_engaged_only_with_usable_fresh_willing_and_asked_for():
    for before, inputs, after in transitions():
        if after.state == State.ENGAGED:
            assert inputs.usable
            assert inputs.peer_fresh
            assert inputs.engage
            assert not inputs.clutch
            assert inputs.fault == Reason.NONE
            assert inputs.stop == Reason.NONE
            assert inputs.peer_state in (State.READY, *COUPLES)
            assert inputs.peer == after.peer
            if before.state == State.READY:
                assert inputs.not_ready_reason == Reason.NONE


def test_engaged_is_entered_from_ready_or_by_the_clutch_only():
    for before, inputs, after in transitions():
        if after.state == State.ENGAGED and before.state != State.ENGAGED:
            assert before.state in (State.READY, State.CLUTCHED)
            if before.state == State.READY:
                assert inputs.peer_state in (State.READY, State.ENGAGED)


def test_clutched_comes_from_engaged_and_ends_with_the_clutch_or_the_session():
    for before, inputs, after in transitions():
        if after.state == State.CLUTCHED:
            assert before.state in COUPLES
            assert inputs.clutch
            assert inputs.engage
        if before.state == State.CLUTCHED and after.state == State.ENGAGED:
            assert not inputs.clutch


def test_an_own_fault_leads_to_fault_unless_stopped():
    for before, inputs, after in transitions():
        if inputs.fault != Reason.NONE:
            latched = before.state == State.STOPPED and not inputs.reset
            assert after.state == (State.STOPPED if latched else State.FAULT)


def test_a_stop_always_stops_and_only_a_reset_without_a_stop_ends_it():
    for before, inputs, after in transitions():
        if inputs.stop != Reason.NONE:
            assert after.state == State.STOPPED
        if before.state == State.STOPPED:
            assert after.state not in (*COUPLES, State.HOLDING)
            if after.state == State.STOPPED:
                assert after.reason == before.reason
            else:
                assert inputs.reset
                assert inputs.stop == Reason.NONE
                assert not after.open_seen  # the switch must be found open, then pressed


def test_a_stop_of_the_peer_stops_whoever_is_coupled_to_it():
    for before, inputs, after in transitions():
        calm = inputs.fault == inputs.stop == Reason.NONE and inputs.usable and inputs.peer_fresh
        coupled = before.state in (*COUPLES, State.HOLDING)
        if coupled and calm and inputs.peer_state == State.STOPPED:
            assert after.outline == (State.STOPPED, Reason.PEER_STOPPED)


def test_a_restarted_peer_is_a_fault_for_whoever_was_coupled_or_held_for_it():
    seen = set()
    for before, inputs, after in transitions():
        calm = inputs.fault == inputs.stop == Reason.NONE and inputs.usable and inputs.peer_fresh
        another = inputs.peer != before.peer and inputs.peer_state != State.STOPPED
        if before.state in (*COUPLES, State.HOLDING) and calm and another and inputs.engage:
            assert after.outline == (State.FAULT, Reason.PEER_RESTARTED)
            seen.add(before.state)
    assert seen == {*COUPLES, State.HOLDING}


def test_silence_while_coupled_is_held_and_ends_in_ready_fault_or_stop():
    for before, inputs, after in transitions():
        calm = inputs.fault == inputs.stop == Reason.NONE and inputs.usable
        if before.state in COUPLES and calm and not inputs.peer_fresh:
            assert after.outline == (State.HOLDING, Reason.PEER_SILENT)
        if before.state == State.HOLDING and after.state != State.HOLDING:
            assert after.state in (State.READY, State.FAULT, State.STOPPED)
            if after.state == State.READY:
                assert inputs.peer_fresh
                assert not inputs.engage
                assert not after.open_seen


def test_fault_is_left_only_with_the_switch_open_and_the_fault_gone():
    for before, inputs, after in transitions():
        if before.state == State.FAULT and after.state not in (State.FAULT, State.STOPPED):
            assert after.state == State.READY
            assert not inputs.engage
            assert inputs.usable
            assert inputs.fault == Reason.NONE
            if before.reason == Reason.PEER_SILENT:
                assert inputs.peer_fresh


def test_a_degraded_session_goes_the_same_ways_and_says_so_while_it_is_engaged():
    plain = inputs_of(EVERY_INPUT)
    degraded, slow = plain.copy(), plain.copy()
    degraded["degraded"] = slow["degraded"] = Reason.CALIBRATION_DUE
    slow["link"] = Reason.LINK_SLOW
    befores = {before for before, _, _ in short_ticks()}
    befores |= {n._replace(reason=Reason.CALIBRATION_DUE) for n in befores if n.state in COUPLES}
    engaged_count = 0
    for before in befores:
        runs = []
        for inputs in (plain, degraded, slow):
            sessions, allowed = sessions_of(before, len(inputs)), np.zeros((len(inputs), 4), bool)
            step_each(sessions, inputs, DT, allowed)
            runs.append((sessions, allowed))
        (as_now, may_now), (session, may), (on_slow_link, _) = runs
        engaged = as_now["state"] == State.ENGAGED
        engaged_count += engaged.sum()
        assert (session["reason"][engaged] == Reason.CALIBRATION_DUE).all()
        told = on_slow_link["reason"][engaged & (as_now["followed"] | (before.state in COUPLES))]
        assert (told == Reason.LINK_SLOW).all()
        session["reason"][engaged] = as_now["reason"][engaged]
        np.testing.assert_array_equal(session, as_now)
        np.testing.assert_array_equal(may, may_now)
    assert engaged_count > 0


def test_a_rig_that_has_played_its_data_ends_without_fault():
    for before in {before for before, _, _ in transitions()}:
        ended = advance(before, Known(True, True, State.ENGAGED, True, Reason.RIG_FINISHED), 1e-3)
        assert ended.outline == (State.OFF, Reason.RIG_FINISHED)


def test_a_fault_keeps_its_first_reason():
    for before, _, after in transitions():
        if before.state == after.state == State.FAULT:
            assert after.reason == before.reason


def test_leaving_engaged_for_ready_takes_the_switch_or_an_end():
    for before, inputs, after in transitions():
        if before.state in COUPLES and after.state == State.READY:
            assert not inputs.engage or inputs.peer_state == State.OFF
            assert inputs.usable
            assert inputs.peer_fresh
            assert inputs.fault == inputs.stop == Reason.NONE


def test_may_move_and_may_render_are_granted_only_while_engaged():
    for _, _, after in transitions():
        if after.state != State.ENGAGED:
            assert not after.may_move
            assert not after.may_render
        assert not after.may_render or after.may_move
        assert not (after.fades and after.may_render)
        assert not (after.may_yield and after.may_move)
        if after.state in (State.STOPPED, State.FAULT, State.OFF, State.READY):
            assert not after.may_yield
            assert not after.fades


def test_forces_wait_for_the_slave_to_engage():
    for before, inputs, after in transitions():
        if after.may_render and not before.may_render:
            assert inputs.peer_state == State.ENGAGED


def test_the_ordinary_way_in_and_out():
    session = Now()
    for inputs, state in (
        (CALM, State.READY),
        (CALM, State.READY),
        (PRESS, State.ENGAGED),
        (COUPLED, State.ENGAGED),
    ):
        session = advance(session, inputs)
        assert session.state == state
    assert session.may_move
    assert session.may_render
    session = advance(session, CALM)
    assert session.outline == (State.READY, Reason.RELEASED)


def test_a_switch_held_from_the_start_does_not_engage():
    session = run(Now(), *[PRESS] * 1000)
    assert session.outline == (State.READY, Reason.RELEASE_FIRST)
    assert run(session, CALM, PRESS).state == State.ENGAGED


@pytest.mark.parametrize(
    "mishap",
    [
        Known(True, False, State.READY, True),
        Known(True, True, State.FAULT, True),
        Known(False, True, State.ENGAGED, True),
        Known(True, True, State.ENGAGED, True, Reason.NOT_FINITE),
    ],
)
def test_no_engagement_by_itself_after_a_mishap(mishap):
    engaged = run(Now(), CALM, CALM, PRESS, COUPLED)
    faulty = advance(engaged, mishap)
    assert faulty.state == (State.FAULT if mishap.peer_fresh else State.HOLDING)
    held = run(faulty, *[PRESS] * 500, *[COUPLED] * 500)
    assert held.state == faulty.state
    assert run(held, CALM).state == State.READY
    assert run(held, CALM, CALM, PRESS).state == State.ENGAGED


def test_a_slave_restarted_while_the_master_is_engaged_stays_out():
    nothing_heard = Known(usable=True, peer_fresh=False, peer_state=State.OFF, engage=False)
    for before in ([], [nothing_heard] * 5):
        assert run(Now(), *before, *[COUPLED] * 1000).state == State.READY


def test_a_peer_that_does_not_follow_in_time_is_a_fault():
    session = run(Now(), CALM, CALM, PRESS)
    ticks = 0
    while session.state == State.ENGAGED:
        session = advance(session, PRESS)
        ticks += 1
        assert ticks < 1000
    assert session.reason == Reason.PEER_DECLINED
    assert ticks * DT == pytest.approx(FOLLOW_LIMIT_S, abs=2 * DT)


def test_a_peer_that_disengages_by_itself_is_a_fault():
    engaged = run(Now(), CALM, CALM, PRESS, COUPLED)
    assert run(engaged, PRESS).outline == (State.FAULT, Reason.PEER_LEFT)


def pair(master, slave, heard, engage, linked, ok, clutch=False, stop=False, reset=False):
    """One tick of both sides; each hears what the other was a tick ago, if they are linked."""
    slave_heard, master_heard = heard
    stopped = STOP if stop else Reason.NONE
    new_master = advance(
        master,
        Known(True, linked, slave_heard, engage, clutch=clutch, stop=stopped, reset=reset),
        DT,
    )
    fault = Reason.NONE if ok else Reason.RIG_FAULT
    asked, held = is_switch_closed(master_heard), master_heard == State.CLUTCHED
    new_slave = advance(slave, Known(True, linked, master_heard, asked, fault, held, reset=reset))
    heard = (new_slave.state, new_master.state) if linked else heard
    return new_master, new_slave, heard


SILENT = Known(usable=True, peer_fresh=False, peer_state=State.ENGAGED, engage=True)


def test_silence_that_lasts_becomes_a_fault():
    session = run(Now(), CALM, CALM, PRESS, COUPLED)
    ticks = 0
    while session.state != State.FAULT:
        session = advance(session, SILENT)
        ticks += 1
    assert session.reason == Reason.PEER_SILENT
    assert ticks * DT == pytest.approx(HOLD_LIMIT_S, abs=3 * DT)


def test_a_short_silence_says_what_to_do_and_does_not_become_a_fault():
    session = run(Now(), CALM, CALM, PRESS, COUPLED)
    for _ in range(3):
        session = run(session, *[SILENT] * 1500, COUPLED)
        assert session.outline == (State.HOLDING, Reason.RELEASE_FIRST)


def test_the_clutch_goes_and_comes_back_while_the_switch_is_held():
    clutched = COUPLED._replace(clutch=True)
    session = run(Now(), CALM, CALM, PRESS, COUPLED, clutched)
    assert session.outline == (State.CLUTCHED, Reason.CLUTCH_HELD)
    answered = clutched._replace(peer_state=State.CLUTCHED)
    session = run(session, *[answered] * 5000)
    assert session.state == State.CLUTCHED
    session = run(session, answered._replace(clutch=False))
    assert session.state == State.ENGAGED
    assert not session.may_render  # until the slave has engaged again too
    assert run(session, COUPLED).may_render
    assert run(session, PRESS._replace(engage=False)).state == State.READY


def test_a_tap_on_the_clutch_over_a_long_line_is_no_fault():
    """The peer's CLUTCHED comes when the clutch has long been let go of."""
    session = run(Now(), CALM, CALM, PRESS, COUPLED, COUPLED._replace(clutch=True), COUPLED)
    assert session.state == State.ENGAGED
    session = run(session, *[COUPLED._replace(peer_state=State.CLUTCHED)] * 50)
    assert session.state == State.ENGAGED
    assert not session.may_render
    assert run(session, COUPLED).may_render


def test_after_a_reset_nothing_is_coupled_until_let_go_and_pressed():
    stopped = run(Now(), CALM, CALM, PRESS, COUPLED, COUPLED._replace(stop=STOP))
    assert run(stopped, *[CALM] * 1000, *[PRESS] * 1000).outline == (State.STOPPED, STOP)
    assert run(stopped, PRESS._replace(reset=True, stop=STOP)).state == State.STOPPED
    ready = run(stopped, PRESS._replace(reset=True))
    assert ready.outline == (State.READY, Reason.RESET)
    assert run(ready, *[PRESS] * 1000).outline == (State.READY, Reason.RELEASE_FIRST)
    assert run(ready, CALM, PRESS).state == State.ENGAGED


def test_what_hinders_is_named_and_must_be_gone_to_engage():
    astray = PRESS._replace(not_ready_reason=Reason.ALIGN_FIRST)
    session = run(Now(), CALM, CALM, *[astray] * 100)
    assert session.outline == (State.READY, Reason.ALIGN_FIRST)
    assert run(session, PRESS).state == State.ENGAGED


def test_two_sides_never_wait_for_each_other_for_ever():
    """From whatever two linked sides can get into, a released switch leads both to READY.

    But for an emergency stop, which first takes a reset.
    """
    start = (Now(), Now(), (State.OFF, State.OFF))
    todo, seen = deque([start]), set()
    while todo:
        master, slave, heard = todo.popleft()
        identity = (whole(master), whole(slave), heard)
        if identity in seen or master.waited_s > 3 * DT or slave.waited_s > 3 * DT:
            continue
        seen.add(identity)
        for held in itertools.product((False, True), repeat=3):
            for more in ({}, {"clutch": True}, {"stop": True}, {"reset": True}):
                todo.append(pair(master, slave, heard, *held, **more))
        for k in range(8):
            master, slave, heard = pair(
                master, slave, heard, False, True, True, reset=State.STOPPED in heard and k < 4
            )
        assert (master.state, slave.state) == (State.READY, State.READY)
        for _ in range(6):
            master, slave, heard = pair(master, slave, heard, True, True, True)
        assert master.may_render
        assert slave.may_move
    assert len(seen) > 100


def test_every_reason_has_its_own_number_and_sentence():
    assert len({r.text for r in Reason}) == len(Reason)
    assert all(r.text and not r.text.endswith(".") for r in Reason)


def test_numbers_of_a_later_version_are_read_as_unreliable():
    assert State(200) == State.FAULT
    assert Reason(200) == Reason.UNKNOWN
    assert to_outline(Session.new(state=200, reason=200)) == (State.FAULT, Reason.UNKNOWN)
    for number in (*range(-3, 300), np.uint32(6), np.uint32(7), np.uint32(2**32 - 1)):
        assert to_known_state(number) == State(int(number))
        assert is_switch_closed(number) == is_switch_closed(to_known_state(number))


def test_a_call_for_a_stop_is_counted_when_it_begins_and_when_it_ends():
    side, counts = Now(), []
    calls = [0, 1, 1, 1, 0, 0, 1, 0]
    for call in calls:
        stop = Reason.STOP_CALLED if call else Reason.NONE
        side = advance(side, CALM._replace(stop=stop))
        counts.append(side.stops)
    assert counts == [0, 1, 1, 1, 2, 2, 3, 4]
