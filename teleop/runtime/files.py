"""Files that people and programs hand us, of a kind that is small: read whole, within a bound."""

import fcntl
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
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


# --- temporary folders that do not outlive their process for long

_SCRATCH_PREFIX = "teleop-run-"
_SCRATCH_AGE_MIN_S = 60.0  # a younger folder may be one that is not locked yet


class ScratchFolder(tempfile.TemporaryDirectory[str]):
    """A temporary folder of this process; those of killed processes of this user are removed."""

    def __init__(self) -> None:
        for folder in Path(tempfile.gettempdir()).glob(f"{_SCRATCH_PREFIX}*"):
            with suppress(OSError):
                if time.time() - folder.stat().st_mtime > _SCRATCH_AGE_MIN_S:
                    os.close(_lock_folder(folder))
                    shutil.rmtree(folder)
        super().__init__(prefix=_SCRATCH_PREFIX)
        self._lock = _lock_folder(Path(self.name))  # until this process ends, however it does


def _lock_folder(folder: Path) -> int:
    """Return a handle that locks a folder; `OSError` if another process has one."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


# --- folders of a user for state and settings, as the XDG base directory specification names them


def find_state_folder() -> Path:
    """Return the folder for what outlives a process; see `_find_folder`."""
    return _find_folder("XDG_STATE_HOME", ".local/state")


def find_config_folder() -> Path:
    """Return the folder for settings; see `_find_folder`."""
    return _find_folder("XDG_CONFIG_HOME", ".config")


def _find_folder(variable: str, below_home: str) -> Path:
    """Return the folder that `variable` names, or else the one below the home folder.

    Raises
    ------
    UsageError
        It would depend on the current folder, or this user has no home.
    """
    if named := os.environ.get(variable):
        if not os.path.isabs(named):
            raise UsageError(f"{variable}={named}: is relative; set it to an absolute path")
        return Path(named)
    home = os.path.expanduser("~")
    if not os.path.isabs(home):
        raise UsageError(
            f"user {os.getuid()} has no home folder (HOME); set {variable} to a folder of this user"
        )
    return Path(home, below_home)
