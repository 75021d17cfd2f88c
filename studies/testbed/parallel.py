"""Parallel map over processes."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from typing import TypeVar

from teleop.runtime.process import die_with_parent

Task = TypeVar("Task")
Done = TypeVar("Done")


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
