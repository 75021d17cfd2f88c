"""What has arrived on one topic since the loop last looked, and waiting for it.

Zenoh's receiving thread stores, the loop's thread waits and takes. A `SimpleQueue` wakes its reader
without running Python code in between: of the ways to wait for a message with a deadline it is the
one that costs least processor time at the latency of polling (docs/latency.md).
"""

import time
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from teleop.clock import now_ns


class Arrived(NamedTuple):
    """One message as it came."""

    data: bytes
    received_ns: int  # when Zenoh handed it over, on our clock


class Inbox:
    """A bounded queue of the newest messages.

    Parameters
    ----------
    size : int
        How many are kept; when more come before anybody looks, the oldest are dropped.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._queue: SimpleQueue[Arrived] = SimpleQueue()
        self._taken: list[Arrived] = []  # by `wait`, not yet by `take`
        self._overflowed = False

    def store(self, sample: Any) -> None:
        """Keep a Zenoh sample; called from Zenoh's thread."""
        if self._queue.qsize() >= self._size:
            self._overflowed = True
            with suppress(Empty):  # the loop may just have taken it
                self._queue.get_nowait()
        # copied at once: a payload kept as it is keeps the whole receive buffer it lies in
        self._queue.put(Arrived(sample.payload.to_bytes(), now_ns()))

    def wait(self, deadline_ns: int) -> bool:
        """Wait until something is there, at most until a time of the monotonic clock [ns]."""
        if self._taken:
            return True
        timeout = (deadline_ns - time.monotonic_ns()) * 1e-9
        try:
            self._taken.append(self._queue.get(timeout > 0.0, max(timeout, 0.0)))
        except Empty:
            return False
        return True

    def take(self) -> tuple[list[Arrived], bool]:
        """Return what has arrived, oldest first, and whether older ones were dropped."""
        arrived, self._taken = self._taken, []
        while len(arrived) <= self._size:
            try:
                arrived.append(self._queue.get_nowait())
            except Empty:
                break
        overflowed, self._overflowed = self._overflowed, False
        return arrived, overflowed
