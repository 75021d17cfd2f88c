"""The session state machine, over every input it can meet."""

import itertools
from collections import deque
from dataclasses import fields

import pytest

from teleop.session import FOLLOW_LIMIT_S, Inputs, Reason, Session, State, step, switch_of

DT = 0.001
OWN_FAULTS = (Reason.RIG_FAULT, Reason.DEVICE_FAULT)
EVERY_INPUT = [
    Inputs(usable, fresh, peer, engage, fault)
    for usable, fresh, peer, engage, fault in itertools.product(
        (False, True), (False, True), State, (False, True), (Reason.NONE, *OWN_FAULTS)
    )
]
CALM = Inputs(usable=True, peer_fresh=True, peer_state=State.READY, engage=False)
PRESS = Inputs(usable=True, peer_fresh=True, peer_state=State.READY, engage=True)
COUPLED = Inputs(usable=True, peer_fresh=True, peer_state=State.ENGAGED, engage=True)


def whole(session: Session) -> tuple[object, ...]:
    """All fields, also those that equality leaves out; the wait only by whether it has run out."""
    values = {f.name: getattr(session, f.name) for f in fields(session)}
    values["waited_s"] = round(values["waited_s"] / FOLLOW_LIMIT_S, 6)
    return tuple(values.values())


def run(session: Session, *inputs: Inputs) -> Session:
    for item in inputs:
        session = step(session, item, DT)
    return session


def explore(dt: float = FOLLOW_LIMIT_S * 0.6) -> list[tuple[Session, Inputs, Session]]:
    """Every transition that any sequence of inputs can cause."""
    todo, seen, transitions = deque([Session()]), {whole(Session())}, []
    while todo:
        before = todo.popleft()
        for inputs in EVERY_INPUT:
            after = step(before, inputs, dt)
            transitions.append((before, inputs, after))
            if whole(after) not in seen:
                seen.add(whole(after))
                todo.append(after)
    return transitions


TRANSITIONS = explore()


def test_all_states_and_the_peer_reasons_are_reachable() -> None:
    reached = {(after.state, after.reason) for _, _, after in TRANSITIONS}
    assert {state for state, _ in reached} == set(State)
    faults = {reason for state, reason in reached if state == State.FAULT}
    peer = {Reason.PEER_SILENT, Reason.PEER_FAULT, Reason.PEER_LEFT, Reason.PEER_DECLINED}
    assert faults == peer | set(OWN_FAULTS) | {Reason.NOT_USABLE}


def test_engaged_only_with_usable_fresh_willing_and_asked_for() -> None:
    for _, inputs, after in TRANSITIONS:
        if after.state == State.ENGAGED:
            assert inputs.usable
            assert inputs.peer_fresh
            assert inputs.engage
            assert inputs.fault == Reason.NONE
            assert inputs.peer_state in (State.READY, State.ENGAGED)


def test_engaged_is_entered_from_ready_only() -> None:
    for before, inputs, after in TRANSITIONS:
        if after.state == State.ENGAGED and before.state != State.ENGAGED:
            assert before.state == State.READY
            assert inputs.peer_state in (State.READY, State.ENGAGED)


def test_an_own_fault_always_leads_to_fault() -> None:
    for _, inputs, after in TRANSITIONS:
        if inputs.fault != Reason.NONE:
            assert after.state == State.FAULT


def test_fault_is_left_only_with_the_switch_open_and_the_fault_gone() -> None:
    for before, inputs, after in TRANSITIONS:
        if before.state == State.FAULT and after.state != State.FAULT:
            assert after.state == State.READY
            assert not inputs.engage
            assert inputs.usable
            assert inputs.fault == Reason.NONE
            if before.reason == Reason.PEER_SILENT:
                assert inputs.peer_fresh


def test_a_rig_that_has_played_its_data_ends_without_fault() -> None:
    for before, _, _ in TRANSITIONS:
        ended = step(before, Inputs(True, True, State.ENGAGED, True, Reason.RIG_FINISHED), 1e-3)
        assert ended == Session(State.OFF, Reason.RIG_FINISHED)


def test_a_fault_keeps_its_first_reason() -> None:
    for before, _, after in TRANSITIONS:
        if before.state == after.state == State.FAULT:
            assert after.reason == before.reason


def test_leaving_engaged_by_anything_but_the_switch_or_an_end_is_a_fault() -> None:
    for before, inputs, after in TRANSITIONS:
        if before.state == State.ENGAGED and after.state != State.ENGAGED:
            ended = not inputs.engage or inputs.peer_state == State.OFF
            calm = inputs.usable and inputs.peer_fresh and inputs.fault == Reason.NONE
            assert (after.state == State.READY) == (ended and calm)


def test_may_move_and_may_render_are_granted_only_while_engaged() -> None:
    for _, _, after in TRANSITIONS:
        if after.state != State.ENGAGED:
            assert not after.may_move
            assert not after.may_render
        assert not after.may_render or after.may_move


def test_forces_wait_for_the_slave_to_engage() -> None:
    for before, inputs, after in TRANSITIONS:
        if after.may_render and not before.may_render:
            assert inputs.peer_state == State.ENGAGED


def test_step_is_a_function() -> None:
    for before, inputs, after in TRANSITIONS[::7]:
        assert whole(step(before, inputs, FOLLOW_LIMIT_S * 0.6)) == whole(after)


