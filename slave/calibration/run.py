"""Run the initialisation on a rig: joint after joint, or all at once.

Every position written has passed `slave.gate`, with the limits of the slave's config. At the end,
unless the rig failed, the tensions are low and the motors hold.
"""

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count, islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.records import to_struct
from slave import gate, initial_position
from slave.calibration import procedure, procedure_state
from slave.calibration.config import InitialiseConfig, compute_compliance_limit
from slave.calibration.procedure_state import (
    JointConstants,
    JointReadings,
    Phase,
    ProcedureState,
    StopContact,
)
from slave.gate import GateConfig, GateFlags
from slave.initial_position import InitialPosition
from slave.rig import Rig, RigFault, RigFinished, RigSample, has_following_motors
from teleop.errors import TeleopError, UsageError
from teleop.runtime.clock import Tick, pause_garbage_collection

Codes = NDArray[np.int64]

WARM_UP_HZ, WARM_UP_TICKS = 500.0, 20
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


@dataclass(frozen=True)
class ProcedureData:
    """Measurements and phases of a procedure: n samples, t tendons, j joints.

    A joint that was not calibrated has no stops.
    """

    joints: tuple[tuple[int, ...], ...]  # the tendons of each
    time: Array  # [s] shape (n,), on the rig's clock
    tension: Array  # [N] shape (n, t)
    travel: Array  # [m] shape (n, t)
    phase: Codes  # shape (n, j)
    side: Codes  # shape (n, j): which tendon of the joint was pulled, 2 and 3 in drags
    releases: Codes  # shape (n, j): ended on that side
    stops: tuple[tuple[StopContact, ...], ...]  # of each joint, one a tendon


class ProcedureResult(NamedTuple):
    """Result of a completed procedure."""

    record: ProcedureData
    samples: tuple[RigSample, ...]  # all of them, to initialise the estimators' tension profiles
    motor: tuple[float, ...]  # [m] written last, shape (tendons,): the motors hold there


@dataclass
class _ProcedureLog:
    """Samples with the state of each joint's procedure."""

    samples: list[RigSample] = field(default_factory=list)
    codes: list[tuple[tuple[int, int, int], ...]] = field(default_factory=list)

    def add(self, samples: Sequence[RigSample], memories: Sequence[ProcedureState]) -> None:
        """Append the samples of a tick."""
        now = tuple((int(m.phase), m.side, m.releases) for m in memories)
        self.samples += samples
        self.codes += [now] * len(samples)

    def record(
        self, joints: tuple[tuple[int, ...], ...], memories: Sequence[ProcedureState]
    ) -> ProcedureData:
        """Return the log as arrays."""
        codes = np.array(self.codes, dtype=np.int64)
        return ProcedureData(
            joints=joints,
            time=np.array([s.time_s for s in self.samples]),
            tension=np.array([s.proximal_tension for s in self.samples]),
            travel=np.array([s.proximal_displacement for s in self.samples]),
            phase=codes[:, :, 0],
            side=codes[:, :, 1],
            releases=codes[:, :, 2],
            stops=tuple(memory.stops for memory in memories),
        )


def run_procedure(
    rig: Rig,
    limits: ProcedureLimits,
    ticks: Iterable[Tick],
    start_ns: int,
    joints: Sequence[int],
    together: bool = False,
    stopped: Callable[[], str] = lambda: "",
    progress: Callable[[ProcedureProgress], None] = lambda _: None,
) -> ProcedureResult:
    """Run the procedure on some joints of a rig; return the measurements.

    A `slave.rig.WatchedRig` is told at the end that a pause follows: the analysis takes seconds.

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

    Raises
    ------
    CalibrationRefused
        If the procedure was aborted; the tensions are low.
    TeleopError
        If the rig failed.
    """
    validate_limits(rig, limits)
    drive = _ProcedureRun(rig, limits, joints, together)
    began_ns, unseen = None, ""
    with pause_garbage_collection():  # a collection takes 0.1 to 0.6 s; drivers wait 0.2 s
        for tick in ticks:
            began_ns = tick.stamp_ns if began_ns is None else began_ns
            drive.tick((tick.stamp_ns - start_ns) * 1e-9, tick.dt, stopped() or unseen)
            if drive.newest is not None and not unseen:
                try:
                    progress(drive.progress((tick.stamp_ns - began_ns) * 1e-9))
                except OSError as error:
                    unseen = f"the progress cannot be printed ({error.strerror}): stopped"
            if drive.over:
                break
        drive.announce_pause()
    return drive.result()


