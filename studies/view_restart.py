"""Rates of the loops and cost of the view while its page is opened, reloaded, and the view killed.

  python studies/view_restart.py [CONFIG [SECONDS]]     configs/demo.yaml, 10 s of each state

One session runs with a view and a recorder (`teleop run --view web`). In turn there is no page, a
page in a headless Chromium, one that is reloaded every few seconds, and a view that is killed every
few seconds. The recording tells the rate and the period of both loops in each state, /proc the
processor time of the view, and the page's own address how long the view was away. Chromium draws by
software, at the lowest priority: what it takes from a small machine is no cost of the view.
"""

import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

import numpy as np

from studies.testbed import browser
from teleop.recording.reader import read_columns
from teleop.runtime.clock import now_ns
from teleop.runtime.process import STANDBY_VARIABLE
from teleop.view.local_server import WEB_VIEW, find_free_port

ROOT = Path(__file__).parents[1]
EVERY_S = 5.0  # [s] between reloads, and kills
START_S = 300.0  # [s] in which the session must have engaged
AWAY_S = 30.0  # [s] in which a killed view must be back
Span = tuple[int, int, float]  # begin and end [ns], processor time of the view [s]


class Run:
    """A session that runs, and what it prints."""

    def __init__(self, config: Path, folder: Path) -> None:
        words = ["run", "--config", str(config), "--view", "web", "--record", str(folder)]
        for text in (
            "session=view-restart",
            *(f"link.{side}=127.0.0.1:{find_free_port(0)}" for side in ("master", "slave")),
        ):
            words += ["--set", text]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "teleop", *words], stdout=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None  # noqa: S101 - a pipe, above
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    @property
    def address(self) -> str:
        """Where its page is; empty until it has said so."""
        found = (line.partition(WEB_VIEW)[2] for line in self.lines if WEB_VIEW in line)
        return next(found, "")

    def engaged(self) -> bool:
        """Return whether it has said so."""
        return any("engaged" in line for line in self.lines)

    def instance(self) -> str:
        """Return which view answers; empty if none does."""
        asked = self.address + "blocks?older=1"  # answered at once
        try:
            with urllib.request.urlopen(asked, timeout=1.0) as answer:  # noqa: S310
                return str(json.loads(answer.headers["X-View"])["instance"])
        except (urllib.error.URLError, OSError, ValueError):
            return ""

    def view(self) -> int:
        """Return the process id of the view: the one of `teleop view` that is no spare."""
        end = time.monotonic() + AWAY_S
        while (pid := self._view()) is None:
            if time.monotonic() > end:
                raise SystemExit(f"no view within {AWAY_S:g} s")
            time.sleep(0.1)
        return pid

    def _view(self) -> int | None:
        text = subprocess.run(
            ["ps", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True
        ).stdout
        rows = [line.split(None, 2) for line in text.splitlines()]
        views = {pid for pid, parent, words in rows if parent == str(self.process.pid)
                 and " view " in words}  # fmt: skip
        found = (int(pid) for pid in views if STANDBY_VARIABLE.encode() not in environment_of(pid))
        return next(found, None)

    def processor_s(self) -> float:
        """Return the processor time [s] that the view has used."""
        fields = Path(f"/proc/{self.view()}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def kill_view(self) -> float:
        """Kill the view; return the time [s] until another answers; infinite if none does."""
        before, begin = self.instance(), time.monotonic()
        os.kill(self.view(), signal.SIGKILL)
        while time.monotonic() - begin < AWAY_S:
            now = self.instance()
            if now and now != before:
                return time.monotonic() - begin
            time.sleep(0.02)
        return math.inf


def environment_of(pid: str) -> bytes:
    return Path(f"/proc/{pid}/environ").read_bytes()


def main(config: str = str(ROOT / "configs" / "demo.yaml"), seconds: str = "10") -> None:
    with tempfile.TemporaryDirectory(prefix="view-restart-") as folder:
        run = Run(Path(config), Path(folder))
        try:
            wait(run.engaged, START_S)
            wait(lambda: bool(run.instance()), START_S)
            spans, away = states(run, float(seconds))
        finally:
            run.process.send_signal(signal.SIGINT)
            run.process.wait(60)
        (recording,) = Path(folder).glob("*.mcap")
        report(recording, spans)
    print("killed, back after [s]: " + ", ".join(f"{value:.2f}" for value in away))
    print("load average: " + " ".join(f"{value:.1f}" for value in os.getloadavg()))
    print("\n".join(line for line in run.lines if re.search("started again", line)))


def states(run: Run, seconds: float) -> tuple[dict[str, Span], list[float]]:
    """Go through the states; return when and at what cost, and how long the view was away."""
    spans: dict[str, Span] = {}
    away: list[float] = []

    def measured(state: str, act: Callable[[], object], kills: bool = False) -> None:
        begin, used = now_ns(), 0.0 if kills else run.processor_s()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(min(EVERY_S, max(0.0, end - time.monotonic())))
            act()
        spent = -1.0 if kills else run.processor_s() - used  # below 0: another process by then
        spans[state] = begin, now_ns(), spent

    measured("no page", lambda: None)
    if browser.program() is not None:
        with browser.Browser() as page:
            os.setpriority(os.PRIO_PGRP, page.pid, 19)
            page.open(run.address + "?renderer=webgl")
            measured("page", lambda: None)
            measured("page reloaded", lambda: page.open(run.address + "?renderer=webgl"))
    measured("view killed", lambda: away.append(run.kill_view()), kills=True)
    return spans, away


def report(recording: Path, spans: dict[str, Span]) -> None:
    """Print the rate and the period of both loops, and the processor time, in each state."""
    print(f"{'':16}{'loop':>8}{'rate [Hz]':>11}{'p50':>8}{'p99':>8}{'p99.9 [ms]':>12}{'view':>12}")
    stamps = {
        "master": read_columns(recording, "hand", ["stamp_ns"])["stamp_ns"],
        "slave": read_columns(recording, "state", ["stamp_ns"])["stamp_ns"],
    }
    for state, (begin, end, spent) in spans.items():
        share = f"{1e11 * spent / (end - begin):.1f} %" if spent >= 0 else "-"
        for loop, all_stamps in stamps.items():
            inside = all_stamps[(all_stamps >= begin) & (all_stamps < end)]
            rate = (len(inside) - 1) / (inside[-1] - inside[0]) * 1e9
            p50, p99, p999 = np.percentile(np.diff(inside), [50, 99, 99.9]) * 1e-6
            print(f"{state:16}{loop:>8}{rate:11.1f}{p50:8.2f}{p99:8.2f}{p999:12.2f}{share:>12}")


def wait(condition: Callable[[], bool], timeout_s: float) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"nothing within {timeout_s:g} s")
        time.sleep(0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
