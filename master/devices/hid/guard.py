"""A process that takes the force off a device when the process that pushes it is dead or stopped.

Most devices forget a force when their host falls silent. For one that does not, nothing inside a
killed, or a stopped, process can help. This file is run as a script of its own, which imports
nothing that is slow. While a force is held it wants to hear a beat; it takes the force away when
none comes, and again at every later silence, and for good when its standard input is closed.
"""

import os
import select
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress

SILENT_S = 0.15  # [s] without a beat: the process that pushed is not there any more
_READY = b"ready\n"
_BEAT = b"."


class Guard:
    """The process, as its owner sees it; `OSError` if the node at `path` cannot be opened.

    Parameters
    ----------
    reports : sequence of bytes
        What takes the force away.
    """

    def __init__(self, path: str, reports: Sequence[bytes]) -> None:
        words = [sys.executable, "-S", "-E", __file__, path, *(report.hex() for report in reports)]
        self.process = subprocess.Popen(
            words,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is not meant for it
        )
        assert self.process.stdin is not None  # noqa: S101 - given as PIPE above
        assert self.process.stdout is not None  # noqa: S101
        self._pipe = self.process.stdin
        with self.process.stdout as stdout:
            ready = stdout.readline() == _READY
        if not ready:
            self.end()
            raise OSError(f"{path}: nobody would take the force away")

    def beat(self) -> None:
        """Say that a force is held on purpose; before it is, and then within `SILENT_S` again.

        `OSError` if nobody hears it.
        """
        self._pipe.write(_BEAT)

    def end(self) -> bool:
        """Let it write its reports and go; return whether it has, a device that hangs apart."""
        self._pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        return self.process.returncode is not None


def main(path: str, *reports: str) -> None:
    """Write whenever beats stop coming, and when nobody holds the other end of standard input."""
    node = os.open(path, os.O_WRONLY)
    os.write(1, _READY)
    patience: float | None = None  # [s]; no force is held before the first beat
    alive = True
    while alive:
        due = not select.select([0], [], [], patience)[0]
        alive = due or bool(os.read(0, 4096))
        patience = None if due else SILENT_S
        if due or not alive:
            for report in reports:
                with suppress(OSError):  # it is gone, and its force with it
                    os.write(node, bytes.fromhex(report))


if __name__ == "__main__":
    main(*sys.argv[1:])
