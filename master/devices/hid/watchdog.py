"""Watchdog process: removes the force of a device when its controlling process is dead or stopped.

Most devices drop a force when their host stops writing. For those that do not, this file runs as a
separate script without slow imports. While a force is active it expects heartbeats; it removes the
force when they stop, at every later silence again, and finally when its standard input is closed.
"""

import os
import select
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

HEARTBEAT_TIMEOUT_S = 0.15  # [s] heartbeat timeout
_READY = b"ready\n"
_HEARTBEAT = b"."


class ForceWatchdog:
    """Handle of the watchdog process; `OSError` if the node at `path` cannot be opened.

    `reports` remove the force.
    """

    def __init__(self, path: str, reports: Sequence[bytes]) -> None:
        words = [sys.executable, "-PSE", __file__, path, *(report.hex() for report in reports)]
        self.process = subprocess.Popen(
            words,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C does not reach it
        )
        assert self.process.stdin is not None  # noqa: S101 - given as PIPE above
        assert self.process.stdout is not None  # noqa: S101
        self._pipe = self.process.stdin
        with self.process.stdout as stdout:
            ready = stdout.readline() == _READY
        if not ready:
            self.end()
            raise OSError(f"{path}: the force watchdog does not start")

    def beat(self) -> None:
        """Send a heartbeat: before a force is applied, then at least every `HEARTBEAT_TIMEOUT_S`.

        `OSError` if the watchdog is not running.
        """
        self._pipe.write(_HEARTBEAT)

    def end(self) -> bool:
        """Let it write its reports and exit; return whether it did (False if a device hangs)."""
        self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        return self.process.returncode is not None


def main(path: str, *reports: str) -> None:
    """Write the reports whenever heartbeats stop, and when standard input is closed."""
    node = os.open(path, os.O_WRONLY)
    os.write(1, _READY)
    patience: float | None = None  # [s]; no force is active before the first heartbeat
    alive = True
    while alive:
        due = not select.select([0], [], [], patience)[0]
        alive = due or bool(os.read(0, 4096))
        patience = None if due else HEARTBEAT_TIMEOUT_S
        if due or not alive:
            for report in reports:
                with suppress(OSError):  # unplugged, so without force
                    os.write(node, bytes.fromhex(report))


if __name__ == "__main__":
    main(*sys.argv[1:])
