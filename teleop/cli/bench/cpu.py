"""Processor time of a running process and of its children, from /proc."""

import os
import time
from pathlib import Path
from typing import NamedTuple

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class CpuSample(NamedTuple):
    """Processor time [s] of each process by its id, all threads, and the time of reading [s]."""

    time_s: float
    used_s: dict[int, float]


def find_children(parent: int) -> dict[str, int]:
    """Return the ids of `teleop COMMAND` processes that `parent` has started, by the command."""
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdecimal():
            continue
        try:
            if int(_read_stat_fields(int(folder.name))[1]) != parent:
                continue
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except (FileNotFoundError, ProcessLookupError):  # it has ended
            continue
        if b"teleop" in words:
            found[words[words.index(b"teleop") + 1].decode()] = int(folder.name)
    return found


def sample_cpu_time(processes: dict[str, int]) -> CpuSample:
    """Read the processor time of the running processes."""
    used = {}
    for process in processes.values():
        try:
            fields = _read_stat_fields(process)
        except (FileNotFoundError, ProcessLookupError):  # it has ended
            continue
        used[process] = (int(fields[11]) + int(fields[12])) * _TICK_S
    return CpuSample(time.monotonic(), used)


def compute_cpu_load(
    processes: dict[str, int], before: CpuSample, after: CpuSample
) -> dict[str, float]:
    """Return the CPU load [% of a core] of each process between two samples."""
    span = after.time_s - before.time_s
    return {
        name: 100.0 * (after.used_s[process] - before.used_s[process]) / span
        for name, process in processes.items()
        if process in after.used_s and process in before.used_s
    }


def _read_stat_fields(process: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name: state, parent, ...; see proc(5)."""
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
