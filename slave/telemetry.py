"""Low-rate messages of the slave: events, tension profiles, sheath shapes."""

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import TextIO

import numpy as np

from estimator.structs import view_struct
from slave import state_messages
from slave.adaptation import ShapeChange, ShapeWatch, compute_friction
from slave.calibration import monitor
from slave.calibration.monitor import Advice
from slave.calibration.procedure_run import ProcedureProgress
from slave.loop import RigModel, SlaveRecords
from slave.loop_records import NOT_CALIBRATED, NOT_READY_TEXT, SlaveMemory
from slave.rig import Rig
from teleop.link import Link
from teleop.messages.messages import PROFILE_POINTS, TensionProfile
from teleop.messages.packet import Packet
from teleop.messages.topics import PROFILE, SHEATH, Role
from teleop.session.events import publish_event
from teleop.session.state_machine import (
    DetailedReason,
    OutlineReader,
    Reason,
    SessionOutline,
    State,
)

PROFILE_PERIOD_S = 0.02  # T(x) of one tendon; the viewer shows no more
PROFILE_PERIOD_MIN_S = 0.005  # least period between two of them, for any number of tendons
SHEATH_PERIOD_S = 1.0  # for listeners that start later
SHAPE_PERIOD_S = 0.1  # between two looks for a change of shape
PROGRESS_S = 2.0  # between two progress lines of a calibration


