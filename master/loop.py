"""One tick of the master: from hand and newest slave state to a command and a force.

A tick has two phases, both compiled and without clock, link or device:

    compute_command reads the hand, steps the session and computes the command for the slave
    compute_force   after the slave's answer or a timeout: computes the force

So a force can be rendered in the tick in which its command was sent. Both phases update the
caller's `MasterMemory` in place; a copy of it undoes them.
"""

from typing import Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import I64, Flag, Struct, StructArray, view_struct
from master import axis_map, coupling_adapter, feedback, gate, operator, workspace
from master.axis_map import VelocityMap
from master.coupling_adapter import RenderMemory
from master.hand_input import Axes, HandInput, is_all_finite
from master.operator import OperatorMemory
from master.settings_record import MasterSettings
from master.workspace import Presence, WorkspaceLimits
from teleop import coupling
from teleop.config.ranges import MOTION_MAX
from teleop.coupling import Side
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState
from teleop.session import state_machine
from teleop.session.state_machine import Reason, Session, SessionInputs, State


class MasterMemory(Struct):
    """State of the master between ticks, and between `compute_command` and `compute_force`."""

    axes: I64  # of the device
    joints: I64  # that it moves: as many, unless its motion is mapped
    session: Session
    operator: OperatorMemory
    force: Axes  # [N] last output of the gate; of a torque, at the lever of its axis
    written: Axes  # [N], [N m] the same as the device has it
    local_force: Axes  # [N] its part from local forces
    joint_force: Axes  # [N] the other part, from the coupling, along the hand's motion for joints
    answered_command_ns: I64  # stamp of the newest command that the slave has answered
    newly_answered_ns: I64 = 0  # the same if its answer came in this tick, 0 = none
    coupling: Side
    rendered: RenderMemory
    limits: WorkspaceLimits
    presence: Presence
    inputs: SessionInputs  # of the session in this tick
    may_render: Flag = False  # whether the session allowed forces in `compute_command`
    has_counted_work: Flag = False  # whether `add_hand_work` counted coupled work there


class TickInput(NamedTuple):
    """Inputs of a phase of a tick besides the hand and the slave's state."""

    dt: float  # [s] since the last tick
    now_ns: int
    has_state: bool  # whether a slave state ever came
    state_age_ns: int  # age of the newest one
    fault: int = int(Reason.NONE)  # Reason: fault on this side detected by the caller
    stop: int = int(Reason.NONE)  # Reason of an emergency stop by another process
    reset: bool = False  # whether a stop is reset
    link: int = int(Reason.NONE)  # Reason: bound that the link exceeds
    link_holds: bool = False  # whether the session must hold because of it


class Tick(NamedTuple):
    """The records of a phase that its steps share."""

    settings: MasterSettings
    memory: MasterMemory
    hand: HandInput
    mapped_hand: HandInput
    state: SlaveState
    input: TickInput


class ForceParts(NamedTuple):
    """Forces of a tick [N], each of shape (8,); a torque counts as the force at its lever."""

    wanted: Array  # along the hand's motion for joints, as the newest state asks for
    joint: Array  # what the coupling and the limits admit of it
    coupling: Array  # the same along the axes of the hand
    local: Array  # of this side alone
    weight: Array  # the part of `local` that carries the device


def init_master(axes: int, now_ns: int, joints: int | None = None) -> StructArray:
    """Return the initial state as an array of one `MasterMemory`.

    Off, no force, no command since `now_ns`. A device of so many `axes` moves as many joints,
    unless `joints` says otherwise.
    """
    records = MasterMemory.array()
    state: MasterMemory = view_struct(records)
    state.axes, state.joints = axes, axes if joints is None else joints
    state.answered_command_ns = now_ns
    return records


