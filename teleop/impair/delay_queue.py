"""A queue that delivers messages at their due time, within a fraction of a millisecond."""

import heapq
import itertools
import threading
import time
from collections.abc import Callable

from teleop.runtime.timing import Durations

WAIT_S = 0.02  # longest wait of `work`, so that its caller can stop
# Both directions of a session at 1 kHz are 2200 messages/s of 420 bytes; with the longest delay,
# jitter and hold-back that a config may ask for, 30 s, that is 41 MB.
CAPACITY_BYTES = 64_000_000
ENTRY_BYTES = 200  # that a waiting message takes beside its own


class DelayQueue:
    """Messages with due times; filled from any thread, emptied by one.

    It holds `capacity_bytes` at most. If it is full, new messages are dropped, as in a network
    queue; accepted ones keep their order and time.

    Parameters
    ----------
    capacity_bytes : int
        Bound on the messages that wait, each counted as its length plus `ENTRY_BYTES` [bytes].

    Attributes
    ----------
    lateness : Durations
        Lateness of deliveries.
    """

    def __init__(self, capacity_bytes: int = CAPACITY_BYTES) -> None:
        self.lateness = Durations()
        self._capacity_bytes, self._held_bytes = capacity_bytes, 0
        self._queue: list[tuple[int, int, Callable[[bytes], None], bytes]] = []
        self._numbers = itertools.count()  # tie-breaker: first in, first out
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._queue)

    @property
    def held_bytes(self) -> int:
        """What the waiting messages take, at most `capacity_bytes`."""
        return self._held_bytes

    def send(self, due_ns: int, put: Callable[[bytes], None], data: bytes) -> bool:
        """Schedule `put(data)` at `due_ns` of the machine's monotonic clock.

        Returns
        -------
        bool
            Whether it was accepted; False = the queue is full and the message is dropped.
        """
        size = len(data) + ENTRY_BYTES
        with self._changed:
            if self._held_bytes + size > self._capacity_bytes:
                return False
            self._held_bytes += size
            heapq.heappush(self._queue, (due_ns, next(self._numbers), put, data))
            if self._queue[0][0] == due_ns:
                self._changed.notify()
        return True

    def wake(self) -> None:
        """Make `work` return soon."""
        with self._changed:
            self._changed.notify()

    def work(self) -> None:
        """Deliver due messages, or wait: at most `WAIT_S`, and until `wake`."""
        with self._changed:
            now = time.monotonic_ns()
            if not self._queue or self._queue[0][0] > now:
                wait_ns = self._queue[0][0] - now if self._queue else WAIT_S * 1e9
                self._changed.wait(min(wait_ns * 1e-9, WAIT_S))
        while True:
            with self._changed:
                now = time.monotonic_ns()
                if not self._queue or self._queue[0][0] > now:
                    return
                due_ns, _, put, data = heapq.heappop(self._queue)
                self._held_bytes -= len(data) + ENTRY_BYTES
            put(data)
            self.lateness.add(now - due_ns)
            self.lateness.take_span()  # unused here, and would grow
