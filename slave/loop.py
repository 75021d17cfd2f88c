"""One tick of the slave, as one compiled function: from a command to a state and motor positions.

No clock, no link, no rig: the process around it has those, and tests have none. `tick` changes the
memory that it is given, in place; whoever wants to take a tick back keeps a copy.

The order is that of the reader: take the samples, update what is known, advance the session, work
out where the motors shall go, let the gate decide, say so. What nobody waits for, the monitor of
the calibration, is `monitor_calibration`, called when the answer is out.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.arrays import copy
from estimator.compiled import compiled
from estimator.online import online
from estimator.online.tendon_estimate import INVALID_INPUT
from estimator.records import F64, I64, Field, Flag, Record, Records, as_records, one, record_dtype
from slave import control, coupling_adapter, fault_detection, gate, initial_position
from slave.calibration import monitor
from slave.calibration.monitor import Advice
from slave.config import SlaveConfig
from slave.control.joint import JointEstimate
from slave.rig import RigSample
from slave.tendons import EstimatedTendon, RigLayout, rig_layout
from teleop import coupling, session
from teleop.coupling import Bilateral, Side
from teleop.messages import MAX_JOINTS, MAX_TENDONS, Command, SlaveState
from teleop.session import Reason, Session, State

DIRECT = Bilateral()

OVERLOAD = 1.2  # times the gate's tension limit; noise and stretch reach over the limit itself
OVERLOAD_S = 0.020  # [s] a collision's peak passes sooner
_ABSURD = 1e3  # [m], [m/s] no tip goes there or as fast; NaN is not below it either

# SlaveMemory.not_ready: why the rig is not usable
USABLE, NO_SAMPLE, NOT_CALIBRATED, NO_POSITION = range(4)
NOT_READY_TEXT = (
    "",
    "the rig has given no sample yet",
    "the rig has no calibration that fits it",
    "no encoder reading tells where the motors stand, and the rig does not start at zero",
)


class SlaveSettings(Record):
    """What the config says, as far as a tick needs it."""

    control: Annotated[control.ControlConfig, Field(record_dtype(control.ControlConfig))]
    fault_detection: Annotated[
        fault_detection.FaultDetectionConfig,
        Field(record_dtype(fault_detection.FaultDetectionConfig)),
    ]
    gate: Annotated[gate.GateConfig, Field(record_dtype(gate.GateConfig))]
    monitor: Annotated[monitor.MonitorConfig, Field(record_dtype(monitor.MonitorConfig))]
    bilateral: coupling.BilateralSettings
    sample_timeout: F64 = 0.1  # [s]
    rig_obeys: Flag = True  # the motors go where they are sent
    calibrated: Flag = True  # there is a calibration that fits the rig


class EstimatedSample(Record):
    """One sample of the rig and what is estimated from it."""

    time_s: F64 = 0.0  # [s] on the rig's clock
    elapsed: F64 = 0.0  # [s] since the sample before
    has_displacement: Flag = False  # whether the rig has encoders
    tendons: Annotated[Sequence[EstimatedTendon], Field(EstimatedTendon, MAX_TENDONS)]
    bench_tension: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [N] at the tip
    bench_displacement: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [m]


class SlaveMemory(Record):
    """All that the slave remembers from one tick to the next, but for the tendons' estimators."""

    session: Session
    initial_position: initial_position.InitialPosition
    detector: fault_detection.FaultDetector
    motors: fault_detection.MotorChecks
    control: control.Control
    coupling: Side
    tendons: Annotated[Sequence[EstimatedTendon], Field(EstimatedTendon, MAX_TENDONS)]  # newest
    monitors: Annotated[Sequence[monitor.TendonMonitor], Field(monitor.TendonMonitor, MAX_TENDONS)]
    joints: Annotated[Sequence[JointEstimate], Field(JointEstimate, MAX_JOINTS)]
    reach: Annotated[Sequence[gate.Reach], Field(gate.Reach, MAX_TENDONS)]
    offsets: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] of each joint's tendons
    motor: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] what the gate last let through
    has_sample: Flag = False
    has_offsets: Flag = False
    has_motor: Flag = False  # engaged at least once
    sample_time: F64 = 0.0  # [s] of the newest sample
    silence: F64 = 0.0  # [s] since the last sample that was new and could be used
    overload: F64 = 0.0  # [s] for which a tension has been far over its limit, engaged
    found: I64 = Reason.NONE  # Reason that the fault detection gave last
    found_tendon: I64 = -1
    advice: I64 = Advice.NONE
    not_ready: I64 = NO_SAMPLE