@jit_compile
def compute_command(
    settings_records: StructArray,
    memories: StructArray,
    hands: StructArray,
    mapped_hands: StructArray,
    states: StructArray,
    tick_input: TickInput,
    commands: StructArray,
) -> None:
    """Run the first phase of a tick: from the hand to the command.

    Parameters
    ----------
    settings_records, memories : Records
        `MasterSettings` and `MasterMemory`, shape (1,); the state is updated.
    hands : Records
        `HandInput`, shape (1,).
    mapped_hands : Records
        `HandInput`, shape (1,): the hand as one with an axis for each joint (`master.axis_map`);
        `hands` itself, unless its motion is mapped.
    states : Records
        `SlaveState`, the newest, shape (1,); ignored unless `tick_input.has_state`.
    commands : Records
        `Command`, shape (1,), filled in except for the head.
    """
    settings, memory, command = settings_records[0], memories[0], commands[0]
    hand, mapped_hand, state, dt = hands[0], mapped_hands[0], states[0], tick_input.dt
    tick = Tick(settings, memory, hand, mapped_hand, state, tick_input)
    wanted_forces = np.zeros(MAX_JOINTS)
    is_finite = _compute_wanted_forces(tick, wanted_forces)
    workspace.update_presence(settings.operator, memory.presence, hand, dt)
    _take_requests(tick)
    _step_session(tick, is_finite, dt)
    memory.may_render = state_machine.may_render(memory.session)
    memory.has_counted_work = memory.may_render and is_finite

    position: Any = command.position
    velocity: Any = command.velocity
    engaged = memory.session.state == State.ENGAGED
    operator.step(
        settings.operator,
        memory.operator,
        mapped_hand,
        state,
        tick_input.has_state,
        engaged,
        position,
        velocity,
    )
    _receive_state(tick, wanted_forces)
    coupling_adapter.add_hand_work(
        settings.bilateral,
        memory.coupling,
        memory.rendered,
        mapped_hand,
        settings.force.scale,
        settings.operator.position_scale,
        memory.joint_force,
        memory.joints,
        memory.has_counted_work,
        dt,
    )
    _fill_command(tick, command)


@jit_compile
def compute_force(
    settings_records: StructArray,
    memories: StructArray,
    hands: StructArray,
    mapped_hands: StructArray,
    states: StructArray,
    tick_input: TickInput,
    maps: StructArray,
    new_state: bool,
    out: Array,
) -> int:
    """Run the second phase of a tick: from the slave's newest state to the force on the hand.

    The force is zero unless the session is engaged on both sides, in both phases, and the state is
    fresh: recent itself, and an answer to a recent command. It fades when the state is no longer
    fresh.

    Parameters
    ----------
    settings_records, memories, hands, mapped_hands, states
        As in `compute_command`.
    tick_input : TickInput
        As in `compute_command`; `now_ns` and what there is of a state are those of this phase.
    maps : Records
        `VelocityMap`, shape (1,): how `mapped_hands` follow from `hands`.
    new_state : bool
        Whether `states` has arrived since `compute_command`. Its faults, stops and non-finite
        values then act at once.
    out : array of shape (8,)
        Forces [N], or torques [N m], for the device; zero beyond its axes.

    Returns
    -------
    int
        The bits of a `gate.GateFlags`.
    """
    settings, memory, state, velocity_map = settings_records[0], memories[0], states[0], maps[0]
    tick = Tick(settings, memory, hands[0], mapped_hands[0], state, tick_input)
    rows = np.zeros((5, MAX_JOINTS))
    forces = ForceParts(rows[0], rows[1], rows[2], rows[3], rows[4])
    is_finite = _compute_wanted_forces(tick, forces.wanted)
    fresh = is_fresh(settings, tick_input, state)
    if new_state:
        _receive_state(tick, forces.wanted)
        memory.inputs.link, memory.inputs.link_holds = tick_input.link, tick_input.link_holds
    if new_state or fresh != memory.inputs.peer_fresh:
        memory.inputs.reset = False  # already processed
        _step_session(tick, is_finite, 0.0)
    is_rendering = _is_rendering(memory, is_finite)
    _compute_coupling_forces(tick, velocity_map, is_rendering, is_finite, forces)
    _compute_local_forces(tick, velocity_map, is_rendering, forces)
    verdict = _limit_total_force(tick, forces, fresh, is_rendering, out)
    _store_forces(settings, memory, velocity_map, forces, out)
    _write_torques(memory, velocity_map, out)
    _record_answer(memory, tick_input, state)
    return verdict


