"""One tick of the master: a hand and the slave's newest state in, a command and a force out.

A tick has two phases, both compiled and without clock, link or device:

    command   reads the hand, steps the session and finds the command for the slave
    force     after the slave has answered, or was waited for long enough: finds the force

So a force can be rendered in the tick in which its command was sent. The caller keeps the state of
one master in a `MasterState`, which both phases change in place.
"""

from typing import Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import F64, I64, Flag, Record, Records, one
from master import coupling_adapter, feedback, gate, local, operator, presence
from master.coupling_adapter import RenderMemory
from master.hand_input import Axes, HandInput, all_finite
from master.local import WorkspaceLimits
from master.operator import OperatorMemory
from master.presence import Presence
from master.settings import MasterSettings
from teleop import coupling, session
from teleop.coupling import Side
from teleop.messages import MAX_JOINTS, Command, Hand, SlaveState
from teleop.session import Inputs, Reason, Session, State

_ABSURD = 1e3  # [m], [m/s] no hand is there or as fast; NaN is not below it either


class MasterState(Record):
    """All that the master remembers from one tick to the next, and from `command` to `force`."""

    axes: I64  # of the device
    session: Session
    operator: OperatorMemory
    force: Axes  # [N] that the gate last let through
    own_force: Axes  # [N] of it, what was not the coupling's
    answered_ns: I64  # stamp of the newest command that the slave has answered
    answer_ns: I64 = 0  # the same if it was answered in this tick, 0 = none
    coupling: Side
    rendered: RenderMemory
    limits: WorkspaceLimits
    presence: Presence
    inputs: Inputs  # of the session in this tick
    may_render: Flag = False  # whether the session let forces reach the hand in `command`
    counted: Flag = False  # whether the coupling counted the hand as coupled there


class TickInput(Record):
    """What the world has told before a phase of a tick.

    The caller sets all of it before `command`, and `has_state`, `state_age_ns` and `now_ns` anew
    before `force`.
    """

    hand: HandInput
    has_state: Flag = False  # the slave has ever answered
    state_age_ns: I64 = 0  # age of its newest state
    now_ns: I64 = 0
    dt: F64 = 0.0  # [s] since the last tick
    fault: I64 = Reason.NONE  # what is wrong on this side, as far as the caller knows
    stop: I64 = Reason.NONE  # why another process wants everything to stop, if one does
    reset: Flag = False  # whether one takes that back


class PhaseInput(NamedTuple):
    """What a loop is told before a phase, besides the hand and the slave's state."""

    has_state: bool  # the slave has ever answered
    state_age_ns: int  # age of its newest state
    now_ns: int
    dt: float  # [s] since the last tick
    fault: int = int(Reason.NONE)
    stop: int = int(Reason.NONE)
    reset: bool = False


@compiled
def run_command(
    settings: Records,
    memories: Records,
    ticks: Records,
    states: Records,
    phase_input: PhaseInput,
    commands: Records,
) -> None:
    """Run `command` on arrays of one record each: what a loop calls."""
    _take(ticks[0], phase_input)
    command(settings[0], memories[0], ticks[0], states[0], commands[0])


@compiled
def run_force(
    settings: Records,
    memories: Records,
    ticks: Records,
    states: Records,
    phase_input: PhaseInput,
    new_state: bool,
    out: Array,
) -> int:
    """Run `force` on arrays of one record each: what a loop calls."""
    _take(ticks[0], phase_input)
    return force(settings[0], memories[0], ticks[0], states[0], new_state, out)


@compiled
def _take(tick: TickInput, phase_input: PhaseInput) -> None:
    tick.has_state, tick.state_age_ns = phase_input.has_state, phase_input.state_age_ns
    tick.now_ns, tick.dt = phase_input.now_ns, phase_input.dt
    tick.fault, tick.stop, tick.reset = phase_input.fault, phase_input.stop, phase_input.reset


@compiled
def fill_hand_message(
    memories: Records, ticks: Records, state_age_ns: int, round_trip_ns: int, messages: Records
) -> None:
    """Run `hand_message` on arrays of one record each."""
    hand_message(memories[0], ticks[0].hand, state_age_ns, round_trip_ns, messages[0])


def start(axes: int, now_ns: int) -> Records:
    """Return the state before the first tick, as an array of one `MasterState`.

    Off, no force, nothing commanded since `now_ns`.
    """
    records = MasterState.array()
    state: MasterState = one(records)
    state.axes = axes
    state.answered_ns = now_ns
    return records


