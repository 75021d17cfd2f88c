"""An open device: its node, its driver, and the thread that writes its forces.

A write may block and a control loop must not, so forces are written by a thread. Only the newest
force is written. A device with a force timeout is re-armed every `REARM_PERIOD_S` while forces are
posted; when posting stops, the force is removed and nothing is written any more.
"""

import math
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import NamedTuple, Protocol

from master.device import DeviceFault
from master.devices.hid.driver import Controls, HidDriver, Share, build_unknown_controls
from master.devices.hid.driver_table import DRIVERS
from master.devices.hid.node import QUEUE_LENGTH, Node
from master.devices.hid.pid import PidConfig
from master.devices.hid.search import FoundDevice
from master.devices.hid.watchdog import ForceWatchdog

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

    `beat` is called every `REARM_PERIOD_S` before a force is written; its `DeviceFault` fails the
    device. `failure` tells why writing has stopped, if it has.
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
            _remove_force(self._node, self._driver)
            with self._changed:
                self._changed.wait_for(lambda: self._ending)
            self._node.close()

    def _write_posts(self) -> None:
        memory, force = WriterState(), self._none
        while True:
            posted = self._take_next(POST_TIMEOUT_S if any(force) else None)
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

    def _take_next(self, patience_s: float | None) -> PostedForce | None:
        """Return the newest post; None if none comes within `patience_s`, or at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._posted is not None or self._ending, patience_s)
            posted, self._posted = self._posted, None
            return posted


# --- an open device: its node, its driver, and its writer thread

_FIRST_REPORT_TIMEOUT_S = 1.0  # timeout for the first report of a device with a heartbeat
_SETTLE_S = 0.1  # after opening, in which a device reports how it was reset and enabled


class DeviceConnection:
    """Opened and set up by its constructor; raises `DeviceFault` on failure.

    `pushed` are the axes whose force will be used, all by default: a device may have memory for a
    few effects only. `found` tells which device it is.
    """

    def __init__(
        self, device: FoundDevice, pid: PidConfig, pushed: tuple[str, ...] | None = None
    ) -> None:
        self.found = device
        item, kind = device.item, DRIVERS[device.kind]
        self._guard: ForceWatchdog | None = None
        with ExitStack() as undo:
            node = Node(item.path, str(item))
            undo.callback(node.close)
            if node.read_descriptor() != device.descriptor:
                raise DeviceFault(f"{item}: its report descriptor has changed; restart")
            try:
                self.driver = kind.make(item, device.descriptor, pid, pushed)
                if self.driver.forces and not kind.forgets and sys.platform == "linux":
                    self._guard = ForceWatchdog(item.path, self.driver.silence())
                    undo.callback(self._guard.end)
                # begun in part, it may push by itself
                undo.callback(_remove_force, node, self.driver)
                self.driver.begin(node)
            except (ValueError, OSError) as error:  # DescriptorError, DriverError; of the guard
                raise DeviceFault(f"{item}: {error}") from error
            self._controls = build_unknown_controls(len(self.driver.axes))
            if kind.heartbeat < math.inf:
                self._await_word(node)
            undo.pop_all()
        self._node, self._heartbeat = node, kind.heartbeat
        self._heard_s: float | None = None  # [s] time of its last report
        self._first_s: float | None = None  # [s] time of the first read
        self._writer = Writer(node, self.driver, self._note_beat)

    def read(self, time_s: float) -> Controls:
        """Return the inputs at session time `time_s` [s], without waiting.

        If reports may have been lost, inputs are unknown until they are reported again.

        `DeviceFault` if the device is gone, accepts no forces, or misses its heartbeat; it must not
        be read any more then.
        """
        if self._writer.failure is not None:
            raise self._writer.failure
        if self._writer.hangs:
            raise DeviceFault(f"{self.found.item}: no longer accepts forces")
        self._forget_interruptions()
        if self._take(self._node.drain()) or self._heard_s is None:
            self._heard_s = time_s
        elif time_s - self._heard_s > self._heartbeat:
            raise DeviceFault(f"{self.found.item}: stopped sending reports")
        self._first_s = time_s if self._first_s is None else self._first_s
        if time_s - self._first_s < _SETTLE_S:
            self._forget_interruptions()
        return self._controls

    def _forget_interruptions(self) -> None:
        actuators = self._controls.actuators
        if actuators is not None and actuators.interrupted:
            self._controls = self._controls._replace(actuators=actuators.read())

    def _take(self, reports: list[bytes]) -> bool:
        """Decode reports, oldest first; return whether there were any."""
        if len(reports) == QUEUE_LENGTH:  # newer ones may be lost, with a button release
            inputs = build_unknown_controls(len(self.driver.axes))
            self._controls = inputs._replace(actuators=self._controls.actuators)
            return True
        controls, decode = self._controls, self.driver.decode
        for report in reports:
            controls = decode(controls, report)
        self._controls = controls
        return bool(reports)

    def _await_word(self, node: Node) -> None:
        end = time.monotonic() + _FIRST_REPORT_TIMEOUT_S
        while not self._take(node.drain()):
            if time.monotonic() > end:
                raise DeviceFault(f"{self.found.item}: sends no reports")
            time.sleep(0.002)

    def post(self, force: tuple[Share, ...]) -> None:
        """Set the force from now on, without waiting."""
        self._writer.post(force)

    def _note_beat(self) -> None:
        if self._guard is not None:
            try:
                self._guard.beat()
            except OSError as error:
                trouble = "the force watchdog process has died"
                raise DeviceFault(f"{self.found.item}: {trouble}") from error

    def end(self, patience_s: float = 0.0) -> bool:
        """Remove the force and close; return whether that was done within `patience_s` [s].

        Otherwise it is done when the device responds. No reads afterwards; may be called again.
        """
        is_finished = self._writer.end(patience_s)
        return (self._guard is None or self._guard.end()) and is_finished


def _remove_force(node: ReportSink, driver: HidDriver) -> None:
    for report in driver.silence():
        with suppress(DeviceFault):  # a device that failed once may still accept it
            node.write(report)
