"""What each of our processes does around its work: when to stop, and what it leaves."""

import argparse
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from teleop.errors import TeleopError, UsageError
from teleop.runtime.machine import find_display_problem
from teleop.runtime.output_file import replace_file

_PR_SET_PDEATHSIG = 1

# What ends a command: Ctrl-C, a service manager, and a terminal that is gone (ssh dropped).
TERMINATION_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# the launcher's process id, in the environment of its children
SUPERVISED_VARIABLE = "TELEOP_SUPERVISED"
# set in the environment of a child on standby, which waits for a line to begin
STANDBY_VARIABLE = "TELEOP_STANDBY"
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
REPEAT_S = 0.01  # [s] until a signal whose exception was ignored is delivered again
HEARTBEAT = "\x06"  # a line that says: not hung; the launcher does not print it
STATUS = "\x05"  # begins a line for the launcher's status line


def build_module_command(module: str) -> list[str]:
    """Return the words that run a module of ours in a process of its own.

    It imports nothing from the current folder (`-P`), where any file may have the name of a module.
    """
    return [sys.executable, "-P", "-m", module]


def is_supervised() -> bool:
    """Return whether a launcher started this process, and speaks for it."""
    return SUPERVISED_VARIABLE in os.environ


def wait_in_standby() -> bool:
    """Wait until the launcher calls this process, if it was started on standby.

    Returns False if the launcher ended instead. Called when all is imported and compiled, which
    takes longest, and before anything is opened.
    """
    return STANDBY_VARIABLE not in os.environ or bool(sys.stdin.readline())


def send_heartbeat() -> None:
    """Tell the launcher, if one started this process, that it is not hung."""
    if is_supervised():
        print(HEARTBEAT, flush=True)


def install_termination_handler(handler: Callable[[int, FrameType | None], None]) -> None:
    """Install the handler of `TERMINATION_SIGNALS`; under `nohup` SIGHUP stays ignored."""
    for number in TERMINATION_SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


class _InterruptHandler:
    """Of a signal to a command without a loop to stop: raised, and remembered."""

    number = 0  # of the signal; 0 before it

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        self.number = self.number or number
        raise KeyboardInterrupt

    def deliver_again(self, ignored: Any) -> None:
        """Deliver the signal again if Python ignores what it raised, as in `__del__`.

        For `sys.unraisablehook`.
        """
        if not issubclass(ignored.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(ignored)
            return
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(self.number or signal.SIGINT))
        signal.setitimer(signal.ITIMER_REAL, REPEAT_S)

    @property
    def exit_code(self) -> int:
        """Of a command that was told to end before it began, or was done."""
        return 128 + (self.number or signal.SIGINT)


interrupt_handler = _InterruptHandler()


def to_exit_code(reason: str) -> int:
    """Return the exit code of a command that a signal of this name ended; 0 for another reason."""
    return 128 + signal.Signals[reason] if reason in signal.Signals.__members__ else 0


