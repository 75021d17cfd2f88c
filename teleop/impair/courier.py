"""Handing things over at their time, to a fraction of a millisecond."""

import heapq
import itertools
import threading
import time
from collections.abc import Callable

from teleop.timing import Durations

LOOK_S = 0.02  # how long the courier sleeps at most, so that it is told to stop


class Courier:
    """A queue of actions with a due time each; filled from any thread, emptied by one.

    Attributes
    ----------
    lateness : Durations
        By how much actions came after their time.
    """

    def __init__(self) -> None:
        self.lateness = Durations()
        self._queue: list[tuple[int, int, Callable[[bytes], None], bytes]] = []
        self._numbers = itertools.count()  # of two that are due at once the first goes first
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._queue)

    def send(self, due_ns: int, put: Callable[[bytes], None], data: bytes) -> None:
        """Have `put(data)` called at `due_ns` of the machine's monotonic clock."""
        with self._changed:
            heapq.heappush(self._queue, (due_ns, next(self._numbers), put, data))
            if self._queue[0][0] == due_ns:
                self._changed.notify()

    def wake(self) -> None:
        """Have `work` return soon."""
        with self._changed:
            self._changed.notify()

    def work(self) -> None:
        """Do what is due, or wait for it a little: at most `LOOK_S`, and until `wake`."""
        with self._changed:
            now = time.monotonic_ns()
            if not self._queue or self._queue[0][0] > now:
                wait_ns = self._queue[0][0] - now if self._queue else LOOK_S * 1e9
                self._changed.wait(min(wait_ns * 1e-9, LOOK_S))
        while True:
            with self._changed:
                now = time.monotonic_ns()
                if not self._queue or self._queue[0][0] > now:
                    return
                due_ns, _, put, data = heapq.heappop(self._queue)
            put(data)
            self.lateness.add(now - due_ns)
            self.lateness.take_span()  # which is of no use here, and would grow
