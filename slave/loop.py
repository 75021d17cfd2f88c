"""One tick of the slave as a compiled function: from a command to a state and motor positions.

It uses no clock, link or rig; the process around it has those. `run_tick` updates its memory in
place; keep a copy to undo a tick.

The steps: process samples, check faults and readiness, advance the session, compute motor targets,
apply the gate, fill the state message. The calibration monitor is not time-critical:
`monitor_calibration` runs after the state was sent.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online import online
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.small_arrays import copy_values
from estimator.structs import StructArray, as_bytes, to_struct_array, view_struct
from slave import control, fault_detection, gate, initial_position
from slave.adaptation import TendonAdapter, build_adapter, mute_monitors
from slave.arm_estimate import ArmEstimator, build_arm_estimator
from slave.calibration import degraded_mode, monitor, probing
from slave.calibration.monitor import Advice
from slave.config import SlaveConfig
from slave.control.joint_estimate import JointEstimates
from slave.loop_records import (
    NO_POSITION,
    NO_SAMPLE,
    NOT_CALIBRATED,
    USABLE,
    EstimatedSample,
    Scratch,
    SlaveMemory,
    SlaveSettings,
    TickInput,
)
from slave.rig import RigSample
from slave.rig_layout import EstimatedTendon, RigLayout, build_rig_layout
from slave.samples import estimate, fill_sample
from teleop import coupling
from teleop.config.arm import ArmConfig
from teleop.config.ranges import MOTION_MAX
from teleop.coupling import Bilateral
from teleop.coupling.config import BilateralSettings
from teleop.coupling.force_attenuation import attenuate_forces
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS, Command, SlaveState
from teleop.session import state_machine
from teleop.session.state_machine import Reason, State

DIRECT = Bilateral()

OVERLOAD_RATIO = 1.2  # times the gate's tension limit; noise and stretch exceed the limit itself
OVERLOAD_S = 0.020  # [s] the peak of a collision is shorter


class RigModel(NamedTuple):
    """The rig's layout and models."""

    joints: tuple[tuple[int, ...], ...]  # `Rig.joints`
    models: tuple[online.TendonModel, ...]  # of each tendon
    layout: StructArray  # RigLayout, shape (1,)
    prepared: StructArray  # for the estimators, shape (tendons,)
    monitor_constants: StructArray  # for the monitor of their calibration, shape (tendons,)
    arms: tuple[ArmConfig, ...] = ()  # whose joints share tendons
    not_ready_text: str = ""  # why it must not be engaged, e.g. no calibration fits


