"""Registry of the sessions that a user has running on one machine, so that commands find them.

Each session is a JSON file in a folder that only the user may enter, locked (`flock`) by its
launcher. The kernel drops the lock with the process, however it ends; a file without a lock is left
over and is removed by the next reader.
"""

import fcntl
import json
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path

from teleop.errors import UsageError

_FOLDER = "tendon-teleop"
_STEM = 30  # longest part of a name that a config file gives [characters]
_TRIES = 100  # random names


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningSession:
    """A session of this user on this machine."""

    session: str
    overrides: tuple[str, ...]  # `key=value` that lead to it: session, link
    endpoints: tuple[str, ...]  # the same for people
    config: str = ""  # absolute path of its config file, if any
    pid: int = field(default_factory=os.getpid)  # of its launcher
    began: str = field(  # local time
        default_factory=lambda: datetime.now().astimezone().isoformat(" ", "seconds")
    )


@contextmanager
def registered(entry: RunningSession) -> Iterator[None]:
    """List a session while this context lasts.

    A session that cannot be listed runs all the same: its first line says how to reach it.
    """
    try:
        folder = _own_folder()
        path = folder / f"{entry.session}.{entry.pid}.json"
        partial = path.with_suffix(".partial")
        file = partial.open("w")
    except OSError:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)  # before it has its name, so that no reader removes it
        json.dump(asdict(entry), file)
        file.flush()
        partial.replace(path)
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def running() -> list[RunningSession]:
    """Return the sessions of this user on this machine, the oldest first."""
    try:
        paths = list(_own_folder().glob("*.json"))
    except OSError:
        return []
    found = [entry for entry in map(_read, paths) if entry is not None]
    return sorted(found, key=lambda entry: entry.began)


def own_name(base: str) -> str:
    """Return a session name that none of the user's sessions has: `base` and four hex digits."""
    stem = re.sub(r"[^a-z0-9_-]+", "-", base.lower()).strip("-")[:_STEM] or "session"
    taken = {entry.session for entry in running()}
    for _ in range(_TRIES):
        name = f"{stem}-{secrets.token_hex(2)}"
        if name not in taken:
            return name
    raise UsageError(f"no free name for a session like {stem!r}; choose one with --session")


def find(name: str = "", config: Path | None = None) -> RunningSession | None:
    """Return the running session that a command means; None if there is none.

    Parameters
    ----------
    name : str
        Its name; empty for the only one.
    config : Path or None
        Its config file; None for any. Ignored if there is a name.

    Raises
    ------
    UsageError
        There are several.
    """
    entries = running()
    if name:
        entries = [entry for entry in entries if entry.session == name]
    elif config is not None:
        entries = [entry for entry in entries if entry.config == str(config.absolute())]
    if len(entries) > 1:
        raise UsageError(
            f"{len(entries)} sessions are running: {names_of(entries)}; name one with --session"
        )
    return entries[0] if entries else None


def names_of(entries: list[RunningSession]) -> str:
    """Return the names of sessions as text; those of one name with their processes."""
    names = [entry.session for entry in entries]
    return ", ".join(
        e.session if names.count(e.session) == 1 else f"{e.session} (process {e.pid})"
        for e in entries
    )


def _read(path: Path) -> RunningSession | None:
    """Return the session of a file; removes the file if its process has ended."""
    try:
        with path.open() as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                data = json.load(file)
                return RunningSession(
                    **data | {key: tuple(data[key]) for key in ("overrides", "endpoints")}
                )
        path.unlink()
    except (OSError, ValueError, TypeError, KeyError):
        pass
    return None


def _own_folder() -> Path:
    """Return the folder, made if it is missing; `OSError` if others could write there."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.access(runtime, os.W_OK):
        folder = Path(runtime) / _FOLDER
    else:
        folder = Path(tempfile.gettempdir()) / f"{_FOLDER}-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{folder} is not a folder of this user alone")
    return folder
