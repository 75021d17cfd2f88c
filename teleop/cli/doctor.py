"""Check whether this machine can run a session, with a remedy for each failed check.

A failed essential check gives exit code 1; the others are advice.
"""

import argparse
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from teleop.runtime.clock import Grid
from teleop.runtime.process import has_display

DISTRIBUTION = "tendon-teleop"

HID_NODES = Path("/dev")
HID_DESCRIPTORS = Path("/sys/class/hidraw")
_STICKS = (b"\x05\x01\x09\x04", b"\x05\x01\x09\x05", b"\x05\x01\x09\x08")  # HID usages, see below


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check."""

    what: str
    good: bool
    detail: str
    remedy: str = ""
    essential: bool = False


def check_python_version() -> Finding:
    """Check the interpreter."""
    return Finding(
        "Python",
        sys.version_info >= (3, 11),
        platform.python_version(),
        "install 3.11 or newer",
        True,
    )


def list_dependencies() -> list[str]:
    """Return the names of the required packages."""
    try:
        lines = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return []
    return [re.split(r"[^\w.-]", line)[0] for line in lines if "extra ==" not in line]


def check_packages() -> Finding:
    """Check that each dependency is installed."""
    missing = []
    for name in (DISTRIBUTION, *list_dependencies()):
        try:
            version(name)
        except PackageNotFoundError:
            missing.append(name)
    return Finding(
        "packages", not missing, "missing: " + ", ".join(missing) if missing else "all installed",
        "pip install " + " ".join(missing), True,
    )  # fmt: skip


def check_processors() -> Finding:
    """Check for a processor per loop."""
    count = os.cpu_count() or 1
    return Finding(
        "processors", count >= 2, f"{count}", "two 1 kHz loops on one processor will overrun"
    )


def check_real_time() -> Finding:
    """Check whether real-time scheduling is permitted."""
    if not hasattr(os, "sched_setscheduler"):
        return Finding("real time", False, "not on this system", "use Linux for the 1 kHz loops")
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        return Finding(
            "real time", False, "SCHED_FIFO not permitted",
            "add 'NAME - rtprio 50' and 'NAME - memlock unlimited' to /etc/security/limits.conf "
            "(your user name for NAME) and log in again",
        )  # fmt: skip
    os.sched_setscheduler(0, before, parameters)
    return Finding("real time", True, "SCHED_FIFO permitted")


def check_timing(seconds: float = 1.0) -> Finding:
    """Run an empty 1 kHz loop and measure its lateness."""
    end = time.monotonic() + seconds
    grid = Grid(1000.0, lambda: time.monotonic() >= end)
    for _ in grid:
        pass
    stats = grid.stats
    return Finding(
        "1 kHz grid", stats.rate_hz > 995.0,
        f"{stats.rate_hz:.1f} Hz, latest tick {stats.lateness_max_ns / 1e6:.2f} ms, "
        f"{stats.overruns} overruns",
        "close other programs, set the processor governor to 'performance'",
    )  # fmt: skip


def check_screen() -> Finding:
    """Check for a display; without one the view is a web page."""
    there = has_display()
    return Finding("screen", there, "found" if there else "none", "use --view web or --view rrd")


def check_hid_nodes() -> Finding:
    """Check that haptic devices can be opened.

    Their report descriptor begins with joystick, gamepad or multi-axis controller; keyboards and
    mice are ignored.
    """
    nodes = sorted(filter(_is_stick, HID_NODES.glob("hidraw*")))
    denied = [node.name for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if not nodes:
        return Finding("haptic devices", True, "none attached; the virtual device needs none")
    detail = f"{len(nodes)} attached" + (f", no permission: {' '.join(denied)}" if denied else "")
    return Finding(
        "haptic devices", not denied, detail,
        "teleop devices rules | sudo tee /etc/udev/rules.d/70-tendon-teleop.rules, then sudo "
        "udevadm control --reload, and plug them in again",
    )  # fmt: skip


def _is_stick(node: Path) -> bool:
    try:
        data = (HID_DESCRIPTORS / node.name / "device/report_descriptor").read_bytes()
    except OSError:
        return False
    return data.startswith(_STICKS)


def check_disk() -> Finding:
    """Check the disk space for recordings."""
    free = shutil.disk_usage(Path.cwd()).free
    return Finding(
        "disk", free > 2e9, f"{free / 1e9:.0f} GB free here", "recordings take some MB a minute"
    )


CHECKS: tuple[Callable[[], Finding], ...] = (
    check_python_version,
    check_packages,
    check_processors,
    check_real_time,
    check_timing,
    check_screen,
    check_hid_nodes,
    check_disk,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no options."""
    del parser


def main(_args: argparse.Namespace) -> int:
    """Run all checks and print them."""
    findings = [check() for check in CHECKS]
    width = max(len(finding.what) for finding in findings)
    for finding in findings:
        mark = "ok  " if finding.good else ("FAIL" if finding.essential else "note")
        remedy = "" if finding.good or not finding.remedy else f"  -> {finding.remedy}"
        print(f"{mark}  {finding.what:{width}}  {finding.detail}{remedy}")
    failed = [finding for finding in findings if finding.essential and not finding.good]
    print("Ready: teleop run --config configs/demo.yaml" if not failed else "Not ready.")
    return 1 if failed else 0
