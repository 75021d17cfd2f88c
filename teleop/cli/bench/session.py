"""Run one session of `teleop run`: its summary and the CPU load of its processes."""

import json
import os
import subprocess
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import TeleopError
from teleop.launch.supervisor import ERROR_PREFIX
from teleop.runtime.child_process import end_process, start_module
from teleop.session.own_endpoints import find_free_ports

# --- processor time of a running process and of its children, from /proc

_END_S = 30.0  # [s] until a session that was told to end is killed
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class CpuSample(NamedTuple):
    """Processor time [s] of each process by its id, all threads, and the time of reading [s]."""

    time_s: float
    used_s: dict[int, float]


def find_children(parent: int) -> dict[str, int]:
    """Return the ids of `teleop COMMAND` processes that `parent` has started, by the command."""
    children = {}
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
            children[words[words.index(b"teleop") + 1].decode()] = int(folder.name)
    return children


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


SIDES = ("slave", "master")
START_S = 300.0  # timeout with an empty compile cache, on a busy machine
_SETTLE_S = 0.5  # after engaging, and before the end
_ENGAGED = "[master] engaged"  # in a line that begins with the time


class SessionMeasurement(NamedTuple):
    """Result of a session."""

    summary: dict[str, Any]  # of `teleop run --json`
    cpu: dict[str, float]  # share of a core [%] by process: run, slave, master


def run_session(config: Path, seconds: float) -> SessionMeasurement:
    """Run an engaged session of `seconds` [s]; `TeleopError` if it does not engage."""
    with ExitStack() as stack:
        out = config.with_suffix(".summary.json")
        master, slave = find_free_ports(2)
        words = [
            *("--config", str(config), "--view", "none", "--duration", str(seconds)),
            *("--json", str(out), "--force", "--set", f"session=bench-{os.getpid()}"),
            *("--set", f"link.master=127.0.0.1:{master}"),
            *("--set", f"link.slave=127.0.0.1:{slave}"),
        ]
        process = stack.enter_context(
            start_module(
                "teleop", "run", *words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        )
        stack.callback(end_process, process, _END_S)  # if it is killed, its children end too
        output = _SessionOutput(process)
        output.await_engaged()
        time.sleep(_SETTLE_S)
        processes = {"run": process.pid, **find_children(process.pid)}
        before = sample_cpu_time(processes)
        time.sleep(max(seconds - 2 * _SETTLE_S, _SETTLE_S))
        after = sample_cpu_time(processes)
        output.await_end(seconds)
        summary = json.loads(out.read_text())
        for side in SIDES:
            if summary.get(side) is None:
                raise TeleopError(
                    f"the {side} of the session to measure was killed: {output.last()}"
                )
        return SessionMeasurement(summary, compute_cpu_load(processes, before, after))


class _SessionOutput:
    """Reads the output of a session."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self._lines: list[str] = []
        self._engaged = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def await_engaged(self) -> None:
        """Wait until the session is engaged."""
        in_time = self._engaged.wait(START_S)
        if not in_time or not any(_ENGAGED in line for line in self._lines):
            raise TeleopError(f"the session to measure did not engage: {self.last()}")

    def await_end(self, seconds: float) -> None:
        """Wait for the end of the session."""
        try:
            code = self._process.wait(seconds + START_S)
        except subprocess.TimeoutExpired as error:
            raise TeleopError("the session to measure did not end") from error
        self._reader.join()
        if code:
            raise TeleopError(f"the session to measure failed: {self.last()}")

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self._lines.append(line.rstrip())
            if _ENGAGED in line or line.startswith(ERROR_PREFIX):
                self._engaged.set()
        self._engaged.set()

    def last(self) -> str:
        complaints = [line for line in self._lines if line.startswith(ERROR_PREFIX)] or self._lines
        return complaints[-1].removeprefix(ERROR_PREFIX) if complaints else "no output"