class Scratch(Record):
    """Arrays that a tick works with; nothing in them outlasts it."""

    inputs: session.Inputs
    requested: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] of the joints
    speed: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m/s]
    force: Annotated[Array, Field("f8", MAX_JOINTS)]  # [N] as the hand feels it
    displacement: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] of the motors in a sample
    tension: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] that limits go by
    motor: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] where the motors are
    wanted: Annotated[Array, Field("f8", MAX_TENDONS)]  # [m] where they shall go


class TickInput(NamedTuple):
    """What a tick is told besides samples and command."""

    dt: float  # [s] since the last tick
    has_command: bool  # whether a command ever came
    fresh: bool  # whether the newest is young enough to be obeyed
    fault: int = int(Reason.NONE)  # Reason: what is wrong on this side, as far as the caller knows
    stop: int = int(Reason.NONE)  # Reason for which another process wants everything to stop
    reset: bool = False  # whether a stop is taken back


class RigModel(NamedTuple):
    """What is known of the rig before the first tick."""

    joints: tuple[tuple[int, ...], ...]  # `Rig.joints`
    models: tuple[online.TendonModel, ...]  # of each tendon
    layout: Records  # RigLayout, shape (1,)
    prepared: Records  # for the estimators, shape (tendons,)
    watched: Records  # for the monitor of their calibration, shape (tendons,)
    not_ready_text: str = ""  # why it must not be engaged: no calibration that fits it


class Slave(NamedTuple):
    """The records that a tick works on, each of shape (1,) but for the tendons' estimators."""

    settings: Records
    layout: Records
    prepared: Records
    estimators: Records
    memory: Records
    scratch: Records
    watched: Records
    estimate: Callable[..., None]  # `estimate`, or what models with effects need

    @property
    def estimated(self) -> tuple[Records, Records, Records, Records]:
        """What `estimate` takes first."""
        return self.layout, self.prepared, self.estimators, self.memory

    @property
    def ticked(self) -> tuple[Records, Records, Records, Records]:
        """What `tick` takes first."""
        return self.settings, self.layout, self.memory, self.scratch


def rig_model(
    joints: Sequence[Sequence[int]],
    models: Sequence[online.TendonModel],
    not_ready_text: str = "",
) -> RigModel:
    """Return what is known of a rig whose tendons have these models."""
    return RigModel(
        tuple(tuple(joint) for joint in joints),
        tuple(models),
        rig_layout(joints),
        online.prepare_all(models),
        monitor.prepare(models),
        not_ready_text,
    )


def settings(config: SlaveConfig, bilateral: Bilateral, calibrated: bool = True) -> Records:
    """Return what a tick needs of the config and of what both sides agreed on, shape (1,)."""
    records = SlaveSettings.array()
    for name in ("control", "fault_detection", "gate", "monitor"):
        records[name] = as_records(getattr(config, name))
    records["bilateral"] = coupling.bilateral_settings(bilateral)
    records["sample_timeout"] = config.sample_timeout
    records["rig_obeys"], records["calibrated"] = config.rig_obeys, calibrated
    return records


def start(
    model: RigModel,
    config: SlaveConfig,
    bilateral: Bilateral,
    starts_at_zero: bool,
    samples: Sequence[RigSample] = (),
) -> Slave:
    """Return a slave that has just started; see `Rig.starts_at_zero`.

    `samples` of the rig, oldest first, are all that it measured before: the tensions along the
    tendons are then known from the start.
    """
    memory = SlaveMemory.array()
    tendons = len(model.models)
    initial_position.start(one(memory).initial_position, tendons, starts_at_zero)
    memory["detector"] = fault_detection.start(model.models)
    slave = Slave(
        settings(config, bilateral, calibrated=not model.not_ready_text),
        model.layout,
        model.prepared,
        online.initial_all(model.prepared),
        memory,
        Scratch.array(),
        model.watched,
        estimate_with_dynamics if model.prepared["has_dynamics"].any() else estimate,
    )
    row = EstimatedSample.array()
    for sample in samples:
        fill_sample(row, 0, sample)
        slave.estimate(*slave.estimated, row, 1)
        locate(slave.layout, memory, slave.scratch, row)
    return slave


