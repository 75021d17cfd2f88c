"""Start, supervise and stop child processes."""

import math
import shlex
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from teleop.errors import UsageError
from teleop.runtime.child_process import start_module
from teleop.runtime.output_file import FORCE_OPTION
from teleop.runtime.process import HEARTBEAT, STANDBY_VARIABLE, STATUS
from teleop.view.local_server import WEB_VIEW

REQUIRED_CHILDREN = ("master", "slave", "impair")  # the session continues without the others
RESTARTED_CHILDREN = ("view",)  # started again after a failure, if it ever worked
ERROR_PREFIX = "teleop: "  # prefix of an error line of the command line
# a child that has beaten and then only waits for so long, without a beat, is killed
_HEARTBEAT_TIMEOUT_S = 3.0
# from then on it is watched whether it computes: beats come twice a second
_HEARTBEAT_LATE_S = 0.75
# and so is one that computes all the time, or is not given a processor
_STARVATION_TIMEOUT_S = 20.0
_SHORT_LIFE_S = 10.0  # a restarted child that fails sooner is started again later each time
_RESTART_PAUSE_MAX_S = 30.0
_EXIT_TIMEOUT_S = 5.0  # a child that has not ended by then, nor printed since, is killed
_EXIT_TIMEOUT_MAX_S = 90.0  # and so is one that keeps printing
_DRAINING_CHILDREN = ("record",)  # may take as long as it prints, and so long without:
_DRAINING_TIMEOUT_S = 60.0  # one write of a slow disk
_POLL_S = 0.02
_READ_S = 1.0  # time to read the remaining output of an ended child


@dataclass
class Child:
    """A child process."""

    name: str
    process: subprocess.Popen[str]
    summary: Path
    arguments: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)  # added to its environment
    descriptors: tuple[int, ...] = ()  # that it has too
    status: str = ""  # of its own, for the status line
    complaint: str = ""  # its error line, which the launcher repeats at the end
    threads: list[threading.Thread] = field(default_factory=list)
    heard_s: float = field(default_factory=time.monotonic)  # when it started or last printed
    beat_s: float | None = None  # when it last beat, None = never
    computed_s: float = 0.0  # when it was last seen to compute, without a beat
    was_healthy: bool = False  # it has beaten, or one before it in its place has
    began_s: float = field(default_factory=time.monotonic)
    pause_s: float = 0.0  # before it is started again
    restart_reason: str = ""  # why it was started again, until it has said so
    was_restarted: bool = False  # it was started again

    @property
    def exit_code(self) -> int | None:
        """Exit code, negative for a signal, None while it runs."""
        return self.process.poll()

    @property
    def is_fatal(self) -> bool:
        """Whether its end is that of the session: it is vital, or failed by a usage error."""
        code = self.exit_code
        return code is not None and (self.name in REQUIRED_CHILDREN or code == UsageError.exit_code)

    def is_hung(self) -> bool:
        """Return whether it runs, but its heartbeats have ceased; to be asked all the time.

        On a loaded machine one that compiles is late for seconds, and at rest between two pieces of
        work now and then: only one that rests all the time hangs.
        """
        if self.beat_s is None or self.exit_code is not None:
            return False
        now = time.monotonic()
        late_s = now - self.beat_s
        if late_s > _HEARTBEAT_LATE_S and is_computing(self.process.pid):
            self.computed_s = now
        idle_s = now - max(self.beat_s, self.computed_s)
        return late_s > _STARVATION_TIMEOUT_S or idle_s > _HEARTBEAT_TIMEOUT_S

    @property
    def may_restart(self) -> bool:
        """Whether it is to be started again after it ended."""
        return (
            self.name in RESTARTED_CHILDREN and self.was_healthy and self.exit_code not in (None, 0)
        )

    def join_readers(self) -> None:
        """Wait for the remaining output of an ended child."""
        for thread in self.threads:
            thread.join(_READ_S)

    def describe_end(self) -> str:
        """Return how it ended, as text."""
        code = self.exit_code or 0
        return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"


