"""Registry of the sessions that a user has running on one machine, so that commands find them.

Each session is a JSON file in a folder that only the user may enter, locked (`flock`) by its
launcher. The kernel drops the lock with the process, however it ends; a file without a lock is left
over and is removed by the next reader. The module imports nothing that is slow to import, since an
emergency stop does not wait.
"""

import fcntl
import json
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from teleop.errors import UsageError
from teleop.runtime.files import find_state_folder

_FOLDER = "tendon-teleop"
_RUN_USER = Path("/run/user")
_TEMPORARY = ("/tmp", "/var/tmp")  # noqa: S108 - private folders only
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_STEM_MAX = 30  # longest part of a name that a config file gives [characters]
_TRIES_MAX = 100  # random names
SOCKET_ADDRESS_BYTES = 104  # of a Unix socket, with a closing zero; 108 on Linux


class RunningSession(NamedTuple):
    """A session of this user on this machine."""

    session: str
    place: dict[str, Any]  # values of the config that lead to it, by dotted key: session, link
    endpoints: tuple[str, ...]  # the same for people
    config: str = ""  # absolute path of its config file, if any
    pid: int = 0  # of its launcher
    began: str = ""  # local time


@contextmanager
def register_session(entry: RunningSession) -> Iterator[None]:
    """List a session while this context lasts.

    Process and time are those of this call. A session that cannot be listed runs all the same: its
    first line says how to reach it.
    """
    entry = entry._replace(pid=os.getpid(), began=time.strftime("%Y-%m-%d %H:%M:%S%z"))
    for folder in find_usable_folders():
        path = folder / f"{entry.session}.{entry.pid}.json"
        partial = path.with_suffix(".partial")
        with suppress(OSError):
            file = partial.open("w")
            break
    else:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)  # before it has its name, so that no reader removes it
        json.dump(entry._asdict(), file)
        file.flush()
        partial.replace(path)
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def list_sessions() -> list[RunningSession]:
    """Return the sessions of this user on this machine, the oldest first."""
    paths = [path for folder in list_own_folders() for path in folder.glob("*.json")]
    sessions = [entry for entry in map(_read_entry, paths) if entry is not None]
    return sorted(sessions, key=lambda entry: (entry.began, entry.session))


def create_session_name(base: str) -> str:
    """Return a session name that none of the user's sessions has: `base` and four hex digits."""
    stem = re.sub(r"[^a-z0-9_-]+", "-", base.lower()).strip("-")[:_STEM_MAX] or "session"
    used_names = {entry.session for entry in list_sessions()}
    for _ in range(_TRIES_MAX):
        name = f"{stem}-{os.urandom(2).hex()}"
        if name not in used_names:
            return name
    raise UsageError(f"no free name for a session like {stem!r}; choose one with --session")


def find_session(name: str = "", config: Path | None = None) -> RunningSession | None:
    """Return the running session that a command means; None if there is none.

    `name` is empty for the only one; `config` is its file, None for any, and ignored if there is a
    name. Raises `UsageError` if there are several.
    """
    entries = list_sessions()
    if name:
        entries = [entry for entry in entries if entry.session == name]
    elif config is not None:
        entries = [entry for entry in entries if entry.config == str(config.absolute())]
    if len(entries) > 1:
        raise UsageError(
            f"{len(entries)} sessions are running: {format_session_names(entries)}; name one "
            f"with --session"
        )
    return entries[0] if entries else None


def describe_absence(session: str, what: str, endpoints: Iterable[str]) -> str:
    """Return the line of a command whose session does not answer.

    `session` is its name, chosen or by default; `what` is missed, e.g. "no master answers".
    """
    if entries := list_sessions():
        return (
            f"session {session!r}: {what}; running on this machine: {format_session_names(entries)}"
        )
    return (
        f"no session of yours runs on this machine, and {what} at {', '.join(endpoints)} (session "
        f"{session!r}); for a session on other machines give its --config FILE"
    )


def format_session_names(entries: list[RunningSession]) -> str:
    """Return the names of sessions as text; those of one name with their processes."""
    names = [entry.session for entry in entries]
    return ", ".join(
        e.session if names.count(e.session) == 1 else f"{e.session} (process {e.pid})"
        for e in entries
    )


def _read_entry(path: Path) -> RunningSession | None:
    """Return the session of a file; removes the file if its process has ended."""
    try:
        with path.open() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                data = json.load(file)
                return RunningSession(**data | {"endpoints": tuple(data["endpoints"])})
        path.unlink()
    except (OSError, ValueError, TypeError, KeyError):
        pass
    return None


def find_usable_folders(socket_name: str = "") -> Iterator[Path]:
    """Yield the folders, made if missing, that nobody else can write to, the preferred one first.

    With a `socket_name` those in which a Unix socket can have that name. One that another user has
    made first, or that cannot be written to, is passed over: everybody may do that below /tmp.
    """
    state = _get_state_folder()
    for folder in _list_candidate_folders():
        is_short = len(os.fsencode(folder / socket_name)) < SOCKET_ADDRESS_BYTES
        if not is_short and socket_name:
            continue
        with suppress(OSError):
            folder.mkdir(mode=0o700, exist_ok=True, parents=folder == state)
            _require_private_folder(folder)
            if os.access(folder, os.W_OK | os.X_OK):
                yield folder


def list_own_folders() -> list[Path]:
    """Return the folders that processes of this user may use, whatever their environment."""
    private = []
    for folder in _list_candidate_folders():
        with suppress(OSError):
            _require_private_folder(folder)
            private.append(folder)
    return private


def _list_candidate_folders() -> list[Path]:
    """Return the folders to try; a process of a service manager may lack `XDG_RUNTIME_DIR`."""
    bases = (os.environ.get("XDG_RUNTIME_DIR"), _RUN_USER / f"{os.getuid()}")
    folders = [Path(base) / _FOLDER for base in bases if base]
    temporary = (os.environ.get("TMPDIR"), *_TEMPORARY)
    folders += [Path(base).absolute() / f"{_FOLDER}-{os.getuid()}" for base in temporary if base]
    state = _get_state_folder()
    return list(dict.fromkeys(folders if state is None else [*folders, state]))


def _get_state_folder() -> Path | None:
    """Return the folder below the home of this user, which no other one can occupy; None without.

    One for each start of a machine: machines may share a home, and a name of a socket in it tells
    them not apart.
    """
    try:
        boot = _BOOT_ID.read_text()[:8]
    except OSError:
        boot = "run"
    try:
        return find_state_folder() / "teleop" / boot
    except UsageError:
        return None


def _require_private_folder(folder: Path) -> None:
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{folder} is not a folder of this user alone")
