"""What has arrived on one topic since the loop last looked, and waiting for it.

Zenoh's receiving thread stores, the loop's thread waits and takes. What Zenoh calls is a method of
C, `SimpleQueue.put`: it wakes the reader without running any Python code, which would still hold
the interpreter when the reader wants it. Of the ways to wait with a deadline this is the one that
has the latency of polling at the least processor time (docs/latency.md).
"""

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

from teleop.clock import now_ns

Arrived: TypeAlias = tuple[bytes, int]
"""One message as it came, and when the loop first had it, on our clock [ns]."""


class Inbox:
    """The newest messages of a topic.

    Attributes
    ----------
    store : callable
        Takes a Zenoh sample; called from Zenoh's thread.

    Parameters
    ----------
    size : int
        How many a look takes; of more the oldest are dropped.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._queue: SimpleQueue[Any] = SimpleQueue()
        self._taken: list[Arrived] = []  # by `wait`, not yet by `take`
        self.store: Callable[[Any], None] = self._queue.put

    def wake(self) -> None:
        """End a wait now; every handler of a signal must call it.

        A `SimpleQueue.get` that a signal interrupts goes on waiting for the rest of its time, and
        for ever where the handler took longer than that rest (CPython 3.11, _queuemodule.c).
        """
        self._queue.put(None)

    def wait(self, deadline_ns: int) -> bool:
        """Wait until something is there, at most until a time of the monotonic clock [ns]."""
        if self._taken:
            return True
        timeout = (deadline_ns - time.monotonic_ns()) * 1e-9
        try:
            sample = self._queue.get(timeout > 0.0, max(timeout, 0.0))
        except Empty:
            return False
        if sample is None:
            return False
        self._taken.append((sample.payload.to_bytes(), now_ns()))
        return True

    def take(self) -> tuple[list[Arrived], bool]:
        """Return what has arrived, oldest first, and whether older ones were dropped."""
        arrived, self._taken = self._taken, []
        waiting = self._queue.qsize()  # what comes during the look waits for the next
        if not waiting:
            return arrived, False
        overflowed = len(arrived) + waiting > self._size
        if overflowed:
            arrived.clear()
        get = self._queue.get_nowait  # nobody else takes from it: what was counted is there
        for _ in range(waiting - self._size):
            get()
        received_ns = now_ns()
        for _ in range(min(waiting, self._size)):
            if (sample := get()) is not None:
                arrived.append((sample.payload.to_bytes(), received_ns))
        return arrived, overflowed
