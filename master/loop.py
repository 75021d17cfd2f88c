"""One tick of the master, as a pure function.

A hand and the slave's newest state go in; a command, a force and a session state come out. No
clock, no link, no device: the process around it has those, and tests have none.
"""

import math
from typing import NamedTuple

from master import feedback, gate, operator
from master.config import MasterConfig
from master.device import Axes, HandState
from teleop import session
from teleop.messages import MAX_JOINTS as JOINTS
from teleop.messages import Command, Hand, SlaveState, padded
from teleop.session import Reason, Session, State

_ABSURD = 1e3  # [m], [m/s] no hand is there or as fast; NaN is not below it either


class Memory(NamedTuple):
    """All that the master remembers from one tick to the next."""

    session: Session
    operator: operator.Memory
    force: Axes  # [N] what the gate last let through
    answered_ns: int  # stamp of the newest command that the slave has answered


class Output(NamedTuple):
    """What a tick asks of the world."""

    command: Command
    force: Axes  # [N]
    verdict: gate.Verdict
    answer_ns: int  # stamp of the command answered in this tick for the first time, 0 = none


def start(axes: int, now_ns: int) -> Memory:
    """Return the memory before the first tick: off, no force, nothing asked for since `now_ns`."""
    return Memory(Session(), operator.Memory(), (0.0,) * axes, now_ns)


def step(
    config: MasterConfig,
    memory: Memory,
    hand: HandState | None,
    state: SlaveState | None,
    age_ns: int,
    now_ns: int,
    dt: float,
    fault: Reason = Reason.NONE,
) -> tuple[Output, Memory]:
    """Advance the master by one tick.

    Parameters
    ----------
    hand : HandState or None
        Newest read of the device; None if it cannot be read.
    state : SlaveState or None
        Newest answer of the slave, if there ever was one.
    age_ns : int
        Its age [ns].
    now_ns : int
        Stamp of this tick.
    dt : float
        Time since the last tick [s].
    fault : Reason
        What is wrong on this side now, as far as the caller knows.

    Returns
    -------
    Output, Memory
        The force is zero unless the session is engaged on both sides and the state is fresh: young
        enough itself, and an answer to a command that is young enough.
    """
    axes = len(memory.force)
    fresh = state is not None and is_fresh(config, state, age_ns, now_ns)
    wanted = feedback.step(config.force, state, axes) if state is not None else (0.0,) * axes
    if fault is Reason.NONE and not sound(memory.session, hand, wanted):
        fault = Reason.NOT_FINITE

    side = session.step(
        memory.session,
        session.Inputs(
            usable=hand is not None,
            peer_fresh=fresh,
            peer_state=peer_state(state),
            engage=hand is not None and hand.engage,
            fault=fault,
        ),
        dt,
    )
    tip, coupling = operator.step(
        config.operator, memory.operator, hand, state, side.state is State.ENGAGED
    )
    force, verdict = gate.step(config.gate, memory.force, wanted, fresh, side.may_render, dt)

    echo = state.echo_stamp_ns if state is not None else 0
    answer = echo if memory.answered_ns < echo <= now_ns else 0
    command = Command(
        state=side.state,
        reason=side.reason,
        echo_stamp_ns=state.stamp_ns if state is not None else 0,
        position=tip.position,
        velocity=tip.velocity,
    )
    after = Memory(side, coupling, force, answer or memory.answered_ns)
    return Output(command, force, verdict, answer), after


def is_fresh(config: MasterConfig, state: SlaveState, age_ns: int, now_ns: int) -> bool:
    """Return whether `state` is young enough to act on.

    Its age tells of a slave that fell silent, and with the age of the sample behind it, of a rig
    that did. The age of the command it answers tells of a slave that no longer hears us, and of a
    delay of both ways together, which no clock of one side shows.
    """
    behind_ns = age_ns + max(state.sample_age_ns, 0)
    answered_ns = now_ns - state.echo_stamp_ns
    return behind_ns <= config.freshness * 1e9 and answered_ns <= config.delay_max * 1e9


def sound(side: Session, hand: HandState | None, wanted: Axes) -> bool:
    """Return whether the hand is where hands are, and the force, if it is rendered, is a number."""
    if hand is not None and not all(
        abs(value) < _ABSURD for value in (*hand.position, *hand.velocity)
    ):
        return False
    return not side.may_render or all(map(math.isfinite, wanted))


def peer_state(state: SlaveState | None) -> State:
    """Return the slave's session state; one we do not know is a fault."""
    if state is None:
        return State.OFF
    return State(state.state) if state.state <= State.FAULT else State.FAULT


def hand_message(
    memory: Memory, hand: HandState, force: Axes, age_ns: int, round_trip_ns: int
) -> Hand:
    """Return what listeners are told about the hand after a tick."""
    return Hand(
        state=memory.session.state,
        reason=memory.session.reason,
        joints=len(force),
        round_trip_ns=round_trip_ns,
        state_age_ns=age_ns,
        position=padded(hand.position, JOINTS),
        velocity=padded(hand.velocity, JOINTS),
        force=padded(force, JOINTS),
    )
