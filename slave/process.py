"""Run the robot's side: the rig, the estimator of each tendon, and the last gate before the motors.

  teleop slave --config configs/demo.yaml
  teleop slave --config configs/demo.yaml --duration 30 --json slave.json
  teleop slave --config rig.yaml --model diagnosis/model.yaml     with what a diagnosis found

Without a master the motors hold. Exception: with `slave.initialise.at_start` the rig calibrates
itself first and every motor moves, even without a master. When no command arrives for
`slave.command_timeout`, or after any other fault, the motors hold too, until the operator lets go
and engages again. At an emergency stop (`teleop stop`) they stop by their own means, or hold if the
rig has none; it must be reset before the operator engages again.
"""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import NamedTuple, cast

from estimator.array_types import Array
from estimator.structs import view_struct
from slave import live_settings, loop, model_files
from slave.adaptation import describe_fixed
from slave.calibration.calibration_file import apply_guide_friction
from slave.calibration.initialisation import initialise
from slave.config import (
    SlaveConfig,
    find_config_warnings,
    find_not_ready_reason,
    has_model_file,
    load_arms,
    load_tendon_configs,
)
from slave.extension_calls import SlaveExtensions
from slave.force_error import Score
from slave.gate import GateFlags
from slave.loop import RigModel
from slave.loop_records import EstimatedSample, SlaveMemory, TickInput
from slave.rig import Rig, RigFault, RigFinished, RigSample, as_enabling_rig, get_emergency_stop
from slave.rigs import open_rig
from slave.rigs.replayed_data import ReplayedRig
from slave.rigs.simulated import SimulatedRigConfig, format_late_effects
from slave.samples import estimate, fill_sample
from slave.state_messages import fill_tendon_state
from slave.telemetry import Telemetry, build_progress_printer
from slave.warm_up import compile_session
from teleop.config.arm import assemble_tendon_rows
from teleop.config.extension_calls import ExtensionFault
from teleop.config.options import add_option, add_options
from teleop.coupling import Bilateral
from teleop.errors import TeleopError, UsageError
from teleop.link import Link
from teleop.link.health import DEFAULT_BOUNDS, HealthConfig
from teleop.messages.messages import SlaveState, TendonState
from teleop.messages.packet import Packet
from teleop.messages.topics import COMMAND, STATE, TENDONS, Role
from teleop.remote.request_listener import RequestListener, Requests, call_stop
from teleop.runtime.clock import EventClock, Grid, Tick, now_ns
from teleop.runtime.process import StopCondition, wait_in_standby
from teleop.runtime.realtime import use_ordinary_scheduling
from teleop.session.config import RunConfig, SideConfig, read_config
from teleop.session.events import publish_event
from teleop.session.loop_process import LoopProcess, answer_requests, report_outcome, run_session
from teleop.session.slow_calls import SlowCallMonitor
from teleop.session.state_machine import DetailedReason, Reason, SessionOutline, State
from teleop.session.summary import ForceError, LoopSummary, RigSummary
from teleop.session.tick_checkpoint import Checkpoint

CALIBRATION_ABORTED = "calibration given up: "
ROWS_INITIAL = 32  # initial length of the array of a tick's samples; it grows

_CLOCK_SET = int(Reason.CLOCK_SET)


class CalibrationHistory(NamedTuple):
    """What a rig did before the loop: the calibration at the start, if any."""

    start_ns: int  # from which its session time counts
    samples: tuple[RigSample, ...]  # all samples since then, oldest first
    motor: tuple[float, ...] = ()  # [m] positions written last, which the motors hold