class Supervisor:
    """Starts children with `teleop COMMAND ...`, relays what they print, and ends them.

    Of a child that is started again after a failure a spare is kept, which has imported all it
    needs: on a busy machine that takes longer than all the rest.

    Children run in their own process sessions, so that Ctrl-C reaches only the launcher, which
    stops them in order. Each child ends by itself if the launcher dies (`die_with_launcher`).

    `scratch` is a folder for the children's summaries; `say` is called with (child name, line) for
    each line a child prints, from a reader thread.
    """

    def __init__(self, scratch: Path, say: Callable[[str, str], None]) -> None:
        self.children: dict[str, Child] = {}
        self._scratch, self._say = scratch, say
        self._reported: set[str] = set()
        self._spares: dict[str, Child] = {}  # of RESTARTED ones: all imported, waiting for a call

    def start(
        self,
        name: str,
        arguments: Sequence[str],
        environment: Mapping[str, str] | None = None,
        descriptors: tuple[int, ...] = (),
        standby: bool = False,
    ) -> Child:
        """Start `teleop NAME ARGUMENTS --json ...`.

        `environment` is added to that of this process; it has the file `descriptors` too. On
        `standby` it imports and compiles what it needs, and then waits for `call`.
        """
        child = self.children[name] = self._spawn(
            name, tuple(arguments), environment or {}, descriptors, standby
        )
        self._start_reader(child)
        return child

    def call(self, name: str) -> None:
        """Let a child on standby begin; one that has ended is left to `find_failed_child`."""
        _call(self.children[name])

    def _spawn(
        self,
        name: str,
        arguments: tuple[str, ...],
        environment: Mapping[str, str],
        descriptors: tuple[int, ...],
        standby: bool = False,
    ) -> Child:
        summary = self._scratch / f"{name}.json"
        process = start_module(
            "teleop",
            *(name, *arguments, "--json", str(summary), FORCE_OPTION),
            environment={
                "NO_COLOR": "1",
                **environment,
                **({STANDBY_VARIABLE: "1"} if standby else {}),
            },
            is_supervised=True,
            stdin=subprocess.PIPE if standby else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            pass_fds=descriptors,
        )
        return Child(name, process, summary, arguments, environment, descriptors)

    def _respawn(self, child: Child, standby: bool = False) -> Child:
        return self._spawn(
            child.name, child.arguments, child.environment, child.descriptors, standby
        )

    def _start_reader(self, child: Child) -> None:
        reader = threading.Thread(target=self._relay, args=(child,), daemon=True)
        reader.start()
        child.threads.append(reader)

    def find_failed_child(self) -> Child | None:
        """Return a child whose end ends the session.

        Of the others that ended, `RESTARTED_CHILDREN` ones are started again, as are those that
        hang; for the rest one line is printed.
        """
        for child in list(self.children.values()):
            if child.name in RESTARTED_CHILDREN and child.is_hung():
                child.complaint = "it hung"
                child.process.kill()
                child.process.wait()
            if child.exit_code is None and child.was_healthy and child.name not in self._spares:
                self._spares[child.name] = self._respawn(child, standby=True)
            if child.exit_code is None or child.name in self._reported:
                continue
            if child.may_restart:
                self._restart(child)
                continue
            child.join_readers()
            if child.is_fatal:
                return child
            self._reported.add(child.name)
            line = f"{child.complaint or f'ended {child.describe_end()}'}; the session goes on"
            if child.name in RESTARTED_CHILDREN:
                command = shlex.join(["teleop", child.name, *child.arguments])
                line += f"; start it again with: {command}"
            self._say(child.name, line)
        return None

    def _restart(self, child: Child) -> None:
        """Start an ended child again, at once, or after a pause if it was started again lately."""
        if time.monotonic() < child.heard_s + child.pause_s:
            return
        child.join_readers()
        spare = self._spares.pop(child.name, None)
        new = spare if spare is not None and _call(spare) else self._respawn(child)
        new.was_healthy = new.was_restarted = True
        new.restart_reason = child.complaint or f"ended {child.describe_end()}"
        if child.was_restarted and time.monotonic() - child.began_s < _SHORT_LIFE_S:
            new.pause_s = min(max(1.0, 2 * child.pause_s), _RESTART_PAUSE_MAX_S)
        self.children[child.name] = new
        self._start_reader(new)

    def stop(self, order: Sequence[str]) -> None:
        """Stop the children in `order`, with time to finish.

        A child that still prints has more time: a slave lowers the tensions first.
        """
        for spare in self._spares.values():
            spare.process.kill()
            spare.process.communicate()
        self._spares.clear()
        for name in order:
            child = self.children.get(name)
            if child is None:
                continue
            if child.exit_code is None:
                child.process.terminate()
            if not wait_for_exit(child):
                self._say(
                    name, f"did not end within {_choose_exit_timeout_s(child):g} s and was killed"
                )
                child.process.kill()
                child.process.wait()
            child.join_readers()
            if child.process.stdin is not None:  # it was never called
                child.process.stdin.close()

    def _relay(self, child: Child) -> None:
        assert child.process.stdout is not None  # noqa: S101 - given as PIPE above
        with child.process.stdout as lines:
            for line in map(str.rstrip, lines):
                now = time.monotonic()
                if line == HEARTBEAT:
                    child.beat_s, child.was_healthy = now, True
                    continue
                child.heard_s = now
                if line.startswith(STATUS):
                    child.status = line.removeprefix(STATUS)
                elif line.startswith(ERROR_PREFIX):
                    child.complaint = line.removeprefix(ERROR_PREFIX)
                else:
                    if child.restart_reason:
                        line = f"started again ({child.restart_reason}); {format_view_hint(line)}"  # noqa: PLW2901
                        child.restart_reason = ""
                    with suppress(OSError):  # the main thread ends for it; the pipe must not fill
                        self._say(child.name, line)