@compiled
def command(
    settings: MasterSettings,
    memory: MasterState,
    tick: TickInput,
    state: SlaveState,
    out: Command,
) -> None:
    """Run the first phase of a tick: from the hand to the command.

    Parameters
    ----------
    settings : MasterSettings
    memory : MasterState
        Changed in place.
    tick : TickInput
    state : SlaveState
        The slave's newest state; not read unless `tick.has_state`.
    out : Command
        All fields but those of the head are written.
    """
    hand, inputs, dt = tick.hand, memory.inputs, tick.dt
    wanted = np.zeros(MAX_JOINTS)
    finite = _wanted_forces(settings, memory, tick, state, wanted)
    presence.step(settings.operator, memory.presence, hand, dt)

    inputs.usable = hand.present
    inputs.clutch = hand.clutch
    inputs.reset = tick.reset
    inputs.stop = tick.stop
    if tick.stop == Reason.NONE and hand.stop:
        inputs.stop = Reason.EMERGENCY_STOP
    inputs.follow_s = session.FOLLOW_LIMIT_S + settings.delay_max
    _step_session(settings, memory, tick, state, finite, dt)
    memory.may_render = session.may_render(memory.session)
    memory.counted = memory.may_render and finite

    position: Any = out.position
    velocity: Any = out.velocity
    engaged = memory.session.state == State.ENGAGED
    operator.step(
        settings.operator, memory.operator, hand, state, tick.has_state, engaged, position, velocity
    )
    _hear(memory, tick, state)
    written = np.zeros(MAX_JOINTS)
    for k in range(memory.axes):
        written[k] = memory.force[k] - memory.own_force[k]
    coupling_adapter.count_hand(
        settings.bilateral,
        memory.coupling,
        memory.rendered,
        hand,
        settings.force.scale,
        settings.operator.position_scale,
        written,
        memory.axes,
        memory.counted,
        dt,
    )
    _describe(settings, memory, tick, state, out)


@compiled
def force(
    settings: MasterSettings,
    memory: MasterState,
    tick: TickInput,
    state: SlaveState,
    new_state: bool,
    out: Array,
) -> int:
    """Run the second phase of a tick: from the slave's newest state to the force on the hand.

    The force is zero unless the session is engaged on both sides, then and now, and the state is
    fresh now: young enough itself, and an answer to a command that is young enough. It fades when
    the state stops being that.

    Parameters
    ----------
    settings, memory, tick, state
        As in `command`; `tick.now_ns` and `tick.state_age_ns` are those of this phase.
    new_state : bool
        Whether `state` has come since `command`. What it tells (a fault, a stop, a value that is
        not finite) then acts at once.
    out : array of shape (8,)
        Forces [N] for the device, zero beyond its axes.

    Returns
    -------
    int
        The bits of a `gate.GateFlags`.
    """
    hand, axes, dt = tick.hand, memory.axes, tick.dt
    wanted = np.zeros(MAX_JOINTS)
    finite = _wanted_forces(settings, memory, tick, state, wanted)
    fresh = is_fresh(settings, tick, state)
    if new_state:
        _hear(memory, tick, state)
    if new_state or fresh != memory.inputs.peer_fresh:
        memory.inputs.reset = False  # it has had its effect
        _step_session(settings, memory, tick, state, finite, 0.0)
    # no force that the coupling has not counted: where it could begin, the next tick does
    renders = memory.may_render and session.may_render(memory.session)
    renders = renders and (memory.counted or not finite)

    total, own = np.zeros(MAX_JOINTS), np.zeros(MAX_JOINTS)
    rest = np.zeros(MAX_JOINTS)
    coupling_adapter.render(
        settings.bilateral,
        memory.coupling,
        settings.force.scale,
        wanted,
        axes,
        renders and memory.counted and finite,
        total,
    )
    if renders:
        coupling_adapter.remember(memory.rendered, settings.force.scale, total, axes)
    local.update_limits(settings.operator, memory.limits, hand, renders)
    if renders and hand.present:  # at once, whatever the delay
        local.wall_forces(settings.operator, memory.limits, hand, own)
    for k in range(axes):
        if _keeps_weight(memory.session):
            rest[k] = settings.operator.weight[k]
            own[k] += rest[k]
        total[k] = feedback.limit_slew(settings.force.slew, memory.force[k], total[k] + own[k], dt)
        total[k] = feedback.clamp(settings.force.limit, total[k])
    fades = session.fades(memory.session)
    verdict = gate.step(
        settings.gate, memory.force, total, axes, fresh, renders, dt, fades, rest, out
    )
    for k in range(MAX_JOINTS):
        out[k] = out[k] if k < axes else 0.0
        memory.force[k] = out[k]
        memory.own_force[k] = own[k]
    _note_answer(memory, tick, state)
    return verdict


@compiled
def _wanted_forces(
    settings: MasterSettings,
    memory: MasterState,
    tick: TickInput,
    state: SlaveState,
    out: Array,
) -> bool:
    """Write the forces that the hand should feel [N] to `out`; return whether all are finite."""
    feedback.tip_forces(settings.bilateral.confidence, state, tick.has_state, memory.axes, out)
    for k in range(memory.axes):
        out[k] = feedback.reflect(settings.force.scale, out[k])
    return all_finite(out, memory.axes)