def fill_sample(rows: Records, index: int, sample: RigSample) -> None:
    """Put a sample of the rig into one of the rows that `tick` takes.

    Numbers that are missing in an array that is too short are NaN, which the estimator refuses.
    """
    travel = sample.proximal_displacement
    tip_tension, tip_travel = sample.bench_distal_tension, sample.bench_distal_displacement
    _fill_row(
        rows,
        index,
        float(sample.time_s),
        travel is not None,
        np.array(sample.proximal_tension, np.float64, order="C"),
        _MISSING if travel is None else np.array(travel, np.float64, order="C"),
        _MISSING if tip_tension is None else np.array(tip_tension, np.float64, order="C"),
        _MISSING if tip_travel is None else np.array(tip_travel, np.float64, order="C"),
    )


# Copies of one kind, whatever a rig gives: for each other kind of array numba would compile anew,
# in the middle of a session.
_MISSING = np.full(MAX_TENDONS, math.nan)


@compiled
def _fill_row(
    rows: Records,
    index: int,
    time_s: float,
    has_displacement: bool,
    tension: Array,
    displacement: Array,
    bench_tension: Array,
    bench_displacement: Array,
) -> None:
    row = rows[index]
    row.time_s, row.has_displacement = time_s, has_displacement
    for i in range(MAX_TENDONS):
        row.tendons[i].tension = _entry(tension, i)
        row.tendons[i].displacement = _entry(displacement, i)
        row.bench_tension[i] = _entry(bench_tension, i)
        row.bench_displacement[i] = _entry(bench_displacement, i)


@compiled
def _entry(values: Array, i: int) -> float:
    """Return an entry, NaN beyond the end, where compiled code would read any memory."""
    return values[i] if i < len(values) else math.nan


def sample_rows(samples: Sequence[RigSample]) -> Records:
    """Return these samples as the rows that `tick` takes, shape (samples,); see `fill_sample`."""
    rows = EstimatedSample.array(len(samples))
    for k, sample in enumerate(samples):
        fill_sample(rows, k, sample)
    return rows


@compiled
def tick(
    settings_records: Records,
    layouts: Records,
    memories: Records,
    scratches: Records,
    rows: Records,
    samples: int,
    tick_input: TickInput,
    commands: Records,
    states: Records,
) -> int:
    """Advance the slave by one tick; return the gate's verdict bits.

    Until it engages for the first time nothing is asked of the motors. From then on they are asked
    to be somewhere at every tick: where the gate let them go last, unless they are commanded on.

    Parameters
    ----------
    settings_records, layouts, memories, scratches : Records
        Of a `Slave`; its memory is changed.
    rows : Records
        `EstimatedSample`, the first `samples` of which are new, oldest first, after `estimate`.
    tick_input : TickInput
        What else is told.
    commands : Records
        `Command`, the newest, shape (1,); not looked at unless `tick_input.has_command`.
    states : Records
        `SlaveState`, shape (1,), filled in but for the head.
    """
    setting, layout, memory = settings_records[0], layouts[0], memories[0]
    work, command = scratches[0], commands[0]
    found, tendon = _take_samples(setting, layout, memory, work, rows, samples, tick_input.dt)
    _update_faults(setting, layout, memory, rows, samples, found, tendon, tick_input.dt)
    _update_readiness(setting, memory, work)
    commanded = _take_command(layout, work, command, tick_input)
    _advance_session(setting, layout, memory, work, command, tick_input)
    engaged = session.may_move(memory.session) and commanded
    if memory.has_sample:
        control.joint_estimates(layout, memory.tendons, memory.offsets, memory.joints)
    _couple(setting, layout, memory, work, command, tick_input, commanded, engaged)
    verdict = gate.HELD
    if memory.has_sample and (memory.has_motor or engaged):
        verdict = _drive(setting, layout, memory, work, engaged, tick_input.dt)
        memory.has_motor = True
    _fill_state(setting, layout, memory, command, tick_input, states[0])
    return verdict


