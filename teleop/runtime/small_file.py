"""Files that people and programs hand us, of a kind that is small: read whole, within a bound."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

from teleop.errors import UsageError


def read_small_file(
    path: Path,
    size_max: int,
    check: Callable[[os.stat_result], None] = lambda _: None,
) -> bytes:
    """Return the content of a regular file.

    Parameters
    ----------
    path : Path
        A pipe or a device is refused, and never waited for.
    size_max : int
        Of the file [B].
    check : callable
        Called with the status of the very file that is read.

    Raises
    ------
    OSError
        It cannot be opened or read, or is a folder.
    UsageError
        It is not a regular file, or too large; one line.
    """
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise UsageError(f"{path}: is a pipe or a device; a regular file is needed")
        check(status)
        data = file.read(size_max + 1)
    if len(data) > size_max:
        raise UsageError(f"{path}: has more than {size_max // 1000} kB, the bound of such a file")
    return data
