"""Bounded queues of raw messages, one per topic, read in the order of arrival."""

import threading
from collections import deque
from collections.abc import Iterable
from typing import Any, NamedTuple

from teleop.messages.topics import Topic

BACKLOG_S = 10.0  # [s] capacity for a topic at its expected rate
CAPACITY_MIN = 256  # messages, for event topics
ENTRY_BYTES = 300  # that a waiting message takes beside its own


class Arrival(NamedTuple):
    """A received message, unchecked."""

    number: int  # over all topics
    topic: Topic[Any]
    data: bytes
    received_ns: int


class MessageQueue:
    """Holds messages until they are taken; each topic has its own bound.

    A full topic drops its oldest message and counts it, exactly: put = taken + dropped + waiting.
    The oldest, so that the next message shows the gap in the sequence numbers. Topics do not
    displace each other's messages.

    Any thread may put, any may take.

    Attributes
    ----------
    has_arrivals : bool
        Whether anything was put since the last `take`.
    """

    def __init__(self) -> None:
        self.has_arrivals = False
        self._lock = threading.Lock()
        self._queues: dict[str, deque[Arrival]] = {}
        self._dropped: dict[str, int] = {}
        self._number = 0

    def add(self, topic: Topic[Any], capacity: int | None = None) -> None:
        """Accept messages of `topic` from now on, `capacity_of(topic)` of them at a time."""
        with self._lock:
            self._queues[topic.name] = deque(maxlen=capacity or compute_capacity(topic))
            self._dropped.setdefault(topic.name, 0)

    def put(self, topic: Topic[Any], data: bytes, received_ns: int) -> None:
        """Append a message; one too long for its topic is truncated, to bound the memory."""
        longest = topic.message.schema.size + 1
        if len(data) > longest:
            data = data[:longest]
        with self._lock:
            queue = self._queues[topic.name]
            self._dropped[topic.name] += len(queue) == queue.maxlen
            queue.append(Arrival(self._number, topic, data, received_ns))
            self._number += 1
            self.has_arrivals = True

    def take(self, limit: int | None = None) -> tuple[list[Arrival], dict[str, int]]:
        """Return the waiting messages, oldest first, and the dropped messages per topic so far.

        With a `limit` only the oldest, at most so many and at least one.
        """
        arrivals: list[Arrival] = []
        with self._lock:
            dropped = self._dropped.copy()
            waiting = [queue for queue in self._queues.values() if queue]
            if limit is None or sum(map(len, waiting)) <= limit:
                for queue in waiting:
                    arrivals += queue
                    queue.clear()
            else:
                end = min(queue[0].number for queue in waiting) + limit
                for queue in waiting:
                    while queue and queue[0].number < end:
                        arrivals.append(queue.popleft())
            self.has_arrivals = any(waiting)
        arrivals.sort(key=_get_number)
        return arrivals, dropped

    def oldest_ns(self) -> int | None:
        """Return when the oldest waiting message was received [ns]; None if none waits."""
        with self._lock:
            heads = [queue[0].received_ns for queue in self._queues.values() if queue]
        return min(heads, default=None)

    def dropped(self, topic: Topic[Any]) -> int:
        """Return how many messages of `topic` were dropped."""
        return self._dropped[topic.name]


def compute_capacity(topic: Topic[Any]) -> int:
    """Return the capacity for a topic; twice as many if both sides publish it."""
    publishers = 2 if topic.publisher is None else 1
    return max(CAPACITY_MIN, round(BACKLOG_S * topic.rate_hz * publishers))


def compute_capacity_bytes(topics: Iterable[Topic[Any]]) -> int:
    """Return the memory [bytes] that messages of `topics` take at most while they wait."""
    return sum(
        compute_capacity(topic) * (topic.message.schema.size + 1 + ENTRY_BYTES) for topic in topics
    )


def _get_number(arrival: Arrival) -> int:
    return arrival.number
