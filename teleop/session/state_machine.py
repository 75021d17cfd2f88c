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

The master has the operator's switch; switch and clutch of the slave are taken from the master's
newest command (`is_switch_closed`). So the master engages first and the slave follows, the slave
disengages with the master, and after its own fault the slave waits until the operator has released
the switch.

To engage, a side must have seen the switch open and its peer READY since it entered READY. So
neither a switch held through a fault nor a restarted process engages by itself. Transient
conditions hold, others are a fault:

======== ============================================================== =========================
state    what is done                                                   how it ends
======== ============================================================== =========================
CLUTCHED motors hold, no force; the hand moves freely                   the clutch is let go of
HOLDING  the peer fell silent, or the link is too bad: motors hold      heard again and switch
         within their tension limit, the force fades to zero            open; after HOLD_LIMIT_S
                                                                        of it a FAULT
FAULT    motors hold, no force                                          fault gone, switch open
STOPPED  motors stop by their own means or, if the rig has none, hold;  an explicit reset
         no force; latched: letting go does not end it
======== ============================================================== =========================

None of them ends in motion: each goes to READY, where the switch must be open and then pressed
again; only the clutch returns directly to ENGAGED.

What each side may do depends on `may_move`, `may_probe` and `may_yield` (slave), `may_render` and
`is_force_fading` (master), and on nothing else.

