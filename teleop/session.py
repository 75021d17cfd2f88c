"""The session state machine: pure, one on each side, the same code on both.

    OFF ──own side usable──► READY ──switch pressed, peer there──► ENGAGED
     ▲                        ▲  ▲                                    │
     └── own side not usable ─┘  ├─────────── switch open ◄───────────┤
                                 │                                    │
    FAULT ──switch open, fault gone, own side usable                  │
      ▲                                                               │
      └── a fault of its own, from any state; a peer that is ◄────────┘
          silent, at fault, gone or not following

The operator's switch is the master's own; the slave's switch is what the master's newest command
says (`switch_of`). So the master engages first and the slave follows, the slave leaves when the
master does, and after a fault of its own the slave waits until the operator has let go.

To engage, a side must have found two things in its present READY spell: the switch open, and its
peer READY. So neither a switch held through a fault, nor a process restarted in the middle of a
session, ever engages by itself.

What each side may do hangs on `may_move` (slave) and `may_render` (master), and on nothing else.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum

FOLLOW_LIMIT_S = 0.1  # [s] within which the peer must be engaged too: 100 ticks of 1 kHz


class State(IntEnum):
    """Where a side is."""

    OFF = 0  # not usable yet: device or rig missing, estimator warming up
    READY = 1  # usable, not coupled: zero force, motors hold
    ENGAGED = 2  # coupled: commands move the rig, forces move the hand
    FAULT = 3  # something is wrong: zero force, motors hold, until the operator releases

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

    PEER_SILENT = 20, "the other side fell silent"
    PEER_FAULT = 21, "the other side is at fault"
    PEER_LEFT = 22, "the other side disengaged by itself"
    PEER_DECLINED = 23, "the other side did not engage in time"

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

    UNKNOWN = 255, "a reason that this version does not know"


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a side knows at a tick."""

    usable: bool  # its own device or rig can be read and written
    peer_fresh: bool  # the peer's newest message is young enough to act on
    peer_state: State  # in that message; OFF if there was none
    engage: bool  # the switch: the operator's, or the master's ENGAGED
    fault: Reason = Reason.NONE  # what is wrong on this side now


@dataclass(frozen=True, slots=True)
class Session:
    """Where a side is and why; two are equal if these are."""

    state: State = State.OFF
    reason: Reason = Reason.NOT_USABLE
    open_seen: bool = field(default=False, compare=False)  # the switch, since last engaged
    peer_seen: bool = field(default=False, compare=False)  # READY, since last engaged
    followed: bool = field(default=False, compare=False)  # the peer is, or was, engaged with us
    waited_s: float = field(default=0.0, compare=False)  # [s] for it to follow

    @property
    def may_move(self) -> bool:
        """Whether commands may move the motors."""
        return self.state == State.ENGAGED

    @property
    def may_render(self) -> bool:
        """Whether forces may reach the hand: only once the slave has engaged too."""
        return self.state == State.ENGAGED and self.followed


def switch_of(master: State) -> bool:
    """Return whether the switch counts as closed for a slave whose master is in this state.

    A master at FAULT has not seen the operator let go.
    """
    return master in (State.ENGAGED, State.FAULT)


def step(session: Session, inputs: Inputs, dt: float) -> Session:
    """Return the session after one tick, `dt` [s] after the last."""
    if inputs.fault == Reason.RIG_FINISHED:
        return Session(State.OFF, inputs.fault)
    if inputs.fault != Reason.NONE:
        first = session.reason if session.state == State.FAULT else inputs.fault
        return Session(State.FAULT, first)
    if session.state == State.ENGAGED:
        return _engaged(session, inputs, dt)
    if session.state == State.FAULT and not _fault_is_over(session, inputs):
        return session
    if not inputs.usable:
        return Session(State.OFF, Reason.NOT_USABLE)
    if session.state == State.FAULT:
        session = Session(State.READY, Reason.RELEASED)
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
    # engaging takes a tick in READY, so that the peer sees READY too
    if session.state == State.READY and inputs.engage and there and open_seen and peer_seen:
        followed = inputs.peer_state == State.ENGAGED
        return Session(State.ENGAGED, Reason.NONE, followed=followed)
    if not inputs.peer_fresh:
        reason = Reason.PEER_ABSENT
    elif not there or not peer_seen:
        reason = Reason.PEER_NOT_READY
    elif not open_seen:
        reason = Reason.RELEASE_FIRST
    else:
        reason = Reason.NONE
    return Session(State.READY, reason, open_seen=open_seen, peer_seen=peer_seen)


def _engaged(session: Session, inputs: Inputs, dt: float) -> Session:
    """Engaged: stay so, or leave."""
    if not inputs.usable:
        return Session(State.FAULT, Reason.NOT_USABLE)
    if not inputs.peer_fresh:
        return Session(State.FAULT, Reason.PEER_SILENT)
    if not inputs.engage:
        return Session(State.READY, Reason.RELEASED)
    if inputs.peer_state == State.ENGAGED:
        return replace(session, followed=True)
    if inputs.peer_state == State.FAULT:
        return Session(State.FAULT, Reason.PEER_FAULT)
    if inputs.peer_state == State.OFF:
        return Session(State.READY, Reason.PEER_ENDED)
    if session.followed:
        return Session(State.FAULT, Reason.PEER_LEFT)
    waited_s = session.waited_s + dt
    if waited_s > FOLLOW_LIMIT_S:
        return Session(State.FAULT, Reason.PEER_DECLINED)
    return replace(session, waited_s=waited_s)