@contextmanager
def defer_interrupt() -> Iterator[None]:
    """Hold Ctrl-C back until this is left; only the main thread is interrupted by it.

    Raised as a lock is being taken, it would leave the lock taken, and all waiting for it.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *signalled: received.append(signalled))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if received:
            handler(*received[-1])


class StopCondition:
    """Asked by a loop before each tick; becomes true and stays so.

    The signals of `TERMINATION_SIGNALS` set it, if it `catches_signals`, so does the end of
    `duration_s`, counted from the first asking since setting up can take long, and `request` from
    inside.
    """

    def __init__(self, duration_s: float | None = None, catches_signals: bool = True) -> None:
        self.reason = ""
        self.wake: Callable[[], None] = lambda: None  # called by the handler: ends a wait
        self._duration_s = math.inf if duration_s is None else duration_s
        self._began_s: float | None = None
        if catches_signals:
            install_termination_handler(self._on_signal)

    def __call__(self) -> bool:
        """Return whether to stop."""
        now = time.monotonic()
        self._began_s = now if self._began_s is None else self._began_s
        if now - self._began_s >= self._duration_s:
            self.request("duration reached")
        return bool(self.reason)

    def request(self, reason: str) -> None:
        """Stop at the next asking; the first reason is kept."""
        self.reason = self.reason or reason

    @property
    def exit_code(self) -> int:
        """Of a command that a signal ended before it was done; 0 without a signal."""
        return to_exit_code(self.reason)

    @contextmanager
    def allow_interrupt(self) -> Iterator[None]:
        """Let a signal raise `KeyboardInterrupt`, where nobody asks for long."""
        install_termination_handler(interrupt_handler)
        try:
            if self.exit_code:  # it came before
                interrupt_handler(signal.Signals[self.reason], None)
            yield
        finally:
            install_termination_handler(self._on_signal)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.request(signal.Signals(number).name)
        self.wake()


def die_with_parent(parent: int, by: signal.Signals = signal.SIGTERM) -> None:
    """Ask Linux to end this process when its parent dies; elsewhere nothing can be asked.

    Raises `TeleopError` if the process `parent` had died before this was asked.
    """
    if sys.platform == "linux":
        import ctypes  # slow to import, and not needed by a command that a user starts

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, by)
    if os.getppid() != parent:
        raise TeleopError(f"the process that started this one ({parent}) has ended")


def die_with_launcher() -> None:
    """End this process when the launcher that started it dies, if one did."""
    if is_supervised():
        die_with_parent(int(os.environ[SUPERVISED_VARIABLE]))


def limit_numeric_threads() -> None:
    """Let numeric libraries compute in one thread, unless the environment says otherwise.

    To be called before numpy is imported. Arrays are small: a second thread is slower, and each
    library's pool would hold locked stacks.
    """
    for name in _THREAD_COUNTS:
        os.environ.setdefault(name, "1")


def lower_priority() -> None:
    """Lower the priority of this process: loops on the same processor go first."""
    os.nice(5)


def print_warning(text: str) -> None:
    """Print a warning in one line on standard error, which is not the output."""
    print(f"WARNING: {text}", file=sys.stderr, flush=True)


# --- other processes of this machine, as /proc tells of them: those of other users in part


def read_command(number: int) -> list[str]:
    """Return the words of a process's command; empty if it is hidden or has ended."""
    with suppress(OSError):
        data = Path(f"/proc/{number}/cmdline").read_bytes()
        return data.decode(errors="replace").rstrip("\0").split("\0")
    return []


def format_process(number: int) -> str:
    """Return a process by number and command, as in 'process 812 (steam)'."""
    words = read_command(number)
    command = " ".join(words[words.index("-m") + 1 :] if "-m" in words else words)
    return f"process {number} ({command[:60]})"


def find_openers(path: str) -> list[str]:
    """Return the other processes that are seen to have a file open, by number and command."""
    wanted, found = os.path.realpath(path), []
    for folder in Path("/proc").glob("[0-9]*/fd"):
        number = int(folder.parent.name)
        with suppress(OSError):
            if number != os.getpid() and any(_is_open(name, wanted) for name in folder.iterdir()):
                found.append(format_process(number))
    return found


def _is_open(descriptor: Path, wanted: str) -> bool:
    with suppress(OSError):  # closed meanwhile
        return os.readlink(descriptor) == wanted
    return False


def is_running(name: str) -> bool:
    """Return whether a process of this name runs, of whatever user."""
    for file in Path("/proc").glob("[0-9]*/comm"):
        with suppress(OSError):
            if file.read_text().strip() == name:
                return True
    return False


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return not find_display_problem()


def parse_seconds(text: str) -> float:
    """Read a duration [s] from the command line: the `type` of an argument."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds above 0")
    return value


def write_summary(path: str | Path | None, summary: dict[str, Any]) -> None:
    """Write `summary` as JSON to `path`, whole or not at all; `UsageError` if that cannot be."""
    if path is not None:
        import json  # slow to import

        write_text_file(path, json.dumps(summary, indent=2) + "\n", "the summary")


def write_text_file(path: str | Path, text: str, what: str) -> None:
    """Write `text` to `path`, whole or not at all; `UsageError` if that cannot be."""
    try:
        with replace_file(Path(path)) as partial:
            partial.write_text(text)
    except OSError as error:
        raise UsageError(f"{path}: {what} cannot be written: {error.strerror}") from error
