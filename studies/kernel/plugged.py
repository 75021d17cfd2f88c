"""A virtual device in a process of its own, as a device is a thing of its own.

It must not share a process with what drives it: hidapi holds Python's lock while it closes a
device, and the kernel may want an answer of the device just then.
"""

import copy
import multiprocessing
import select
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from studies.kernel.uhid import Uhid
from tests.hid.virtual.device import Push, VirtualDevice

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

    def pushes(self) -> list[Push]:
        """Return what it did to the hand so far."""
        return list(self._tell("pushes"))

    def refused(self) -> list[bytes]:
        """Return the reports it could make nothing of."""
        return list(self._tell("refused"))

    def power(self, *, on: bool) -> None:
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
            reports = device.inputs(now)
            if uhid is not None:
                for report in reports:
                    uhid.send(report)
            due = max(due + device.interval, now - 10 * device.interval)


def _wait(due: float, *things: Any) -> list[Any]:
    return select.select(things, [], [], max(due - time.monotonic(), 0.0))[0]
