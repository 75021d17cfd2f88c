"""Child processes: started together, watched, and ended in order."""

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

VITAL = ("master", "slave", "impair")  # a session does without the others
COMPLAINT = "teleop: "  # what the command line begins the one line of an error with
_PATIENCE_S = 5.0  # a child that has not ended by then, nor said a word since, is killed
_LONGEST_S = 90.0  # and so is one that goes on talking
_POLL_S = 0.02
_READ_S = 1.0  # what a child that has ended still had to say is there by then


@dataclass
class Child:
    """One of our processes."""

    name: str
    process: subprocess.Popen[str]
    summary: Path
    complaint: str = ""  # the one line of an error, which the launcher says at the end
    threads: list[threading.Thread] = field(default_factory=list)
    heard_s: float = field(default_factory=time.monotonic)  # when it was started, or spoke last

    @property
    def exit_code(self) -> int | None:
        """Exit code, negative for a signal, None while it runs."""
        return self.process.poll()

    @property
    def fatal(self) -> bool:
        """Whether its end is that of the session: it was vital, or wrongly called (by us)."""
        code = self.exit_code
        return code is not None and (self.name in VITAL or code == UsageError.exit_code)

    def hear_out(self) -> None:
        """Wait for the last of what a child that has ended had printed."""
        for thread in self.threads:
            thread.join(_READ_S)

    def how(self) -> str:
        """Return in what way it ended."""
        code = self.exit_code or 0
        return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"


class Supervisor:
    """Starts children with `teleop COMMAND ...`, relays what they print, and ends them.

    Children live in sessions of their own, so that Ctrl-C reaches the launcher alone and it decides
    the order of ending. Each child ends by itself when the launcher is gone (`die_with_launcher`).

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
        """Return a child whose end is that of the session; say of any other that it is gone."""
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
        """End the children in `order`, each given time to finish its work.

        One that still has something to say has more of it: a slave lets tensions down first.
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
    """Return whether a child that was asked to end does, before patience with it is lost."""
    asked_s = time.monotonic()
    while child.exit_code is None:
        patience_s = max(asked_s, child.heard_s) + _PATIENCE_S
        if time.monotonic() > min(patience_s, asked_s + _LONGEST_S):
            return False
        time.sleep(_POLL_S)
    return True


def wait_for(condition: Callable[[], bool], timeout_s: float, poll_s: float = 0.02) -> bool:
    """Wait until `condition` holds; return whether it came to hold in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end:
            return False
        time.sleep(poll_s)
    return True