@jit_compile
def _is_rendering(memory: MasterMemory, is_finite: bool) -> bool:
    """Return whether both phases of the tick allow forces.

    Every force is in the ledger: a coupling that could start now starts at the next tick.
    """
    is_allowed = memory.may_render and state_machine.may_render(memory.session)
    return is_allowed and (memory.has_counted_work or not is_finite)


@jit_compile
def _compute_coupling_forces(
    tick: Tick, velocity_map: VelocityMap, is_rendering: bool, is_finite: bool, forces: ForceParts
) -> None:
    """Write what the coupling admits of the wanted forces, along the joints and on the hand."""
    settings, memory = tick.settings, tick.memory
    coupling_adapter.render_force(
        settings.bilateral,
        memory.coupling,
        settings.force.scale,
        forces.wanted,
        memory.joints,
        is_rendering and memory.has_counted_work and is_finite,
        forces.joint,
    )
    if velocity_map.is_active:
        axis_map.limit_joint_force(
            settings.force,
            settings.gate.total_max,
            velocity_map,
            memory.joint_force,
            forces.joint,
            memory.axes,
            memory.joints,
            tick.input.dt,
        )
    axis_map.compute_hand_force(
        velocity_map, forces.joint, memory.axes, memory.joints, forces.coupling
    )
    if is_rendering:
        coupling_adapter.store_rendered_force(
            memory.rendered, settings.force.scale, forces.joint, memory.joints
        )


@jit_compile
def _compute_local_forces(
    tick: Tick, velocity_map: VelocityMap, is_rendering: bool, forces: ForceParts
) -> None:
    """Write the forces of this side alone: walls, virtual fixtures, weight compensation.

    They act without delay.
    """
    settings, memory, hand = tick.settings, tick.memory, tick.hand
    workspace.update_limits(settings.operator, memory.limits, hand, is_rendering)
    if is_rendering and hand.present:
        workspace.compute_wall_forces(
            settings.operator, memory.limits, hand, velocity_map.lever, forces.local
        )
    for k in range(memory.axes):
        if is_rendering:
            forces.local[k] += velocity_map.fixture_force[k]
        if _has_weight_compensation(memory.session):
            forces.weight[k] = settings.operator.weight[k] / velocity_map.lever[k]
            forces.local[k] += forces.weight[k]


@jit_compile
def _limit_total_force(
    tick: Tick, forces: ForceParts, fresh: bool, is_rendering: bool, out: Array
) -> int:
    """Add the parts and apply the limits of rendering and the gate; return its `GateFlags`."""
    settings, memory, dt = tick.settings, tick.memory, tick.input.dt
    total = np.zeros(MAX_JOINTS)
    for k in range(memory.axes):
        # the tips' force as the slave limits it, then of this device
        tip_force = feedback.clamp(settings.force.limit, forces.coupling[k])
        requested = settings.force_share[k] * tip_force + forces.local[k]
        slowed = feedback.limit_slew(settings.force.slew, memory.force[k], requested, dt)
        total[k] = feedback.clamp(settings.force.limit, slowed)
    verdict = gate.step(
        settings.gate,
        memory.force,
        total,
        memory.axes,
        fresh,
        is_rendering,
        dt,
        state_machine.is_force_fading(memory.session),
        forces.weight,
        out,
    )
    out[memory.axes :] = 0.0
    return verdict


@jit_compile
def _store_forces(
    settings: MasterSettings,
    memory: MasterMemory,
    velocity_map: VelocityMap,
    forces: ForceParts,
    gated: Array,
) -> None:
    """Store what left the gate, and which part of it the joints feel."""
    unshared = np.zeros(MAX_JOINTS)
    for k in range(MAX_JOINTS):
        memory.force[k], memory.local_force[k] = gated[k], forces.local[k]
        unshared[k] = forces.local[k] + (gated[k] - forces.local[k]) / settings.force_share[k]
    axis_map.store_joint_force(
        velocity_map,
        unshared,
        forces.local,
        forces.coupling,
        forces.joint,
        memory.axes,
        memory.joints,
        memory.joint_force,
    )


