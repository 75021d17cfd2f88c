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

from teleop.process import SUPERVISED

COMPLAINT = "teleop: "  # what the command line begins the one line of an error with
_PATIENCE_S = 5.0  # a child that has not ended by then is killed


@dataclass
class Child:
    """One of our processes."""

    name: str
    process: subprocess.Popen[str]
    summary: Path
    complaint: str = ""  # the one line of an error, which the launcher says at the end
    threads: list[threading.Thread] = field(default_factory=list)

    @property
    def exit_code(self) -> int | None:
        """Exit code, negative for a signal, None while it runs."""
        return self.process.poll()


class Supervisor:
    """Starts children with `teleop COMMAND ...`, relays what they print, and ends them.

    Children live in sessions of their own, so that Ctrl-C reaches the launcher alone and it decides
    the order of ending. Each child ends by itself when the launcher is gone (`die_with_parent`).

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

    def start(self, name: str, arguments: Sequence[str]) -> Child:
        """Start `teleop NAME ARGUMENTS --json ...`."""
        summary = self._scratch / f"{name}.json"
        process = subprocess.Popen(
            [sys.executable, "-m", "teleop.cli", name, *arguments, "--json", str(summary)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {SUPERVISED: "1"},
            start_new_session=True,
        )
        child = Child(name, process, summary)
        reader = threading.Thread(target=self._relay, args=(child,), daemon=True)
        reader.start()
        child.threads.append(reader)
        self.children[name] = child
        return child

    def ended(self) -> list[Child]:
        """Return the children that have ended."""
        return [child for child in self.children.values() if child.exit_code is not None]

    def stop(self, order: Sequence[str]) -> None:
        """End the children in `order`, each given time to finish its work."""
        for name in order:
            child = self.children.get(name)
            if child is None:
                continue
            if child.exit_code is None:
                child.process.send_signal(signal.SIGINT)
            try:
                child.process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._say(name, f"did not end within {_PATIENCE_S:g} s and was killed")
                child.process.kill()
                child.process.wait()
            for thread in child.threads:
                thread.join(1.0)

    def _relay(self, child: Child) -> None:
        assert child.process.stdout is not None  # noqa: S101 - given as PIPE above
        for line in map(str.rstrip, child.process.stdout):
            if line.startswith(COMPLAINT):
                child.complaint = line.removeprefix(COMPLAINT)
            else:
                self._say(child.name, line)


def wait_for(condition: Callable[[], bool], timeout_s: float, poll_s: float = 0.02) -> bool:
    """Wait until `condition` holds; return whether it came to hold in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end:
            return False
        time.sleep(poll_s)
    return True