@compiled
def estimate(
    layouts: Records,
    prepared: Records,
    estimators: Records,
    memories: Records,
    rows: Records,
    samples: int,
) -> None:
    """Step each tendon's estimator with the first `samples` of `rows`; fill in their estimates."""
    layout, memory = layouts[0], memories[0]
    for s in range(samples):
        row = rows[s]
        _begin_sample(memory, row)
        for i in range(layout.tendons):
            tendon = row.tendons[i]
            tendon.corrected_tension, tendon.corrected_displacement = online.advance_law(
                prepared[i],
                estimators[i],
                tendon.tension,
                tendon.displacement,
                row.elapsed,
                tendon.estimate,
            )
        _end_sample(layout, memory, row)


@compiled
def estimate_with_dynamics(
    layouts: Records,
    prepared: Records,
    estimators: Records,
    memories: Records,
    rows: Records,
    samples: int,
) -> None:
    """Do what `estimate` does, for models with effects beside the law; takes longer to compile."""
    layout, memory = layouts[0], memories[0]
    for s in range(samples):
        row = rows[s]
        _begin_sample(memory, row)
        for i in range(layout.tendons):
            tendon = row.tendons[i]
            tendon.corrected_tension, tendon.corrected_displacement = online.advance(
                prepared[i],
                estimators[i],
                tendon.tension,
                tendon.displacement,
                row.elapsed,
                tendon.estimate,
            )
        _end_sample(layout, memory, row)


@compiled
def _begin_sample(memory: SlaveMemory, row: EstimatedSample) -> None:
    row.elapsed = row.time_s - memory.sample_time if memory.has_sample else 0.0
    memory.sample_time = row.time_s
    memory.has_sample = True


@compiled
def _end_sample(layout: RigLayout, memory: SlaveMemory, row: EstimatedSample) -> None:
    usable = True
    newest: Any = memory.tendons
    for i in range(layout.tendons):
        tendon = row.tendons[i]
        tendon.valid = tendon.estimate.status & INVALID_INPUT == 0
        usable = usable and tendon.valid
        newest[i] = tendon
    if usable and not memory.has_offsets:
        memory.has_offsets = control.joint_offsets(layout, row.tendons, memory.offsets)


@compiled
def locate(layouts: Records, memories: Records, scratches: Records, rows: Records) -> None:
    """Take in where the first of `rows`, measured before the first tick, has the motors."""
    _locate(layouts[0], memories[0], scratches[0], rows[0])


@compiled
def _take_samples(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    work: Scratch,
    rows: Records,
    samples: int,
    dt: float,
) -> tuple[int, int]:
    """Take the samples in; return the newest Reason that speaks of a fault, and its tendon."""
    found, tendon = Reason.NONE + 0, -1
    initial_position.age(memory.initial_position, dt)
    for i in range(samples):
        row = rows[i]
        reason, where = fault_detection.step(
            setting.fault_detection, layout, memory.detector, row.tendons, row.elapsed
        )
        if reason != Reason.NONE:
            found, tendon = reason, where
        _locate(layout, memory, work, row)
        if setting.rig_obeys and memory.has_motor:
            fault_detection.take_motor_readings(memory.motors, layout, row.tendons, memory.motor)
    return found, tendon


@compiled
def _locate(layout: RigLayout, memory: SlaveMemory, work: Scratch, row: EstimatedSample) -> None:
    """Take in where a sample has the motors."""
    for i in range(layout.tendons):
        work.displacement[i] = row.tendons[i].displacement
    initial_position.take(
        memory.initial_position, layout.tendons, work.displacement, row.has_displacement
    )


@compiled
def _update_faults(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    rows: Records,
    samples: int,
    found: int,
    tendon: int,
    dt: float,
) -> None:
    """Note what speaks of a fault: of the motors, of silence, of a tension over its limit."""
    if setting.rig_obeys:
        astray, motor = fault_detection.check_motors(
            setting.fault_detection,
            memory.motors,
            layout,
            memory.motor,
            memory.has_motor,
            samples > 0,
            dt,
        )
        if found == Reason.NONE:
            found, tendon = astray, motor
    if samples > 0:
        memory.found, memory.found_tendon = found, tendon
    usable = False
    for i in range(samples):
        usable = usable or _is_usable(layout, rows[i].tendons)
    has_new_sample = usable and not memory.motors.repeated
    memory.silence = 0.0 if has_new_sample else memory.silence + dt
    overloaded = session.may_move(memory.session) and _is_overloaded(setting, layout, memory)
    memory.overload = memory.overload + dt if overloaded else 0.0


@compiled
def _is_usable(layout: RigLayout, tendons: Sequence[EstimatedTendon]) -> bool:
    """Return whether every tendon's sample could be used by its estimator."""
    for i in range(layout.tendons):  # noqa: SIM110 - compiled
        if not tendons[i].valid:
            return False
    return True


@compiled
def _is_overloaded(setting: SlaveSettings, layout: RigLayout, memory: SlaveMemory) -> bool:
    """Return whether a tendon pulls so hard that refusing to pull further has not helped."""
    if not memory.has_sample:
        return False
    limit = OVERLOAD * setting.gate.tension_max
    for i in range(layout.tendons):
        tendon = memory.tendons[i]
        if tendon.tension > limit or tendon.corrected_tension > limit:
            return True
    return False


@compiled
def _update_readiness(setting: SlaveSettings, memory: SlaveMemory, work: Scratch) -> None:
    """Say where the motors are, and whether the rig is usable at all."""
    known = memory.has_motor or initial_position.known(
        memory.initial_position, setting.sample_timeout
    )
    if memory.has_motor:
        copy(memory.motor[:], work.motor[:])
    elif known:
        copy(memory.initial_position.position[:], work.motor[:])
    if not memory.has_sample:
        memory.not_ready = NO_SAMPLE
    elif not setting.calibrated:
        memory.not_ready = NOT_CALIBRATED
    else:
        memory.not_ready = USABLE if known else NO_POSITION


@compiled
def _take_command(
    layout: RigLayout, work: Scratch, command: Command, tick_input: TickInput
) -> bool:
    """Take over what is asked of the joints; return whether the tips are asked to follow."""
    work.requested[:] = 0.0
    work.speed[:] = 0.0
    commanded = tick_input.has_command and tick_input.fresh and command.state == State.ENGAGED
    if commanded:
        for k in range(layout.joints):
            work.requested[k] = command.position[k]
            work.speed[k] = command.velocity[k]
    return commanded


@compiled
def _advance_session(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    work: Scratch,
    command: Command,
    tick_input: TickInput,
) -> None:
    master = session.known_state(command.state) if tick_input.has_command else State.OFF + 0
    fault = tick_input.fault
    if fault == Reason.NONE:
        fault = _own_fault(setting, layout, memory, work)
    differs = tick_input.has_command and coupling.differs(setting.bilateral, command.coupling)
    inputs = work.inputs
    inputs.usable = memory.not_ready == USABLE
    inputs.peer_fresh = tick_input.fresh
    inputs.peer_state = master
    inputs.engage = session.switch_of(master)
    inputs.fault = fault
    inputs.clutch = master == State.CLUTCHED
    inputs.stop = tick_input.stop
    inputs.reset = tick_input.reset
    inputs.not_ready_reason = Reason.COUPLING_DIFFERS if differs else Reason.NONE
    inputs.peer = 0
    if tick_input.has_command:
        inputs.peer = command.sender
    session.step(memory.session, inputs, tick_input.dt)


