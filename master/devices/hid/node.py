"""One open HID node; every failure is a `DeviceFault`."""

import importlib
import os
import sys
from contextlib import suppress
from typing import Any

from master.device import DeviceFault

QUEUE_LENGTH = 64  # length of Linux's report queue; further reports are dropped
_REPORT_SIZE_MAX = 4096  # bytes, of any report
REMEDY = (
    "teleop devices rules | sudo tee /etc/udev/rules.d/70-tendon-teleop.rules, then sudo udevadm "
    "control --reload, and plug it in again"
)


def load_hidapi() -> Any:
    """Return hidapi's module for this system; `DeviceFault` if it is not installed.

    On Linux that is `hidraw`: `hid` is the libusb back end there, which detaches the kernel's
    drivers.
    """
    name = "hidraw" if sys.platform == "linux" else "hid"
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise DeviceFault(f"the Python module {name!r} is missing: pip install hidapi") from error
    if not hasattr(module, "device"):
        raise DeviceFault(
            f"the Python module {name!r} is that of another package: pip uninstall hid; pip "
            "install --force-reinstall hidapi"
        )
    return module


class Node:
    """An open node; `master.devices.hid.driver.ReportAccess` of a driver being set up.

    One thread may read while another writes, as long as neither continues after its own failure:
    hidapi keeps one error text for both (so it is not used). A node must not be used while it is
    closed. `path` is as `master.devices.hid.search` gives it.
    """

    def __init__(self, path: str, name: str) -> None:
        self.name = name
        self._handle = load_hidapi().device()
        try:
            self._handle.open_path(path.encode())
        except OSError as error:
            is_gone = sys.platform == "linux" and not os.path.exists(path)
            remedy = "it was unplugged: plug it in again" if is_gone else REMEDY
            raise DeviceFault(f"{name}: cannot be opened; {remedy}") from error
        if self._handle.set_nonblocking(1) != 0:  # a read would block
            self.close()
            raise DeviceFault(f"{name}: non-blocking reads are not supported")

    def read_descriptor(self) -> bytes:
        """Return the report descriptor."""
        try:
            return bytes(self._handle.get_report_descriptor())
        except (OSError, ValueError) as error:
            raise DeviceFault(f"{self.name}: cannot read its report descriptor") from error

    def drain(self) -> list[bytes]:
        """Return the reports since the last call, oldest first, without waiting.

        At most `QUEUE_LENGTH` reports; if there are that many, newer ones may have been lost.
        """
        reports: list[bytes] = []
        read = self._handle.read
        try:
            while len(reports) < QUEUE_LENGTH:
                report = read(_REPORT_SIZE_MAX)
                if not report:
                    break
                reports.append(bytes(report))
        except (OSError, ValueError) as error:
            raise DeviceFault(f"{self.name}: was unplugged") from error
        return reports

    def write(self, report: bytes) -> None:
        """Send an output report; may wait for a USB frame, and for 5 s on a device that hangs."""
        self._send(self._handle.write, report, "rejects reports")

    def send_feature(self, report: bytes) -> None:
        """Send a feature report."""
        self._send(self._handle.send_feature_report, report, "rejects feature reports")

    def get_feature(self, number: int, length: int) -> bytes:
        """Return feature report `number`, at most `length` bytes, its id first."""
        try:
            return bytes(self._handle.get_feature_report(number, length))
        except (OSError, ValueError) as error:
            raise DeviceFault(f"{self.name}: cannot read feature report {number}") from error

    def get_input(self, number: int, length: int) -> bytes:
        """Return input report `number` as it is now, at most `length` bytes, its id first."""
        try:
            return bytes(self._handle.get_input_report(number, length))
        except (OSError, ValueError) as error:
            raise DeviceFault(f"{self.name}: cannot read input report {number}") from error

    def close(self) -> None:
        """Close the node."""
        with suppress(OSError, ValueError):
            self._handle.close()

    def _send(self, send: Any, report: bytes, trouble: str) -> None:
        try:
            written = send(report)
        except (OSError, ValueError) as error:
            raise DeviceFault(f"{self.name}: {trouble}; unplugged?") from error
        if written < 0:
            raise DeviceFault(f"{self.name}: {trouble}; unplugged?")
