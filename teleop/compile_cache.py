"""Where compiled code is kept between runs: one folder for each state of the sources.

Numba keeps compiled functions beside their source and looks at that one file's date, so after a
change in one module it would go on running old code that another module had compiled in. A folder
named after all our sources has no old code in it.
"""

import hashlib
import os
import shutil
from pathlib import Path

KEPT = 3  # folders of former states, for going back and forth between two
_COMPILED = ("estimator", "slave/plant")


def choose() -> Path | None:
    """Name the folder in the environment, before numba is imported, and forget the oldest ones.

    Where no folder can be made, numba is left to its own ways and None is returned.
    """
    root = Path(__file__).parents[1]
    sources = sorted(path for name in _COMPILED for path in (root / name).rglob("*.py"))
    state = hashlib.sha256(
        "".join(f"{p} {p.stat().st_mtime_ns} {p.stat().st_size}\n" for p in sources).encode()
    ).hexdigest()[:16]
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tendon-teleop"
    folder = caches / state
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    for old in sorted(caches.iterdir(), key=_last_used)[: -1 - KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return folder


def _last_used(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:  # another process of ours has just forgotten it
        return 0
