"""A virtual device in the kernel, in a process of its own.

It must not share a process with what drives it: hidapi holds Python's lock while it closes a
device, and the kernel may want an answer of the device just then.
"""

import copy
import multiprocessing
import os
import select
import struct
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from studies.hid.virtual.device import Push, VirtualDevice

# --- a virtual device in the kernel: what `linux/uhid.h` needs, and no more
# Events are a number and a packed struct each, host byte order. The kernel always hands out whole
# events of the largest size; it takes shorter ones.


_DESTROY, _OUTPUT, _GET_REPORT, _GET_REPORT_REPLY = 1, 6, 9, 10
_CREATE2, _INPUT2, _SET_REPORT, _SET_REPORT_REPLY = 11, 12, 13, 14
_INPUT_REPORT = 2  # kind of report that is got
_LARGEST = 4380
_DATA_MAX = 4096
_EIO = 5


class Uhid:
    """Plugs a virtual device into the kernel, and carries the bytes between the two.

    Without a thread: it becomes readable when the kernel wants something; then call `handle`.
    """

    def __init__(self, device: VirtualDevice) -> None:
        self._device = device
        self._fd = os.open("/dev/uhid", os.O_RDWR | os.O_CLOEXEC)
        self._write(
            _CREATE2,
            struct.pack(
                "=128s64s64sHHIIII",
                device.name.encode(),
                b"",
                device.serial.encode(),
                len(device.descriptor),
                device.bus,
                device.vendor,
                device.product,
                0x0111,
                0,
            )
            + device.descriptor,
        )

    def fileno(self) -> int:
        """Return what `select` can wait for."""
        return self._fd

    def close(self) -> None:
        """Pull the device out."""
        self._write(_DESTROY, b"")
        os.close(self._fd)

    def send(self, report: bytes) -> None:
        """Hand an input report to the kernel."""
        self._write(_INPUT2, struct.pack("=H", len(report)) + report)

    def handle(self, now: float) -> None:
        """Take one event: an output report, or a feature to set or to get."""
        event = os.read(self._fd, _LARGEST)
        (kind,) = struct.unpack_from("=I", event)
        if kind == _OUTPUT:
            (size,) = struct.unpack_from("=H", event, 4 + _DATA_MAX)
            self._device.take_output(now, event[4 : 4 + size])
        elif kind == _GET_REPORT:
            number, report, kind = struct.unpack_from("=IBB", event, 4)
            device = self._device
            ask = device.get_input if kind == _INPUT_REPORT else device.get_feature
            answer = ask(now, report)
            head = struct.pack("=IHH", number, 0 if answer else _EIO, len(answer or b""))
            self._write(_GET_REPORT_REPLY, head + (answer or b""))
        elif kind == _SET_REPORT:
            number, _report, _type, size = struct.unpack_from("=IBBH", event, 4)
            self._device.set_feature(now, event[12 : 12 + size])
            self._write(_SET_REPORT_REPLY, struct.pack("=IH", number, 0))

    def _write(self, kind: int, body: bytes) -> None:
        os.write(self._fd, struct.pack("=I", kind) + body)


Hand = Callable[[VirtualDevice, int], None]
"""Moves the device: sets its axes and buttons for input report number n."""


class Plugged:
    """A device that is plugged in from here to the end of the block, and moved by `hand`."""

    def __init__(self, device: VirtualDevice, hand: Hand) -> None:
        context = multiprocessing.get_context("fork")
        self._ask, theirs = context.Pipe()
        self._process = context.Process(target=_live, args=(device, hand, theirs), daemon=True)
        self._process.start()

    def __enter__(self) -> "Plugged":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()

    def unplug(self) -> float:
        """Pull it out; return when that was done [s]."""
        return float(self._tell("unplug"))

    def plug(self) -> float:
        """Put it in again, as it is after power on; return when that was done [s]."""
        return float(self._tell("plug"))

    def list_pushes(self) -> list[Push]:
        """Return what it did to the hand so far."""
        return list(self._tell("pushes"))

    def list_refused(self) -> list[bytes]:
        """Return the reports it could make nothing of."""
        return list(self._tell("refused"))

    def switch_power(self, *, on: bool) -> None:
        """Switch the power of its motors."""
        self._tell("power on" if on else "power off")

    def _tell(self, word: str) -> Any:
        self._ask.send(word)
        return self._ask.recv()


def _live(powered_on: VirtualDevice, hand: Hand, asked: Connection) -> None:
    """Be the device: answer the kernel and the test, and report on a grid of its interval."""
    device = copy.deepcopy(powered_on)
    uhid: Uhid | None = Uhid(device)
    number, due = 0, time.monotonic()
    while True:
        ready = _wait(due, *([asked] if uhid is None else [asked, uhid]))
        now = time.monotonic()
        if uhid in ready:
            uhid.handle(now)
        if asked in ready:
            word = asked.recv()
            if word == "unplug" and uhid is not None:
                uhid.close()
                uhid = None
            elif word == "plug" and uhid is None:
                device = copy.deepcopy(powered_on)
                uhid = Uhid(device)
            elif word.startswith("power "):
                device.powered = word == "power on"
            asked.send(getattr(device, word, time.monotonic()))
        if now >= due:
            hand(device, number)
            number += 1
            reports = device.build_inputs(now)
            if uhid is not None:
                for report in reports:
                    uhid.send(report)
            due = max(due + device.interval, now - 10 * device.interval)


def _wait(due: float, *things: Any) -> list[Any]:
    return select.select(things, [], [], max(due - time.monotonic(), 0.0))[0]
