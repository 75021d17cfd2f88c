"""The session state machine: pure, one on each side, the same code on both.

    OFF ◄─own side usable or not─► READY ─switch pressed, peer there─► ENGAGED ◄─clutch─► CLUTCHED
                                   ▲ ▲ ▲ ▲                             │  │                 │
                                   │ │ │ └───────── switch open ───────┤  │                 │
                                   │ │ │                               └──┼──────────┬──────┘
                                   │ │ └─heard, switch open─ HOLDING ◄─silence───────┤
                                   │ │                          │ HOLD_LIMIT_S       │
                                   │ │                          ▼                    │
                                   │ └─over, switch open──── FAULT ◄─fault of a side─┘
                                   │                          ▲ a fault of its own, from any state
                                   └─reset──── STOPPED ◄─ a stop, from any state

The operator's switch is the master's own; the slave's switch is what the master's newest command
says (`switch_of`), and so is its clutch. So the master engages first and the slave follows, the
slave leaves when the master does, and after a fault of its own the slave waits until the operator
has let go.

To engage, a side must have found two things in its present READY spell: the switch open, and its
peer READY. So neither a switch held through a fault, nor a process restarted in the middle of a
session, ever engages by itself.

What goes away by itself is held, what does not is a fault:

======== ============================================================== =========================
state    what is done                                                   how it ends
======== ============================================================== =========================
CLUTCHED motors hold, no force; the hand moves freely                   the clutch is let go of
HOLDING  the peer fell silent: motors hold within their tension limit,  heard again and switch
         the force fades to zero                                        open; after HOLD_LIMIT_S
                                                                        of silence a FAULT
FAULT    motors hold, no force                                          fault gone, switch open
STOPPED  motors hold, no force; latched: letting go does not end it     an explicit reset
======== ============================================================== =========================

None of them ends in motion: each goes to READY, where the switch has to be found open and be
pressed again; only the clutch goes straight back, because the operator's hand held it.

What each side may do depends on `may_move` and `may_yield` (slave), `may_render` and `fades`
(master), and on nothing else.

`Session` and `Inputs` are records (`estimator.records`), and all functions of them are compiled.
Python code around the loops, which reports and prints, takes a `SessionOutline`.
"""

from enum import IntEnum
from typing import NamedTuple

from estimator.compiled import compiled
from estimator.records import F64, I64, U64, Flag, Record, Records

FOLLOW_LIMIT_S = 0.1  # [s] within which the peer must be engaged too: 100 ticks of 1 kHz
HOLD_LIMIT_S = 2.0  # [s] of silence after which nobody counts on the peer any more


class State(IntEnum):
    """Where a side is."""

    OFF = 0  # not usable yet: device or rig missing, estimator warming up
    READY = 1  # usable, not coupled: zero force, motors hold
    ENGAGED = 2  # coupled: commands move the rig, forces move the hand
    FAULT = 3  # something is wrong: zero force, motors hold, until the operator releases
    CLUTCHED = 4  # coupled but for the clutch: zero force, motors hold, the hand is free
    HOLDING = 5  # the peer fell silent while coupled: force fades, motors hold and give way
    STOPPED = 6  # emergency stop: zero force, motors hold, until it is reset

    @classmethod
    def _missing_(cls, value: object) -> "State | None":
        """Read a number of a later version as FAULT: such a peer cannot be relied upon."""
        return cls.FAULT if isinstance(value, int) else None


