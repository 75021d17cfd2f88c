"""What Rerun's runtime writes to the standard error stream goes to a file, not to the terminal.

Its lines (a dropped connection, a slow flush) come from native code, straight to file descriptor 2,
and tell a user of the session nothing that our own messages do not say.
"""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from teleop.runtime.user_folders import find_state_folder

_STDERR = 2
_SIZE_MAX = 1_000_000  # [bytes] after which the file begins anew


def find_log_path(session: str) -> Path:
    """Return the file for a session: in the user's state folder (XDG base directories)."""
    return find_state_folder() / "tendon-teleop" / f"view-{session}.log"


@contextlib.contextmanager
def divert_stderr(path: Path) -> Iterator[Path]:
    """Send file descriptor 2 to the end of `path` in this context; yields the file in use.

    `sys.stderr` keeps writing to where it did. Where no folder can be made, the file is in that of
    temporary files.
    """
    path = _find_writable_path(path)
    if path.exists() and path.stat().st_size > _SIZE_MAX:
        path.unlink()
    sys.stderr.flush()
    terminal, python_stream = os.dup(_STDERR), sys.stderr
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    try:
        os.dup2(log, _STDERR)
        if python_stream is sys.__stderr__:
            sys.stderr = os.fdopen(os.dup(terminal), "w", buffering=1)
        yield path
    finally:
        if sys.stderr is not python_stream:
            sys.stderr.close()
            sys.stderr = python_stream
        os.dup2(terminal, _STDERR)
        os.close(terminal)
        os.close(log)


def _find_writable_path(path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError:
        return Path(tempfile.gettempdir()) / f"{os.getuid()}-{path.name}"
    return path
