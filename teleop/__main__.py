"""Program entry point, and the handling of Ctrl-C until a command runs.

Python raises KeyboardInterrupt anywhere; during an import that is a long traceback, or it is lost
in a callback. Nothing is open yet, so the signal just ends the process here.
"""

import atexit
import gc
import os
import signal
import sys
import threading
from contextlib import suppress
from typing import NoReturn

# new objects between two collections of garbage; imports make half a million that stay, through
# which it would look at every 700: a fifth of their time
GARBAGE_THRESHOLD = 50_000
STOP_PRIORITY = 2  # SCHED_FIFO: below the loops, above the recorder and ordinary processes


def main() -> int:
    """Run `teleop`; returns the exit code, or ends the process with it."""
    gc.set_threshold(GARBAGE_THRESHOLD)
    signal.signal(signal.SIGINT, _exit_on_interrupt)
    _exclude_current_folder()
    if sys.argv[1:2] == ["stop"]:
        _request_realtime_priority()
    from teleop.cli import commands

    try:
        exit_code = commands.main(begin=_install_interrupt_handler)
    except KeyboardInterrupt:  # even while another error is printed
        from teleop.runtime.process import interrupt_handler

        exit_code = interrupt_handler.exit_code
    finally:  # the exit code is known; ignore later signals
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if "zenoh" in sys.modules and sys.version_info < (3, 14):
        _end_beside_threads(exit_code)
    return exit_code


def _end_beside_threads(exit_code: int) -> NoReturn:
    """End the process without taking the interpreter apart, as Python would end otherwise.

    A thread of Zenoh may still ask for it, even with its session closed, and until Python 3.14
    (gh-87135) such a thread is unwound, which aborts the process where it comes from Rust.
    """
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # closed, or never there
            stream.flush()
    os._exit(exit_code)


def _exclude_current_folder() -> None:
    """Forget the folder of the script, or with `-m` the current one, here and in child processes.

    A file in it may have the name of any module.
    """
    if not sys.flags.safe_path:
        del sys.path[0]
    os.environ["PYTHONSAFEPATH"] = "1"  # of processes that `multiprocessing` starts


def _request_realtime_priority() -> None:
    """Compute at real-time priority, where this user may: an emergency stop waits for no program.

    The loops, which have a higher one, wait for nothing either. Imports need a processor for 50 ms.
    """
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(STOP_PRIORITY))


def _install_interrupt_handler() -> None:
    """From now on raise KeyboardInterrupt, so that open resources are closed."""
    from teleop.runtime.process import install_termination_handler, interrupt_handler

    install_termination_handler(interrupt_handler)
    sys.unraisablehook = interrupt_handler.deliver_again


def _exit_on_interrupt(*_: object) -> None:
    os.write(2, b"teleop: interrupted\n")
    os._exit(128 + signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())
