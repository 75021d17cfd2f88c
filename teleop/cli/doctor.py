"""Check whether this machine can run a session, with a remedy for each failed check.

  teleop doctor               check this machine
  teleop doctor --startup     where the time of a start goes, for both sides of a session

A failed essential check gives exit code 1; the others are advice.
"""

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from estimator.compile_cache import choose_folder
from master.devices.hid.node import REMEDY
from slave.drivers import ports
from teleop.errors import TeleopError, UsageError
from teleop.runtime.child_process import start_module
from teleop.runtime.clock import Grid
from teleop.runtime.files import find_config_folder, find_state_folder
from teleop.runtime.machine import (
    count_processors,
    describe_machine,
    find_container,
    find_display_problem,
    find_realtime_remedy,
)
from teleop.runtime.process import STANDBY_VARIABLE

DISTRIBUTION = "tendon-teleop"

INSTALLED = Path(__file__)
CLOCK_MARGIN_S = 86_400.0  # [s] of packages that were dated in another time zone
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
    delays: bool = False  # whether the loops are late without it


def check_machine() -> Finding:
    """Tell where this is."""
    return Finding("machine", True, describe_machine())


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
    count = count_processors()
    return Finding(
        "processors", count >= 2, f"{count}", "two 1 kHz loops on one processor will overrun",
        delays=True,
    )  # fmt: skip


def check_real_time() -> Finding:
    """Check whether real-time scheduling is permitted."""
    if not hasattr(os, "sched_setscheduler"):
        return Finding("real time", False, "not on this system", "use Linux for the 1 kHz loops")
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    except PermissionError:
        remedy = find_realtime_remedy()
        return Finding("real time", False, "SCHED_FIFO not permitted", remedy, delays=True)
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
        delays=True,
    )  # fmt: skip


def check_clock() -> Finding:
    """Check that the clock is not earlier than the installation of this program."""
    installed_s, now_s = INSTALLED.stat().st_mtime, time.time()
    installed, now = (f"{datetime.fromtimestamp(at):%Y-%m-%d %H:%M}" for at in (installed_s, now_s))
    good = now_s > installed_s - CLOCK_MARGIN_S
    detail = now if good else f"{now}, before this program was installed ({installed})"
    remedy = "sudo timedatectl set-ntp true: keys of other machines are refused, files misdated"
    return Finding("clock", good, detail, remedy)


def check_screen() -> Finding:
    """Check for a display; without one the view is a web page."""
    problem = find_display_problem()
    return Finding("screen", not problem, problem or "found", "use --view web or --view rrd")


def check_serial_ports() -> Finding:
    """Check that serial adapters can be used."""
    devices = ports.list_ports()
    problems = [f"{device}: {text}" for device in devices for text in ports.find_problems(device)]
    if not devices:
        hint = ports.explain_missing()
        return Finding("serial ports", "brltty" not in hint, f"none attached{hint}")
    return Finding("serial ports", not problems, "; ".join([f"{len(devices)} attached", *problems]))


def check_folders() -> Finding:
    """Check the folders of this user that a session writes to."""
    problems, is_essential = [], False
    for find, variable, is_needed in (
        (find_state_folder, "XDG_STATE_HOME", True),
        (lambda: Path(tempfile.gettempdir()), "TMPDIR", True),
        (find_config_folder, "XDG_CONFIG_HOME", False),
    ):
        try:
            folder = find()
            existing = next(place for place in (folder, *folder.parents) if place.exists())
            problem = "" if os.access(existing, os.W_OK) else f"{existing} cannot be written"
        except (UsageError, OSError):
            problem = "no folder of this user"
        if problem:
            problems.append(f"{problem} ({variable})")
            is_essential |= is_needed
    kept = None
    with suppress(OSError):  # no temporary folder
        kept = choose_folder()
    if kept is None:
        problems.append("compiled code is not kept (NUMBA_CACHE_DIR)")
    remedy = "set these variables to folders that this user can write"
    if find_container():
        remedy += ", such as a volume or docker run --tmpfs /tmp"
    detail = "; ".join(problems) or "writable"
    return Finding("folders", not problems, detail, remedy, is_essential)