class Reason(IntEnum):
    """Why a side is in its state. Numbers are sent and recorded: none is ever reassigned."""

    text: str

    def __new__(cls, number: int, text: str) -> "Reason":
        """Attach the text to each number, `reason.text`."""
        reason = int.__new__(cls, number)
        reason._value_ = number
        reason.text = text
        return reason

    @classmethod
    def _missing_(cls, value: object) -> "Reason | None":
        """Read a number of a later version as UNKNOWN."""
        return cls.UNKNOWN if isinstance(value, int) else None

    NONE = 0, "ok"
    NOT_USABLE = 1, "device or rig not usable"
    PEER_ABSENT = 2, "peer not connected"
    PEER_NOT_READY = 3, "peer not ready"
    RELEASE_FIRST = 4, "release the engage switch first"
    RELEASED = 5, "engage switch released"
    PEER_ENDED = 6, "peer has ended"
    CLUTCH_HELD = 7, "clutch held"
    ALIGN_FIRST = 8, "move the hand to where the tip is first"
    RESET = 9, "emergency stop was reset; engage again"
    HAND_AWAY = 10, "no hand detected at the device; release the engage switch first"
    COUPLING_DIFFERS = 11, "the peer's config has another coupling or confidence"

    PEER_SILENT = 20, "no messages from the peer"
    PEER_FAULT = 21, "peer in fault"
    PEER_LEFT = 22, "peer disengaged by itself"
    PEER_DECLINED = 23, "peer did not engage in time"
    PEER_STOPPED = 24, "peer in emergency stop"
    PEER_HOLDS = 25, "peer is holding, as it receives no messages"
    PEER_RESTARTED = 26, "peer was restarted"

    DEVICE_FAULT = 40, "haptic device failed"
    RIG_FAULT = 41, "rig failed"
    RIG_FINISHED = 42, "rig has played its last sample"
    SAMPLES_STALE = 43, "no new samples from the rig"
    NOT_FINITE = 44, "value not finite"
    OVER_LIMIT = 45, "measured value over its limit"
    TENDON_BROKEN = 46, "tendon has no tension although it is wound in"
    TENDON_JAMMED = 47, "tendon stiffer than its sheath allows, as if jammed"
    CELL_SATURATED = 48, "load cell at the end of its range"
    CELL_STUCK = 49, "load cell repeats the same reading"
    CALIBRATION_DUE = 50, "sheath has changed its shape; calibrate again"
    MOTOR_ASTRAY = 51, "motor not where it was commanded"
    SAMPLES_FROZEN = 52, "the rig's samples stay the same although a motor was moved"
    EMERGENCY_STOP = 53, "operator pressed the emergency stop"
    STOP_CALLED = 54, "emergency stop requested"
    WATCH_LOST = 55, "watching process was lost"

    UNKNOWN = 255, "reason unknown to this version"


class Inputs(Record):
    """What a side knows at a tick."""

    usable: Flag  # its own device or rig can be read and written
    peer_fresh: Flag  # the peer's newest message is young enough to act on
    peer_state: I64 = State.OFF  # in that message, `known_state` of it; OFF if there was none
    engage: Flag = False  # the switch: the operator's, or `switch_of` the master's state
    fault: I64 = Reason.NONE  # what is wrong on this side now
    clutch: Flag = False  # the clutch: the operator's, or the master's CLUTCHED
    stop: I64 = Reason.NONE  # why everything must stop, if it must
    reset: Flag = False  # the emergency stop is taken back
    not_ready_reason: I64 = Reason.NONE  # why this side must not engage yet
    peer: U64 = 0  # nonce of the peer's process
    follow_s: F64 = FOLLOW_LIMIT_S  # [s] within which the peer must be engaged too


class Session(Record):
    """State and reason of a side, and what it must remember to leave them."""

    state: I64 = State.OFF
    reason: I64 = Reason.NOT_USABLE
    open_seen: Flag = False  # the switch, since last engaged
    peer_seen: Flag = False  # READY, since last engaged
    followed: Flag = False  # the peer is, or was, engaged with us
    waited_s: F64 = 0.0  # [s] for it to follow, or to be heard
    peer: U64 = 0  # nonce of the process we are coupled to
    calling: Flag = False  # a stop was asked for in this tick
    stops: I64 = 0  # calls that began or ended: a reset names it


_REASONS = {int(reason): reason for reason in Reason}


class SessionOutline(NamedTuple):
    """What people and listeners are told of a session; an event is a change of it."""

    state: State = State.OFF
    reason: Reason = Reason.NOT_USABLE


def outline(session: Session) -> SessionOutline:
    """Return the state and the reason of a session as Python enums."""
    reason = _REASONS.get(int(session.reason), Reason.UNKNOWN)
    return SessionOutline(State(int(session.state)), reason)


_LAST_STATE = int(max(State))
_FAULT = int(State.FAULT)