def test_the_ordinary_way_in_and_out() -> None:
    session = Session()
    for inputs, state in (
        (CALM, State.READY),
        (CALM, State.READY),
        (PRESS, State.ENGAGED),
        (COUPLED, State.ENGAGED),
    ):
        session = step(session, inputs, DT)
        assert session.state == state
    assert session.may_move
    assert session.may_render
    session = step(session, CALM, DT)
    assert session == Session(State.READY, Reason.RELEASED)


def test_a_switch_held_from_the_start_does_not_engage() -> None:
    session = run(Session(), *[PRESS] * 1000)
    assert session == Session(State.READY, Reason.RELEASE_FIRST)
    assert run(session, CALM, PRESS).state == State.ENGAGED


@pytest.mark.parametrize(
    "mishap",
    [
        Inputs(True, False, State.READY, True),
        Inputs(True, True, State.FAULT, True),
        Inputs(False, True, State.ENGAGED, True),
        Inputs(True, True, State.ENGAGED, True, Reason.NOT_FINITE),
    ],
)
def test_no_engagement_by_itself_after_a_mishap(mishap: Inputs) -> None:
    engaged = run(Session(), CALM, CALM, PRESS, COUPLED)
    faulty = step(engaged, mishap, DT)
    assert faulty.state == State.FAULT
    held = run(faulty, *[PRESS] * 500, *[COUPLED] * 500)
    assert held.state == State.FAULT
    assert run(held, CALM).state == State.READY
    assert run(held, CALM, CALM, PRESS).state == State.ENGAGED


def test_a_slave_restarted_while_the_master_is_engaged_stays_out() -> None:
    nothing_heard = Inputs(usable=True, peer_fresh=False, peer_state=State.OFF, engage=False)
    for before in ([], [nothing_heard] * 5):
        assert run(Session(), *before, *[COUPLED] * 1000).state == State.READY


def test_a_peer_that_does_not_follow_in_time_is_a_fault() -> None:
    session = run(Session(), CALM, CALM, PRESS)
    ticks = 0
    while session.state == State.ENGAGED:
        session = step(session, PRESS, DT)
        ticks += 1
        assert ticks < 1000
    assert session.reason == Reason.PEER_DECLINED
    assert ticks * DT == pytest.approx(FOLLOW_LIMIT_S, abs=2 * DT)


def test_a_peer_that_disengages_by_itself_is_a_fault() -> None:
    engaged = run(Session(), CALM, CALM, PRESS, COUPLED)
    assert run(engaged, PRESS) == Session(State.FAULT, Reason.PEER_LEFT)


def pair(
    master: Session,
    slave: Session,
    heard: tuple[State, State],
    engage: bool,
    linked: bool,
    ok: bool,
) -> tuple[Session, Session, tuple[State, State]]:
    """One tick of both sides; each hears what the other was a tick ago, if they are linked."""
    slave_heard, master_heard = heard
    new_master = step(master, Inputs(True, linked, slave_heard, engage), DT)
    fault = Reason.NONE if ok else Reason.RIG_FAULT
    asked = switch_of(master_heard)
    new_slave = step(slave, Inputs(True, linked, master_heard, asked, fault), DT)
    heard = (new_slave.state, new_master.state) if linked else heard
    return new_master, new_slave, heard


def test_two_sides_never_wait_for_each_other_for_ever() -> None:
    """From whatever two linked sides can get into, a released switch leads both to READY."""
    start = (Session(), Session(), (State.OFF, State.OFF))
    todo, seen = deque([start]), set()
    while todo:
        master, slave, heard = todo.popleft()
        identity = (whole(master), whole(slave), heard)
        if identity in seen or master.waited_s > 3 * DT:
            continue
        seen.add(identity)
        for engage, linked, ok in itertools.product((False, True), repeat=3):
            todo.append(pair(master, slave, heard, engage, linked, ok))
        for _ in range(6):
            master, slave, heard = pair(master, slave, heard, False, True, True)
        assert (master.state, slave.state) == (State.READY, State.READY)
        for _ in range(6):
            master, slave, heard = pair(master, slave, heard, True, True, True)
        assert master.may_render
        assert slave.may_move
    assert len(seen) > 100


def test_a_fault_of_the_slave_is_kept_until_the_operator_lets_go() -> None:
    master, slave, heard = Session(), Session(), (State.OFF, State.OFF)
    for engage in [False] * 4 + [True] * 4:
        master, slave, heard = pair(master, slave, heard, engage, True, True)
    assert slave.may_move
    master, slave, heard = pair(master, slave, heard, True, True, False)
    for _ in range(100):  # the rig is well again, the switch is still held
        master, slave, heard = pair(master, slave, heard, True, True, True)
        assert slave == Session(State.FAULT, Reason.RIG_FAULT)
    for _ in range(6):
        master, slave, heard = pair(master, slave, heard, False, True, True)
    assert (master.state, slave.state) == (State.READY, State.READY)


def test_equality_ignores_the_bookkeeping_so_that_an_event_is_a_change_of_state_or_reason() -> None:
    assert Session(State.READY, Reason.NONE, open_seen=True) == Session(State.READY, Reason.NONE)
    assert Session(State.READY) != Session(State.ENGAGED)


def test_every_reason_has_its_own_number_and_sentence() -> None:
    assert len({r.text for r in Reason}) == len(Reason)
    assert all(r.text and not r.text.endswith(".") for r in Reason)


def test_numbers_of_a_later_version_are_read_as_unreliable() -> None:
    assert State(200) == State.FAULT
    assert Reason(200) == Reason.UNKNOWN
