"""A memory cgroup whose processes the kernel kills when they want more than is left (root only)."""

import os
from pathlib import Path

ROOT = Path("/sys/fs/cgroup")
ROOM_BYTES = 32_000_000  # that a process may allocate before it is killed


class MemoryGroup:
    """A context with a group of its own, of cgroup v1 or v2; `add` a process to it."""

    def __init__(self) -> None:
        first = ROOT / "memory"
        self._folder = (first if first.is_dir() else ROOT) / f"teleop-faults-{os.getpid()}"
        self._limit = "memory.limit_in_bytes" if first.is_dir() else "memory.max"

    def __enter__(self) -> "MemoryGroup":
        self._folder.mkdir(exist_ok=True)
        (self._folder / self._limit).write_text(str(ROOM_BYTES))
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.rmdir()

    def add(self, process: int) -> None:
        """Count what a process allocates from now on."""
        (self._folder / "cgroup.procs").write_text(str(process))

    @property
    def kills(self) -> int:
        """Number of processes that the kernel has killed for want of memory."""
        for name in ("memory.events", "memory.oom_control"):
            if (self._folder / name).exists():
                counts = dict(map(str.split, (self._folder / name).read_text().splitlines()))
                return int(counts["oom_kill"])
        return 0