class OutlineReader:
    """Reads the outline of a session that a loop keeps; costs little while it stays the same.

    Parameters
    ----------
    sessions : Records
        `Session`, shape (1,).
    """

    def __init__(self, sessions: Records) -> None:
        self._state, self._reason, self._stops = (
            sessions[name] for name in ("state", "reason", "stops")
        )
        self._sessions, self._numbers = sessions, (-1, -1)
        self._outline = SessionOutline()

    def __call__(self) -> SessionOutline:
        """Return state and reason as they are now."""
        numbers = (int(self._state[0]), int(self._reason[0]))
        if numbers != self._numbers:
            self._numbers = numbers
            self._outline = outline(one(self._sessions))
        return self._outline

    @property
    def stops(self) -> int:
        """How many calls for a stop began or ended so far."""
        return int(self._stops[0])


@compiled
def known_state(number: int) -> int:
    """Return the state that a message tells; a number of a later version counts as FAULT."""
    if 0 <= number <= _LAST_STATE:
        return number
    return _FAULT


@compiled
def switch_of(master: int) -> bool:
    """Return whether the switch counts as closed for a slave whose master is in this state.

    A master at FAULT, HOLDING or STOPPED has not seen the operator let go.
    """
    return master not in (State.OFF, State.READY)


@compiled
def may_move(session: Session) -> bool:
    """Return whether commands may move the motors."""
    return session.state == State.ENGAGED


@compiled
def may_yield(session: Session) -> bool:
    """Return whether motors that hold may give way to a tension over its limit."""
    return session.state in (State.CLUTCHED, State.HOLDING)


@compiled
def may_render(session: Session) -> bool:
    """Return whether forces may reach the hand: only once the slave has engaged too."""
    return session.state == State.ENGAGED and session.followed


@compiled
def fades(session: Session) -> bool:
    """Return whether the force on the hand goes to zero by a ramp, and not at once."""
    return session.state == State.HOLDING


@compiled
def _enter(session: Session, state: int, reason: int) -> None:
    """Enter a state: nothing of what was seen or waited for before counts in it."""
    session.state = state
    session.reason = reason
    session.open_seen = False
    session.peer_seen = False
    session.followed = False
    session.waited_s = 0.0
    session.peer = 0


@compiled
def _enter_with(session: Session, state: int, reason: int, followed: bool, waited_s: float) -> None:
    """Enter a state that counts on the peer: the one that the session is coupled to."""
    peer = session.peer
    _enter(session, state, reason)
    session.followed = followed
    session.waited_s = waited_s
    session.peer = peer


@compiled
def _fault_is_over(session: Session, inputs: Inputs) -> bool:
    """Return whether nothing but the past keeps a side in FAULT."""
    if inputs.engage or not inputs.usable:
        return False
    if session.reason in (Reason.PEER_SILENT, Reason.PEER_LEFT, Reason.PEER_DECLINED):
        return inputs.peer_fresh
    return True


@compiled
def _step_ready(session: Session, inputs: Inputs) -> None:
    """Usable and not engaged: engage, or say what is missing."""
    peer_ready = inputs.peer_fresh and inputs.peer_state == State.READY
    peer_engaged = inputs.peer_fresh and inputs.peer_state == State.ENGAGED
    present = peer_ready or peer_engaged
    open_seen = session.open_seen or not inputs.engage
    peer_seen = session.peer_seen or peer_ready
    asked = inputs.engage and not inputs.clutch and inputs.not_ready_reason == Reason.NONE
    # engaging takes a tick in READY, so that the peer sees READY too
    if session.state == State.READY and asked and present and open_seen and peer_seen:
        _enter(session, State.ENGAGED, Reason.NONE)
        session.followed = peer_engaged
        session.peer = inputs.peer
        return
    _enter(session, State.READY, inputs.not_ready_reason)
    session.open_seen = open_seen
    session.peer_seen = peer_seen
    if not inputs.peer_fresh:
        session.reason = Reason.PEER_ABSENT
    elif not present or not peer_seen:
        session.reason = Reason.PEER_NOT_READY
    elif not open_seen:
        session.reason = Reason.RELEASE_FIRST


