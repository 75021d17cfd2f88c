"""Program entry point, and the handling of Ctrl-C until a command runs.

Python raises KeyboardInterrupt anywhere; during an import that is a long traceback, or it is lost
in a callback. Nothing is open yet, so the signal just ends the process here.
"""

import os
import signal
import sys

_INTERRUPTED = 128 + signal.SIGINT


def main() -> int:
    """Run `teleop`; returns the exit code."""
    signal.signal(signal.SIGINT, _end)
    from teleop.app import cli

    try:
        return cli.main(begin=_interruptible)
    except KeyboardInterrupt:  # even while another error is printed
        return _INTERRUPTED
    finally:  # the exit code is known; ignore later signals
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _interruptible() -> None:
    """From now on raise KeyboardInterrupt, so that open resources are closed."""
    from teleop.process import interruption, on_ending

    on_ending(interruption)


def _end(*_: object) -> None:
    os.write(2, b"teleop: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