def check_hid_nodes() -> Finding:
    """Check that haptic devices can be opened.

    Their report descriptor begins with joystick, gamepad or multi-axis controller; keyboards and
    mice are ignored.
    """
    nodes = sorted(filter(_is_stick, HID_NODES.glob("hidraw*")))
    in_container = bool(find_container())
    hidden = [place.name for place in HID_DESCRIPTORS.glob("*") if _is_stick(place)]
    if hidden and not nodes and in_container:
        return Finding(
            "haptic devices", False, f"not in this container: {' '.join(sorted(hidden))}",
            f"docker run --device /dev/{min(hidden)} ...",
        )  # fmt: skip
    denied = [node.name for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if not nodes:
        return Finding("haptic devices", True, "none attached; the virtual device needs none")
    detail = f"{len(nodes)} attached" + (f", no permission: {' '.join(denied)}" if denied else "")
    remedy = REMEDY
    if in_container:
        remedy = f"on the machine outside, where udev runs: {REMEDY}"
    return Finding("haptic devices", not denied, detail, remedy)


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
    check_machine,
    check_python_version,
    check_packages,
    check_processors,
    check_real_time,
    check_timing,
    check_clock,
    check_screen,
    check_hid_nodes,
    check_serial_ports,
    check_folders,
    check_disk,
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop doctor`."""
    parser.add_argument(
        "--startup", action="store_true", help="measure a start of both sides instead, by package"
    )


def main(args: argparse.Namespace) -> int:
    """Run all checks and print them, or measure a start."""
    if args.startup:
        for side in ("slave", "master"):
            print("\n".join(format_startup(side, *measure_startup(side))), flush=True)
        return 0
    findings = [check() for check in CHECKS]
    width = max(len(finding.what) for finding in findings)
    for finding in findings:
        mark = "ok  " if finding.good else ("FAIL" if finding.essential else "note")
        remedy = "" if finding.good or not finding.remedy else f"  -> {finding.remedy}"
        print(f"{mark}  {finding.what:{width}}  {finding.detail}{remedy}")
    missing = [finding for finding in findings if not finding.good]
    if any(finding.essential for finding in missing):
        print("Not ready.")
        return 1
    late = ", ".join(finding.what for finding in missing if finding.delays)
    reserve = f", but forces may be late here (see {late})" if late else ""
    print(f"Ready{reserve}: teleop run --config configs/demo.yaml")
    return 0


# --- where the time of a start goes

_IMPORT_LINE = re.compile(r"^import time:\s*(\d+) \|\s*\d+ \|\s*([\w]+)", re.MULTILINE)
_PACKAGES_SHOWN = 8


def measure_startup(side: str) -> tuple[float, float, Counter[str]]:
    """Start a side of a session until it would open its hardware; return where the time went.

    The times of a start that compiled first [s], 0 if all was compiled, and of one with compiled
    code [s]; of that the import time of each package [us], without what the package itself imports.
    """
    first_s = 0.0
    while True:
        begin_s = time.monotonic()
        process = start_module(
            "teleop",
            side,
            environment={STANDBY_VARIABLE: "1", "PYTHONPROFILEIMPORTTIME": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        output, log = process.communicate()
        total_s = time.monotonic() - begin_s
        if process.returncode:
            raise TeleopError(f"teleop {side} did not start: {log.strip().splitlines()[-1]}")
        if first_s or "compiling" not in output:
            break
        first_s = total_s
    imports: Counter[str] = Counter()
    for microseconds, package in _IMPORT_LINE.findall(log):
        imports[package] += int(microseconds)
    return first_s, total_s, imports


def format_startup(side: str, first_s: float, total_s: float, imports: Counter[str]) -> list[str]:
    """Return the lines that tell where the time of a start went."""
    shown = imports.most_common(_PACKAGES_SHOWN)
    others_us = imports.total() - sum(microseconds for _, microseconds in shown)
    rest_s = total_s - imports.total() * 1e-6
    rows = [(f"import {package}", microseconds * 1e-6) for package, microseconds in shown]
    rows += [("other imports", others_us * 1e-6), ("load compiled code, and the rest", rest_s)]
    first = f"; the first start, which compiled: {first_s:.1f} s" if first_s else ""
    return [
        f"{side}: {total_s:.2f} s until it opens its hardware{first}",
        *(f"  {seconds:6.2f} s  {what}" for what, seconds in rows),
    ]
