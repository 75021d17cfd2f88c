"""Cache of compiled code: one folder per state of the sources.

Numba checks only the date of a function's own file, so after a change in one module it would run
outdated code inlined into another. A folder named after a hash of all sources is never outdated.
"""

import contextlib
import gc
import hashlib
import multiprocessing
import os
import shutil
import signal
import stat
import tempfile
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess
from pathlib import Path

KEPT = 3  # folders of earlier states, for switching between versions
_COMPILED = ("estimator", "master", "slave", "teleop")
_NAME = "tendon-teleop"


def choose() -> Path | None:
    """Set the folder in the environment, before numba is imported, and delete the oldest ones.

    `NUMBA_CACHE_DIR` set by the user has precedence. Returns None, with numba's default, if no
    folder can be created.
    """
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(named)
    state = _state()
    for caches in _places():
        folder = caches / state
        try:
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
            for old in sorted(caches.iterdir(), key=_last_used)[: -1 - KEPT]:
                shutil.rmtree(old, ignore_errors=True)
        except OSError:
            continue
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        return folder
    return None


@contextlib.contextmanager
def announced(
    what: str, about_s: float, beside: Callable[[], object] | None = None
) -> Iterator[None]:
    """Print one line if anything has to be compiled in this context; with a warm cache, nothing.

    Parameters
    ----------
    what : str
        What is compiled, for the line.
    about_s : float
        Compile time [s] with an empty cache.
    beside : callable, optional
        Also to be compiled: called at the end of the context, and in a parallel process if anything
        has to be compiled, so that it is cached by then. A function of a module, or a
        `functools.partial` of one.
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
            if beside is not None:
                self.helper = _start_helper(beside)

        def on_end(self, _event: object) -> None:
            """Do nothing; required by the listener interface."""

    announcement = Announcement()
    with event.install_listener("numba:compile", announcement):
        yield
        if announcement.helper is not None:
            announcement.helper.join()
        if beside is not None:
            beside()


@contextlib.contextmanager
def compiling_beside(work: Callable[[], object]) -> Iterator[None]:
    """Compile by another process during this context, if the cache is empty; else do nothing.

    Parameters
    ----------
    work : callable
        Calls what is to be compiled: a function of a module, or a `functools.partial` of one.
    """
    folder = choose()
    if folder is None or any(folder.glob("*/*")):
        yield
        return
    helper = _start_helper(work)
    try:
        yield
    finally:
        helper.kill()
        helper.join()


def _start_helper(work: Callable[[], object]) -> BaseProcess:
    # not a fork of this process, which may be in the middle of compiling
    start = multiprocessing.get_context("spawn").Process
    helper = start(target=_help, args=(work,), daemon=True)
    helper.start()
    return helper


def _help(beside: Callable[[], object]) -> None:
    """Compile in a child process, which its parent ends on an interrupt."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()
    beside()


def _state() -> str:
    """Return a hash of the sources of compiled functions."""
    root = Path(__file__).parents[1]
    sources = sorted(path for name in _COMPILED for path in (root / name).rglob("*.py"))
    text = "".join(f"{p} {p.stat().st_mtime_ns} {p.stat().st_size}\n" for p in sources)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _places() -> Iterator[Path]:
    """Yield candidate folders: in the user's cache, then a temporary one."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():
        yield named / _NAME
    with contextlib.suppress(RuntimeError):  # a user id without a home
        yield Path.home() / ".cache" / _NAME
    private = Path(tempfile.gettempdir()) / f"{_NAME}-{os.getuid()}"
    try:
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
    except OSError:
        return
    # code is loaded from there: it must be owned and writable by this user only
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077:
        yield private


def _last_used(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:  # deleted by another process
        return 0
