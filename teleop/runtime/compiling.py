"""Compiling at a start: one line that says so, and two processes that share the work."""

import contextlib
import gc
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess


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
                # not a fork of this process, which may be in the middle of compiling
                start = multiprocessing.get_context("spawn").Process
                self.helper = start(target=_run_helper, args=(work,), daemon=True)
                self.helper.start()

        def on_end(self, _event: object) -> None:
            """Do nothing; required by the listener interface."""

    announcement = Announcement()
    with event.install_listener("numba:compile", announcement):
        yield
        if announcement.helper is not None:
            announcement.helper.join()
        if work is not None:
            work()


def _run_helper(work: Callable[[], object]) -> None:
    """Compile in a child process, which its parent ends on an interrupt."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()
    work()