@compiled
def _step_session(
    settings: MasterSettings,
    memory: MasterState,
    tick: TickInput,
    state: SlaveState,
    finite: bool,
    dt: float,
) -> None:
    """Step the session with what is known of hand and peer; `finite` is about the wanted forces."""
    inputs, hand = memory.inputs, tick.hand
    inputs.peer_fresh = is_fresh(settings, tick, state)
    inputs.peer_state = State.OFF
    inputs.peer = 0
    if tick.has_state:
        inputs.peer_state = session.known_state(state.state)
        inputs.peer = state.sender
    inputs.engage = hand.present and switch(memory.session, hand, memory.presence)
    inputs.fault = tick.fault
    if tick.fault == Reason.NONE and not sound(memory.session, hand, finite):
        inputs.fault = Reason.NOT_FINITE
    inputs.not_ready_reason = not_ready_reason(settings, memory, tick, state)
    session.step(memory.session, inputs, dt)


@compiled
def _hear(memory: MasterState, tick: TickInput, state: SlaveState) -> None:
    if tick.has_state:
        energy: Any = state.energy
        wave: Any = state.wave
        coupling.receive(memory.coupling, state.sender, energy, wave)


@compiled
def _describe(
    settings: MasterSettings,
    memory: MasterState,
    tick: TickInput,
    state: SlaveState,
    out: Command,
) -> None:
    """Write all of a command but its head and the tips."""
    fields: Any = out
    fields.state = memory.session.state
    fields.reason = memory.session.reason
    fields.echo_stamp_ns = state.stamp_ns if tick.has_state else 0
    fields.stops = memory.session.stops
    fields.coupling = settings.bilateral.signature
    fields.force_max = feedback.saturation(settings.force)
    for k in range(MAX_JOINTS):
        fields.energy[k] = memory.coupling.ports[k].passed_on
        fields.wave[k] = memory.coupling.ports[k].sent_wave


@compiled
def _note_answer(memory: MasterState, tick: TickInput, state: SlaveState) -> None:
    """Note which command is answered for the first time."""
    memory.answer_ns = 0
    if tick.has_state and memory.answered_ns < state.echo_stamp_ns <= tick.now_ns:
        memory.answer_ns = state.echo_stamp_ns
        memory.answered_ns = state.echo_stamp_ns


@compiled
def _keeps_weight(side: Session) -> bool:
    """Return whether a device keeps its weight in this state of the session."""
    return (
        side.state == State.READY  # noqa: PLR1714 - compiled
        or side.state == State.CLUTCHED
        or side.state == State.HOLDING
        or side.state == State.ENGAGED
    )


@compiled
def is_fresh(settings: MasterSettings, tick: TickInput, state: SlaveState) -> bool:
    """Return whether `state` is there, and young enough to act on.

    Its age tells of a slave that fell silent, and with the age of the sample behind it, of a rig
    that did. The age of the command it answers tells of a slave that no longer hears us, and of a
    delay of both ways together, which no clock of one side shows.
    """
    if not tick.has_state:
        return False
    # as floats: sums of what a message may hold go beyond 64 bits
    behind_ns = float(tick.state_age_ns) + max(float(state.sample_age_ns), 0.0)
    answered_ns = float(tick.now_ns - state.echo_stamp_ns)
    return (
        behind_ns <= settings.state_timeout * 1e9 and 0.0 <= answered_ns <= settings.delay_max * 1e9
    )


@compiled
def switch(side: Session, hand: HandInput, there: Presence) -> bool:
    """Return whether the operator's switch counts as closed.

    It does not while nobody is there; but what went wrong is over only when the operator has let
    go of everything.
    """
    if (
        side.state == State.FAULT  # noqa: PLR1714 - compiled
        or side.state == State.HOLDING
        or side.state == State.STOPPED
    ):
        return hand.engage or hand.clutch or hand.stop
    return hand.engage and not there.away


@compiled
def not_ready_reason(
    settings: MasterSettings, memory: MasterState, tick: TickInput, state: SlaveState
) -> int:
    """Return why this side must not engage yet, `Reason.NONE` if it may."""
    if tick.has_state and coupling.differs(settings.bilateral, state.coupling):
        return Reason.COUPLING_DIFFERS
    if memory.presence.away:
        return Reason.HAND_AWAY
    return operator.not_ready_reason(
        settings.operator, memory.operator, tick.hand, state, tick.has_state
    )


@compiled
def sound(side: Session, hand: HandInput, finite: bool) -> bool:
    """Return whether the hand is where hands are, and the force, if it is rendered, is `finite`."""
    for k in range(hand.axes):
        if not abs(hand.position[k]) < _ABSURD or not abs(hand.velocity[k]) < _ABSURD:
            return False
    return finite or not session.may_render(side)


@compiled
def hand_message(
    memory: MasterState, hand: HandInput, state_age_ns: int, round_trip_ns: int, out: Hand
) -> None:
    """Write what listeners are told about the hand after a tick to all but the head of `out`."""
    fields: Any = out
    fields.state = memory.session.state
    fields.reason = memory.session.reason
    fields.joints = memory.axes
    fields.round_trip_ns = round_trip_ns
    fields.state_age_ns = state_age_ns
    for k in range(MAX_JOINTS):
        fields.position[k] = hand.position[k]
        fields.velocity[k] = hand.velocity[k]
        fields.force[k] = memory.force[k]
