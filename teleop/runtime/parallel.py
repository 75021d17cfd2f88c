"""Parallel map over processes."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from teleop.runtime.process import die_with_parent

Task = TypeVar("Task")
Done = TypeVar("Done")


CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # of a container: microseconds in a period, or max


def count_processors() -> int:
    """Return the number of processors that this process may use, by its cores and its quota."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    with suppress(OSError, ValueError):
        quota, period = map(float, CPU_QUOTA.read_text().split())
        return max(1, min(cores, int(quota / period)))
    return cores


def map_in_parallel(
    work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int
) -> Iterator[Done]:
    """Yield `work(task)` for each task in order, with `jobs` processes."""
    if jobs == 1:
        yield from map(work, tasks)
        return
    # spawned, as numba's and the BLAS's threads do not survive a fork
    with get_context("spawn").Pool(min(jobs, len(tasks)), _end_with_parent, (os.getpid(),)) as pool:
        yield from pool.imap(work, tasks)


def _end_with_parent(parent: int) -> None:
    """Ignore Ctrl-C in a child, which its parent ends, and the end of the parent itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    die_with_parent(parent)
