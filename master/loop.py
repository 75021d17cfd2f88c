"""One tick of the master, as a pure function.

A hand and the slave's newest state go in; a command, a force and a session state come out. No
clock, no link, no device: the process around it has those, and tests have none.
"""

import math
from typing import NamedTuple

from master import feedback, gate, local, operator, port, presence
from master.config import MasterConfig
from master.device import Axes, HandState
from master.local import Reach
from master.port import Rendered
from master.presence import Presence
from teleop import coupling, session
from teleop.coupling import Bilateral, Side
from teleop.messages import MAX_JOINTS as JOINTS
from teleop.messages import Command, Hand, SlaveState, padded
from teleop.session import Reason, Session, State

DIRECT = Bilateral()
AT_REST = (State.READY, State.CLUTCHED, State.HOLDING, State.ENGAGED)  # a device keeps its weight
_ABSURD = 1e3  # [m], [m/s] no hand is there or as fast; NaN is not below it either


class Memory(NamedTuple):
    """All that the master remembers from one tick to the next."""

    session: Session
    operator: operator.Memory
    force: Axes  # [N] what the gate last let through
    answered_ns: int  # stamp of the newest command that the slave has answered
    port: Side = Side()  # of the coupling
    rendered: Rendered = Rendered()
    local: Axes = ()  # [N] how much of `force` was not the coupling's
    reach: Reach = ()  # where the limits of the workspace begin
    presence: Presence = Presence()


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
    bilateral: Bilateral = DIRECT,
    stop: Reason = Reason.NONE,
    reset: bool = False,
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
    bilateral : Bilateral
        What the session's config says of confidence and coupling.
    stop, reset : Reason, bool
        Why another process wants everything to stop, if one does; whether one takes that back.

    Returns
    -------
    Output, Memory
        The force is zero unless the session is engaged on both sides and the state is fresh: young
        enough itself, and an answer to a command that is young enough. It fades when the state
        stops being that.
    """
    axes = len(memory.force)
    fresh = state is not None and is_fresh(config, state, age_ns, now_ns)
    felt = feedback.felt(bilateral.confidence, state, axes)  # estimate, interval, attenuation
    wanted = tuple(feedback.reflect(config.force.scale, force) for force in felt)  # scale
    if stop is Reason.NONE and hand is not None and hand.stop:
        stop = Reason.EMERGENCY_STOP
    if fault is Reason.NONE and not sound(memory.session, hand, wanted):
        fault = Reason.NOT_FINITE

    there = presence.step(config.operator, memory.presence, hand, dt)
    side = session.step(
        memory.session,
        session.Inputs(
            usable=hand is not None,
            peer_fresh=fresh,
            peer_state=peer_state(state),
            engage=hand is not None and switch(memory.session, hand, there),
            fault=fault,
            clutch=hand is not None and hand.clutch,
            stop=stop,
            reset=reset,
            hindrance=hindrance(config, memory, hand, state, bilateral, there),
            peer=state.sender if state is not None else 0,
            follow_s=session.FOLLOW_LIMIT_S + config.delay_max,
        ),
        dt,
    )
    tip, anchors = operator.step(
        config.operator, memory.operator, hand, state, side.state is State.ENGAGED
    )
    heard = memory.port
    if state is not None:
        heard = coupling.hear(heard, state.sender, state.energy, state.wave)
    written = local.less(memory.force, memory.local)
    coupled, ports, rendered = port.step(
        bilateral,
        heard,
        memory.rendered,
        hand,
        config.force.scale,
        config.operator.position_scale,
        written,
        wanted,
        side.may_render,
        dt,
    )
    rest = local.weight(config.operator, axes) if side.state in AT_REST else ()
    reach = local.reach(config.operator, memory.reach, hand, side.may_render)
    own = rest
    if hand is not None and side.may_render:  # at once, whatever the delay
        own = local.plus(local.walls(config.operator, reach, hand), rest)
    total = local.plus(coupled, own)
    slewed = (
        feedback.slewed(config.force.slew, *pair, dt)
        for pair in zip(memory.force, total, strict=True)
    )
    clamped = tuple(feedback.clamp(config.force.limit, force) for force in slewed)
    force, verdict = gate.step(
        config.gate, memory.force, clamped, fresh, side.may_render, dt, side.fades, rest
    )

    echo = state.echo_stamp_ns if state is not None else 0
    answer = echo if memory.answered_ns < echo <= now_ns else 0
    command = Command(
        state=side.state,
        reason=side.reason,
        echo_stamp_ns=state.stamp_ns if state is not None else 0,
        position=tip.position,
        velocity=tip.velocity,
        stops=side.stops,
        coupling=bilateral.signature,
        force_max=feedback.saturation(config.force),
        energy=ports.energy,
        wave=ports.wave,
    )
    after = Memory(
        side,
        anchors,
        force,
        answer or memory.answered_ns,
        ports,
        rendered,
        own,
        reach,
        there,
    )
    return Output(command, force, verdict, answer), after


def is_fresh(config: MasterConfig, state: SlaveState, age_ns: int, now_ns: int) -> bool:
    """Return whether `state` is young enough to act on.

    Its age tells of a slave that fell silent, and with the age of the sample behind it, of a rig
    that did. The age of the command it answers tells of a slave that no longer hears us, and of a
    delay of both ways together, which no clock of one side shows.
    """
    behind_ns = age_ns + max(state.sample_age_ns, 0)
    answered_ns = now_ns - state.echo_stamp_ns
    return behind_ns <= config.freshness * 1e9 and 0 <= answered_ns <= config.delay_max * 1e9


def switch(side: Session, hand: HandState, there: Presence) -> bool:
    """Return whether the operator's switch counts as closed.

    It does not while nobody is there; but what went wrong is over only when the operator has let
    go of everything.
    """
    if side.state in (State.FAULT, State.HOLDING, State.STOPPED):
        return hand.engage or hand.clutch or hand.stop
    return hand.engage and not there.away


def hindrance(
    config: MasterConfig,
    memory: Memory,
    hand: HandState | None,
    state: SlaveState | None,
    bilateral: Bilateral,
    there: Presence,
) -> Reason:
    """Return why this side must not engage yet, `Reason.NONE` if it may."""
    if state is not None and bilateral.differs(state.coupling):
        return Reason.COUPLING_DIFFERS
    if there.away:
        return Reason.HAND_AWAY
    return operator.hindrance(config.operator, memory.operator, hand, state)


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
    return State(state.state)


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
