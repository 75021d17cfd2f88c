"""Run the operator's side: read the haptic device, command the slave, render the force.

  teleop master                                          a scripted hand, on this machine
  teleop master --config configs/demo.yaml --duration 30 --json master.json
  teleop master --set master.force.scale=0.1 --set master.device.reference.type=reaches

Without a slave the hand feels nothing. When the slave's states stop coming for longer than
`master.state_timeout`, the force fades; on any other fault it is zero at once. It stays zero until
the operator releases the engage switch and presses it again, and after an emergency stop until that
has been reset too (`teleop stop --reset`). A HID device that is unplugged may be plugged in again.
`teleop set` changes some settings while this runs.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, TypeVar

import numpy as np

from estimator.structs import StructArray, view_struct
from master import live_settings, loop
from master.axis_map import AxisMapper, HandMapper, VelocityMap
from master.config import MasterConfig
from master.coupling_extension import HandEnd
from master.device import Device, DeviceFault, DeviceLost, HandState
from master.devices import open_device
from master.gate import GateFlags
from master.hand_input import HandInput, fill_hand_input
from master.mapping_config import AxisMapConfig
from master.settings_record import SettingsRecord
from teleop.config.arm import ArmConfig
from teleop.config.extension_calls import ExtensionFault
from teleop.config.options import add_option, add_options
from teleop.config.ranges import build_bounds_warnings
from teleop.coupling import Bilateral, CouplingExtension
from teleop.errors import TeleopError, UsageError
from teleop.link import NEVER_NS, LatestMessage, Link
from teleop.link.health import DEFAULT_BOUNDS, HealthConfig, compile_link_window_update
from teleop.link.rate_limit import RateLimit
from teleop.messages.messages import MAX_JOINTS, Command, Hand, SlaveState
from teleop.messages.packet import Packet
from teleop.messages.topics import COMMAND, HAND, LATENCY, STATE, Role
from teleop.remote.request_listener import RequestListener, Requests
from teleop.runtime.clock import STALL_NS, Grid, SuspensionWatch, Tick, monotonic_ns, now_ns
from teleop.runtime.compiling import announce_compilation
from teleop.runtime.process import StopCondition, wait_in_standby
from teleop.session.config import SideConfig, read_config
from teleop.session.events import format_press, publish_event
from teleop.session.loop_process import LoopProcess, report_outcome, run_session
from teleop.session.slow_calls import SlowCallMonitor
from teleop.session.state_machine import (
    DetailedReason,
    OutlineReader,
    Reason,
    SessionOutline,
    State,
)
from teleop.session.tick_checkpoint import Checkpoint

R = TypeVar("R")

DIRECT = Bilateral()
COMPILE_S = 12.0  # [s] without a cache, on a machine that does nothing else
# share of a period, from reading the device, in which to wait for an answer
ANSWER_WAIT_SHARE = 0.6
LATE_ANSWERS_MAX = 20  # in a row, after which the master stops waiting for same-tick answers
RETRY_TICKS = 100  # ticks between two waits after that, to detect answers in time again
PRESSES_PER_S = 10  # events of buttons, and as many at once; a worn switch bounces
_CLOCK_SET, _ENGAGED = int(Reason.CLOCK_SET), int(State.ENGAGED)


class MasterProcess(LoopProcess):
    """Runs the two phases of `master.loop` on one device and one link, and counts what happened.

    The device has `commands_every` ticks for one command on the link.
    """

    role, verdict = Role.MASTER, GateFlags

    def __init__(
        self,
        config: MasterConfig,
        link: Link,
        device: Device,
        grid: Grid,
        bilateral: Bilateral = DIRECT,
        commands_every: int = 1,
        health: HealthConfig = DEFAULT_BOUNDS,
        requests: RequestListener | None = None,
        mapper: HandMapper | None = None,
    ) -> None:
        self._mapper = mapper
        joints = device.axes if mapper is None else mapper.joints
        self._memory = loop.init_master(device.axes, now_ns(), joints)
        self.memory: loop.MasterMemory = view_struct(self._memory)
        self._checkpoint = Checkpoint(self._memory)  # of the tick, then of its second phase
        self._commanded_outline = OutlineReader(self._checkpoint.saved[0]["session"])
        super().__init__(link, grid.stats, self._memory, device.axes, requests, health)
        self._newly_answered_ns = self._memory["newly_answered_ns"]
        self._hands = HandInput.array()
        self._mapped_hands = self._hands if mapper is None else mapper.mapped_hands
        self._maps = VelocityMap.array() if mapper is None else mapper.maps
        self._live, self._device = live_settings.init_settings(config), device
        self._reads = SlowCallMonitor("device: read")
        self._writes = SlowCallMonitor("device: write")
        self._is_layout_compared = False  # axes of the device with joints of the rig
        self._settings = SettingsRecord(config, bilateral)
        self._command, self._hand = Packet(Command), Packet(Hand)
        self._force = np.zeros(MAX_JOINTS)  # [N] that the gate let through
        self._stop_text = ""  # who called for the last stop
        self._commands_every, self._tick_index = commands_every, 0
        self._wait_ns, self._late_answers = round(ANSWER_WAIT_SHARE * grid.period_ns), 0
        self._start_ns = now_ns()
        self._published = self._outline()
        self._held_buttons: tuple[int, ...] = ()  # without a function
        self._may_publish_press = RateLimit(PRESSES_PER_S, PRESSES_PER_S)
        self._absence = ""  # why the device cannot be read, while it is looked for
        self._suspension = SuspensionWatch()
        self._states = link.subscribe_latest(STATE, round(config.state_timeout * 1e9))
        self._echo_ns = self._states.packet.records["echo_stamp_ns"]
        self._slave_answer_ns = self._states.packet.records["answer_ns"]
        self._peer_state = self._states.packet.records["state"]
        self._peer_reason = self._states.packet.records["reason"]
        self._joints = self._states.packet.records["joints"]
        self._scale_key, self._scaled_config = (config, 1.0), config
        self._coupling_extension: HandEnd | None = None
        if isinstance(bilateral.coupling, CouplingExtension):
            self._coupling_extension = HandEnd(
                bilateral.coupling,
                self._memory,
                self._settings.records,
                self._states.packet.records,
            )

    def tick(self, tick: Tick) -> None:
        """Read, command, wait for the answer, render; then the work that is not time-critical."""
        fault, hand, absence = self._read_hand((tick.stamp_ns - self._start_ns) * 1e-9)
        self._link.take_latest(STATE)
        requests = self._requests.take_requests(tick.stamp_ns, int(self._stops[0]))
        if requests.stop_text or requests.settings:
            self._process_requests(requests)
        settings, changed = self._update_settings(hand, tick.dt)
        fill_hand_input(self._hands, hand)
        if self._mapper is not None:
            scale = self._live.config.operator.position_scale
            self._mapper.step(self._hands, self._memory, scale, tick.dt)
        fault = self._compute_command(settings, tick, fault, requests)
        state_ns = self._states.stamp_ns  # of the state that the command has used
        sent_ns = 0
        if self._tick_index % self._commands_every == 0:
            sent_ns = self._link.publish_packet(COMMAND, self._command)
            if fault is Reason.NONE and requests.stop is Reason.NONE:  # else: no force, at once
                self._await_answer(sent_ns, monotonic_ns(tick.stamp_ns) + self._wait_ns)
        self._tick_index += 1
        verdict = self._render_force(settings, tick, fault, requests, state_ns, hand)
        written_ns = now_ns()
        self._verdicts[verdict] += 1
        round_trip = self._measure_round_trip(tick.stamp_ns, sent_ns, written_ns)
        self._finish_tick(tick, hand, requests, round_trip)
        self._publish_changes(changed, hand, absence)
        outline = self._outline()
        self._meter.add_tick(outline, now_ns() - tick.stamp_ns, self._describe_reason(outline))

    def close(self) -> None:
        """Write zero force and publish the end, however the loop ended."""
        try:
            with suppress(DeviceFault):
                self._device.write((0.0,) * self._device.axes)
        finally:
            self._link.publish(COMMAND, Command())
            outline = SessionOutline()
            publish_event(self._link, Role.MASTER, outline, f"off: {self.ended or 'ended'}")

    def _read_hand(self, time_s: float) -> tuple[Reason, HandState | None, str]:
        """Read the device; return its fault, the hand, and why the device is absent.

        After the machine was suspended any device counts as lost for one tick: the hand is
        elsewhere.
        """
        begin_ns = now_ns()
        try:
            if explanation := self._suspension.explain():
                return Reason.DEVICE_FAULT, None, explanation
            return Reason.NONE, self._device.read(time_s), ""
        except DeviceLost as error:
            return Reason.DEVICE_FAULT, None, str(error)
        except DeviceFault as error:
            return self._end_on_fault(error), None, ""
        finally:
            self._reads.add(now_ns() - begin_ns)

    def _update_settings(self, hand: HandState | None, dt: float) -> tuple[StructArray, str]:
        """Advance the settings that ramp; return their record, and what has changed, as text."""
        self._live, changed = live_settings.update_settings(self._live, hand, dt)
        config = self._live.config
        scaled = config if self._link_scale == 1.0 else self._scale_config(config)
        return self._settings.update(scaled), changed

    def _compute_command(
        self, settings: StructArray, tick: Tick, fault: Reason, requests: Requests
    ) -> Reason:
        """Run the first phase; return its fault, that of an extension if it has one."""
        outputs = (self._command.records,)
        compute: Callable[..., None]
        compute = partial(self._run_phase, loop.compute_command, outputs, settings)
        if self._coupling_extension is not None:
            self._coupling_extension.start_tick()
            compute = partial(
                self._coupling_extension.compute_command, compute, self._command.records
            )
        try:
            self._checkpoint.run_step(partial(compute, fault, requests), now_ns(), tick.dt)
        except ExtensionFault as error:
            self._checkpoint.restore()
            fault = self._end_on_fault(error)
            compute(fault, requests, now_ns(), tick.dt)
        return fault

    def _run_phase(
        self,
        phase: Callable[..., R],
        outputs: tuple[Any, ...],
        settings: StructArray,
        fault: Reason,
        requests: Requests,
        now: int,
        dt: float,
    ) -> R:
        """Run a phase of the tick with the inputs known at the stamp `now`; return its result."""
        states = self._states
        tick_input = loop.TickInput(
            dt,
            now,
            states.is_there,
            states.compute_age_ns(now),
            int(fault),
            int(requests.stop),
            requests.reset,
            _CLOCK_SET if states.settles else self._link_reason,
            states.settles or self._link_holds,
        )
        return phase(
            settings,
            self._memory,
            self._hands,
            self._mapped_hands,
            states.packet.records,
            tick_input,
            *outputs,
        )

    def _scale_config(self, config: MasterConfig) -> MasterConfig:
        """Return the config with force and motion scaled as the link allows."""
        unscaled, scale = self._scale_key
        if config is not unscaled or self._link_scale != scale:
            self._scale_key = config, self._link_scale
            self._scaled_config = live_settings.scale_config(config, self._link_scale)
        return self._scaled_config

    def _await_answer(self, sent_ns: int, deadline_ns: int) -> None:
        """Wait for the state that answers the command of `sent_ns`.

        After `LATE_ANSWERS_MAX` that came too late only every `RETRY_TICKS` ticks.
        """
        if self._late_answers > LATE_ANSWERS_MAX and self._tick_index % RETRY_TICKS:
            return
        while self._link.wait(STATE, deadline_ns):
            self._link.take_latest(STATE)
            if self._echo_ns[0] >= sent_ns:
                self._late_answers = 0
                return
            if monotonic_ns(now_ns()) >= deadline_ns:  # whatever else keeps coming
                break
        self._late_answers += 1

    def _render_force(
        self,
        settings: StructArray,
        tick: Tick,
        fault: Reason,
        requests: Requests,
        state_ns: int,
        hand: HandState | None,
    ) -> int:
        """Compute the force and write it to the device; return the gate's verdict."""
        has_new_state = self._states.stamp_ns != state_ns
        has_failed = False
        if self._coupling_extension is not None:
            try:
                self._coupling_extension.render(settings, self._states.is_there)
            except ExtensionFault as error:
                fault, has_new_state, has_failed = self._end_on_fault(error), True, True
        self._checkpoint.save()
        verdict = self._compute_force(settings, tick, fault, requests, has_new_state)
        begin_ns = now_ns()
        try:
            self._device.write(tuple(self._force[: self._device.axes].tolist()))
            self._writes.add(now_ns() - begin_ns)
        except DeviceFault as error:
            # no force acts: compute it again with the fault and without a hand, which the next
            # command then tells the slave
            self._checkpoint.restore()
            fill_hand_input(self._hands, None)
            failed = self._end_on_fault(error)
            verdict = self._compute_force(settings, tick, failed, requests, has_new_state=True)
            fill_hand_input(self._hands, hand)
            has_failed = True
        if has_failed:
            self._publish_fault()
        return verdict

    def _compute_force(
        self,
        settings: StructArray,
        tick: Tick,
        fault: Reason,
        requests: Requests,
        has_new_state: bool,
    ) -> int:
        """Run the second phase; return the gate's verdict.

        The time of a stall before it, while the answer was waited for, counts as passed.
        """
        outputs = self._maps, has_new_state, self._force
        compute = partial(self._run_phase, loop.compute_force, outputs, settings, fault, requests)
        now, dt = now_ns(), tick.dt
        waited_ns = now - tick.stamp_ns
        if waited_ns > STALL_NS + self._wait_ns:
            dt += waited_ns * 1e-9
        return self._checkpoint.run_step(compute, now, dt)

    def _publish_fault(self) -> None:
        """Send a fault found after the tick's command to the slave: there may be no next tick."""
        fields = self._command.records
        fields["state"], fields["reason"] = self._outline()
        self._link.publish_packet(COMMAND, self._command)

    def _measure_round_trip(self, read_ns: int, sent_ns: int, written_ns: int) -> int:
        """Record the durations of the stages of an answered command; return its round trip [ns]."""
        command_ns = int(self._newly_answered_ns[0])
        if not command_ns:
            return 0
        round_trip = written_ns - command_ns
        self._meter.latency.add(round_trip)
        slave_ns = int(self._slave_answer_ns[0])
        if command_ns == sent_ns and slave_ns:
            received_ns = self._states.received_ns
            link_ns = received_ns - sent_ns - slave_ns
            stages = (sent_ns - read_ns, link_ns, slave_ns, written_ns - received_ns)
            self._meter.stages.add((*stages, written_ns - read_ns))
        return round_trip

    def _finish_tick(
        self, tick: Tick, hand: HandState | None, requests: Requests, round_trip: int
    ) -> None:
        """Do the work that is not time-critical, once the force is written."""
        newest = self._outline()
        self._finish_requests(newest, requests, self._states, tick.stamp_ns)
        if hand is not None and not self._link.skip_unsubscribed(HAND):
            age = self._states.compute_age_ns(tick.stamp_ns)
            loop.fill_hand_message(
                self._memory,
                self._hands,
                -1 if age == NEVER_NS else age,
                round_trip,
                self._hand.records,
            )
            self._link.publish_packet(HAND, self._hand)
        self._publish_ledger(tick.stamp_ns)
        for outline in (self._commanded_outline(), newest):  # the answer may have changed it again
            if outline != self._published:
                self._publish_session(outline)
        self._watch_link(
            tick.stamp_ns,
            self._states,
            int(self._echo_ns[0]),
            int(self._slave_answer_ns[0]),
            int(self._peer_reason[0]) if self._peer_state[0] == _ENGAGED else 0,
        )
        self._report(tick.stamp_ns, self._states)
        self._checkpoint.save()

    def _publish_reports(self, latest: LatestMessage[Any]) -> Iterator[None]:
        yield from super()._publish_reports(latest)
        stages, spans = self._meter.stages, []
        for stage in stages.durations:
            yield
            spans.append(stage.take_span())
        self._link.publish(LATENCY, stages.build_message(Role.MASTER, spans))

    def _take_warnings(self) -> list[str]:
        extension = self._coupling_extension
        calls = (self._reads, self._writes, *(() if extension is None else (extension.calls,)))
        return [*(monitor.take() for monitor in calls), self._describe_layout_difference()]

    def _describe_layout_difference(self) -> str:
        """Return, once, which axes of the device or joints of the rig have no counterpart."""
        joints, axes = int(self._joints[0]), int(self._memory["joints"][0])
        if self._is_layout_compared or not joints:
            return ""
        self._is_layout_compared = True
        if axes == joints:
            return ""
        moved = "device has" if self._mapper is None else "mapped hand has"
        difference = f"the {moved} {axes} axes, the rig {joints} joints: "
        if axes > joints:
            return f"{difference}axes from {joints + 1} on move nothing"
        return f"{difference}joints from {axes + 1} on are not moved"

    def _end_on_fault(self, error: DeviceFault | ExtensionFault) -> Reason:
        if isinstance(error, ExtensionFault):
            self._end_session(error)
            return Reason.EXTENSION_FAULT
        self._end_session(TeleopError(f"haptic device: {error}"))
        return Reason.DEVICE_FAULT

    def _publish_session(self, outline: SessionOutline) -> None:
        self._published = outline
        text = DetailedReason(outline.reason, self._describe_reason(outline)).text
        publish_event(self._link, Role.MASTER, outline, f"{outline.state.name.lower()}: {text}")

    def _describe_reason(self, outline: SessionOutline) -> str:
        """Return the detail of a state's reason; empty if there is none."""
        if outline.reason is Reason.STOP_CALLED:
            return self._stop_text
        return self._absence if outline.reason is Reason.DEVICE_FAULT else ""

    def _process_requests(self, requests: Requests) -> None:
        """Keep who called a stop, and change the settings that other processes request."""
        if requests.stop_text and self._published.state is not State.STOPPED:
            self._stop_text = requests.stop_text  # of the first caller
        self._process_settings(requests.settings)

    def _change_setting(self, key: str, value: str) -> str:
        self._live, text = live_settings.change_setting(self._live, key, value)
        return text

    def _publish_changes(self, changed: str, hand: HandState | None, absence: str) -> None:
        """Publish settings that have `changed`, pressed buttons, and a device lost or back."""
        if changed:
            publish_event(self._link, Role.MASTER, self._outline(), f"set: {changed}")
        if hand is not None and hand.buttons != self._held_buttons:
            self._publish_presses(hand.buttons)
        if absence != self._absence:
            self._publish_device_state(absence)

    def _publish_presses(self, held: tuple[int, ...]) -> None:
        """Publish each button without a function that was not held before."""
        before, self._held_buttons = self._held_buttons, held
        for button in sorted({*held} - {*before}):
            if self._may_publish_press():
                publish_event(self._link, Role.MASTER, self._outline(), format_press(button))
            else:
                self._link.refusals.note("presses of buttons came too fast")

    def _publish_device_state(self, absence: str) -> None:
        self._absence = absence
        recovery = "it is back; let go of everything, then engage"
        text = f"haptic device: {absence or recovery}"
        publish_event(self._link, Role.MASTER, self._outline(), text)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop master`."""
    add_option(parser, "--session", help="name of the session (default that of the config)")
    add_options(
        parser, "--config", "--set", "--allow-imports", "--insecure", "--duration", "--json"
    )


def build_mapper(config: MasterConfig, arms: Sequence[ArmConfig], axes: int) -> HandMapper | None:
    """Return what maps a device of so many axes to the joints, None if axis k moves joint k.

    `UsageError` if the device, the mapping and the arms do not fit.
    """
    mapping = config.mapping
    if mapping is None:
        return None
    if isinstance(mapping, AxisMapConfig):
        for j, joint in enumerate(mapping.joints):
            if joint.axis is not None and joint.axis >= axes:
                raise UsageError(
                    f"master.mapping.joints.{j}.axis: {joint.axis}, but the device has {axes} axes"
                )
        return AxisMapper(mapping, config.gate.torque_lever)
    from master.space_map import SpaceMapper

    count = sum(len(hand.axes) for hand in mapping.hands)
    if count != axes:
        raise UsageError(
            f"master.mapping.hands: their axes are {count}, but the device has {axes}; name each"
        )
    if len(mapping.hands) != len(arms) or not all(arm.has_kinematics for arm in arms):
        raise UsageError(
            f"master.mapping.hands: {len(mapping.hands)} hands in space need as many arms with "
            "kinematics (arms.0.urdf or arms.0.sections)"
        )
    kinematics = [arm.load_kinematics() for arm in arms]
    return SpaceMapper(mapping, kinematics, [arm.pulleys for arm in arms], config.gate.torque_lever)


def main(args: argparse.Namespace) -> int:
    """Run the master; returns the exit code."""
    document = read_config(args, join=False)
    shared, config = document.load(SideConfig), document.load(MasterConfig, "master")
    config.check_rate(shared.rate_hz)
    with announce_compilation("the master's loop", COMPILE_S):
        warm_up()
    if not wait_in_standby():
        return 0
    stop = StopCondition(args.duration)

    def start(
        link: Link, requests: RequestListener, stack: ExitStack
    ) -> tuple[MasterProcess, Grid, StopCondition]:
        stop.wake = link.wake
        for warning in build_bounds_warnings("master.gate", config.gate):
            print(warning, flush=True)
        device = open_device(config.device)
        stack.callback(device.close)
        commands_every = config.count_ticks_per_command(shared.rate_hz)
        grid = Grid(shared.rate_hz * commands_every, stop)
        master = MasterProcess(
            config,
            link,
            device,
            grid,
            shared.bilateral,
            commands_every,
            shared.health,
            requests,
            build_mapper(config, shared.arms, device.axes),
        )
        return master, grid, stop

    return report_outcome(args, *run_session(Role.MASTER, shared, start))


def warm_up() -> None:
    """Compile what the loop calls, before it has to be on time."""
    memory, hands = loop.init_master(1, 0), HandInput.array()
    settings = SettingsRecord(MasterConfig(), DIRECT).records
    state, command, message = Packet(SlaveState), Packet(Command), Packet(Hand)
    fill_hand_input(hands, HandState((0.0,), (0.0,), engage=False))
    tick_input = loop.TickInput(1e-3, 0, False, NEVER_NS)
    inputs = settings, memory, hands, hands, state.records, tick_input
    loop.compute_command(*inputs, command.records)
    loop.compute_force(*inputs, VelocityMap.array(), False, np.zeros(MAX_JOINTS))
    loop.fill_hand_message(memory, hands, -1, 0, message.records)
    compile_link_window_update()