@jit_compile
def _write_torques(memory: MasterMemory, velocity_map: VelocityMap, out: Array) -> None:
    """Turn the forces at the levers of the axes that turn into torques [N m], in place."""
    for k in range(MAX_JOINTS):
        if k < memory.axes:
            out[k] *= velocity_map.lever[k]
        memory.written[k] = out[k]


@jit_compile
def compute_tip_forces(
    settings_records: StructArray, states: StructArray, has_state: bool, joints: int, out: Array
) -> None:
    """Write the admissible forces at the tips [N]; see `feedback.compute_tip_forces`."""
    bilateral = settings_records[0].bilateral
    feedback.compute_tip_forces(bilateral, states[0], has_state, joints, out)


@jit_compile
def _compute_wanted_forces(tick: Tick, out: Array) -> bool:
    """Write the wanted forces on the hand [N] to `out`; return whether all are finite."""
    settings, joints = tick.settings, tick.memory.joints
    feedback.compute_tip_forces(settings.bilateral, tick.state, tick.input.has_state, joints, out)
    for k in range(joints):
        out[k] = feedback.reflect_force(settings.force.scale, out[k])
    return is_all_finite(out, joints)


@jit_compile
def _take_requests(tick: Tick) -> None:
    """Fill in what the session is asked in this tick, by the operator, others and the link."""
    inputs, hand, tick_input = tick.memory.inputs, tick.hand, tick.input
    inputs.usable = hand.present
    inputs.clutch = hand.clutch
    inputs.reset = tick_input.reset
    inputs.stop = tick_input.stop
    if tick_input.stop == Reason.NONE and hand.stop:
        inputs.stop = Reason.EMERGENCY_STOP
    inputs.link, inputs.link_holds = tick_input.link, tick_input.link_holds
    inputs.follow_s = state_machine.FOLLOW_LIMIT_S + tick.settings.delay_max


@jit_compile
def _step_session(tick: Tick, is_finite: bool, dt: float) -> None:
    """Step the session with hand and peer; `is_finite` refers to the wanted forces."""
    memory, hand, state, tick_input = tick.memory, tick.hand, tick.state, tick.input
    inputs = memory.inputs
    inputs.peer_fresh = is_fresh(tick.settings, tick_input, state)
    inputs.peer_state = State.OFF
    inputs.peer = 0
    if tick_input.has_state:
        inputs.peer_state = state_machine.to_known_state(state.state)
        inputs.peer = state.sender
    is_degraded = tick_input.has_state and state.force_reduction != 0.0
    inputs.degraded = Reason.CALIBRATION_DUE if is_degraded else Reason.NONE
    inputs.engage = hand.present and is_engage_pressed(memory.session, hand, memory.presence)
    inputs.fault = tick_input.fault
    if tick_input.fault == Reason.NONE and not is_plausible(memory.session, hand, is_finite):
        inputs.fault = Reason.NOT_FINITE
    inputs.not_ready_reason = find_not_ready_reason(tick)
    state_machine.step(memory.session, inputs, dt)


@jit_compile
def _receive_state(tick: Tick, wanted_forces: Array) -> None:
    """Process energy, waves and tips of the newest state, which asks for `wanted_forces` [N]."""
    settings, memory, state = tick.settings, tick.memory, tick.state
    if not tick.input.has_state:
        return
    energy: Any = state.energy
    wave: Any = state.wave
    coupling.receive_totals(memory.coupling, state.sender, energy, wave)
    position: Any = state.position
    axes = min(memory.joints, state.joints)
    valid_forces = np.full(MAX_JOINTS, np.nan)
    for k in range(axes):
        if feedback.is_valid(state, k):
            valid_forces[k] = wanted_forces[k]
    coupling_adapter.observe_tips(
        settings.bilateral, memory.coupling, settings.force.scale, position, valid_forces, axes
    )


