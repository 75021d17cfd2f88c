"""Files that people and programs hand us, of a kind that is small: read whole, within a bound."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

from teleop.errors import UsageError


def read_small_file(
    path: Path, size_max: int, check: Callable[[os.stat_result], None] = lambda _: None
) -> bytes:
    """Return the content of a regular file.

    At most `size_max` [B]; a pipe or a device is refused, and never waited for. `check` is called
    with the status of the very file that is read. Raises `OSError` if it cannot be opened or read,
    or is a folder; `UsageError`, one line, if it is not a regular file, or too large.
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


# --- folders of a user for state and settings, as the XDG base directory specification names them


def find_state_folder() -> Path:
    """Return the folder for what outlives a process; see `_find_folder`."""
    return _find_folder("XDG_STATE_HOME", ".local/state")


def find_config_folder() -> Path:
    """Return the folder for settings; see `_find_folder`."""
    return _find_folder("XDG_CONFIG_HOME", ".config")


def _find_folder(variable: str, below_home: str) -> Path:
    """Return the folder that `variable` names, or else the one below the home folder.

    Raises `UsageError` if it would depend on the current folder, or this user has no home.
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