class SlaveRecords(NamedTuple):
    """The records of a tick, each of shape (1,) except for the tendons' estimators."""

    settings: StructArray
    layout: StructArray
    prepared: StructArray
    estimators: StructArray
    memory: StructArray
    scratch: StructArray
    monitor_constants: StructArray
    with_dynamics: bool | None  # True, or None where no model has dynamic effects: see `compiled`
    arm: ArmEstimator | None  # None where no joints share tendons
    adapter: TendonAdapter | None  # None where K stays as calibrated

    @property
    def estimate_arguments(self) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
        """First arguments of `estimate`."""
        estimators = self.prepared, self.estimators, self.memory
        return self.layout, *estimators, self.with_dynamics, self.arm, self.adapter

    @property
    def monitor_arguments(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """First arguments of `monitor_calibration`."""
        own = self.settings, self.layout, self.monitor_constants, self.memory
        return *own, self.prepared, self.adapter

    @property
    def restorable_arrays(self) -> tuple[Any, ...]:
        """The arrays that ticks and samples change; of the memory all before its monitors."""
        fields: Any = SlaveMemory.dtype.fields
        memory = as_bytes(self.memory)[: fields["monitors"][1]]
        arm = () if self.arm is None else (self.arm.memory, self.arm.pairs)
        adapted = () if self.adapter is None else (self.prepared, *self.adapter[1:3])
        return memory, self.estimators, *arm, *adapted

    @property
    def tick_arguments(self) -> tuple[StructArray, StructArray, StructArray, StructArray]:
        """First arguments of `run_tick`."""
        return self.settings, self.layout, self.memory, self.scratch


class Tick(NamedTuple):
    """The records of a tick that its steps share."""

    settings: SlaveSettings
    layout: RigLayout
    memory: SlaveMemory
    scratch: Scratch
    command: Command
    input: TickInput


def build_rig_model(
    joints: Sequence[Sequence[int]],
    models: Sequence[online.TendonModel],
    not_ready_text: str = "",
    arms: Sequence[ArmConfig] = (),
) -> RigModel:
    """Return the `RigModel` of a rig with these tendon models, shared by the joints of `arms`."""
    return RigModel(
        tuple(tuple(joint) for joint in joints),
        tuple(models),
        build_rig_layout(joints, arms),
        online.prepare_all(models),
        monitor.build_monitor_constants(models),
        tuple(arms),
        not_ready_text,
    )


def build_settings(
    config: SlaveConfig, bilateral: Bilateral, calibrated: bool = True
) -> StructArray:
    """Return the `SlaveSettings` of a config and a coupling, shape (1,)."""
    records = SlaveSettings.array()
    for name in ("control", "fault_detection", "gate", "monitor", "probing"):
        records[name] = to_struct_array(getattr(config, name))
    records["bilateral"] = coupling.to_bilateral_settings(bilateral)
    records["sample_timeout"] = config.sample_timeout
    records["is_actuated"], records["calibrated"] = config.is_actuated, calibrated
    records["degrades"] = config.monitor.on_demand == "degrade"
    return records


def init_slave(
    model: RigModel,
    config: SlaveConfig,
    bilateral: Bilateral,
    starts_at_zero: bool,
    samples: Sequence[RigSample] = (),
    motor: Sequence[float] = (),
) -> SlaveRecords:
    """Return a slave in its initial state; for `starts_at_zero` see `Rig`.

    `samples` are all earlier samples of the rig, oldest first; they initialise the tension profiles
    of the estimators. `motor` [m] are the positions that were written last, if any: the first tick
    goes on writing them.
    """
    memory = SlaveMemory.array()
    tendons = len(model.models)
    initial_position.init_position(view_struct(memory).initial_position, tendons, starts_at_zero)
    memory["detector"] = fault_detection.init_detector(model.models)
    settings = build_settings(config, bilateral, calibrated=not model.not_ready_text)
    settings["probed"][0, :tendons] = probing.build_probe_constants(model.models, config.probing)
    slave = SlaveRecords(
        settings,
        model.layout,
        model.prepared.copy(),  # the adaptation changes them
        online.build_initial_states(model.prepared),
        memory,
        Scratch.array(),
        model.monitor_constants,
        True if model.prepared["has_dynamics"].any() else None,
        build_arm_estimator(model.joints, model.arms),
        build_adapter(config.adaptation, model.joints, model.models),
    )
    row = EstimatedSample.array()
    for sample in samples:
        fill_sample(row, 0, sample)
        estimate(*slave.estimate_arguments, row, 1)
        track_initial_position(*map(view_struct, (slave.layout, memory, slave.scratch, row)))
    if motor:
        memory["gated_position"][0, :tendons] = motor
        memory["has_gated_position"] = True
    return slave


@jit_compile
def run_tick(
    settings_records: StructArray,
    layouts: StructArray,
    memories: StructArray,
    scratches: StructArray,
    rows: StructArray,
    sample_count: int,
    tick_input: TickInput,
    commands: StructArray,
    states: StructArray,
) -> int:
    """Advance the slave by one tick; return the bits of `GateFlags`.

    Before the first engagement nothing is written to the motors, unless a calibration has written
    before. From then on a position is written at every tick: the last gated one, unless a new one
    is commanded.

    Parameters
    ----------
    settings_records, layouts, memories, scratches : Records
        Of a `SlaveRecords`; the memory is updated.
    rows : Records
        `EstimatedSample` after `estimate`; the first `sample_count` are new, oldest first.
    commands : Records
        `Command`, the newest, shape (1,); ignored unless `tick_input.has_command`.
    states : Records
        `SlaveState`, shape (1,), filled in except for the head.
    """
    engaged = begin_tick(
        settings_records, layouts, memories, scratches, rows, sample_count, tick_input, commands
    )
    return end_tick(
        settings_records, layouts, memories, scratches, tick_input, commands, states, engaged
    )


@jit_compile
def begin_tick(
    settings_records: StructArray,
    layouts: StructArray,
    memories: StructArray,
    scratches: StructArray,
    rows: StructArray,
    sample_count: int,
    tick_input: TickInput,
    commands: StructArray,
) -> bool:
    """Run `run_tick` up to the motion of the tips; return whether they shall move."""
    layout, memory = layouts[0], memories[0]
    tick = Tick(settings_records[0], layout, memory, scratches[0], commands[0], tick_input)
    fault, faulty_tendon = _process_samples(tick, rows, sample_count)
    _update_faults(tick, rows, sample_count, fault, faulty_tendon)
    _update_readiness(tick)
    degraded_mode.advance_ramp(memory.degradation, tick_input.dt)
    commanded = _copy_command(tick)
    _advance_session(tick)
    engaged = state_machine.may_move(memory.session) and commanded
    if memory.has_sample:
        _estimate_joints(layout, memory)
    _apply_coupling(tick, commanded, engaged)
    return engaged


@jit_compile
def end_tick(
    settings_records: StructArray,
    layouts: StructArray,
    memories: StructArray,
    scratches: StructArray,
    tick_input: TickInput,
    commands: StructArray,
    states: StructArray,
    engaged: bool,
) -> int:
    """Run the rest of `run_tick`: motors, gate, state."""
    memory = memories[0]
    tick = Tick(settings_records[0], layouts[0], memory, scratches[0], commands[0], tick_input)
    verdict = gate.HELD
    if memory.has_sample and (memory.has_gated_position or engaged):
        verdict = _command_motors(tick, engaged)
        memory.has_gated_position = True
    _fill_state(tick, states[0])
    return verdict


@jit_compile
def _process_samples(tick: Tick, rows: StructArray, sample_count: int) -> tuple[int, int]:
    """Process the samples; return the newest fault Reason and its tendon."""
    settings, layout, memory = tick.settings, tick.layout, tick.memory
    fault: int = Reason.NONE
    faulty_tendon = -1
    initial_position.increase_age(memory.initial_position, tick.input.dt)
    for i in range(sample_count):
        row = rows[i]
        reason, tendon = fault_detection.step(
            settings.fault_detection, layout, memory.detector, row.tendons, row.elapsed
        )
        if reason != Reason.NONE:
            fault, faulty_tendon = reason, tendon
        track_initial_position(layout, memory, tick.scratch, row)
        if settings.is_actuated and memory.has_gated_position:
            fault_detection.record_motor_readings(
                memory.motors, layout, row.tendons, memory.gated_position
            )
    return fault, faulty_tendon


@jit_compile
def track_initial_position(
    layout: RigLayout, memory: SlaveMemory, scratch: Scratch, row: EstimatedSample
) -> None:
    """Update the initial motor positions with a sample."""
    for i in range(layout.tendons):
        scratch.displacement[i] = row.tendons[i].displacement
    initial_position.process_sample(
        memory.initial_position, layout.tendons, scratch.displacement, row.has_displacement
    )


@jit_compile
def _update_faults(
    tick: Tick, rows: StructArray, sample_count: int, fault: int, faulty_tendon: int
) -> None:
    """Update the fault conditions: motors, missing samples, tension over its limit."""
    settings, layout, memory, dt = tick.settings, tick.layout, tick.memory, tick.input.dt
    if settings.is_actuated:
        motor_fault, faulty_motor = fault_detection.check_motors(
            settings.fault_detection,
            memory.motors,
            layout,
            memory.gated_position,
            memory.has_gated_position,
            sample_count > 0,
            dt,
        )
        if fault == Reason.NONE:
            fault, faulty_tendon = motor_fault, faulty_motor
    if sample_count > 0:
        memory.detected_fault, memory.faulty_tendon = fault, faulty_tendon
    has_valid_sample = False
    for i in range(sample_count):
        has_valid_sample = has_valid_sample or _are_all_valid(layout, rows[i].tendons)
    is_renewed = has_valid_sample and not memory.motors.repeated
    memory.sample_age = 0.0 if is_renewed else memory.sample_age + dt
    is_overloaded = state_machine.may_move(memory.session) and _is_overloaded(tick)
    memory.overload = memory.overload + dt if is_overloaded else 0.0


@jit_compile
def _are_all_valid(layout: RigLayout, tendons: Sequence[EstimatedTendon]) -> bool:
    """Return whether the estimators accepted the sample of every tendon."""
    for i in range(layout.tendons):  # noqa: SIM110 - compiled
        if not tendons[i].valid:
            return False
    return True


@jit_compile
def _is_overloaded(tick: Tick) -> bool:
    """Return whether a tension exceeds its limit although the gate stops the pull."""
    if not tick.memory.has_sample:
        return False
    limit = OVERLOAD_RATIO * tick.settings.gate.tension_max
    for i in range(tick.layout.tendons):
        tendon = tick.memory.tendons[i]
        if tendon.tension > limit or tendon.corrected_tension > limit:
            return True
    return False


@jit_compile
def _update_readiness(tick: Tick) -> None:
    """Update the motor positions and whether the rig is usable.

    Motors that do not follow yet, as they are being enabled, are where their encoders say.
    """
    memory, scratch = tick.memory, tick.scratch
    is_measured = initial_position.is_known(memory.initial_position, tick.settings.sample_timeout)
    if memory.has_gated_position and (tick.input.motors_follow or not is_measured):
        copy_values(memory.gated_position[:], scratch.motor_position[:])
    elif is_measured:
        copy_values(memory.initial_position.position[:], scratch.motor_position[:])
    is_position_known = memory.has_gated_position or is_measured
    if not memory.has_sample:
        memory.readiness = NO_SAMPLE
    elif not tick.settings.calibrated:
        memory.readiness = NOT_CALIBRATED
    else:
        memory.readiness = USABLE if is_position_known else NO_POSITION


@jit_compile
def _copy_command(tick: Tick) -> bool:
    """Copy the commanded joint motion; return whether motion is commanded."""
    scratch, command, tick_input = tick.scratch, tick.command, tick.input
    scratch.requested[:] = 0.0
    scratch.tip_velocity[:] = 0.0
    is_commanded = tick_input.has_command and tick_input.fresh and command.state == State.ENGAGED
    if is_commanded:
        for k in range(tick.layout.joints):
            scratch.requested[k] = command.position[k]
            scratch.tip_velocity[k] = command.velocity[k]
    return is_commanded


@jit_compile
def _advance_session(tick: Tick) -> None:
    """Advance the session by one tick, from the master's state and the faults of this side."""
    memory, command, tick_input = tick.memory, tick.command, tick.input
    inputs = tick.scratch.inputs
    inputs.peer_fresh = tick_input.fresh
    inputs.peer_state = State.OFF
    inputs.peer = 0
    inputs.not_ready_reason = Reason.NONE
    if tick_input.has_command:
        inputs.peer_state = state_machine.to_known_state(command.state)
        inputs.peer = command.sender
        if coupling.has_settings_mismatch(tick.settings.bilateral, command.coupling):
            inputs.not_ready_reason = Reason.COUPLING_DIFFERS
    inputs.engage = state_machine.is_switch_closed(inputs.peer_state)
    inputs.clutch = inputs.peer_state == State.CLUTCHED
    inputs.usable = memory.readiness == USABLE
    inputs.fault = tick_input.fault
    if tick_input.fault == Reason.NONE:
        inputs.fault = _find_local_fault(tick)
    inputs.stop = tick_input.stop
    inputs.reset = tick_input.reset
    inputs.link, inputs.link_holds = tick_input.link, tick_input.link_holds
    is_degraded = memory.degradation.ramp > 0.0
    inputs.degraded = Reason.CALIBRATION_DUE if is_degraded else Reason.NONE
    state_machine.step(memory.session, inputs, tick_input.dt)


@jit_compile
def _find_local_fault(tick: Tick) -> int:
    """Return the Reason of a fault on this side."""
    settings, memory, scratch = tick.settings, tick.memory, tick.scratch
    if memory.has_sample and memory.sample_age > settings.sample_timeout:
        return Reason.SAMPLES_FROZEN if memory.motors.repeated else Reason.SAMPLES_STALE
    if memory.overload > OVERLOAD_S:
        return Reason.OVER_LIMIT
    if memory.detected_fault != Reason.NONE:
        return memory.detected_fault
    if memory.advice == Advice.DEMANDED and not settings.degrades:
        return Reason.CALIBRATION_DUE
    for k in range(tick.layout.joints):
        if not (
            abs(scratch.requested[k]) < MOTION_MAX and abs(scratch.tip_velocity[k]) < MOTION_MAX
        ):
            return Reason.NOT_FINITE
    return Reason.NONE


@jit_compile
def _apply_coupling(tick: Tick, commanded: bool, engaged: bool) -> None:
    """Replace the commanded tip motion in `scratch` by what the bilateral coupling makes of it."""
    if not tick.input.has_command:
        return
    settings, layout, memory = tick.settings, tick.layout, tick.memory
    scratch, command = tick.scratch, tick.command
    energy: Any = command.energy
    wave: Any = command.wave
    coupling.receive_totals(memory.coupling, command.sender, energy, wave)
    if engaged:
        _compute_port_forces(settings, layout, memory, command, scratch.force)
    coupling.compute_tip_motion(
        settings.bilateral,
        memory.coupling,
        scratch.requested,
        scratch.tip_velocity,
        scratch.force,
        layout.joints if commanded else 0,
        engaged,
        tick.input.dt,
        degraded_mode.compute_speed_max(settings.monitor, memory.degradation),
    )


@jit_compile
def _estimate_joints(layout: RigLayout, memory: SlaveMemory) -> None:
    """Estimate the joints from the newest sample."""
    control.estimate_joints(layout, memory.tendons, memory.offsets, memory.arm_force, memory.joints)
    degraded_mode.widen_intervals(layout, memory.degradation, memory.tendons, memory.joints)


@jit_compile
def compute_port_forces(
    settings_records: StructArray,
    layouts: StructArray,
    memories: StructArray,
    scratches: StructArray,
    commands: StructArray,
) -> None:
    """Write the forces of the newest sample at the slave's port to `scratch.force`."""
    settings, layout, memory = settings_records[0], layouts[0], memories[0]
    _estimate_joints(layout, memory)
    _compute_port_forces(settings, layout, memory, commands[0], scratches[0].force)


@jit_compile
def _compute_port_forces(
    settings: SlaveSettings, layout: RigLayout, memory: SlaveMemory, command: Command, out: Array
) -> None:
    reduction = degraded_mode.compute_force_reduction(settings.monitor, memory.degradation)
    compute_rendered_forces(
        settings.bilateral, memory.joints, layout.joints, command.force_max, out, reduction
    )


@jit_compile
def compute_rendered_forces(
    bilateral: BilateralSettings,
    joint_estimates: JointEstimates,
    joints: int,
    force_max: float,
    out_forces: Array,
    reduction: float = 0.0,
) -> None:
    """Write the forces as rendered to the hand, at the slave's port; the master computes the same.

    Parameters
    ----------
    joint_estimates : JointEstimates, shape (joints,) or longer
        Of the `joints` of the rig.
    force_max : float
        Largest rendered force [N]; sent by the master, may be any number.
    out_forces : array, shape (joints,) or longer
        [N], at most `force_max`; zero for joints whose estimate is invalid or not finite.
    reduction : float
        `SlaveState.force_reduction`.
    """
    force_max = force_max if force_max > 0.0 else 0.0
    estimates = np.zeros((4, MAX_JOINTS))
    for k in range(joints):
        estimate = joint_estimates[k]
        if math.isfinite(estimate.force) and not estimate.status & INVALID_INPUT:
            estimates[0, k], estimates[3, k] = estimate.force, estimate.margin
            estimates[1, k], estimates[2, k] = estimate.low, estimate.high
        else:
            estimates[1:, k] = math.nan  # of an arm, no joint is then rendered
    attenuate_forces(bilateral.confidence, bilateral.arm, estimates, joints, reduction, out_forces)
    for k in range(joints):
        out_forces[k] = min(max(out_forces[k], -force_max), force_max)


@jit_compile
def _command_motors(tick: Tick, engaged: bool) -> int:
    """Compute the motor targets and apply the gate; hold unless `engaged`, or probing."""
    settings, layout, memory, scratch = tick.settings, tick.layout, tick.memory, tick.scratch
    moving = engaged and tick.input.motors_follow
    _compute_motor_targets(tick, moving)
    if settings.probing.enabled:
        is_probing = _probe_sheaths(tick)
        moving = moving or is_probing
    if moving:
        gate.compute_reaches(settings.gate, layout, memory.joints, memory.reach)
    _copy_largest_tensions(layout, memory, scratch)
    return gate.step(
        settings.gate,
        layout.tendons,
        scratch.motor_position,
        scratch.motor_target,
        scratch.tension,
        memory.sample_age,
        moving,
        tick.input.dt,
        memory.reach,
        moving,
        state_machine.may_yield(memory.session),
        memory.gated_position,
    )


@jit_compile
def _compute_motor_targets(tick: Tick, moving: bool) -> None:
    """Write the targets [m] of the controller, or of that of an extension."""
    memory, scratch = tick.memory, tick.scratch
    if scratch.has_extension_target:
        copy_values(scratch.extension_target[:], scratch.motor_target[:])
        return
    control.step(
        tick.settings.control,
        tick.layout,
        memory.control,
        scratch.requested,
        scratch.tip_velocity,
        scratch.motor_position,
        memory.tendons,
        moving,
        tick.input.dt,
        scratch.motor_target,
    )


@jit_compile
def _probe_sheaths(tick: Tick) -> bool:
    """Replace the target of a tendon that is probed; return whether there is one."""
    settings, layout, memory, scratch = tick.settings, tick.layout, tick.memory, tick.scratch
    dt = tick.input.dt
    probing.track_pulls(settings.probed, layout, memory.probe, memory.tendons, dt)
    may_probe = state_machine.may_probe(memory.session) and tick.input.motors_follow
    return probing.step(
        settings.probing,
        settings.probed,
        layout,
        memory.probe,
        memory.tendons,
        scratch.requested,
        scratch.motor_position,
        may_probe and not scratch.has_extension_target,
        dt,
        scratch.motor_target,
    )


@jit_compile
def _copy_largest_tensions(layout: RigLayout, memory: SlaveMemory, scratch: Scratch) -> None:
    """Copy the larger of read and corrected tensions [N], NaN of invalid samples, for the gate."""
    for i in range(layout.tendons):
        tendon = memory.tendons[i]
        scratch.tension[i] = math.nan
        if tendon.valid:
            scratch.tension[i] = max(tendon.tension, tendon.corrected_tension)


@jit_compile
def _fill_state(tick: Tick, out: SlaveState) -> None:
    """Fill the state message, except for its head."""
    settings, memory = tick.settings, tick.memory
    state: Any = out
    state.answer_ns = 0  # filled in by the sender
    state.state, state.reason = memory.session.state, memory.session.reason
    state.stops = memory.session.stops
    state.echo_stamp_ns = tick.command.stamp_ns if tick.input.has_command else 0
    state.coupling = settings.bilateral.signature
    state.probing = memory.probe.tendon + 1
    state.force_reduction = degraded_mode.compute_force_reduction(
        settings.monitor, memory.degradation
    )
    state.joints = tick.layout.joints if memory.has_sample else 0
    state.sample_age_ns = round(memory.sample_age * 1e9) if memory.has_sample else 0
    for k in range(MAX_JOINTS):
        port = memory.coupling.ports[k]
        state.energy[k], state.wave[k] = port.passed_on, port.sent_wave
        is_joint = k < state.joints
        joint = memory.joints[k]
        state.position[k] = joint.position if is_joint else 0.0
        state.force[k] = joint.force if is_joint else 0.0
        state.force_low[k] = joint.low if is_joint else 0.0
        state.force_high[k] = joint.high if is_joint else 0.0
        state.force_margin[k] = joint.margin if is_joint else 0.0
        state.status[k] = joint.status if is_joint else 0


@jit_compile
def monitor_calibration(
    settings_records: StructArray,
    layouts: StructArray,
    monitor_constants: StructArray,
    memories: StructArray,
    prepared: StructArray,
    adapter: TendonAdapter | None,
    rows: StructArray,
    sample_count: int,
) -> None:
    """Update the calibration monitor with the samples of a tick."""
    settings, layout, memory = settings_records[0], layouts[0], memories[0]
    constants: Any = monitor_constants
    if settings.probing.enabled:
        probing.transfer_probe_result(
            settings.monitor, settings.probed, memory.probe, memory.monitors
        )
    degradation, decided = memory.degradation, np.zeros(MAX_TENDONS, np.bool_)
    if adapter is not None:
        mute_monitors(adapter, layout, prepared, memory.monitors, degradation.active, decided)
    for i in range(sample_count):
        memory.advice = monitor.step_rig(
            settings.monitor, layout, constants, memory.monitors, rows[i].tendons, rows[i].elapsed
        )
    if settings.degrades:
        degraded_mode.update_degradation(
            settings.monitor, degradation, memory.monitors, memory.advice, decided[: layout.tendons]
        )
