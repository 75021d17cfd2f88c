"""Where the program begins, and what Ctrl-C does until a command runs.

Python raises KeyboardInterrupt wherever it happens to be. Half-way through an import that is a
traceback of thirty lines, or it is lost in a callback. Nothing is open yet, so the signal just ends
the process here.
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
    except KeyboardInterrupt:  # as late as in the words about another error
        return _INTERRUPTED
    finally:  # the outcome is known; a signal on the way out changes nothing
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _interruptible() -> None:
    """From now on there may be something to close: raise, for a command without a loop to stop."""
    from teleop.process import interruption

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interruption)


def _end(*_: object) -> None:
    os.write(2, b"teleop: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
