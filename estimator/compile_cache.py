"""Where compiled code is cached: one folder per state of the sources.

Numba checks only the date of a function's own file, so after a change in one module it would run
outdated code inlined into another. A folder named after a hash of all sources is never outdated.
"""

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

KEPT = 3  # folders of earlier states, for switching between versions
IN_USE_S = 3600.0  # [s] since its last use, within which another process may use a folder
_COMPILED = ("estimator", "master", "slave", "teleop")
_NAME = "tendon-teleop"


def choose() -> Path | None:
    """Set the folder in the environment, before numba is imported, and delete old ones.

    `NUMBA_CACHE_DIR` set by the user has precedence. Returns None, with numba's default, if no
    folder can be created.
    """
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(named)
    state = _state()
    for caches in _places():
        folder = caches / state
        try:
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
            for old in sorted(caches.iterdir(), key=_last_used)[: -1 - KEPT]:
                if _last_used(folder) - _last_used(old) > IN_USE_S * 1e9:
                    shutil.rmtree(old, ignore_errors=True)
        except OSError:
            continue
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        return folder
    return None


def _state() -> str:
    """Return a hash of the sources of compiled functions."""
    root = Path(__file__).parents[1]
    sources = sorted(path for name in _COMPILED for path in (root / name).rglob("*.py"))
    text = "".join(f"{p} {p.stat().st_mtime_ns} {p.stat().st_size}\n" for p in sources)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _places() -> Iterator[Path]:
    """Yield candidate folders: in the user's cache, then a temporary one."""
    named = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if named.is_absolute():
        yield named / _NAME
    with contextlib.suppress(RuntimeError):  # a user id without a home
        yield Path.home() / ".cache" / _NAME
    private = Path(tempfile.gettempdir()) / f"{_NAME}-{os.getuid()}"
    try:
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
    except OSError:
        return
    # code is loaded from there: it must be owned and writable by this user only
    if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077:
        yield private


def _last_used(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:  # deleted by another process
        return 0