@jit_compile
def _fill_command(tick: Tick, out: Command) -> None:
    """Fill in a command except for its head and the tip motion."""
    settings, memory = tick.settings, tick.memory
    fields: Any = out
    fields.state = memory.session.state
    fields.reason = memory.session.reason
    fields.echo_stamp_ns = tick.state.stamp_ns if tick.input.has_state else 0
    fields.stops = memory.session.stops
    fields.coupling = settings.bilateral.signature
    fields.force_max = feedback.compute_saturation(settings.force)
    for k in range(MAX_JOINTS):
        fields.energy[k] = memory.coupling.ports[k].passed_on
        fields.wave[k] = memory.coupling.ports[k].sent_wave


@jit_compile
def _record_answer(memory: MasterMemory, tick_input: TickInput, state: SlaveState) -> None:
    """Record the command that is answered for the first time."""
    memory.newly_answered_ns = 0
    # our clock may have been set back
    memory.answered_command_ns = min(memory.answered_command_ns, tick_input.now_ns)
    if (
        tick_input.has_state
        and memory.answered_command_ns < state.echo_stamp_ns <= tick_input.now_ns
    ):
        memory.newly_answered_ns = state.echo_stamp_ns
        memory.answered_command_ns = state.echo_stamp_ns


@jit_compile
def _has_weight_compensation(session: Session) -> bool:
    """Return whether weight compensation is on in this state of the session."""
    return session.state in (State.READY, State.CLUTCHED, State.HOLDING, State.ENGAGED)


@jit_compile
def is_fresh(settings: MasterSettings, tick_input: TickInput, state: SlaveState) -> bool:
    """Return whether `state` exists and is fresh.

    Its age detects a silent slave and, with the age of its sample, a silent rig. The age of the
    command it answers detects a slave that no longer receives, and the round-trip delay, which no
    single clock shows.
    """
    if not tick_input.has_state:
        return False
    # as floats: sums of message fields may exceed 64 bits
    state_age_ns = float(tick_input.state_age_ns) + max(float(state.sample_age_ns), 0.0)
    command_age_ns = float(tick_input.now_ns - state.echo_stamp_ns)
    return (
        state_age_ns <= settings.state_timeout * 1e9
        and 0.0 <= command_age_ns <= settings.delay_max * 1e9
    )


@jit_compile
def is_engage_pressed(session: Session, hand: HandInput, presence: Presence) -> bool:
    """Return whether the engage switch counts as pressed.

    Not while no hand is detected; but a fault is cleared only when the real switch is released.
    """
    if session.state in (State.FAULT, State.HOLDING, State.STOPPED):
        return hand.engage or hand.clutch or hand.stop
    return hand.engage and not presence.is_away


@jit_compile
def find_not_ready_reason(tick: Tick) -> int:
    """Return why this side must not engage, `Reason.NONE` if it may."""
    settings, state, has_state = tick.settings, tick.state, tick.input.has_state
    if has_state and coupling.has_settings_mismatch(settings.bilateral, state.coupling):
        return Reason.COUPLING_DIFFERS
    if tick.memory.presence.is_away:
        return Reason.HAND_AWAY
    return operator.find_not_ready_reason(
        settings.operator, tick.memory.operator, tick.mapped_hand, state, has_state
    )


@jit_compile
def is_plausible(session: Session, hand: HandInput, finite: bool) -> bool:
    """Return whether the hand's motion is plausible and a rendered force is `finite`."""
    for k in range(hand.axes):
        if not abs(hand.position[k]) < MOTION_MAX or not abs(hand.velocity[k]) < MOTION_MAX:
            return False
    return finite or not state_machine.may_render(session)


@jit_compile
def fill_hand_message(
    memories: StructArray,
    hands: StructArray,
    state_age_ns: int,
    round_trip_ns: int,
    messages: StructArray,
) -> None:
    """Fill in a `Hand` message after a tick, except for its head; all of shape (1,)."""
    memory, hand, fields = memories[0], hands[0], messages[0]
    fields.state = memory.session.state
    fields.reason = memory.session.reason
    fields.joints = memory.axes
    fields.round_trip_ns = round_trip_ns
    fields.state_age_ns = state_age_ns
    for k in range(MAX_JOINTS):
        fields.position[k] = hand.position[k]
        fields.velocity[k] = hand.velocity[k]
        fields.force[k] = memory.written[k]
