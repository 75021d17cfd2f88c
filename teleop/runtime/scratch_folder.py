"""Temporary folders that do not outlive their process for long."""

import fcntl
import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path

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
        # until it is cleaned up, or this process ends, however it does
        self._lock: int | None = _lock_folder(Path(self.name))

    def cleanup(self) -> None:
        """Remove the folder."""
        super().cleanup()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _lock_folder(folder: Path) -> int:
    """Return a handle that locks a folder; `OSError` if another process has one."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle
