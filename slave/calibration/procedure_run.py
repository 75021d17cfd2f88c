"""Run the initialisation on a rig: joint after joint, or all at once.

Joints that share tendons are done in stages (`slave.calibration.posture`), and the others follow.
Every position written has passed `slave.gate`, with the limits of the slave's config. At the end,
unless the rig failed, the tensions are low and the motors hold.
"""

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import count, islice
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.structs import to_struct
from slave import gate, initial_position
from slave.calibration import procedure, procedure_state
from slave.calibration.config import InitialiseConfig, compute_compliance_limit
from slave.calibration.posture import HOLD_RATIO, JointTravels, Stage, plan_stages
from slave.calibration.procedure_log import ProcedureData, ProcedureLog
from slave.calibration.procedure_state import (
    JointConstants,
    JointReadings,
    Phase,
    ProcedureState,
    StopContact,
    format_tendon_name,
)
from slave.gate import GateConfig, GateFlags
from slave.initial_position import InitialPosition
from slave.rig import Rig, RigFault, RigFinished, RigSample, has_following_motors
from teleop.errors import TeleopError, UsageError
from teleop.runtime.clock import Tick, pause_garbage_collection

WARM_UP_HZ, WARM_UP_TICKS = 500.0, 20
COMPLIANCE_SHARE = 0.3  # of the largest compliance: a first guess
SILENCE_MAX_S = 0.5  # [s] without a usable sample
NO_READINGS_TEXT = (
    "no tension and travel of every tendon for 0.5 s: check that every tendon has a load cell "
    "and an encoder"
)


class CalibrationRefused(TeleopError):
    """A joint could not be calibrated; exit code 1, the message gives reason and remedy."""


class CalibrationInterrupted(CalibrationRefused):
    """The operator ended the procedure."""

    exit_code = 128 + signal.SIGINT


class ProcedureLimits(NamedTuple):
    """Limits of the procedure and of the gate."""

    initialise: InitialiseConfig
    gate: GateConfig


class ProcedureProgress(NamedTuple):
    """Progress of the procedure."""

    time_s: float  # [s] since it began
    joint: int  # from 1
    phase: Phase
    side: int  # the tendon that is pulled
    done: float  # fraction of the whole, 0 to 1
    tension: tuple[float, ...]  # [N] of the joint's tendons

    def format_tendon(self, rig: Rig) -> str:
        """Return the name of the tendon that is pulled."""
        count = len(rig.joints[self.joint - 1])
        return format_tendon_name(self.joint, count, self.side % count)


class ProcedureResult(NamedTuple):
    """Result of a completed procedure."""

    record: ProcedureData
    samples: tuple[RigSample, ...]  # all of them, to initialise the estimators' tension profiles
    motor: tuple[float, ...]  # [m] written last, shape (tendons,): the motors hold there


def run_procedure(
    rig: Rig,
    limits: ProcedureLimits,
    ticks: Iterable[Tick],
    start_ns: int,
    joints: Sequence[int],
    together: bool = False,
    stopped: Callable[[], str] = lambda: "",
    progress: Callable[[ProcedureProgress], None] = lambda _: None,
    ratio: Array | None = None,
) -> ProcedureResult:
    """Run the procedure on some joints of a rig; return the measurements.

    A `slave.rig.WatchedRig` is told at the end that a pause follows: the analysis takes seconds.

    `CalibrationRefused` if the procedure was aborted, the tensions are then low; `TeleopError` if
    the rig failed.

    Parameters
    ----------
    rig : Rig
        Open; nothing else may read or write it.
    limits : ProcedureLimits
        Of the procedure, and of the gate before the motors.
    ticks : iterable of Tick
        Endless: a `teleop.runtime.clock.Grid` that never stops for a real rig, else
        `generate_fast_ticks`.
    start_ns : int
        Stamp [ns] from which the rig's session time counts.
    joints : sequence of int
        Which joints, counted from 0.
    together : bool
        Whether to move them all at once; else the others hold while one moves.
    stopped : callable
        Called at every tick; a non-empty reason ends the procedure and lowers the tensions.
    progress : callable
        Called at every tick. An `OSError` of it, of a terminal that is gone, ends the procedure as
        `stopped` does.
    ratio : array, shape (joints, joints), optional
        Travel of the tendons of joint k over that of joint j, of joints that share tendons.
    """
    validate_limits(rig, limits)
    drive = _ProcedureRun(rig, limits, joints, together, ratio)
    began_ns, unseen = None, ""
    with pause_garbage_collection():  # a collection takes 0.1 to 0.6 s; drivers wait 0.2 s
        for tick in ticks:
            began_ns = tick.stamp_ns if began_ns is None else began_ns
            drive.tick((tick.stamp_ns - start_ns) * 1e-9, tick.dt, stopped() or unseen)
            if drive.newest is not None and not unseen:
                try:
                    progress(drive.compute_progress((tick.stamp_ns - began_ns) * 1e-9))
                except OSError as error:
                    unseen = f"the progress cannot be printed ({error.strerror}): stopped"
            if drive.over:
                break
        drive.announce_pause()
    return drive.build_result()


