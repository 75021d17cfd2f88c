"""Where the processor time of a session goes: microseconds and wake-ups of each thread, by the ms.

  python -m studies.tick [--seconds 20] [--config FILE]

Recorder, slave and master run as in `teleop run --record`, without a view. The kernel counts the
time of each thread (/proc/PID/task/TID/schedstat). Threads of Zenoh have names: rx, tx, acc (of
accepted connections), net; those of Python are called `python`, the loop's own first. A thread that
waits for a processor counts nothing, but other load makes each microsecond longer: compare only
runs that take turns. Then the same of the messages alone, over bare Zenoh: the least that a session
could use. Takes twice `--seconds` and 20 s, with an empty compile cache a minute more.
"""

import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from studies.testbed.bare_zenoh import run_bare_traffic
from studies.testbed.command import parse_options
from studies.testbed.processes import DEMO_CONFIG, Processes, pause

SETTLE_S, CONNECT_S = 1.0, 4.0
SHOWN_MIN_US = 0.5  # threads of less are in the sum only


class Thread(NamedTuple):
    """What a thread has used."""

    name: str
    used_us: float
    wake_ups: int


def main() -> None:
    options = parse_options(
        __doc__,
        seconds=(20.0, "of the measurement [s]"),
        config=(DEMO_CONFIG, "of a session on a simulated rig"),
    )
    with (
        tempfile.TemporaryDirectory(prefix="tick-") as folder,
        Processes(Path(folder), options.config) as session,
    ):
        session.start_all()
        pause(SETTLE_S)
        print_processes(session.running, options.seconds)
        for command in reversed(session.running):
            session.stop(command, 60.0)
        for side in ("slave", "master"):
            summary = session.summary(side)
            figures = {key: round(summary[key], 2) for key in ("rate_hz", "ticks", "overruns")}
            print(side, *(f"{key} {value}" for key, value in figures.items()))
        print("command to force [ms]", session.summary("master")["latency_ms"])
    print("\nbare Zenoh")
    with run_bare_traffic() as running:
        pause(CONNECT_S)
        print_processes(running, options.seconds)


def print_processes(processes: Mapping[str, subprocess.Popen[bytes]], seconds: float) -> None:
    """Print what the threads of processes use in the next `seconds` [s]."""
    pids = {command: process.pid for command, process in processes.items()}
    begin, before = time.monotonic(), {c: read_threads(pid) for c, pid in pids.items()}
    pause(seconds)
    passed_ms = 1000.0 * (time.monotonic() - begin)
    print(f"{'':8}{'thread':>10}{'us/ms':>9}{'wake-ups/ms':>13}")
    for command, pid in pids.items():
        print_threads(command, before[command], read_threads(pid), passed_ms)


def read_threads(pid: int) -> dict[int, Thread]:
    """Return what the threads of a process have used so far, by their id."""
    threads = {}
    for task in sorted(Path(f"/proc/{pid}/task").iterdir(), key=lambda task: int(task.name)):
        status = (task / "status").read_text().split()
        used_ns = (task / "schedstat").read_text().split()[0]
        wake_ups = status[status.index("voluntary_ctxt_switches:") + 1]
        name = (task / "comm").read_text().strip()
        threads[int(task.name)] = Thread(name, int(used_ns) * 1e-3, int(wake_ups))
    return threads


def print_threads(
    command: str, before: dict[int, Thread], after: dict[int, Thread], passed_ms: float
) -> None:
    """Print what was used in each millisecond, by each thread and by all together."""
    total = 0.0
    for number, thread in after.items():
        known = before.get(number, Thread(thread.name, 0.0, 0))
        used_us = (thread.used_us - known.used_us) / passed_ms
        total += used_us
        if used_us >= SHOWN_MIN_US:
            wake_ups = (thread.wake_ups - known.wake_ups) / passed_ms
            print(f"{command:8}{thread.name:>10}{used_us:9.1f}{wake_ups:13.2f}")
    print(f"{command:8}{'all':>10}{total:9.1f}")


if __name__ == "__main__":
    main()
