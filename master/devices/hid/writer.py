"""Writer thread for forces, as a write may block and a control loop must not.

Only the newest force is written. A device with a force timeout is re-armed every `REARM_PERIOD_S`
while forces are posted; when posting stops, the force is removed and nothing is written any more.
"""

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, Protocol

from master.device import DeviceFault
from master.devices.hid.driver import HidDriver, Share

REARM_PERIOD_S = 0.050  # [s] interval of re-arming a device
POST_TIMEOUT_S = 0.050  # [s] without a post after which the force is removed
WRITE_TIMEOUT_S = 0.2  # [s] timeout of a write

Force = tuple[Share, ...]


class ReportSink(Protocol):
    """Destination of reports."""

    def write(self, report: bytes) -> None:
        """Send a report; raises `DeviceFault` on failure."""

    def close(self) -> None:
        """Close it."""


class PostedForce(NamedTuple):
    """A force to be rendered."""

    force: Force
    at_s: float


class WriterState(NamedTuple):
    """What was written last."""

    reports: tuple[bytes, ...] = ()
    armed_s: float = -math.inf  # [s] when the device was last re-armed


def step(
    driver: HidDriver, memory: WriterState, force: Force, now_s: float
) -> tuple[tuple[bytes, ...], WriterState]:
    """Return the reports to be written now for `force`: changes and re-arming."""
    arm = now_s - memory.armed_s >= REARM_PERIOD_S
    reports = driver.encode(force, arm)
    due = reports if arm else tuple(r for r in reports if r not in memory.reports)
    return due, WriterState(reports, now_s if arm else memory.armed_s)


class Writer:
    """Owns the writing side of a node, and closes the node at the end.

    Parameters
    ----------
    beat : callable
        Called every `REARM_PERIOD_S` before a force is written; its `DeviceFault` fails the device.

    Attributes
    ----------
    failure : DeviceFault or None
        Why writing has stopped, if it has.
    """

    def __init__(
        self,
        node: ReportSink,
        driver: HidDriver,
        beat: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.failure: DeviceFault | None = None
        self._node, self._driver, self._beat, self._clock = node, driver, beat, clock
        self._none: Force = (0.0,) * len(driver.forces)
        self._changed = threading.Condition()
        self._posted: PostedForce | None = None
        self._ending = False
        self._writing_since_s = math.inf
        self._thread = threading.Thread(target=self._run, name="hid writer", daemon=True)
        self._thread.start()

    @property
    def hangs(self) -> bool:
        """Whether a write has exceeded `WRITE_TIMEOUT_S`."""
        return self._clock() - self._writing_since_s > WRITE_TIMEOUT_S

    def post(self, force: Force) -> None:
        """Set the force from now on; never waits."""
        with self._changed:
            self._posted = PostedForce(force, self._clock())
            self._changed.notify()

    def end(self, patience_s: float = 0.0) -> bool:
        """Remove the force and close the node; return whether that was done in time.

        The caller must not use the node any more. Waits at most `patience_s` for a hanging write;
        the thread closes the node when it returns.
        """
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join(patience_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self._write_posts()
        except DeviceFault as fault:
            self.failure = fault
        finally:  # also after a bug: no force must remain
            if not self._ending and self.failure is None:
                self.failure = DeviceFault("the driver failed; no forces are written")
            for report in self._driver.silence():
                with suppress(DeviceFault):  # a device that failed once may still accept it
                    self._node.write(report)
            self._await_end()
            self._node.close()

    def _write_posts(self) -> None:
        memory, force = WriterState(), self._none
        while True:
            posted = self._next(POST_TIMEOUT_S if any(force) else None)
            if self._ending:
                return
            now_s = self._clock()
            # forces from before a suspension of this process are outdated
            fresh = posted is not None and now_s - posted.at_s <= POST_TIMEOUT_S
            force = posted.force if posted is not None and fresh else self._none
            armed_s = memory.armed_s
            reports, memory = step(self._driver, memory, force, now_s)
            self._writing_since_s = now_s
            if memory.armed_s != armed_s:
                self._beat()
            for report in reports:
                self._node.write(report)
            self._writing_since_s = math.inf

    def _next(self, patience_s: float | None) -> PostedForce | None:
        """Return the newest post; None if none comes within `patience_s`, or at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._posted is not None or self._ending, patience_s)
            posted, self._posted = self._posted, None
            return posted

    def _await_end(self) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._ending)