class _ProcedureRun:
    """A rig while the procedure runs."""

    def __init__(
        self, rig: Rig, limits: ProcedureLimits, joints: Sequence[int], together: bool
    ) -> None:
        self.newest: RigSample | None = None
        self.over = False
        self._rig, self._limits, self._joints = rig, limits, joints
        self._joint_constants = [
            JointConstants(
                j, tuple(compute_compliance_limit(limits.initialise, k) for k in tendons)
            )
            for j, tendons in enumerate(rig.joints, 1)
        ]
        self._memories = [ProcedureState() for _ in rig.joints]
        self._verdicts = [GateFlags.PASSED for _ in rig.joints]
        self._groups = [tuple(joints)] if together else [(j,) for j in joints]
        self._log = _ProcedureLog()
        self._position = InitialPosition.new()
        initial_position.init_position(self._position, rig.tendons, rig.starts_at_zero)
        self._motor: tuple[float, ...] = ()
        self._motors_follow = False  # as of the last read
        self._gate = to_struct(limits.gate)
        self._no_reach = gate.Reach.array(0)  # the range of the joints is not known yet
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
                raise (
                    CalibrationInterrupted(order)
                    if self._interrupted
                    else CalibrationRefused(order)
                )
            if is_located:
                self._write(self._motor, dt)  # enables the motors where they are
            return
        group = self._groups[0]
        wanted = list(self._motor)
        for j in group:
            order = order or next((m.refusal for m in self._memories if m.refusal), "")
            for k, target in zip(self._rig.joints[j], self._step(j, order, dt), strict=True):
                wanted[k] = target
        self._write(wanted, dt)
        if all(procedure_state.is_ended(self._memories[j]) for j in group):
            del self._groups[0]
            self.over = not self._groups or any(m.refusal for m in self._memories)

    def announce_pause(self) -> None:
        """Tell a `slave.rig.WatchedRig` that its loop pauses."""
        try:
            announce_pause = getattr(self._rig, "announce_pause", None)
            if announce_pause is not None:
                announce_pause()
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error

    def progress(self, time_s: float) -> ProcedureProgress:
        """Return the progress `time_s` [s] after the start."""
        finished = [
            procedure_state.compute_progress(self._limits.initialise, m) for m in self._memories
        ]
        group = self._groups[0] if self._groups else self._joints[-1:]
        j = min(group, key=lambda j: finished[j])
        memory = self._memories[j]
        share = sum(finished[i] for i in self._joints) / len(self._joints)
        return ProcedureProgress(time_s, j + 1, memory.phase, memory.side, share, memory.tension)

    def result(self) -> ProcedureResult:
        """Return the measurements, or raise the reason of the abort."""
        refusal = next((m.refusal for m in self._memories if m.refusal), "")
        if refusal:
            raise (
                CalibrationInterrupted(refusal)
                if self._interrupted
                else CalibrationRefused(refusal)
            )
        return ProcedureResult(
            self._log.record(self._rig.joints, self._memories),
            tuple(self._log.samples),
            self._motor,
        )

    def _read(self, time_s: float, dt: float) -> None:
        try:
            samples = self._rig.read(time_s)
            self._motors_follow = has_following_motors(self._rig)
        except RigFinished as error:
            raise CalibrationRefused("replayed data: there is no rig to calibrate") from error
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error
        useful = [sample for sample in samples if is_complete(sample)]
        self._log.add(useful, self._memories)
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

    def _step(self, j: int, order: str, dt: float) -> tuple[float, ...]:
        """Step one joint; return its motor targets [m]."""
        assert self.newest is not None and self.newest.proximal_displacement is not None  # noqa: S101, PT018 - `is_complete`
        tendons = list(self._rig.joints[j])
        readings = JointReadings(
            tuple(self.newest.proximal_tension[tendons].tolist()),
            tuple(self.newest.proximal_displacement[tendons].tolist()),
            tuple(self._motor[k] for k in tendons),
            self._verdicts[j],
            self._silence == 0.0,
        )
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
            motor[k], self._verdicts[j] = self._gated(
                motor[k], np.array([target[i] for i in k]), tension[k].astype(np.float64), dt
            )
        self._motor = tuple(motor.tolist())
        try:
            self._rig.write(motor)
        except RigFault as error:
            raise TeleopError(f"rig: {error}") from error

    def _gated(
        self, last: Array, target: Array, tension: Array, dt: float
    ) -> tuple[Array, GateFlags]:
        """Return the output of the gate for a joint [m], and its flags."""
        passed = np.empty_like(last)
        verdict = gate.step(
            self._gate, len(last), last, target, tension, self._silence, True, dt,
            self._no_reach, False, False, passed,
        )  # fmt: skip
        return passed, GateFlags(verdict)


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

    def summary(self) -> dict[str, int | float | str]:
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
    if config.tension > gate_limits.tension_max:
        raise UsageError(
            f"slave.initialise.tension: {config.tension:g} N is over slave.gate.tension_max "
            f"({gate_limits.tension_max:g} N)"
        )
    if config.seek_speed > gate_limits.speed_max:
        raise UsageError(
            f"slave.initialise.seek_speed: {config.seek_speed:g} m/s is over "
            f"slave.gate.speed_max ({gate_limits.speed_max:g} m/s)"
        )
