"""What `teleop run` shows in the terminal: events with their time, the status, the summary."""

import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any, Self

from rich.table import Table
from rich.text import Text

from teleop.link.health import format_link_health
from teleop.messages.messages import Latency, LinkReport, LoopReport, SlaveState
from teleop.messages.topics import Role
from teleop.runtime.status_line import StatusLine
from teleop.session.state_machine import Reason, State
from teleop.session.summary import SessionSummary, build_loop_figures, format_summary

# --- single keys of the launcher's terminal: space is the emergency stop

KEY_HELP = "space: emergency stop, r: reset it, Ctrl-C: end"


class KeyReader:
    """Context manager that reads single keys; none without a controlling terminal."""

    def __init__(self) -> None:
        self._terminal = -1
        self._before: list[Any] = []

    def __enter__(self) -> Self:
        if sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp():
            self._terminal = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)  # single keys without echo; Ctrl-C still works
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal >= 0:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
            self._terminal = -1

    @property
    def there(self) -> bool:
        """Whether keys can be read."""
        return self._terminal >= 0

    def wait(self, seconds: float) -> str:
        """Return the keys pressed within `seconds` [s], as soon as there are any."""
        if not self.there:
            time.sleep(seconds)
            return ""
        if not select.select([self._terminal], [], [], seconds)[0]:
            return ""
        pressed = os.read(self._terminal, 64)
        if not pressed:  # the terminal was closed
            self._terminal = -1
        return pressed.decode(errors="replace")


_STYLES = {
    State.ENGAGED: "bold green", State.HOLDING: "bold yellow", State.FAULT: "bold white on red",
    State.STOPPED: "bold white on red", State.CLUTCHED: "bold cyan", State.READY: "bold blue",
}  # fmt: skip


class RepeatFilter:
    """Collapses lines that a source repeats: the first is printed, the others are counted."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[str, int]] = {}  # by source: its last line, and how often

    def take(self, source: str, text: str) -> list[str]:
        """Return the lines to print for one more line of a source."""
        last, count = self._last.get(source, ("", 0))
        if text == last:
            self._last[source] = (text, count + 1)
            return []
        self._last[source] = (text, 1)
        return [*_format_repeats(last, count), text]

    def flush(self) -> list[tuple[str, str]]:
        """Return (source, line) of what is still only counted, and forget it."""
        lines = [
            (source, line)
            for source, repeats in self._last.items()
            for line in _format_repeats(*repeats)
        ]
        self._last.clear()
        return lines


def _format_repeats(text: str, count: int) -> list[str]:
    return [f"{text} ({count} times)"] if count > 1 else []


def format_time_of_day() -> str:
    """Return the local time to a tenth of a second."""
    return datetime.now().astimezone().strftime("%H:%M:%S.%f")[:-5]


class Console:
    """Prints lines of sources with their time, repeats collapsed, above a status line."""

    def __init__(self, status: StatusLine, clock: Callable[[], str] = format_time_of_day) -> None:
        self.status = status
        self._clock = clock
        self._repeats = RepeatFilter()
        self._lock = threading.Lock()

    def say(self, source: str, text: str) -> None:
        """Print a line of a source, from any thread."""
        with self._lock:
            lines = self._repeats.take(source, text)
        for line in lines:
            self._print(source, line)

    def finish(self) -> None:
        """Remove the status line, and print what was only counted."""
        self.status.clear()
        with self._lock:
            remaining = self._repeats.flush()
        for source, line in remaining:
            self._print(source, line)

    def _print(self, source: str, line: str) -> None:
        self.status.say(f"{self._clock()} [{source}] {line}")

    def summarise(self, summary: SessionSummary) -> None:
        """Print the summary of the session: in a terminal its loops as a table."""
        if self.status.live:
            table = build_summary_table(summary)
            if table.row_count:
                self.status.say(table)
        for line in format_summary(summary, with_loops=not self.status.live):
            self.status.say(line)


def build_summary_table(summary: SessionSummary) -> Table:
    """Return the figures of both loops as a table; without rows if none ran."""
    table = Table(title="Session")
    table.add_column("")
    for loop in summary.loops:
        table.add_column(loop.role.name.lower(), justify="right")
    columns = [build_loop_figures(loop) for loop in summary.loops]
    for name in columns[0] if columns else ():
        table.add_row(name, *(figures[name] for figures in columns))
    return table


def format_status(
    reports: Mapping[Role, LoopReport],
    state: SlaveState | None,
    latency: Latency | None = None,
    recorder: str = "",
    links: Mapping[Role, LinkReport] | None = None,
    insecure: bool = False,
) -> Text:
    """Return the status of a session in one line: state, force, rates, latency, losses.

    An `insecure` session says so first.
    """
    master, slave = reports.get(Role.MASTER), reports.get(Role.SLAVE)
    text = Text()
    if insecure:
        text.append("INSECURE", "bold white on red")
        text.append(" │ ")
    if master:
        now = State(master.state)
        text.append(now.name, _STYLES.get(now, "bold"))
    else:
        text.append("waiting for the master", "bold")
    if state and state.joints:
        text.append(" │ force " + " ".join(f"{f:.1f}" for f in state.force[: state.joints]) + " N")
    rates = [f"{report.rate_hz:.0f}" for report in (master, slave) if report]
    text.append(f" │ {' / '.join(rates)} Hz" if rates else " │ slave starting")
    if latency and latency.answered:
        text.append(f" │ latency {latency.p50_ns[-1] * 1e-6:.2f} ms")
        text.append(f" (99 %: {latency.p99_ns[-1] * 1e-6:.2f})")
    elif master and master.latency_p50_ns:
        text.append(f" │ latency {master.latency_p50_ns * 1e-6:.2f} ms")
        text.append(f" (99 %: {master.latency_p99_ns * 1e-6:.2f})")
    lost = sum(report.lost + report.rejected for report in (master, slave) if report)
    if rates:
        text.append(f" │ lost {lost}", "yellow" if lost else "")
    for link in (links or {}).values():
        if link.role == Role.MASTER or link.reason:
            is_bad = link.reason != Reason.NONE
            text.append(f" │ {format_link_health(link)}", "bold yellow" if is_bad else "")
    if recorder:
        text.append(f" │ {recorder}", "yellow" if "missing" in recorder else "")
    return text
