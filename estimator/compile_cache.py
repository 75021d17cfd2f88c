"""Where compiled code is cached: a folder that nobody else can change.

What lies in it (see `estimator.function_cache`) is run as it is, so it must be this user's alone,
as must those above it.
"""

import contextlib
import grp
import os
import pwd
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

_FOLDER_NAME = "tendon-teleop"
_ENVIRONMENT_VARIABLE = "NUMBA_CACHE_DIR"
# numba, when imported with colorama, colours texts of errors that it drops: a seventh of compiling
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")


def choose_folder() -> Path | None:
    """Set the folder in the environment, before numba is imported.

    `NUMBA_CACHE_DIR` set by the user has precedence. A folder that other users own or can change is
    left out, with a line on standard error. Returns None, with nothing cached, if none is left.
    """
    if override := os.environ.get(_ENVIRONMENT_VARIABLE):
        with contextlib.suppress(OSError):
            return _create_private_folder(Path(override))
    for candidate in _generate_candidate_folders():
        try:
            folder = _create_private_folder(candidate)
        except OSError:
            continue
        os.environ[_ENVIRONMENT_VARIABLE] = str(folder)
        return folder
    return None


def _create_private_folder(folder: Path) -> Path:
    """Return a folder without links in its path, made if it is missing, readable by us only.

    Raises
    ------
    OSError
        It cannot be made or written, or others can change it, which is said on standard error.
    """
    folder = folder.resolve()
    for parent in (*reversed(folder.parents), folder):
        parent.mkdir(mode=0o700, exist_ok=True)
    if risk := _find_write_risk(folder):
        print(f"WARNING: {folder}: no compiled code is kept there: {risk}", file=sys.stderr)
        raise PermissionError(risk)
    if not os.access(folder, os.W_OK):
        raise PermissionError(folder)
    return folder


def _find_write_risk(folder: Path) -> str:
    """Return why others could put code into a folder, and the remedy; empty if nobody can."""
    trusted = {0, os.geteuid(), Path("/").stat().st_uid}  # in a user namespace / is of nobody
    for parent in (folder, *folder.parents):
        status = parent.stat()
        if status.st_uid not in trusted:
            return f"{parent} belongs to another user; set XDG_CACHE_HOME to a folder of yours"
        sticky = status.st_mode & stat.S_ISVTX and parent != folder
        if _is_writable_by_others(status) and not sticky:
            remedy = f"delete {parent}" if parent == folder else f"chmod go-w {parent}"
            return f"other users can write {parent}; {remedy}"
    return ""


def _is_writable_by_others(status: os.stat_result) -> bool:
    """Return whether a mode lets others write; a group of nobody but this user is this user."""
    if not status.st_mode & stat.S_IWGRP or status.st_mode & stat.S_IWOTH:
        return bool(status.st_mode & stat.S_IWOTH)
    try:
        user, group = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(status.st_gid)
    except KeyError:
        return True
    return group.gr_name != user or not set(group.gr_mem) <= {user}


def _generate_candidate_folders() -> Iterator[Path]:
    """Yield candidate folders: in the user's cache, then a temporary one."""
    cache_home = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if cache_home.is_absolute():
        yield cache_home / _FOLDER_NAME
    with contextlib.suppress(RuntimeError):  # a user id without a home
        yield Path.home() / ".cache" / _FOLDER_NAME
    yield Path(tempfile.gettempdir()) / f"{_FOLDER_NAME}-{os.getuid()}"
