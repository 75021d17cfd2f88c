"""Inbox of one topic, with a wait that ends at an arrival.

Zenoh's receiving thread stores, the loop's thread waits and takes. Zenoh calls the C method
`SimpleQueue.put`, which wakes the reader without running Python code that would still hold the
interpreter lock. This wait has the latency of polling at the least processor time
(docs/latency.md).
"""

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

from teleop.runtime.clock import now_ns

TimedBytes: TypeAlias = tuple[bytes, int]
"""A received message with its tags, and when the loop first took it, on our clock [ns]."""


class Inbox:
    """The newest messages of a topic.

    Attributes
    ----------
    store : callable
        Takes a Zenoh sample; called from Zenoh's thread.

    Parameters
    ----------
    size : int
        Capacity; the oldest messages are dropped.
    tagged : bool
        Whether to give each message with its tags behind it.
    """

    def __init__(self, size: int, tagged: bool = False) -> None:
        self._size, self._tagged = size, tagged
        self._queue: SimpleQueue[Any] = SimpleQueue()
        self._taken: list[TimedBytes] = []  # by `wait`, not yet by `take`
        self.store: Callable[[Any], None] = self._queue.put

    def wake(self) -> None:
        """End a wait now; every signal handler must call it.

        A `SimpleQueue.get` interrupted by a signal continues to wait for the rest of its time, or
        for ever if the handler took longer (CPython 3.11, _queuemodule.c).
        """
        self._queue.put(None)

    def wait(self, deadline_ns: int) -> bool:
        """Wait for a message, at most until a time of the monotonic clock [ns]."""
        if self._taken:
            return True
        timeout = (deadline_ns - time.monotonic_ns()) * 1e-9
        try:
            sample = self._queue.get(timeout > 0.0, max(timeout, 0.0))
        except Empty:
            return False
        if sample is None:
            return False
        data = sample.payload.to_bytes()
        if self._tagged and (tags := sample.attachment) is not None:
            data += tags.to_bytes()
        self._taken.append((data, now_ns()))
        return True

    def take(self) -> tuple[list[TimedBytes], bool]:
        """Return the messages, oldest first, and whether older ones were dropped."""
        arrived, self._taken = self._taken, []
        waiting = self._queue.qsize()  # later messages wait for the next call
        if not waiting:
            return arrived, False
        overflowed = len(arrived) + waiting > self._size
        if overflowed:
            arrived.clear()
        get = self._queue.get_nowait  # single consumer: the counted messages are there
        for _ in range(waiting - self._size):
            get()
        received_ns = now_ns()
        for _ in range(min(waiting, self._size)):
            if (sample := get()) is not None:
                data = sample.payload.to_bytes()
                if self._tagged and (tags := sample.attachment) is not None:
                    data += tags.to_bytes()
                arrived.append((data, received_ns))
        return arrived, overflowed
