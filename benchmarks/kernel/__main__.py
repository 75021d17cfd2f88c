"""Drive virtual HID devices with the project's own drivers, through a Linux kernel of their own.

  python -m benchmarks.kernel                        what `make test-kernel` does
  python -m benchmarks.kernel arduino dualsense      these devices only
  python -m benchmarks.kernel --by-the-wall          in real time, on an idle machine

Boots virtual machines (qemu, in software) that make the devices and drive them, and prints what
they found. Exit code 1 if anything is not as it must be, 2 if there can be no such machine.
"""

import argparse
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from benchmarks.kernel import image
from benchmarks.kernel.cases import CASES
from benchmarks.kernel.kernel import MissingError, emulator, kernel
from benchmarks.kernel.machine import Machine

_LATE = ("hidraw", "multiprocessing.popen_fork", "encodings.utf_8_sig")  # imported while it runs
_PATIENCE = 400.0  # [s]
_MACHINES_MAX = 2


def run(names: list[str], by_the_wall: bool, folder: Path) -> int:
    """Try these devices; return how much has failed."""
    qemu = emulator()
    vmlinuz, modules = kernel()
    initrd = folder / "initrd"
    initrd.write_bytes(image.build("benchmarks.kernel.guest", _LATE, modules))
    count = 1 if by_the_wall else min(_MACHINES_MAX, len(names), os.cpu_count() or 1)
    results: list[dict[str, Any]] = []
    with ExitStack() as running:
        machines = [
            running.enter_context(
                Machine(
                    qemu,
                    vmlinuz,
                    initrd,
                    f"devices={','.join(names[k::count])}",
                    folder / str(k),
                    by_the_wall,
                )
            )
            for k in range(count)
        ]
        _follow(machines, results)
        if sum(line["check"] == "end" for line in results) < count:
            results.append({"check": "end", "trouble": "a machine did not come to its end"})
            _show(results[-1])
        if failed := sum("trouble" in line for line in results):
            print(*(machine.console for machine in machines), sep="\n")
    print(f"{len(results)} checks, {failed} failed")
    return failed


def _follow(machines: list[Machine], results: list[dict[str, Any]]) -> None:
    """Print and keep each line as it comes."""
    end = time.monotonic() + _PATIENCE
    running = True
    while running and time.monotonic() < end:
        running = any(machine.runs for machine in machines)
        for line in [line for machine in machines for line in machine.news()]:
            results.append(line)
            _show(line)
        time.sleep(0.1)


def _show(line: dict[str, Any]) -> None:
    if "trouble" in line:
        what = f"FAILED: {line['trouble']}"
    else:
        what = ", ".join(f"{name} {value}" for name, value in line["figures"].items())
    print(f"{line.get('device', ''):18} {line['check']:14} {what}", flush=True)


def main() -> int:
    """Return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.kernel",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    known = [case.name for case in CASES]
    parser.add_argument("device", nargs="*", help=f"any of {', '.join(known)}; none means all")
    parser.add_argument("--by-the-wall", action="store_true", help="take the time from the wall")
    args = parser.parse_args()
    if unknown := set(args.device) - set(known):
        parser.error(f"no device {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    print(f"load of this machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    try:
        with tempfile.TemporaryDirectory(prefix="kernel-") as folder:
            failed = run(args.device or known, args.by_the_wall, Path(folder))
    except MissingError as error:
        print(error, file=sys.stderr)
        return 2
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
