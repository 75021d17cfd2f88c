"""Drive virtual devices with the project's own drivers, through a Linux kernel of their own.

  python -m studies.kernel                        what `make test-kernel` does: HID devices, CAN
  python -m studies.kernel arduino dualsense      these HID devices only
  python -m studies.kernel can                    CiA 402 drives on SocketCAN only
  python -m studies.kernel --by-the-wall          in real time, on an idle machine

Boots virtual machines (qemu, in software) that make the devices and drive them, and prints what
they found. Exit code 1 if anything is not as it must be, 2 if there can be no such machine.
Takes 210 s of processor, in two machines; the first run downloads qemu and two of Debian's kernels.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from studies.kernel import image
from studies.kernel.cases import CASES
from studies.kernel.machine import CAN, Machine, MissingError, find_emulator, find_kernel

_LATE = ("hidraw", "multiprocessing.popen_fork", "encodings.utf_8_sig")  # imported while it runs
_LATE_CAN = (  # imported by the driver's process and that of the drives
    "studies.rigs.model",
    "can.interfaces.socketcan",
    "numpy.random",
    "slave.drivers.cia402.driver",
    "slave.drivers.cia402.bring_up",
    "slave.drivers.worker",
    "encodings.utf_8_sig",
    "runpy",
)
CAN_CHECKS = "can"
SILENCE_MAX_S = 120.0  # of the processor's time that a machine works without a result
HANGING_S = 120.0  # of the wall in which it gets no work done at all


def run(names: list[str], by_the_wall: bool, folder: Path) -> int:
    """Try these devices; return how much has failed."""
    start = time.monotonic()
    qemu = find_emulator()
    devices = [name for name in names if name != CAN_CHECKS]
    results: list[dict[str, Any]] = []
    with ExitStack() as running:
        machines = []
        if devices:
            vmlinuz, modules = find_kernel()
            initrd = folder / "initrd"
            initrd.write_bytes(image.build_image("studies.kernel.hid_guest", _LATE, modules))
            machines.append((vmlinuz, initrd, f"devices={','.join(devices)}"))
        if CAN_CHECKS in names:
            vmlinuz, modules = find_kernel(CAN)
            initrd = folder / "initrd-can"
            initrd.write_bytes(image.build_image("studies.kernel.can_guest", _LATE_CAN, modules))
            machines.append((vmlinuz, initrd, ""))
        guests = [
            running.enter_context(Machine(qemu, *one, folder / str(k), by_the_wall))
            for k, one in enumerate(machines)
        ]
        for line in follow(guests):
            results.append(line)
            _show(line)
        if failed := sum("trouble" in line for line in results):
            print(*(guest.console for guest in guests), sep="\n")
    print(f"{len(results)} checks, {failed} failed, {time.monotonic() - start:.0f} s")
    return failed


def follow(machines: Sequence[Machine]) -> Iterator[dict[str, Any]]:
    """Yield each result as it comes, and one for each machine that did not come to its end.

    A machine is given up that has worked for `SILENCE_MAX_S` without a result, however long a busy
    host took over that.
    """
    heard = [(time.monotonic(), machine.worked_s) for machine in machines]
    worked = list(heard)
    last = ["the start"] * len(machines)
    left = set(range(len(machines)))
    while left:
        for k in sorted(left):
            runs = machines[k].runs  # before its news: what it said at its end is not missed
            for line in machines[k].take_news():
                heard[k] = time.monotonic(), machines[k].worked_s
                last[k] = f"{line.get('device', '')} {line['check']}".strip()
                yield line
            now_s, work_s = time.monotonic(), machines[k].worked_s
            if work_s > worked[k][1]:
                worked[k] = now_s, work_s
            silent_s, worked_s = now_s - heard[k][0], work_s - heard[k][1]
            if runs and worked_s < SILENCE_MAX_S and now_s - worked[k][0] < HANGING_S:
                continue
            left.remove(k)
            if last[k] != "end":
                why = f"no result for {silent_s:.0f} s, {worked_s:.0f} s of work"
                why = why if runs else "it ended too early"
                trouble = f"machine {k + 1} did not come to its end: {why}, after {last[k]}"
                yield {"check": "end", "trouble": trouble}
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
        prog="python -m studies.kernel",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    known = [*(case.name for case in CASES), CAN_CHECKS]
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
