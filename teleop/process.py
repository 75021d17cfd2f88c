"""What each of our processes does around its loop: when to stop, real time, what it leaves."""

import ctypes
import json
import os
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

_PR_SET_PDEATHSIG = 1
_MCL_CURRENT_AND_FUTURE = 3


SUPERVISED = "TELEOP_SUPERVISED"  # set by the launcher in the environment of its children


def supervised() -> bool:
    """Return whether a launcher started this process, and speaks for it."""
    return SUPERVISED in os.environ


class Stop:
    """Asked by a loop before each tick; becomes true and stays so.

    SIGINT and SIGTERM set it, so does the end of `duration_s`, and `request` from inside.
    """

    def __init__(self, duration_s: float | None = None) -> None:
        self.reason = ""
        self._end_ns = None if duration_s is None else time.monotonic_ns() + round(duration_s * 1e9)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def __call__(self) -> bool:
        """Return whether to stop."""
        if not self.reason and self._end_ns is not None and time.monotonic_ns() >= self._end_ns:
            self.reason = "duration reached"
        return bool(self.reason)

    def request(self, reason: str) -> None:
        """Stop at the next asking; the first reason is kept."""
        self.reason = self.reason or reason

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.request(signal.Signals(number).name)


def die_with_parent() -> None:
    """Ask Linux to end this process when its parent dies; elsewhere nothing can be asked."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def go_realtime(priority: int = 20) -> list[str]:
    """Take real-time scheduling and lock memory where the user may; return what was granted."""
    granted = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        granted.append("SCHED_FIFO")
    except (AttributeError, PermissionError, OSError):
        granted.append("no SCHED_FIFO (see `teleop doctor`)")
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mlockall") and libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0:
        granted.append("memory locked")
    return granted


def write_summary(path: str | None, summary: dict[str, Any]) -> None:
    """Write `summary` as JSON to `path`, whole or not at all."""
    if path is None:
        return
    target = Path(path)
    partial = target.with_name(target.name + ".partial")
    partial.write_text(json.dumps(summary, indent=2) + "\n")
    partial.replace(target)
