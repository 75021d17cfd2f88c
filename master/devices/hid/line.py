"""A device while it is open: its node, its driver, and the thread that writes to it."""

import math
import sys
import time
from contextlib import ExitStack

from master.device import DeviceFault
from master.devices.hid.driver import Controls, Share, unknown
from master.devices.hid.drivers import DRIVERS
from master.devices.hid.guard import Guard
from master.devices.hid.node import QUEUE, Node
from master.devices.hid.pid import PidConfig
from master.devices.hid.search import FoundDevice
from master.devices.hid.writer import Writer

_FIRST_WORD_S = 1.0  # within which a device that always sends something has begun


class DeviceConnection:
    """Opened and set up by its constructor; `DeviceFault` if that cannot be done.

    Attributes
    ----------
    found : FoundDevice
        Which device it is.
    driver : Driver
        Its driver.
    """

    def __init__(self, found: FoundDevice, pid: PidConfig) -> None:
        self.found = found
        item, kind = found.item, DRIVERS[found.kind]
        self._guard: Guard | None = None
        with ExitStack() as undo:
            node = Node(item.path, str(item))
            undo.callback(node.close)
            if node.descriptor() != found.descriptor:
                raise DeviceFault(f"{item}: describes itself in another way than before; restart")
            try:
                self.driver = kind.make(item, found.descriptor, pid)
                if self.driver.forces and not kind.forgets and sys.platform == "linux":
                    self._guard = Guard(item.path, self.driver.silence())
                    undo.callback(self._guard.end)
                self.driver.begin(node)
            except (ValueError, OSError) as error:  # DescriptorError, DriverError; of the guard
                raise DeviceFault(f"{item}: {error}") from error
            self._controls = unknown(len(self.driver.axes))
            if kind.heartbeat < math.inf:
                self._await_word(node)
            undo.pop_all()
        self._node, self._heartbeat = node, kind.heartbeat
        self._heard_s: float | None = None  # [s] when it sent something
        self._writer = Writer(node, self.driver, self._beat)

    def read(self, time_s: float) -> Controls:
        """Return what the inputs say at session time `time_s` [s], without waiting.

        When reports may have been lost, nothing is known until it is reported anew.

        `DeviceFault` if the device is gone, takes no forces, or is silent although it never is; it
        must not be read any more then.
        """
        if self._writer.failure is not None:
            raise self._writer.failure
        if self._writer.hangs:
            raise DeviceFault(f"{self.found.item}: takes no forces any more")
        if self._take(self._node.drain()) or self._heard_s is None:
            self._heard_s = time_s
        elif time_s - self._heard_s > self._heartbeat:
            raise DeviceFault(f"{self.found.item}: fell silent")
        return self._controls

    def _take(self, reports: list[bytes]) -> bool:
        """Take in reports, oldest first; return whether there were any."""
        if len(reports) == QUEUE:  # the newest may be lost, and with it a button let go of
            self._controls = unknown(len(self.driver.axes))
            return True
        controls, decode = self._controls, self.driver.decode
        for report in reports:
            controls = decode(controls, report)
        self._controls = controls
        return bool(reports)

    def _await_word(self, node: Node) -> None:
        end = time.monotonic() + _FIRST_WORD_S
        while not self._take(node.drain()):
            if time.monotonic() > end:
                raise DeviceFault(f"{self.found.item}: sends nothing")
            time.sleep(0.002)

    def post(self, force: tuple[Share, ...]) -> None:
        """Have the device push with `force` from now on, without waiting."""
        self._writer.post(force)

    def _beat(self) -> None:
        if self._guard is not None:
            try:
                self._guard.beat()
            except OSError as error:
                trouble = "the process that would take its force away has died"
                raise DeviceFault(f"{self.found.item}: {trouble}") from error

    def end(self, patience_s: float = 0.0) -> bool:
        """Take the force away and close; return whether that was done within `patience_s` [s].

        Else it is done when the device lets it. It must not be read any more; may be called again.
        """
        done = self._writer.end(patience_s)
        return (self._guard is None or self._guard.end()) and done