class Telemetry:
    """Publishes low-rate messages when due, and events when they occur.

    `detail` is that of the reason of the present session state, and may be empty; `stop_text` the
    sender of the last emergency stop; `shape_changes` what was said about the shape of sheaths.
    """

    def __init__(self, link: Link, model: RigModel, slave: SlaveRecords) -> None:
        self._link, self._model, self._slave = link, model, slave
        self._memory: SlaveMemory = view_struct(slave.memory)
        self._outline = OutlineReader(slave.memory["session"])
        self._now = {
            name: slave.memory[name]
            for name in ("advice", "has_sample", "readiness", "detected_fault")
        }
        self._points = [np.linspace(0.0, m.sheath.length, PROFILE_POINTS) for m in model.models]
        self._joint_of = {k: j for j, tendons in enumerate(model.joints) for k in tendons}
        self._profile_s = max(PROFILE_PERIOD_S / len(model.models), PROFILE_PERIOD_MIN_S)
        self._next_profile_s = self._next_sheath_s = 0.0
        self._tendon = 0
        self._profile = Packet(TensionProfile)
        self.detail = self.stop_text = ""
        self._published: tuple[SessionOutline, str] | None = None
        self._advice = int(Advice.NONE)
        self._shapes = slave.adapter and ShapeWatch(slave.prepared, slave.adapter)
        self._next_shape_s = 0.0
        self.shape_changes: list[str] = []

    def publish(self, time_s: float) -> None:
        """Publish the messages due at session time `time_s` [s]."""
        outline = self._outline()
        published = self._published
        is_published_once = outline.state is State.FAULT or outline.reason is Reason.CALIBRATION_DUE
        lasting = is_published_once and published is not None and published[0] == outline
        if not (lasting and self.detail):  # the origin of a fault, not its later symptoms
            self.detail = self._describe_reason(outline.reason)
        now = outline, self.detail
        if now != published:
            self._published = now
            text = (
                f"{outline.state.name.lower()}: {DetailedReason(outline.reason, self.detail).text}"
            )
            publish_event(self._link, Role.SLAVE, outline, text)
        advice = int(self._now["advice"][0])
        if advice != self._advice:
            self._advice = advice
            if advice == Advice.ADVISED:
                text = f"calibrate again when there is time: {self._describe_misfit()}"
                publish_event(self._link, Role.SLAVE, outline, text)
        if self._shapes is not None and time_s >= self._next_shape_s:
            self._next_shape_s = time_s + SHAPE_PERIOD_S
            for change in self._shapes.update(time_s):
                text = self._describe_shape(change, time_s)
                self.shape_changes.append(text)
                publish_event(self._link, Role.SLAVE, outline, text)
        if time_s >= self._next_profile_s and self._now["has_sample"][0]:
            self._next_profile_s = time_s + self._profile_s
            self._publish_profile()
        if time_s >= self._next_sheath_s:
            self._next_sheath_s = time_s + SHEATH_PERIOD_S
            for k, model in enumerate(self._model.models):
                if not self._link.skip_unsubscribed(SHEATH):
                    friction = compute_friction(self._slave.prepared, self._slave.adapter, k)
                    message = state_messages.build_sheath_message(
                        k, self._joint_of[k], model.sheath, friction
                    )
                    self._link.publish(SHEATH, message)

    def describe_friction(self) -> tuple[str, ...]:
        """Return K of the tendons that adapt, after what was said about their shape."""
        adapter, lines = self._slave.adapter, list(self.shape_changes)
        for k, model in enumerate(self._model.models):
            if adapter is not None and adapter.get_friction(k)["pieces"] > 0:
                now = compute_friction(self._slave.prepared, adapter, k)
                lines.append(
                    f"K of {self._format_name(k)}: {now.K:.2f}, in {now.low:.2f} to "
                    f"{now.high:.2f}; calibrated {model.sheath.K:.2f}"
                )
        return tuple(lines)

    def _describe_reason(self, reason: Reason) -> str:
        """Return the detail of a reason: why not usable, or which tendon."""
        if reason is Reason.NONE:
            return ""
        if reason is Reason.NOT_USABLE:
            readiness = int(self._now["readiness"][0])
            if readiness == NOT_CALIBRATED:
                return self._model.not_ready_text
            return NOT_READY_TEXT[readiness]
        if reason is Reason.SAMPLES_STALE:
            return self._describe_unreadable()
        if reason is Reason.CALIBRATION_DUE:
            return self._describe_misfit()
        if reason is Reason.STOP_CALLED:
            return self.stop_text
        if self._now["detected_fault"][0] == reason:
            return self._format_name(int(self._memory.faulty_tendon))
        return ""

    def _describe_unreadable(self) -> str:
        """Return which value of the newest sample is refused as not finite; empty if none is."""
        for k in range(len(self._model.models)):
            tendon = self._memory.tendons[k]
            for name, value in (("tension", tendon.tension), ("displacement", tendon.displacement)):
                if not (tendon.valid or math.isfinite(value)):
                    return f"{self._format_name(k)}: its {name} is {value}"
        return ""

    def _describe_misfit(self) -> str:
        tendons = range(len(self._model.models))
        errors = [monitor.compute_force_error(self._memory.monitors[k]) for k in tendons]
        k = max(tendons, key=lambda k: abs(errors[k]))
        return f"{self._format_name(k)}: force error about {100.0 * errors[k]:+.0f} %"

    def _describe_shape(self, change: ShapeChange, time_s: float) -> str:
        named, K = self._format_name(change.tendon), change.now.K
        begin = datetime.now().astimezone() - timedelta(seconds=time_s - change.begin_s)
        if not change.has_settled:
            return f"the shape changes: K of {named} leaves {change.before:.2f}"
        error = max(change.now.high - K, K - change.now.low)
        return (
            f"the shape changed at {begin:%H:%M:%S}: K of {named} from {change.before:.2f} to "
            f"{K:.2f} ± {error:.2f}"
        )

    def _format_name(self, tendon: int) -> str:
        j = self._joint_of[tendon]
        return f"joint {j + 1}, tendon {'ab'[self._model.joints[j].index(tendon)]}"

    def _publish_profile(self) -> None:
        k = self._tendon
        self._tendon = (k + 1) % len(self._model.models)
        if self._link.skip_unsubscribed(PROFILE):
            return
        slave, records = self._slave, self._profile.records
        state_messages.fill_tension_profile(
            slave.prepared, slave.estimators, slave.memory, k, self._points[k], records
        )
        self._link.publish_packet(PROFILE, self._profile)


def build_progress_printer(
    rig: Rig, stream: TextIO | None = None, period_s: float = PROGRESS_S
) -> Callable[[ProcedureProgress], None]:
    """Return a callback that prints the progress of a calibration to standard output."""
    due_s = 0.0

    def show(progress: ProcedureProgress) -> None:
        nonlocal due_s
        if progress.time_s < due_s:
            return
        due_s = progress.time_s + period_s
        tendon = progress.format_tendon(rig)
        tension = " and ".join(f"{t:z.1f}" for t in progress.tension)
        print(
            f"calibrating {rig.name}: {progress.done:.0%}, {tendon}: {progress.phase.text}, "
            f"{tension} N",
            file=stream,
            flush=True,
        )

    return show