class _ProcedureRun:
    """A rig while the procedure runs."""

    def __init__(
        self,
        rig: Rig,
        limits: ProcedureLimits,
        joints: Sequence[int],
        together: bool,
        ratio: Array | None = None,
    ) -> None:
        self.newest: RigSample | None = None
        self.over = False
        self._rig, self._limits, self._joints = rig, limits, joints
        ratio = np.eye(len(rig.joints)) if ratio is None else ratio
        stages = plan_stages(ratio, rig.joints, joints, limits.initialise.drags, together)
        self._joint_constants = [
            JointConstants(
                j,
                tuple(compute_compliance_limit(limits.initialise, k) for k in tendons),
                is_staged=stages[0].phase is not None,
            )
            for j, tendons in enumerate(rig.joints, 1)
        ]
        self._memories = [ProcedureState() for _ in rig.joints]
        self._verdicts = [GateFlags.PASSED for _ in rig.joints]
        self._stages, self._stage = stages, 0
        compliance = [
            COMPLIANCE_SHARE * compute_compliance_limit(limits.initialise, k)
            for k in range(rig.tendons)
        ]
        self._travels = JointTravels(ratio, rig.joints, compliance)
        self._log = ProcedureLog()
        self._position = InitialPosition.new()
        initial_position.init_position(self._position, rig.tendons, rig.starts_at_zero)
        self._motor: tuple[float, ...] = ()
        self._motors_follow = False  # as of the last read
        self._gate = to_struct(limits.gate)
        self._stops: list[tuple[StopContact, ...]] = [()] * len(rig.joints)
        self._is_begun = False  # this stage
        self._silence = 0.0
        self._interrupted = False

    def tick(self, time_s: float, dt: float, order: str) -> None:
        """Read, step every joint of the current group, and write; a non-empty `order` ends it."""
        self._read(time_s, dt)
        self._interrupted = self._interrupted or bool(order)
        if self._silence > SILENCE_MAX_S:
            order = order or NO_READINGS_TEXT
        is_located = self.newest is not None and bool(self._motor)
        if not (is_located and self._motors_follow):
            if order:
                raise self._build_refusal(order)
            if is_located:
                self._write(self._motor, dt)  # enables the motors where they are
            return
        group = self._select_joints(order)
        wanted = list(self._motor)
        for k, move in self._follow(dt).items():
            wanted[k] += move
        for j in group:
            order = order or next((m.refusal for m in self._memories if m.refusal), "")
            for k, target in zip(self._rig.joints[j], self._step(j, order, dt), strict=True):
                wanted[k] = target
        self._write(wanted, dt)
        if all(procedure_state.is_ended(self._memories[j]) for j in group):
            self._end_stage()

    def announce_pause(self) -> None:
        """Tell a `slave.rig.WatchedRig` that its loop pauses."""
        try:
            announce_pause = getattr(self._rig, "announce_pause", None)
            if announce_pause is not None:
                announce_pause()
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error

    def compute_progress(self, time_s: float) -> ProcedureProgress:
        """Return the progress `time_s` [s] after the start."""
        finished = [
            procedure_state.compute_progress(self._limits.initialise, m) for m in self._memories
        ]
        stage = self._stages[min(self._stage, len(self._stages) - 1)]
        j = min(stage.joints, key=lambda j: finished[j])
        memory = self._memories[j]
        share = sum(finished[i] for i in self._joints) / len(self._joints)
        if stage.phase is not None:
            share = self._stage / len(self._stages)
        return ProcedureProgress(time_s, j + 1, memory.phase, memory.side, share, memory.tension)

    def build_result(self) -> ProcedureResult:
        """Return the measurements, or raise the reason of the abort."""
        refusal = next((m.refusal for m in self._memories if m.refusal), "")
        if refusal:
            raise self._build_refusal(refusal)
        return ProcedureResult(
            self._log.record(self._rig.joints, self._stops, self._travels),
            tuple(self._log.samples),
            self._motor,
        )

    def _build_refusal(self, reason: str) -> CalibrationRefused:
        return (CalibrationInterrupted if self._interrupted else CalibrationRefused)(reason)

    def _read(self, time_s: float, dt: float) -> None:
        try:
            samples = self._rig.read(time_s)
            self._motors_follow = has_following_motors(self._rig)
        except RigFinished as error:
            raise CalibrationRefused("replayed data: there is no rig to calibrate") from error
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error
        useful = [sample for sample in samples if is_complete(sample)]
        self._log.add(useful, self._memories, self._stage, self._travels.travel)
        self._locate(samples, dt)
        self._silence = 0.0 if useful else self._silence + dt
        self.newest = useful[-1] if useful else self.newest

    def _locate(self, samples: Sequence[RigSample], dt: float) -> None:
        """Determine the motor positions, until the motors follow what is written."""
        if self._motor and self._motors_follow:
            return
        tendons = self._rig.tendons
        initial_position.increase_age(self._position, dt)
        for sample in samples:
            travel = sample.proximal_displacement
            if travel is not None:
                initial_position.process_sample(
                    self._position, tendons, np.array(travel, np.float64), True
                )
        if initial_position.is_known(self._position, SILENCE_MAX_S):
            self._motor = tuple(self._position.position[:tendons].tolist())

    def _select_joints(self, order: str) -> tuple[int, ...]:
        """Return the joints to step: those of the stage, which begins if it has not, or all."""
        stage = self._stages[self._stage]
        if stage.phase is None:
            return stage.joints
        if order or any(memory.refusal for memory in self._memories):
            return tuple(range(len(self._memories)))  # those that are held, too, let go
        if not self._is_begun:
            self._is_begun = True
            for j in stage.joints if stage.phase is not Phase.TAKE_UP else ():
                self._memories[j] = self._begin_stage(j, stage)
        return stage.joints

    def _begin_stage(self, j: int, stage: Stage) -> ProcedureState:
        assert stage.phase is not None  # noqa: S101 - asked by the caller
        memory = self._memories[j]
        if stage.phase is not Phase.SETTLE:
            moves = stage.phase in (Phase.MOVE, Phase.DRAG)
            memory = memory._replace(
                side=stage.side,
                lane=self._travels.compute_lane(stage) if moves else 0.0,
                hold=HOLD_RATIO * self._limits.initialise.tension if abs(stage.target) == 1 else 0,
                easing=False,
            )
        return procedure_state.begin_phase(memory, stage.phase, self._get_readings(j))

    def _end_stage(self) -> None:
        """Go on to the next stage, if there is one and no joint was refused."""
        stage, self._is_begun = self._stages[self._stage], False
        (j, *others), memories = stage.joints, self._memories
        self._stage += 1
        self.over = self._stage == len(self._stages) or any(m.refusal for m in memories)
        if any(m.refusal for m in memories):
            return
        if stage.phase is Phase.TAKE_UP:
            self._travels.set_home(memories, self._get_travel())
        elif stage.phase is Phase.SEEK:
            self._travels.stops[j, 1 - stage.side] = self._travels.travel[j]
            contact = memories[j].stops[stage.side]
            shift = self._travels.get_passing_travel(self._travels.travel)
            moved = contact.travel - float(shift[self._rig.joints[j][stage.side]])
            self._stops[j] = (*self._stops[j], contact._replace(travel=moved))
        elif stage.phase is None:
            for k in (j, *others):
                self._stops[k] = memories[k].stops

    def _follow(self, dt: float) -> dict[int, float]:
        """Return by how much [m] the motors of tendons go that pass the joint of this stage."""
        stage = self._stages[self._stage]
        if stage.phase is None or len(stage.joints) > 1 or any(m.refusal for m in self._memories):
            return {}
        (j,), config, travel = stage.joints, self._limits.initialise, self._get_travel()
        assert self.newest is not None  # noqa: S101 - asked by the caller
        self._travels.update(config, j, self._memories[j], travel)
        if self._is_begun and stage.phase is Phase.MOVE:
            left = self._travels.compute_lane(stage)
            self._memories[j] = self._memories[j]._replace(lane=left)
        return self._travels.follow(config, j, self.newest.proximal_tension, dt)

    def _get_travel(self) -> Array:
        assert self.newest is not None and self.newest.proximal_displacement is not None  # noqa: S101, PT018 - `is_complete`
        return self.newest.proximal_displacement

    def _get_readings(self, j: int) -> JointReadings:
        assert self.newest is not None  # noqa: S101 - asked by the caller
        tendons = list(self._rig.joints[j])
        return JointReadings(
            tuple(self.newest.proximal_tension[tendons].tolist()),
            tuple(self._get_travel()[tendons].tolist()),
            tuple(self._motor[k] for k in tendons),
            self._verdicts[j],
            self._silence == 0.0,
        )

    def _step(self, j: int, order: str, dt: float) -> tuple[float, ...]:
        """Step one joint; return its motor targets [m]."""
        readings = self._get_readings(j)
        previous = self._memories[j]
        if order and not previous.refusal:
            previous = procedure_state.abort_procedure(previous, readings, order)
        targets, self._memories[j] = procedure.step(
            self._limits.initialise, self._joint_constants[j], previous, readings, dt
        )
        return targets

    def _write(self, target: Sequence[float], dt: float) -> None:
        """Pass the targets through the gate and write them."""
        assert self.newest is not None  # noqa: S101 - asked by the caller
        tension = self.newest.proximal_tension
        motor = np.array(self._motor)
        for j, joint in enumerate(self._rig.joints):
            k = list(joint)
            wanted, pulled = np.array([target[i] for i in k]), tension[k].astype(np.float64)
            motor[k], self._verdicts[j] = gate.limit_targets(
                self._gate, motor[k], wanted, pulled, self._silence, dt
            )
        self._motor = tuple(motor.tolist())
        try:
            self._rig.write(motor)
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error