@compiled
def _own_fault(
    setting: SlaveSettings, layout: RigLayout, memory: SlaveMemory, work: Scratch
) -> int:
    """Return what the slave itself finds wrong; nothing is asked of it unless it shall move."""
    if memory.has_sample and memory.silence > setting.sample_timeout:
        return Reason.SAMPLES_FROZEN + 0 if memory.motors.repeated else Reason.SAMPLES_STALE + 0
    if memory.overload > OVERLOAD_S:
        return Reason.OVER_LIMIT + 0
    if memory.found != Reason.NONE:
        return memory.found
    if memory.advice == Advice.DEMANDED:
        return Reason.CALIBRATION_DUE + 0
    for k in range(layout.joints):
        if not (abs(work.requested[k]) < _ABSURD and abs(work.speed[k]) < _ABSURD):
            return Reason.NOT_FINITE + 0
    return Reason.NONE + 0


@compiled
def _couple(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    work: Scratch,
    command: Command,
    tick_input: TickInput,
    commanded: bool,
    engaged: bool,
) -> None:
    """Put the coupling between what is asked of the tips and where they shall go."""
    if not tick_input.has_command:
        return
    energy: Any = command.energy
    wave: Any = command.wave
    coupling.receive(memory.coupling, command.sender, energy, wave)
    if engaged:
        coupling_adapter.rendered_forces(
            setting.bilateral.confidence,
            memory.joints,
            layout.joints,
            command.force_max,
            work.force,
        )
    coupling.at_tip(
        setting.bilateral,
        memory.coupling,
        work.requested,
        work.speed,
        work.force,
        layout.joints if commanded else 0,
        engaged,
        tick_input.dt,
    )


@compiled
def _drive(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    work: Scratch,
    engaged: bool,
    dt: float,
) -> int:
    """Work out where the motors shall go, and let the gate decide how far."""
    control.step(
        setting.control,
        layout,
        memory.control,
        work.requested,
        work.speed,
        work.motor,
        memory.tendons,
        engaged,
        dt,
        work.wanted,
    )
    for i in range(layout.tendons):
        tendon = memory.tendons[i]
        work.tension[i] = math.nan
        if tendon.valid:
            work.tension[i] = max(tendon.tension, tendon.corrected_tension)
    if engaged:
        gate.reaches(setting.gate, layout, memory.joints, memory.reach)
    return gate.step(
        setting.gate,
        layout.tendons,
        work.motor,
        work.wanted,
        work.tension,
        memory.silence,
        engaged,
        dt,
        memory.reach,
        engaged,
        session.may_yield(memory.session),
        memory.motor,
    )


@compiled
def _fill_state(
    setting: SlaveSettings,
    layout: RigLayout,
    memory: SlaveMemory,
    command: Command,
    tick_input: TickInput,
    out: SlaveState,
) -> None:
    """Say what the tick found: every field of the answer but its head."""
    state: Any = out
    state.answer_ns = 0  # of whoever sends it
    state.state, state.reason = memory.session.state, memory.session.reason
    state.stops = memory.session.stops
    state.echo_stamp_ns = command.stamp_ns if tick_input.has_command else 0
    state.coupling = setting.bilateral.signature
    state.joints = layout.joints if memory.has_sample else 0
    state.sample_age_ns = round(memory.silence * 1e9) if memory.has_sample else 0
    for k in range(MAX_JOINTS):
        port = memory.coupling.ports[k]
        state.energy[k], state.wave[k] = port.passed_on, port.sent_wave
        used = k < state.joints
        joint = memory.joints[k]
        state.position[k] = joint.position if used else 0.0
        state.force[k] = joint.force if used else 0.0
        state.force_low[k] = joint.low if used else 0.0
        state.force_high[k] = joint.high if used else 0.0
        state.status[k] = joint.status if used else 0


@compiled
def monitor_calibration(
    settings_records: Records,
    layouts: Records,
    watched: Records,
    memories: Records,
    rows: Records,
    samples: int,
) -> None:
    """Take note of whether the sheaths still have the shape they were calibrated in."""
    setting, layout, memory = settings_records[0], layouts[0], memories[0]
    constants: Any = watched
    for s in range(samples):
        memory.advice = monitor.step_rig(
            setting.monitor,
            layout,
            constants,
            memory.monitors,
            rows[s].tendons,
            rows[s].elapsed,
        )
