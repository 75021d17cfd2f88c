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

What each side may do hangs on `may_move` and `may_yield` (slave), `may_render` and `fades`
(master), and on nothing else.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum

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
        """Take a number of a later version for a peer that cannot be relied upon."""
        return cls.FAULT if isinstance(value, int) else None


class Reason(IntEnum):
    """Why a side is where it is. The numbers travel and are recorded: none is ever given anew."""

    text: str

    def __new__(cls, number: int, text: str) -> "Reason":
        """Give each number its sentence, `reason.text`."""
        reason = int.__new__(cls, number)
        reason._value_ = number
        reason.text = text
        return reason

    @classmethod
    def _missing_(cls, value: object) -> "Reason | None":
        """Take a number of a later version for what it is."""
        return cls.UNKNOWN if isinstance(value, int) else None

    NONE = 0, "all is well"
    NOT_USABLE = 1, "its device or rig is not usable"
    PEER_ABSENT = 2, "the other side is not there"
    PEER_NOT_READY = 3, "the other side is not ready"
    RELEASE_FIRST = 4, "the engage switch must be let go of first"
    RELEASED = 5, "the engage switch was let go of"
    PEER_ENDED = 6, "the other side has ended"
    CLUTCH_HELD = 7, "the clutch is held"
    ALIGN_FIRST = 8, "the hand must first go to where the tip is"
    RESET = 9, "the emergency stop was reset; engage again"
    HAND_AWAY = 10, "no hand is felt at the device; let go of the engage switch first"
    COUPLING_DIFFERS = 11, "the other side's config has another coupling or confidence"

    PEER_SILENT = 20, "the other side fell silent"
    PEER_FAULT = 21, "the other side is at fault"
    PEER_LEFT = 22, "the other side disengaged by itself"
    PEER_DECLINED = 23, "the other side did not engage in time"
    PEER_STOPPED = 24, "the other side is at emergency stop"
    PEER_HOLDS = 25, "the other side holds, as it hears nothing"
    PEER_RESTARTED = 26, "the other side was restarted"

    DEVICE_FAULT = 40, "the haptic device failed"
    RIG_FAULT = 41, "the rig failed"
    RIG_FINISHED = 42, "the rig has played its last sample"
    SAMPLES_STALE = 43, "the rig's samples stopped coming"
    NOT_FINITE = 44, "a value was not finite"
    OVER_LIMIT = 45, "a measured value was over its limit"
    TENDON_BROKEN = 46, "a tendon has no tension although it is wound in"
    TENDON_JAMMED = 47, "a tendon is stiffer than its sheath allows, as if it were jammed"
    CELL_SATURATED = 48, "a load cell is at the end of its range"
    CELL_STUCK = 49, "a load cell repeats the same reading"
    CALIBRATION_DUE = 50, "a sheath has changed its shape; it must be calibrated again"
    MOTOR_ASTRAY = 51, "a motor is not where it was sent"
    SAMPLES_FROZEN = 52, "the rig's samples stay the same although a motor was sent on"
    EMERGENCY_STOP = 53, "the operator pressed the emergency stop"
    STOP_CALLED = 54, "an emergency stop was called for"
    WATCH_LOST = 55, "the process that watched over the session is gone"

    UNKNOWN = 255, "a reason that this version does not know"


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a side knows at a tick."""

    usable: bool  # its own device or rig can be read and written
    peer_fresh: bool  # the peer's newest message is young enough to act on
    peer_state: State  # in that message; OFF if there was none
    engage: bool  # the switch: the operator's, or `switch_of` the master's state
    fault: Reason = Reason.NONE  # what is wrong on this side now
    clutch: bool = False  # the clutch: the operator's, or the master's CLUTCHED
    stop: Reason = Reason.NONE  # why everything must stop, if it must
    reset: bool = False  # somebody takes back the emergency stop
    hindrance: Reason = Reason.NONE  # why this side must not engage yet
    peer: int = 0  # nonce of the peer's process
    follow_s: float = FOLLOW_LIMIT_S  # [s] within which the peer must be engaged too


@dataclass(frozen=True, slots=True)
class Session:
    """Where a side is and why; two are equal if these are."""

    state: State = State.OFF
    reason: Reason = Reason.NOT_USABLE
    open_seen: bool = field(default=False, compare=False)  # the switch, since last engaged
    peer_seen: bool = field(default=False, compare=False)  # READY, since last engaged
    followed: bool = field(default=False, compare=False)  # the peer is, or was, engaged with us
    waited_s: float = field(default=0.0, compare=False)  # [s] for it to follow, or to be heard
    peer: int = field(default=0, compare=False)  # nonce of the process we are coupled to
    calling: bool = field(default=False, compare=False)  # a stop was asked for in this tick
    stops: int = field(default=0, compare=False)  # calls that began or ended: a reset names it

    @property
    def may_move(self) -> bool:
        """Whether commands may move the motors."""
        return self.state == State.ENGAGED

    @property
    def may_yield(self) -> bool:
        """Whether motors that hold may give way to a tension over its limit."""
        return self.state in (State.CLUTCHED, State.HOLDING)

    @property
    def may_render(self) -> bool:
        """Whether forces may reach the hand: only once the slave has engaged too."""
        return self.state == State.ENGAGED and self.followed

    @property
    def fades(self) -> bool:
        """Whether the force on the hand goes to zero by a ramp, and not at once."""
        return self.state == State.HOLDING


def switch_of(master: State) -> bool:
    """Return whether the switch counts as closed for a slave whose master is in this state.

    A master at FAULT, HOLDING or STOPPED has not seen the operator let go.
    """
    return master not in (State.OFF, State.READY)


def step(session: Session, inputs: Inputs, dt: float) -> Session:
    """Return the session after one tick, `dt` [s] after the last."""
    after = _next(session, inputs, dt)
    calling = inputs.stop != Reason.NONE
    stops = session.stops + (calling != session.calling)
    if (after.calling, after.stops) == (calling, stops):
        return after
    return replace(after, calling=calling, stops=stops)


def _next(session: Session, inputs: Inputs, dt: float) -> Session:
    if inputs.stop != Reason.NONE:
        first = session.reason if session.state == State.STOPPED else inputs.stop
        return Session(State.STOPPED, first)
    if inputs.fault == Reason.RIG_FINISHED:
        return Session(State.OFF, inputs.fault)
    if session.state == State.STOPPED and not inputs.reset:
        return session
    if inputs.fault != Reason.NONE:
        first = session.reason if session.state == State.FAULT else inputs.fault
        return Session(State.FAULT, first)
    if session.state in (State.ENGAGED, State.CLUTCHED):
        return _coupled(session, inputs, dt)
    if session.state == State.HOLDING:
        return _holding(session, inputs, dt)
    if session.state == State.FAULT and not _fault_is_over(session, inputs):
        return session
    if not inputs.usable:
        return Session(State.OFF, Reason.NOT_USABLE)
    if session.state == State.FAULT:
        session = Session(State.READY, Reason.RELEASED)
    if session.state == State.STOPPED:
        return Session(State.READY, Reason.RESET)
    return _ready(session, inputs)


def _fault_is_over(session: Session, inputs: Inputs) -> bool:
    """Return whether nothing but the past keeps a side in FAULT."""
    if inputs.engage or not inputs.usable:
        return False
    if session.reason in (Reason.PEER_SILENT, Reason.PEER_LEFT, Reason.PEER_DECLINED):
        return inputs.peer_fresh
    return True


def _ready(session: Session, inputs: Inputs) -> Session:
    """Usable and not engaged: engage, or say what is missing."""
    there = inputs.peer_fresh and inputs.peer_state in (State.READY, State.ENGAGED)
    open_seen = session.open_seen or not inputs.engage
    peer_seen = session.peer_seen or (inputs.peer_fresh and inputs.peer_state == State.READY)
    asked = inputs.engage and not inputs.clutch and inputs.hindrance == Reason.NONE
    # engaging takes a tick in READY, so that the peer sees READY too
    if session.state == State.READY and asked and there and open_seen and peer_seen:
        followed = inputs.peer_state == State.ENGAGED
        return Session(State.ENGAGED, Reason.NONE, followed=followed, peer=inputs.peer)
    if not inputs.peer_fresh:
        reason = Reason.PEER_ABSENT
    elif not there or not peer_seen:
        reason = Reason.PEER_NOT_READY
    elif not open_seen:
        reason = Reason.RELEASE_FIRST
    else:
        reason = inputs.hindrance
    return Session(State.READY, reason, open_seen=open_seen, peer_seen=peer_seen)


def _coupled(session: Session, inputs: Inputs, dt: float) -> Session:
    """Engaged or clutched: stay so, change between the two, or leave."""
    if not inputs.usable:
        return Session(State.FAULT, Reason.NOT_USABLE)
    if not inputs.peer_fresh:
        return Session(State.HOLDING, Reason.PEER_SILENT, peer=session.peer)
    if inputs.peer_state == State.STOPPED:
        return Session(State.STOPPED, Reason.PEER_STOPPED)
    if not inputs.engage:
        why = inputs.hindrance if inputs.hindrance == Reason.HAND_AWAY else Reason.RELEASED
        return Session(State.READY, why)
    if inputs.peer != session.peer:
        return Session(State.FAULT, Reason.PEER_RESTARTED)
    if inputs.peer_state == State.HOLDING:
        return Session(State.HOLDING, Reason.PEER_HOLDS, peer=session.peer)
    if inputs.peer_state == State.FAULT:
        return Session(State.FAULT, Reason.PEER_FAULT)
    if inputs.peer_state == State.OFF:
        return Session(State.READY, Reason.PEER_ENDED)
    if session.followed and inputs.peer_state == State.READY:
        return Session(State.FAULT, Reason.PEER_LEFT)
    follows = inputs.peer_state == State.ENGAGED
    if inputs.clutch:
        followed = session.followed or follows
        return Session(State.CLUTCHED, Reason.CLUTCH_HELD, followed=followed, peer=session.peer)
    if session.state == State.ENGAGED and follows:
        return session if session.followed else replace(session, followed=True)
    waited_s = 0.0 if session.state == State.CLUTCHED or session.followed else session.waited_s + dt
    if waited_s > inputs.follow_s:
        return Session(State.FAULT, Reason.PEER_DECLINED)
    return Session(
        State.ENGAGED, Reason.NONE, followed=follows, waited_s=waited_s, peer=session.peer
    )


def _holding(session: Session, inputs: Inputs, dt: float) -> Session:
    """Hold until the peer is heard and the operator has let go; silence for too long is a fault."""
    if not inputs.usable:
        return Session(State.FAULT, Reason.NOT_USABLE)
    if not inputs.peer_fresh:
        waited_s = session.waited_s + dt
        if waited_s > HOLD_LIMIT_S:
            return Session(State.FAULT, Reason.PEER_SILENT)
        return replace(session, waited_s=waited_s)
    if inputs.peer_state == State.STOPPED:
        return Session(State.STOPPED, Reason.PEER_STOPPED)
    if not inputs.engage:
        return Session(State.READY, Reason.RELEASED)
    if inputs.peer != session.peer:
        return Session(State.FAULT, Reason.PEER_RESTARTED)
    return Session(State.HOLDING, Reason.RELEASE_FIRST, peer=session.peer)