`Session` and `SessionInputs` are records (`estimator.structs`), and all functions of them are
compiled. Python code around the loops, which reports and prints, takes a `SessionOutline`.
"""

from enum import IntEnum
from typing import NamedTuple

from estimator.compiled import jit_compile
from estimator.structs import F64, I64, U64, Flag, Struct, StructArray, view_struct

FOLLOW_LIMIT_S = 0.1  # [s] timeout for the peer to engage: 100 ticks at 1 kHz
HOLD_LIMIT_S = 2.0  # [s] of silence after which HOLDING becomes a fault


class State(IntEnum):
    """State of a side."""

    OFF = 0  # not usable yet: device or rig missing, estimator warming up
    READY = 1  # usable, not coupled: zero force, motors hold
    ENGAGED = 2  # coupled: commands move the rig, forces move the hand
    FAULT = 3  # fault: zero force, motors hold, until the operator releases
    CLUTCHED = 4  # clutch held while coupled: zero force, motors hold, the hand is free
    HOLDING = 5  # no messages of the peer while coupled: force fades, motors hold and yield
    STOPPED = 6  # emergency stop: zero force, motors stopped or held, until it is reset

    @classmethod
    def _missing_(cls, value: object) -> "State | None":
        """Decode an unknown number, of a later version, as FAULT."""
        return cls.FAULT if isinstance(value, int) else None


class Reason(IntEnum):
    """Reason of a state. Numbers are sent and recorded, and never reassigned."""

    text: str

    def __new__(cls, number: int, text: str) -> "Reason":
        """Attach the text to each number, `reason.text`."""
        reason = int.__new__(cls, number)
        reason._value_ = number
        reason.text = text
        return reason

    @classmethod
    def _missing_(cls, value: object) -> "Reason | None":
        """Decode an unknown number, of a later version, as UNKNOWN."""
        return cls.UNKNOWN if isinstance(value, int) else None

    NONE = 0, "ok"
    NOT_USABLE = 1, "device or rig not usable"
    PEER_ABSENT = 2, "peer not connected"
    PEER_NOT_READY = 3, "peer not ready"
    RELEASE_FIRST = 4, "release the engage switch first"
    RELEASED = 5, "engage switch released"
    PEER_ENDED = 6, "peer has ended"
    CLUTCH_HELD = 7, "clutch held"
    ALIGN_FIRST = 8, "move the hand to the position of the tip first"
    RESET = 9, "emergency stop was reset; engage again"
    HAND_AWAY = 10, "no hand detected at the device; release the engage switch first"
    COUPLING_DIFFERS = 11, "the peer's config differs in coupling or confidence"

    PEER_SILENT = 20, "no messages from the peer"
    PEER_FAULT = 21, "peer in fault"
    PEER_LEFT = 22, "peer disengaged by itself"
    PEER_DECLINED = 23, "peer did not engage in time"
    PEER_STOPPED = 24, "peer in emergency stop"
    PEER_HOLDS = 25, "peer is holding: it receives no messages"
    PEER_RESTARTED = 26, "peer was restarted"
    CLOCK_SET = 27, "a clock was set; release and engage again"
    LINK_SLOW = 28, "round trip of the link beyond its bound"
    LINK_JITTER = 29, "jitter of the link beyond its bound"
    LINK_LOSS = 30, "loss of the link beyond its bound"

    DEVICE_FAULT = 40, "haptic device failed"
    RIG_FAULT = 41, "rig failed"
    RIG_FINISHED = 42, "rig has played its last sample"
    SAMPLES_STALE = 43, "no new samples from the rig"
    NOT_FINITE = 44, "value not finite"
    OVER_LIMIT = 45, "measured value over its limit"
    TENDON_BROKEN = 46, "tendon has no tension although it is wound in"
    TENDON_JAMMED = 47, "tendon stiffer than its sheath allows, probably jammed"
    CELL_SATURATED = 48, "load cell at the end of its range"
    CELL_STUCK = 49, "load cell repeats the same reading"
    CALIBRATION_DUE = 50, "sheath has changed its shape; calibrate again"
    MOTOR_POSITION_ERROR = 51, "motor not where it was commanded"
    SAMPLES_FROZEN = 52, "samples of the rig do not change although a motor was moved"
    EMERGENCY_STOP = 53, "operator pressed the emergency stop"
    STOP_CALLED = 54, "emergency stop requested"
    WATCH_LOST = 55, "watching process was lost"
    EXTENSION_FAULT = 56, "estimator, controller or coupling of another package failed"

    UNKNOWN = 255, "reason unknown to this version"


# reasons of a fault that started at the peer
PEER_REASONS = (
    Reason.PEER_SILENT,
    Reason.PEER_FAULT,
    Reason.PEER_LEFT,
    Reason.PEER_DECLINED,
    Reason.PEER_STOPPED,
    Reason.PEER_RESTARTED,
)


class SessionInputs(Struct):
    """Inputs of a side at a tick."""

    usable: Flag  # its own device or rig can be read and written
    peer_fresh: Flag  # the peer's newest message is recent
    peer_state: I64 = State.OFF  # in that message, `to_known_state` of it; OFF if there was none
    engage: Flag = False  # the switch: the operator's, or `is_switch_closed` the master's state
    fault: I64 = Reason.NONE  # present fault of this side
    clutch: Flag = False  # the clutch: the operator's, or the master's CLUTCHED
    stop: I64 = Reason.NONE  # Reason of an emergency stop, if any
    reset: Flag = False  # the emergency stop is reset
    not_ready_reason: I64 = Reason.NONE  # why this side must not engage
    peer: U64 = 0  # nonce of the peer's process
    follow_s: F64 = FOLLOW_LIMIT_S  # [s] timeout for the peer to engage
    link: I64 = Reason.NONE  # the bound that the link exceeds, or CLOCK_SET
    link_holds: Flag = False  # for so long, or so badly, that the session must hold
    degraded: I64 = Reason.NONE  # why force and motion are limited, besides the link


class Session(Struct):
    """State and reason of a side, and conditions for leaving them."""

    state: I64 = State.OFF
    reason: I64 = Reason.NOT_USABLE
    open_seen: Flag = False  # the switch was open since last engaged
    peer_seen: Flag = False  # the peer was READY since last engaged
    followed: Flag = False  # the peer is, or was, engaged in this engagement
    waited_s: F64 = 0.0  # [s] waited for the peer to engage or to send
    peer: U64 = 0  # nonce of the coupled process
    calling: Flag = False  # a stop was requested in this tick
    stops: I64 = 0  # number of stops so far; a reset gives it


_REASONS = {int(reason): reason for reason in Reason}
_REASONS_BY_TEXT = {reason.text: reason for reason in Reason}


class DetailedReason(NamedTuple):
    """A reason and what it is about: which tendon, or why it is not usable."""

    reason: Reason
    detail: str = ""

    @property
    def text(self) -> str:
        """Both in one line."""
        return f"{self.reason.text}: {self.detail}" if self.detail else self.reason.text

    @classmethod
    def parse(cls, text: str) -> "DetailedReason":
        """Return what has this `text`, as it is read from a file; an unknown reason as UNKNOWN."""
        names = [name for name in _REASONS_BY_TEXT if f"{text}: ".startswith(f"{name}: ")]
        if not names:
            return cls(Reason.UNKNOWN, text)
        name = max(names, key=len)  # a reason may have a colon of its own
        return cls(_REASONS_BY_TEXT[name], text[len(name) + 2 :])


class SessionOutline(NamedTuple):
    """Summary of a session for people and listeners; an event is a change of it."""

    state: State = State.OFF
    reason: Reason = Reason.NOT_USABLE


def to_reason(number: int) -> Reason:
    """Return the reason in a message; an unknown number counts as UNKNOWN."""
    return _REASONS.get(number, Reason.UNKNOWN)


def to_outline(session: Session) -> SessionOutline:
    """Return the state and the reason of a session as Python enums."""
    return SessionOutline(State(int(session.state)), to_reason(int(session.reason)))


_LAST_STATE = int(max(State))
_FAULT = int(State.FAULT)


class OutlineReader:
    """Reads the outline of a loop's session; cheap while it does not change.

    `sessions` are of `Session`, shape (1,).
    """

    def __init__(self, sessions: StructArray) -> None:
        self._state, self._reason = sessions["state"], sessions["reason"]
        self._sessions, self._numbers = sessions, (-1, -1)
        self._outline = SessionOutline()

    def __call__(self) -> SessionOutline:
        """Return the present state and reason."""
        numbers = (int(self._state[0]), int(self._reason[0]))
        if numbers != self._numbers:
            self._numbers = numbers
            self._outline = to_outline(view_struct(self._sessions))
        return self._outline


@jit_compile
def to_known_state(number: int) -> int:
    """Return the state in a message; an unknown number counts as FAULT."""
    if 0 <= number <= _LAST_STATE:
        return number
    return _FAULT


@jit_compile
def is_switch_closed(master_state: int) -> bool:
    """Return whether the switch counts as closed for a slave whose master is in this state.

    At FAULT, HOLDING or STOPPED the master has not seen the switch open.
    """
    return master_state not in (State.OFF, State.READY)


@jit_compile
def may_move(session: Session) -> bool:
    """Return whether commands may move the motors."""
    return session.state == State.ENGAGED


@jit_compile
def may_probe(session: Session) -> bool:
    """Return whether motors at rest may measure friction by motions that no tip notices.

    Not while holding: a side that hears nothing must not begin to move.
    """
    return session.state in (State.ENGAGED, State.CLUTCHED)


@jit_compile
def may_yield(session: Session) -> bool:
    """Return whether holding motors may pay out a tendon over its tension limit."""
    return session.state in (State.CLUTCHED, State.HOLDING)


@jit_compile
def may_render(session: Session) -> bool:
    """Return whether forces may be rendered: only when the slave has engaged too."""
    return session.state == State.ENGAGED and session.followed


@jit_compile
def is_force_fading(session: Session) -> bool:
    """Return whether the force on the hand ramps to zero instead of stepping."""
    return session.state == State.HOLDING


@jit_compile
def _enter_state(session: Session, state: int, reason: int) -> None:
    """Enter a state, with all conditions reset."""
    session.state = state
    session.reason = reason
    session.open_seen = False
    session.peer_seen = False
    session.followed = False
    session.waited_s = 0.0
    session.peer = 0


@jit_compile
def _enter_coupled_state(
    session: Session, state: int, reason: int, followed: bool, waited_s: float
) -> None:
    """Enter a coupled state with the present peer."""
    peer = session.peer
    _enter_state(session, state, reason)
    session.followed = followed
    session.waited_s = waited_s
    session.peer = peer


@jit_compile
def _is_fault_over(session: Session, inputs: SessionInputs) -> bool:
    """Return whether the cause of a FAULT is gone."""
    if inputs.engage or not inputs.usable:
        return False
    if session.reason in (Reason.PEER_SILENT, Reason.PEER_LEFT, Reason.PEER_DECLINED):
        return inputs.peer_fresh
    if session.reason in (Reason.CLOCK_SET, Reason.LINK_SLOW, Reason.LINK_JITTER, Reason.LINK_LOSS):
        return inputs.peer_fresh and not inputs.link_holds
    return True


@jit_compile
def _step_ready(session: Session, inputs: SessionInputs) -> None:
    """Usable and not engaged: engage, or set the reason why not."""
    peer_ready = inputs.peer_fresh and inputs.peer_state == State.READY
    peer_engaged = inputs.peer_fresh and inputs.peer_state == State.ENGAGED
    present = peer_ready or peer_engaged
    open_seen = session.open_seen or not inputs.engage
    peer_seen = session.peer_seen or peer_ready
    not_ready = inputs.not_ready_reason
    if inputs.link_holds and not_ready == Reason.NONE:
        not_ready = inputs.link
    may_engage = inputs.engage and not inputs.clutch and not_ready == Reason.NONE
    # engaging takes a tick in READY, so that the peer sees READY too
    if session.state == State.READY and may_engage and present and open_seen and peer_seen:
        _enter_state(session, State.ENGAGED, inputs.degraded)
        session.followed = False  # a peer that is engaged already was before: its next word counts
        session.peer = inputs.peer
        return
    _enter_state(session, State.READY, not_ready)
    session.open_seen = open_seen
    session.peer_seen = peer_seen
    if not inputs.peer_fresh:
        session.reason = Reason.PEER_ABSENT
    elif not present or not peer_seen:
        session.reason = Reason.PEER_NOT_READY
    elif not open_seen:
        session.reason = Reason.RELEASE_FIRST


@jit_compile
def _step_coupled(session: Session, inputs: SessionInputs, dt: float) -> None:
    """Engaged or clutched: stay, switch between the two, or leave."""
    follows = inputs.peer_state == State.ENGAGED
    if not inputs.usable:
        _enter_state(session, State.FAULT, Reason.NOT_USABLE)
    elif inputs.link_holds:
        _enter_coupled_state(session, State.HOLDING, inputs.link, False, 0.0)
    elif not inputs.peer_fresh:
        _enter_coupled_state(session, State.HOLDING, Reason.PEER_SILENT, False, 0.0)
    elif inputs.peer_state == State.STOPPED:
        _enter_state(session, State.STOPPED, Reason.PEER_STOPPED)
    elif not inputs.engage:
        _enter_state(session, State.READY, Reason.RELEASED)
        if inputs.not_ready_reason == Reason.HAND_AWAY:
            session.reason = Reason.HAND_AWAY
    elif inputs.peer != session.peer:
        _enter_state(session, State.FAULT, Reason.PEER_RESTARTED)
    elif inputs.peer_state == State.HOLDING:
        _enter_coupled_state(session, State.HOLDING, Reason.PEER_HOLDS, False, 0.0)
    elif inputs.peer_state == State.FAULT:
        _enter_state(session, State.FAULT, Reason.PEER_FAULT)
    elif inputs.peer_state == State.OFF:
        _enter_state(session, State.READY, Reason.PEER_ENDED)
    elif session.followed and inputs.peer_state == State.READY:
        _enter_state(session, State.FAULT, Reason.PEER_LEFT)
    elif inputs.clutch:
        followed = session.followed or follows
        _enter_coupled_state(session, State.CLUTCHED, Reason.CLUTCH_HELD, followed, 0.0)
    elif session.state == State.ENGAGED and follows:
        session.followed = True
    else:
        is_reengaging = session.state == State.CLUTCHED or session.followed
        waited_s = 0.0 if is_reengaging else session.waited_s + dt
        if waited_s > inputs.follow_s:
            _enter_state(session, State.FAULT, Reason.PEER_DECLINED)
        else:
            _enter_coupled_state(session, State.ENGAGED, Reason.NONE, follows, waited_s)
    if session.state == State.ENGAGED:
        # force and motion are limited; the peer's link watch needs the bound
        session.reason = inputs.link if inputs.link != Reason.NONE else inputs.degraded


@jit_compile
def _step_holding(session: Session, inputs: SessionInputs, dt: float) -> None:
    """Hold until the peer sends again, the link is good and the switch is open; or a fault."""
    if not inputs.usable:
        _enter_state(session, State.FAULT, Reason.NOT_USABLE)
    elif inputs.link_holds:
        session.reason = inputs.link
        session.waited_s += dt
        if session.waited_s > HOLD_LIMIT_S:
            _enter_state(session, State.FAULT, inputs.link)
    elif not inputs.peer_fresh:
        session.waited_s += dt
        if session.waited_s > HOLD_LIMIT_S:
            _enter_state(session, State.FAULT, Reason.PEER_SILENT)
    elif inputs.peer_state == State.STOPPED:
        _enter_state(session, State.STOPPED, Reason.PEER_STOPPED)
    elif not inputs.engage:
        _enter_state(session, State.READY, Reason.RELEASED)
    elif inputs.peer != session.peer:
        _enter_state(session, State.FAULT, Reason.PEER_RESTARTED)
    else:
        _enter_coupled_state(session, State.HOLDING, Reason.RELEASE_FIRST, False, 0.0)


@jit_compile
def _change_state(session: Session, inputs: SessionInputs, dt: float) -> None:
    """Enter the next state; a stop or a fault that lasts keeps its first reason."""
    if inputs.stop != Reason.NONE:
        reason = session.reason if session.state == State.STOPPED else inputs.stop
        _enter_state(session, State.STOPPED, reason)
    elif inputs.fault == Reason.RIG_FINISHED:
        _enter_state(session, State.OFF, inputs.fault)
    elif session.state == State.STOPPED and not inputs.reset:
        return
    elif inputs.fault != Reason.NONE:
        reason = session.reason if session.state == State.FAULT else inputs.fault
        _enter_state(session, State.FAULT, reason)
    elif session.state in (State.ENGAGED, State.CLUTCHED):
        _step_coupled(session, inputs, dt)
    elif session.state == State.HOLDING:
        _step_holding(session, inputs, dt)
    elif session.state == State.FAULT and not _is_fault_over(session, inputs):
        return
    elif not inputs.usable:
        _enter_state(session, State.OFF, Reason.NOT_USABLE)
    elif session.state == State.STOPPED:
        _enter_state(session, State.READY, Reason.RESET)
    else:
        if session.state == State.FAULT:
            _enter_state(session, State.READY, Reason.RELEASED)
        _step_ready(session, inputs)


@jit_compile
def step(session: Session, inputs: SessionInputs, dt: float) -> None:
    """Advance a session by one tick, in place.

    `inputs` are those of this side, `peer_state` among them a known state (`to_known_state`); `dt`
    [s] is the time since the last tick.
    """
    _change_state(session, inputs, dt)
    calling = inputs.stop != Reason.NONE
    if calling != session.calling:
        session.stops += 1
    session.calling = calling
