"""What the slave tells listeners now and then: events, tension profiles, sheath shapes."""

from collections.abc import Callable

import numpy as np

from estimator import online
from slave import outbox
from slave.calibration import monitor
from slave.calibration.monitor import Advice
from slave.calibration.refusals import tendon_name
from slave.calibration.run import Progress
from slave.loop import Known, Memory
from slave.rig import Rig
from teleop.link import Link
from teleop.messages import PROFILE_POINTS
from teleop.meter import in_words
from teleop.session import Reason, Session, State
from teleop.tell import tell
from teleop.topics import PROFILE, SHEATH, Role

PROFILE_PERIOD_S = 0.02  # T(x) of one tendon after the other; the viewer shows no more of one
PROFILE_LEAST_S = 0.005  # between two of them, however many tendons there are
SHEATH_PERIOD_S = 1.0  # for listeners that come late
PROGRESS_S = 2.0  # between two lines of a calibration


class Housekeeping:
    """Publishes what is due, and what is new.

    Attributes
    ----------
    detail : str
        What the reason of the present session state is about; empty if nothing more is known.
    stop_words : str
        By whom the last emergency stop was called for.
    """

    def __init__(self, link: Link, known: Known) -> None:
        self._link, self._known = link, known
        self._points = [np.linspace(0.0, m.sheath.length, PROFILE_POINTS) for m in known.models]
        self._joint_of = {k: j for j, tendons in enumerate(known.joints) for k in tendons}
        self._profile_s = max(PROFILE_PERIOD_S / len(known.models), PROFILE_LEAST_S)
        self._next_profile_s = self._next_sheath_s = 0.0
        self._tendon = 0
        self.detail = self.stop_words = ""
        self._said: tuple[Session, str] | None = None
        self._advice = Advice.NONE

    def __call__(self, time_s: float, memory: Memory) -> None:
        """Publish what is due at session time `time_s` [s]."""
        side = memory.session
        lasting = side.state is State.FAULT and self._said is not None and self._said[0] == side
        if not (lasting and self.detail):  # where a fault began, not where it shows by and by
            self.detail = self._detail(memory)
        now = side, self.detail
        if now != self._said:
            self._said = now
            text = f"{side.state.name.lower()}: {in_words(side.reason, self.detail)}"
            tell(self._link, Role.SLAVE, side, text)
        if memory.advice is not self._advice:
            self._advice = memory.advice
            if memory.advice is Advice.ADVISED:
                text = f"calibrate again when there is time: {self._misfit(memory)}"
                tell(self._link, Role.SLAVE, memory.session, text)
        if time_s >= self._next_profile_s and memory.newest is not None:
            self._next_profile_s = time_s + self._profile_s
            self._publish_profile(memory)
        if time_s >= self._next_sheath_s:
            self._next_sheath_s = time_s + SHEATH_PERIOD_S
            for k, model in enumerate(self._known.models):
                self._link.publish(SHEATH, outbox.sheath(k, self._joint_of[k], model.sheath))

    def _detail(self, memory: Memory) -> str:
        """Return what the reason of a state is about: why it is not usable, which tendon it is."""
        reason = memory.session.reason
        if reason is Reason.NOT_USABLE:
            return memory.hindrance
        if reason is Reason.CALIBRATION_DUE:
            return self._misfit(memory)
        if reason is Reason.STOP_CALLED:
            return self.stop_words
        if memory.found is not None and memory.found.reason is reason:
            return self._named(memory.found.tendon)
        return ""

    def _misfit(self, memory: Memory) -> str:
        errors = [monitor.force_error(watch) for watch in memory.monitors]
        k = max(range(len(errors)), key=lambda k: abs(errors[k]))
        return f"{self._named(k)}: the force is wrong by about {100.0 * errors[k]:+.0f} %"

    def _named(self, tendon: int) -> str:
        j = self._joint_of[tendon]
        return f"joint {j + 1}, tendon {'ab'[self._known.joints[j].index(tendon)]}"

    def _publish_profile(self, memory: Memory) -> None:
        assert memory.newest is not None  # noqa: S101 - asked by the caller
        k = self._tendon
        self._tendon = (k + 1) % len(self._known.models)
        x = self._points[k]
        tension = online.profile_at(self._known.prepared[k], memory.estimators[k], x)
        front = memory.newest.estimates[k].front
        self._link.publish(PROFILE, outbox.tension_profile(k, x[-1], front, tension.tolist()))


def calibrating(rig: Rig) -> Callable[[Progress], None]:
    """Return what prints how far the calibration of a rig is, at each phase that lasts."""
    due_s = 0.0

    def show(progress: Progress) -> None:
        nonlocal due_s
        if progress.time_s < due_s:
            return
        due_s = progress.time_s + PROGRESS_S
        count = len(rig.joints[progress.joint - 1])
        where = tendon_name(progress.joint, count, progress.side % count)
        tension = " and ".join(f"{t:z.1f}" for t in progress.tension)
        print(
            f"calibrating {rig.name}: {progress.done:.0%}, {where}: {progress.phase.text}, "
            f"{tension} N",
            flush=True,
        )

    return show
