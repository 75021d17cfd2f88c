"""Start, supervise and stop child processes."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from teleop.errors import UsageError
from teleop.process import SUPERVISED

VITAL = ("master", "slave", "impair")  # the session continues without the others
COMPLAINT = "teleop: "  # prefix of an error line of the command line
_PATIENCE_S = 5.0  # a child that has not ended by then, nor printed since, is killed
_LONGEST_S = 90.0  # and so is one that keeps printing
_POLL_S = 0.02
_READ_S = 1.0  # time to read the remaining output of an ended child


@dataclass
class Child:
    """A child process."""

    name: str
    process: subprocess.Popen[str]
    summary: Path
    complaint: str = ""  # its error line, which the launcher repeats at the end
    threads: list[threading.Thread] = field(default_factory=list)
    heard_s: float = field(default_factory=time.monotonic)  # when it started or last printed

    @property
    def exit_code(self) -> int | None:
        """Exit code, negative for a signal, None while it runs."""
        return self.process.poll()

    @property
    def fatal(self) -> bool:
        """Whether its end is that of the session: it is vital, or failed by a usage error."""
        code = self.exit_code
        return code is not None and (self.name in VITAL or code == UsageError.exit_code)

    def hear_out(self) -> None:
        """Wait for the remaining output of an ended child."""
        for thread in self.threads:
            thread.join(_READ_S)

    def how(self) -> str:
        """Return how it ended, as text."""
        code = self.exit_code or 0
        return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"


class Supervisor:
    """Starts children with `teleop COMMAND ...`, relays what they print, and ends them.

    Children run in their own process sessions, so that Ctrl-C reaches only the launcher, which
    stops them in order. Each child ends by itself if the launcher dies (`die_with_launcher`).

    Parameters
    ----------
    scratch : Path
        Folder for the children's summaries.
    say : callable
        Called with (child name, line) for each line a child prints, from a reader thread.
    """

    def __init__(self, scratch: Path, say: Callable[[str, str], None]) -> None:
        self.children: dict[str, Child] = {}
        self._scratch, self._say = scratch, say
        self._missed: set[str] = set()

    def start(self, name: str, arguments: Sequence[str]) -> Child:
        """Start `teleop NAME ARGUMENTS --json ...`."""
        summary = self._scratch / f"{name}.json"
        process = subprocess.Popen(
            [sys.executable, "-m", "teleop", name, *arguments, "--json", str(summary)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {SUPERVISED: str(os.getpid()), "NO_COLOR": "1"},
            start_new_session=True,
        )
        child = Child(name, process, summary)
        reader = threading.Thread(target=self._relay, args=(child,), daemon=True)
        reader.start()
        child.threads.append(reader)
        self.children[name] = child
        return child

    def casualty(self) -> Child | None:
        """Return a child whose end ends the session; print a line for any other that ended."""
        for child in self.children.values():
            if child.exit_code is None or child.name in self._missed:
                continue
            child.hear_out()
            if child.fatal:
                return child
            self._missed.add(child.name)
            why = child.complaint or f"ended {child.how()}"
            self._say(child.name, f"{why}; the session goes on")
        return None

    def stop(self, order: Sequence[str]) -> None:
        """Stop the children in `order`, with time to finish.

        A child that still prints has more time: a slave lowers the tensions first.
        """
        for name in order:
            child = self.children.get(name)
            if child is None:
                continue
            if child.exit_code is None:
                child.process.terminate()
            if not ends(child):
                self._say(name, f"did not end within {_PATIENCE_S:g} s and was killed")
                child.process.kill()
                child.process.wait()
            child.hear_out()

    def _relay(self, child: Child) -> None:
        assert child.process.stdout is not None  # noqa: S101 - given as PIPE above
        with child.process.stdout as lines:
            for line in map(str.rstrip, lines):
                child.heard_s = time.monotonic()
                if line.startswith(COMPLAINT):
                    child.complaint = line.removeprefix(COMPLAINT)
                else:
                    self._say(child.name, line)


def ends(child: Child) -> bool:
    """Return whether a child told to stop ends within its timeout."""
    asked_s = time.monotonic()
    while child.exit_code is None:
        patience_s = max(asked_s, child.heard_s) + _PATIENCE_S
        if time.monotonic() > min(patience_s, asked_s + _LONGEST_S):
            return False
        time.sleep(_POLL_S)
    return True


def wait_for(condition: Callable[[], bool], timeout_s: float, poll_s: float = 0.02) -> bool:
    """Wait until `condition` holds; return whether it does in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end:
            return False
        time.sleep(poll_s)
    return True