class StationaryRig:
    """A joint of one tendon at rest, on which nothing moves."""

    name = "still"
    tendons = 1
    joints: tuple[tuple[int, ...], ...] = ((0,),)
    starts_at_zero = True

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return one sample."""
        return (RigSample(time_s, np.ones(1), np.zeros(1)),)

    def write(self, proximal_displacement: Array) -> None:
        """Do nothing."""

    def advance(self) -> None:
        """Do nothing."""

    def summarise(self) -> dict[str, int | float | str]:
        """Return nothing."""
        return {}

    def close(self) -> None:
        """Do nothing."""


def warm_up() -> None:
    """Compile what a tick of the procedure calls, before it has to be on time."""
    driven = _ProcedureRun(
        StationaryRig(), ProcedureLimits(InitialiseConfig(), GateConfig()), (0,), together=False
    )
    for tick in islice(generate_fast_ticks(WARM_UP_HZ), WARM_UP_TICKS):
        driven.tick(tick.stamp_ns * 1e-9, tick.dt, "")


def generate_fast_ticks(rate_hz: float) -> Iterator[Tick]:
    """Yield ticks of a simulated rig's own time, as fast as they are consumed."""
    dt = 1.0 / rate_hz
    return (Tick(k, round(k * dt * 1e9), dt) for k in count())