@compiled
def _step_coupled(session: Session, inputs: Inputs, dt: float) -> None:
    """Engaged or clutched: stay so, change between the two, or leave."""
    follows = inputs.peer_state == State.ENGAGED
    if not inputs.usable:
        _enter(session, State.FAULT, Reason.NOT_USABLE)
    elif not inputs.peer_fresh:
        _enter_with(session, State.HOLDING, Reason.PEER_SILENT, False, 0.0)
    elif inputs.peer_state == State.STOPPED:
        _enter(session, State.STOPPED, Reason.PEER_STOPPED)
    elif not inputs.engage:
        _enter(session, State.READY, Reason.RELEASED)
        if inputs.not_ready_reason == Reason.HAND_AWAY:
            session.reason = Reason.HAND_AWAY
    elif inputs.peer != session.peer:
        _enter(session, State.FAULT, Reason.PEER_RESTARTED)
    elif inputs.peer_state == State.HOLDING:
        _enter_with(session, State.HOLDING, Reason.PEER_HOLDS, False, 0.0)
    elif inputs.peer_state == State.FAULT:
        _enter(session, State.FAULT, Reason.PEER_FAULT)
    elif inputs.peer_state == State.OFF:
        _enter(session, State.READY, Reason.PEER_ENDED)
    elif session.followed and inputs.peer_state == State.READY:
        _enter(session, State.FAULT, Reason.PEER_LEFT)
    elif inputs.clutch:
        followed = session.followed or follows
        _enter_with(session, State.CLUTCHED, Reason.CLUTCH_HELD, followed, 0.0)
    elif session.state == State.ENGAGED and follows:
        session.followed = True
    else:
        again = session.state == State.CLUTCHED or session.followed
        waited_s = 0.0 if again else session.waited_s + dt
        if waited_s > inputs.follow_s:
            _enter(session, State.FAULT, Reason.PEER_DECLINED)
        else:
            _enter_with(session, State.ENGAGED, Reason.NONE, follows, waited_s)


@compiled
def _step_holding(session: Session, inputs: Inputs, dt: float) -> None:
    """Hold until the peer is heard and the operator has let go; silence for too long is a fault."""
    if not inputs.usable:
        _enter(session, State.FAULT, Reason.NOT_USABLE)
    elif not inputs.peer_fresh:
        session.waited_s += dt
        if session.waited_s > HOLD_LIMIT_S:
            _enter(session, State.FAULT, Reason.PEER_SILENT)
    elif inputs.peer_state == State.STOPPED:
        _enter(session, State.STOPPED, Reason.PEER_STOPPED)
    elif not inputs.engage:
        _enter(session, State.READY, Reason.RELEASED)
    elif inputs.peer != session.peer:
        _enter(session, State.FAULT, Reason.PEER_RESTARTED)
    else:
        _enter_with(session, State.HOLDING, Reason.RELEASE_FIRST, False, 0.0)


@compiled
def _change_state(session: Session, inputs: Inputs, dt: float) -> None:
    if inputs.stop != Reason.NONE:
        first = session.reason if session.state == State.STOPPED else inputs.stop
        _enter(session, State.STOPPED, first)
    elif inputs.fault == Reason.RIG_FINISHED:
        _enter(session, State.OFF, inputs.fault)
    elif session.state == State.STOPPED and not inputs.reset:
        return
    elif inputs.fault != Reason.NONE:
        first = session.reason if session.state == State.FAULT else inputs.fault
        _enter(session, State.FAULT, first)
    elif session.state in (State.ENGAGED, State.CLUTCHED):
        _step_coupled(session, inputs, dt)
    elif session.state == State.HOLDING:
        _step_holding(session, inputs, dt)
    elif session.state == State.FAULT and not _fault_is_over(session, inputs):
        return
    elif not inputs.usable:
        _enter(session, State.OFF, Reason.NOT_USABLE)
    elif session.state == State.STOPPED:
        _enter(session, State.READY, Reason.RESET)
    else:
        if session.state == State.FAULT:
            _enter(session, State.READY, Reason.RELEASED)
        _step_ready(session, inputs)


@compiled
def step(session: Session, inputs: Inputs, dt: float) -> None:
    """Advance a session by one tick, in place.

    Parameters
    ----------
    session : Session
        Changed to what it is after the tick.
    inputs : Inputs
        What this side knows; its `peer_state` must be a state of this version (`known_state`).
    dt : float
        Time since the last tick [s].
    """
    _change_state(session, inputs, dt)
    calling = inputs.stop != Reason.NONE
    if calling != session.calling:
        session.stops += 1
    session.calling = calling
