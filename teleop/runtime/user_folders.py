"""Folders of a user for state and settings, as the XDG base directory specification names them."""

import os
from pathlib import Path

from teleop.errors import UsageError


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
