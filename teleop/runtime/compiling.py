"""Compiling at a start: one line that says so, and two processes that share the work."""

import contextlib
import gc
import hashlib
import importlib
import multiprocessing
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from pathlib import Path

from estimator.compile_cache import choose_folder
from teleop.runtime.child_process import start_module
from teleop.runtime.process import die_with_launcher

_COMPILED_PACKAGES = ("estimator", "master", "slave", "teleop")


@contextlib.contextmanager
def announce_compilation(
    what: str, about_s: float, work: Callable[[], object] | None = None
) -> Iterator[None]:
    """Print one line if anything has to be compiled in this context; with a warm cache, nothing.

    `what` is named in the line, with the compile time `about_s` [s] with an empty cache. `work` is
    to be compiled too: called at the end of the context, and in a parallel process if anything has
    to be compiled, so that it is cached by then. A function of a module, or a `functools.partial`
    of one.
    """
    from numba.core import event

    class Announcement(event.Listener):
        printed = False
        helper: BaseProcess | None = None

        def on_start(self, _event: object) -> None:
            if self.printed:
                return
            self.printed = True
            print(f"compiling {what} (once on this machine; about {about_s:.0f} s) ...", flush=True)
            if work is not None:
                self.helper = _start_helper(work)

        def on_end(self, _event: object) -> None:
            """Do nothing; required by the listener interface."""

    announcement = Announcement()
    with event.install_listener("numba:compile", announcement):
        yield
        if announcement.helper is not None:
            announcement.helper.join()
        if work is not None:
            work()


@contextlib.contextmanager
def compile_in_parallel(function: str) -> Iterator[None]:
    """Compile by another process during this context, unless one has with these sources.

    Not by `multiprocessing`, whose processes import the script of a program that starts a session.

    `function` is a `package.module:function` that calls what is to be compiled.
    """
    folder = choose_folder()
    done = folder and folder / f"{function.replace(':', '.')}-{_hash_sources()}"
    if done is None or done.exists():
        yield
        return
    helper = start_module(
        __name__, function, str(done), is_supervised=True, stdout=subprocess.DEVNULL
    )
    try:
        yield
    finally:
        helper.kill()
        helper.wait()


def _hash_sources() -> str:
    root = Path(__file__).parents[2]
    sources = (path for name in _COMPILED_PACKAGES for path in (root / name).rglob("*.py"))
    states = sorted((str(path), path.stat().st_mtime_ns, path.stat().st_size) for path in sources)
    return hashlib.sha256(repr(states).encode()).hexdigest()[:16]


def _start_helper(work: Callable[[], object]) -> BaseProcess:
    # not a fork of this process, which may be in the middle of compiling
    start = multiprocessing.get_context("spawn").Process
    helper = start(target=_run_helper, args=(work,), daemon=True)
    helper.start()
    return helper


def _run_helper(work: Callable[[], object]) -> None:
    """Compile in a child process, which its parent ends on an interrupt."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()
    work()


if __name__ == "__main__":
    die_with_launcher()
    module, _, name = sys.argv[1].partition(":")
    _run_helper(getattr(importlib.import_module(module), name))
    Path(sys.argv[2]).touch()