def is_complete(sample: RigSample) -> bool:
    """Return whether the sample has finite tension and travel of every tendon."""
    travel = sample.proximal_displacement
    return travel is not None and bool(
        np.isfinite(sample.proximal_tension).all() and np.isfinite(travel).all()
    )


def validate_limits(rig: Rig, limits: ProcedureLimits) -> None:
    """Raise `UsageError` if the procedure cannot run with this config."""
    config, gate_limits = limits.initialise, limits.gate
    if len(config.sheaths) not in (0, 1, rig.tendons):
        raise UsageError(
            f"slave.initialise.sheaths: {len(config.sheaths)} sheaths, but the rig has "
            f"{rig.tendons} tendons"
        )
    if isinstance(config.range, tuple) and len(config.range) != len(rig.joints):
        raise UsageError(
            f"slave.initialise.range: {len(config.range)} entries, but the rig has "
            f"{len(rig.joints)} joints"
        )
    for name, limit_name, unit in (
        ("tension", "tension_max", "N"),
        ("seek_speed", "speed_max", "m/s"),
    ):
        value, limit = getattr(config, name), getattr(gate_limits, limit_name)
        if value > limit:
            raise UsageError(
                f"slave.initialise.{name}: {value:g} {unit} is over slave.gate.{limit_name} "
                f"({limit:g} {unit})"
            )