def _call(child: Child) -> bool:
    """Let a child on standby begin; return whether it was there."""
    assert child.process.stdin is not None  # noqa: S101 - given as PIPE at its start
    try:
        with child.process.stdin as line:
            line.write("begin\n")
    except BrokenPipeError:
        return False
    child.began_s = child.heard_s = time.monotonic()
    return True


def is_computing(pid: int) -> bool:
    """Return whether a thread of a process runs or would if it had a processor (Linux; else False).

    Any thread: the first one may wait for another that is not given a processor.
    """
    try:
        stats = [file.read_text() for file in Path(f"/proc/{pid}/task").glob("*/stat")]
    except OSError:
        return False
    return any(stat.rpartition(")")[2].split()[0] in ("R", "D") for stat in stats)


def format_view_hint(line: str) -> str:
    """Return how to open a view, from the first line that it prints."""
    if not line.startswith(WEB_VIEW):
        return line
    address = line.removeprefix(WEB_VIEW)
    return f"an open page reconnects; to open one: xdg-open {address}"


def _choose_exit_timeout_s(child: Child) -> float:
    return _DRAINING_TIMEOUT_S if child.name in _DRAINING_CHILDREN else _EXIT_TIMEOUT_S


def wait_for_exit(child: Child) -> bool:
    """Return whether a child told to stop ends within its timeout.

    A recorder that tells of its progress is waited for without end.
    """
    asked_s = time.monotonic()
    longest_s = math.inf if child.name in _DRAINING_CHILDREN else _EXIT_TIMEOUT_MAX_S
    while child.exit_code is None:
        patience_s = max(asked_s, child.heard_s) + _choose_exit_timeout_s(child)
        if time.monotonic() > min(patience_s, asked_s + longest_s):
            return False
        time.sleep(_POLL_S)
    return True