class SlaveProcess(LoopProcess):
    """Runs `loop.run_tick` on one rig and one link, and counts what happened."""

    role, verdict = Role.SLAVE, GateFlags

    def __init__(
        self,
        config: SlaveConfig,
        link: Link,
        rig: Rig,
        model: RigModel,
        clock: EventClock,
        history: CalibrationHistory | None = None,
        bilateral: Bilateral = loop.DIRECT,
        requests: RequestListener | None = None,
        health: HealthConfig = DEFAULT_BOUNDS,
    ) -> None:
        self._rig, self._model = rig, model
        self._emergency_stop = get_emergency_stop(rig)
        self._enabling = as_enabling_rig(rig)
        self._motors_follow = self._enabling is None  # as of the last read
        self._reads, self._writes = SlowCallMonitor("rig: read"), SlowCallMonitor("rig: write")
        self._is_rig_stopped = False  # its emergency stop was called, nothing written since
        history = history or CalibrationHistory(now_ns(), ())
        with use_ordinary_scheduling():  # the samples of a calibration take up to seconds
            self._slave = loop.init_slave(
                model, config, bilateral, rig.starts_at_zero, history.samples, history.motor
            )
        self.memory: SlaveMemory = view_struct(self._slave.memory)
        extensions = SlaveExtensions(config, bilateral.coupling, model, self._slave)
        self._extensions = extensions if extensions.opened else None  # each call costs time
        joints = len(model.joints)
        super().__init__(link, clock.stats, self._slave.memory, joints, requests, health)
        self._gated_position = self._slave.memory["gated_position"][0]  # [m]
        self._has_gated_position = self._slave.memory["has_gated_position"]
        self._estimate_arguments = self._slave.estimate_arguments
        run_tick = partial(loop.run_tick, *self._slave.tick_arguments)
        self._run_tick = run_tick if self._extensions is None else self._extensions.run_tick
        self._monitor_arguments = self._slave.monitor_arguments
        self._checkpoint = Checkpoint(*self._slave.restorable_arrays)
        self._rows = EstimatedSample.array(ROWS_INITIAL)
        self._sample_count = 0
        # the rig's next sample; its estimate is in the memory, but not in the checkpoint
        self._next_sample: RigSample | None = None
        self._is_estimated = False  # whether this tick's sample was estimated ahead
        self._commands = link.subscribe_latest(COMMAND, round(config.command_timeout * 1e9))
        self._echo_ns = self._commands.packet.records["echo_stamp_ns"]
        self._state, self._tendon_state = Packet(SlaveState), Packet(TendonState)
        self._answer_ns = self._state.records["answer_ns"]
        self._telemetry = Telemetry(link, model, self._slave)
        self._score = Score(model.models)
        self._timeout_ns = round(config.command_timeout * 1e9)
        self._start_ns = history.start_ns

    def tick(self, tick: Tick) -> None:
        """Answer the newest command; then the work that is not time-critical."""
        time_s = (tick.stamp_ns - self._start_ns) * 1e-9
        fault = self._read_samples(time_s)
        commands = self._link.take_latest(COMMAND)
        now = now_ns()
        requests = self._requests.take_requests(now, int(self._stops[0]))
        if requests.stop_text and self._outline().state is not State.STOPPED:
            self._telemetry.stop_text = requests.stop_text  # of the first caller
        self._verdicts[self._step_and_move(fault, requests, now, tick.dt)] += 1
        if commands.new:
            self._answer_ns[0] = now_ns() - commands.received_ns
        self._link.publish_packet(STATE, self._state)
        self._meter.answer.add(now_ns() - tick.stamp_ns)
        rig_ns = self._finish_tick(tick, time_s, requests)
        work_ns = now_ns() - tick.stamp_ns
        self._meter.without_rig.add(work_ns - rig_ns)
        self._meter.add_tick(self._outline(), work_ns, self._telemetry.detail)

    def close(self) -> None:
        """Publish that the slave no longer moves the rig, however the loop ended."""
        last = self._outline()
        if last.state not in (State.OFF, State.FAULT, State.STOPPED):
            last = SessionOutline(State.OFF, Reason.NOT_USABLE)
        state = self._state.records
        state["state"], state["reason"] = last
        for name in ("joints", "position", "force", "force_low", "force_high", "status"):
            state[name] = 0
        state["sample_age_ns"] = state["answer_ns"] = 0
        self._link.publish_packet(STATE, self._state)
        publish_event(self._link, Role.SLAVE, last, f"off: {self.ended or 'ended'}")

    def summarise(self) -> LoopSummary:
        """Return the figures of the run."""
        force_error = cast("ForceError | None", self._score.summarise())
        rig = RigSummary(force_error, self._rig.summarise(), self._telemetry.describe_friction())
        return replace(super().summarise(), rig=rig)

    def _step_and_move(self, fault: Reason, requests: Requests, now: int, dt: float) -> int:
        """Step the slave, move the rig unless it has a fault; return the gate's verdict."""
        if self._extensions is not None:
            self._extensions.start_tick()
        step = partial(self._step_slave, fault, requests)
        try:
            verdict = self._checkpoint.run_step(step, now, dt)
            if fault is Reason.NONE:
                self._move_rig()
        except (RigFault, ExtensionFault) as error:
            # nothing has moved: step again with the fault, which the state then tells the master
            self._checkpoint.restore()
            return self._step_slave(self._end_on_fault(error), requests, now_ns(), dt)
        return verdict

    def _move_rig(self) -> None:
        """Write the gated positions, if any; an emergency stop uses the motors' own means.

        Motors may have power before the first engagement, so the stop is called in any case.
        """
        if self._emergency_stop is None or self._outline().state is not State.STOPPED:
            self._is_rig_stopped = False
            if self._has_gated_position[0]:
                begin_ns = now_ns()
                self._rig.write(self._gated_position[: self._rig.tendons].copy())
                self._writes.add(now_ns() - begin_ns)
            return
        # the next engagement begins where the encoders are by then
        self._has_gated_position[0] = False
        if not self._is_rig_stopped:
            self._emergency_stop()
            self._is_rig_stopped = True

    def _step_slave(self, fault: Reason, requests: Requests, now: int, dt: float) -> int:
        """Step the slave with the inputs known at the stamp `now`; return the gate's verdict."""
        commands = self._commands
        tick_input = TickInput(
            dt,
            commands.is_there,
            commands.compute_age_ns(now) <= self._timeout_ns,
            int(fault),
            int(requests.stop),
            requests.reset,
            _CLOCK_SET if commands.settles else self._link_reason,
            commands.settles or self._link_holds,
            self._motors_follow,
        )
        rows, sample_count = self._rows, self._sample_count
        if (extension_estimates := self._get_extension_estimates()) is not None:
            estimate(*self._estimate_arguments, rows, sample_count, extension_estimates)
        elif not self._is_estimated:
            estimate(*self._estimate_arguments, rows, sample_count)
        self._is_estimated = False
        return self._run_tick(
            rows, sample_count, tick_input, commands.packet.records, self._state.records
        )

    def _read_samples(self, time_s: float) -> Reason:
        """Read the rig's new samples into the rows; return a fault of the rig."""
        expected, self._next_sample, self._sample_count = self._next_sample, None, 0
        samples: tuple[RigSample, ...] = ()
        fault = Reason.NONE
        begin_ns = now_ns()
        try:
            samples = self._rig.read(time_s)
            if self._enabling is not None:
                self._motors_follow = self._enabling.follows
            if self._extensions is not None:
                self._extensions.estimate(samples)
        except RigFinished:
            self.ended = Reason.RIG_FINISHED.text
            fault = Reason.RIG_FINISHED
        except (RigFault, ExtensionFault) as error:
            samples, fault = (), self._end_on_fault(error)
        self._reads.add(now_ns() - begin_ns)
        if expected is not None:
            if len(samples) == 1 and samples[0] is expected:
                self._sample_count, self._is_estimated = 1, True
                return fault
            self._checkpoint.restore()  # another sample came: the read was too early or too late
        if len(samples) > len(self._rows):  # after a stall; the array keeps this length
            self._rows = EstimatedSample.array(2 * len(samples))
        for sample in samples:
            fill_sample(self._rows, self._sample_count, sample)
            self._sample_count += 1
        return fault

    def _change_setting(self, key: str, value: str) -> str:
        return live_settings.change_setting(self._rig, key, value)

    def _end_on_fault(self, error: RigFault | ExtensionFault) -> Reason:
        if isinstance(error, ExtensionFault):
            self._end_session(error)
            return Reason.EXTENSION_FAULT
        self._end_session(TeleopError(f"rig: {error}"))
        return Reason.RIG_FAULT

    def _finish_tick(self, tick: Tick, time_s: float, requests: Requests) -> int:
        """Do the work that is not time-critical; return how long the rig took of it [ns]."""
        slave, rows, sample_count = self._slave, self._rows, self._sample_count
        for k in range(sample_count):  # close behind the state: one wake-up of Zenoh sends both
            if self._link.skip_unsubscribed(TENDONS):
                continue
            fill_tendon_state(slave.layout, slave.memory, rows, k, self._tendon_state.records)
            self._link.publish_packet(TENDONS, self._tendon_state)
        begin_ns = now_ns()
        next_sample = None if self.error or self.ended else self._advance_rig()
        rig_ns = now_ns() - begin_ns
        loop.monitor_calibration(*self._monitor_arguments, rows, sample_count)
        self._checkpoint.save()
        if requests.settings:
            self._process_settings(requests.settings)
        outline = self._outline()
        self._score.add_rows(slave.layout, rows, sample_count)
        self._finish_requests(outline, requests, self._commands, tick.stamp_ns)
        self._publish_ledger(tick.stamp_ns)
        self._telemetry.publish(time_s)
        self._watch_link(tick.stamp_ns, self._commands, int(self._echo_ns[0]), 0)
        self._report(tick.stamp_ns, self._commands)
        if next_sample is not None and self._get_extension_estimates() is None:
            self._estimate_ahead(next_sample)
        return rig_ns

    def _get_extension_estimates(self) -> Array | None:
        return None if self._extensions is None else self._extensions.estimates

    def _take_warnings(self) -> list[str]:
        opened = () if self._extensions is None else self._extensions.opened
        calls = (self._reads, self._writes, *(extension.calls for extension in opened))
        return [monitor.take() for monitor in calls]

    def _estimate_ahead(self, sample: RigSample) -> None:
        """Estimate from the sample of the next tick ahead of it; last, as it changes the memory."""
        fill_sample(self._rows, 0, sample)
        estimate(*self._estimate_arguments, self._rows, 1)
        self._next_sample = sample

    def _advance_rig(self) -> RigSample | None:
        try:
            return self._rig.advance()
        except RigFault as error:  # published at once, as there is no next tick
            self._sample_count = 0
            self._step_slave(self._end_on_fault(error), Requests(), now_ns(), 0.0)
            self._link.publish_packet(STATE, self._state)
            return None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop slave`."""
    add_option(parser, "--session", help="name of the session (default that of the config)")
    add_options(parser, "--config", "--set", "--allow-imports", "--insecure", "--model")
    add_options(parser, "--duration", "--json")


def main(args: argparse.Namespace) -> int:
    """Run the slave; returns the exit code."""
    document = read_config(args, join=False)
    shared, config = document.load(SideConfig), document.load(SlaveConfig, "slave")
    config.check_rate(shared.rate_hz)
    config.check_arms(shared.arms)
    files = model_files.parse(args.model)
    if files and config.initialise.at_start:
        raise UsageError("--model: conflicts with slave.initialise.at_start; use one of them")
    compile_session(config, bool(files) or has_model_file(config), shared.arms)
    if not wait_in_standby():
        return 0

    def start(
        link: Link, requests: RequestListener, stack: ExitStack
    ) -> tuple[SlaveProcess, EventClock, StopCondition]:
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        for warning in find_config_warnings(config, shared.coupling):
            print(warning, flush=True)
        stop = StopCondition(args.duration)
        stop.wake = link.wake
        link.subscribe_latest(COMMAND, round(config.command_timeout * 1e9))
        model, history = prepare_rig_model(config, rig, link, requests, stop, shared, files)
        for line in describe_fixed(config.adaptation, model.joints, model.models):
            print(line, flush=True)
        clock = EventClock(shared.rate_hz, stop, partial(link.wait, COMMAND))
        slave = SlaveProcess(
            config, link, rig, model, clock, history, shared.bilateral, requests, shared.health
        )
        return slave, clock, stop

    slave, summary = run_session(Role.SLAVE, shared, start)
    if isinstance(config.rig, SimulatedRigConfig):
        for line in format_late_effects(config.rig.effects, summary.seconds):
            print(line, flush=True)
    return report_outcome(args, slave, summary)


def prepare_rig_model(
    config: SlaveConfig,
    rig: Rig,
    link: Link,
    requests: RequestListener,
    stop: StopCondition,
    shared: RunConfig,
    files: model_files.ModelFiles,
) -> tuple[RigModel, CalibrationHistory]:
    """Return the model of a rig for the loop, and its samples of a calibration before the loop.

    Model `files` replace the sheaths of the config. If the config asks for it, the rig is first
    calibrated by the quick procedure; `TeleopError` if that is aborted. An emergency stop, among
    the `requests` or by the master, stops the motors and aborts it.
    """
    history = CalibrationHistory(now_ns(), ())
    try:
        assemble_tendon_rows(shared.arms, rig.joints)
    except ValueError as error:
        raise UsageError(f"arms: {error}") from error
    if config.initialise.at_start:
        return _calibrate_rig(config, rig, link, requests, stop, shared, history)
    return _load_rig_model(config, rig, shared, files), history


def _load_rig_model(
    config: SlaveConfig, rig: Rig, shared: RunConfig, files: model_files.ModelFiles
) -> RigModel:
    """Return the model of a rig from the config and model `files`; print what is to be noted."""
    tendons = load_tendon_configs(config, rig.tendons, rig.joints, files)
    if isinstance(rig, ReplayedRig):
        tendons = tuple(
            model_files.set_noise_from_data(tendon, *rig.housing[k])
            for k, tendon in enumerate(tendons)
        )
    notes = model_files.describe_models(tendons)
    if files and (config.tendons or config.calibration):
        notes += model_files.find_friction_warnings(
            load_tendon_configs(config, rig.tendons, rig.joints), tendons
        )
    for line in notes:
        print(line, flush=True)
    not_ready_text = find_not_ready_reason(config, rig, modelled=bool(files))
    return loop.build_rig_model(
        rig.joints,
        [tendon.build_model() for tendon in tendons],
        not_ready_text,
        load_arms(config, shared.arms),
    )


def _calibrate_rig(
    config: SlaveConfig,
    rig: Rig,
    link: Link,
    requests: RequestListener,
    stop: StopCondition,
    shared: RunConfig,
    history: CalibrationHistory,
) -> tuple[RigModel, CalibrationHistory]:
    """Return the model of a rig by the quick procedure, and `history` with the samples of it."""

    def check_stop() -> str:
        pending = requests.take_requests(now_ns())
        master = link.take_latest(COMMAND).message
        if pending.stop:
            call_stop(link, Role.SLAVE, pending.stop_text or pending.stop.text)
            cause = DetailedReason(pending.stop, pending.stop_text)
            reason = f"{CALIBRATION_ABORTED}{cause.text}"
            stop_motors(rig, reason)
            outline = SessionOutline(State.STOPPED, pending.stop)
            if requests.is_asked:
                latest = link.take_latest(COMMAND)
                answer_requests(link, requests, Role.SLAVE, outline, 0, latest, now_ns())
            raise TeleopError(reason)
        if master is not None and State(master.state) is State.STOPPED:
            reason = f"{CALIBRATION_ABORTED}{Reason.PEER_STOPPED.text}"
            stop_motors(rig, reason)
            raise TeleopError(reason)
        return stop.reason if stop() else ""

    publish_event(
        link, Role.SLAVE, SessionOutline(), f"off: calibrating {rig.name}; keep its joints free"
    )
    result = initialise(
        rig,
        config,
        Grid(shared.rate_hz, lambda: False, phase=0.5),
        history.start_ns,
        stopped=check_stop,
        progress=build_progress_printer(rig),
        analysing=stop.allow_interrupt,
        arms=shared.arms,
    )
    publish_event(link, Role.SLAVE, SessionOutline(), f"off: {rig.name} is calibrated")
    arms = apply_guide_friction(shared.arms, result.calibration.guides)
    models = [tendon.build_model() for tendon in result.calibration.tendons]
    return loop.build_rig_model(rig.joints, models, arms=arms), history._replace(
        samples=result.samples, motor=result.motor
    )


def stop_motors(rig: Rig, reason: str) -> None:
    """Stop the motors by their own means, if they have any; `TeleopError` if that fails."""
    emergency_stop = get_emergency_stop(rig)
    if emergency_stop is not None:
        try:
            emergency_stop()
        except RigFault as error:
            raise TeleopError(f"{reason}; rig: {error}") from error
