"""The `record:` section of a config file."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Folder of recordings, write intervals, scheduling."""

    directory: str = "recordings"  # created if missing; `--out` overrides it
    chunk_s: float = 0.1  # [s] messages are written to the file in chunks of this duration
    drain_s: float = 0.02  # [s] between two reads from the link
    priority: int = 1  # SCHED_RR, below the loops (realtime.priority); 0: ordinary, after them
    compression: Literal["zstd", "lz4", "none"] = "zstd"

    def __post_init__(self) -> None:
        if not self.directory:
            raise ValueError("directory: is empty, give a path (recordings)")
        if not 0.01 <= self.chunk_s <= 10:
            raise ValueError(f"chunk_s: {self.chunk_s} s is outside 0.01 to 10 s")
        if not 0.001 <= self.drain_s <= 1:
            raise ValueError(f"drain_s: {self.drain_s} s is outside 0.001 to 1 s")
        if not 0 <= self.priority <= 49:
            raise ValueError(f"priority: {self.priority} is outside 0 to 49")
