"""An open device: its node, its driver, and its writer thread."""

import math
import sys
import time
from contextlib import ExitStack, suppress

from master.device import DeviceFault
from master.devices.hid.driver import Controls, HidDriver, Share, build_unknown_controls
from master.devices.hid.drivers import DRIVERS
from master.devices.hid.guard import ForceWatchdog
from master.devices.hid.node import QUEUE_LENGTH, Node
from master.devices.hid.pid import PidConfig
from master.devices.hid.search import FoundDevice
from master.devices.hid.writer import Writer

_FIRST_REPORT_TIMEOUT_S = 1.0  # timeout for the first report of a device with a heartbeat
_SETTLE_S = 0.1  # after opening, in which a device reports how it was reset and enabled


class DeviceConnection:
    """Opened and set up by its constructor; raises `DeviceFault` on failure.

    Parameters
    ----------
    pushed : tuple of str, optional
        The axes whose force will be used, all by default: a device may have memory for a few
        effects only.

    Attributes
    ----------
    found : FoundDevice
        Which device it is.
    driver : Driver
        Its driver.
    """

    def __init__(
        self, found: FoundDevice, pid: PidConfig, pushed: tuple[str, ...] | None = None
    ) -> None:
        self.found = found
        item, kind = found.item, DRIVERS[found.kind]
        self._guard: ForceWatchdog | None = None
        with ExitStack() as undo:
            node = Node(item.path, str(item))
            undo.callback(node.close)
            if node.descriptor() != found.descriptor:
                raise DeviceFault(f"{item}: its report descriptor has changed; restart")
            try:
                self.driver = kind.make(item, found.descriptor, pid, pushed)
                if self.driver.forces and not kind.forgets and sys.platform == "linux":
                    self._guard = ForceWatchdog(item.path, self.driver.silence())
                    undo.callback(self._guard.end)
                undo.callback(
                    _remove_force, node, self.driver
                )  # begun in part, it may push by itself
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
        self._writer = Writer(node, self.driver, self._beat)

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

    def _beat(self) -> None:
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
        done = self._writer.end(patience_s)
        return (self._guard is None or self._guard.end()) and done


def _remove_force(node: Node, driver: HidDriver) -> None:
    for report in driver.silence():
        with suppress(DeviceFault):
            node.write(report)
