"""Bounded queues of raw messages, one for each topic, read back in the order of arrival."""

import threading
from collections import deque
from typing import Any, NamedTuple

from teleop.topics import Topic

BACKLOG_S = 10.0  # [s] of a topic at its expected rate, kept for a slow reader
CAPACITY_MIN = 256  # messages, of topics that come now and then


class Arrival(NamedTuple):
    """One message as it came, unchecked."""

    number: int  # of all that came, whatever their topic
    topic: Topic[Any]
    data: bytes
    received_ns: int


class MessageQueue:
    """Holds what has arrived until it is taken; each topic has a bound of its own.

    A full topic drops its oldest message and counts it, exactly: put = taken + dropped + waiting.
    The oldest, because the message after it then shows the gap in the sequence numbers, and the
    end of a stream is never the part that is missing. One topic cannot displace another's
    messages.

    Any thread may put, any may take.

    Attributes
    ----------
    has_arrivals : bool
        Whether anything was put since the last `take`; to be looked at without a call.
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
            self._queues[topic.name] = deque(maxlen=capacity or capacity_of(topic))
            self._dropped.setdefault(topic.name, 0)

    def put(self, topic: Topic[Any], data: bytes, received_ns: int) -> None:
        """Append a message.

        Of one that is longer than its topic's only so much is kept as shows that it is: what a
        message takes in memory is no choice of its sender.
        """
        longest = topic.message.schema.size + 1
        if len(data) > longest:
            data = data[:longest]
        with self._lock:
            queue = self._queues[topic.name]
            self._dropped[topic.name] += len(queue) == queue.maxlen
            queue.append(Arrival(self._number, topic, data, received_ns))
            self._number += 1
            self.has_arrivals = True

    def take(self) -> tuple[list[Arrival], dict[str, int]]:
        """Return what is waiting, oldest first; and how many each topic has dropped so far."""
        arrivals: list[Arrival] = []
        with self._lock:
            dropped = self._dropped.copy()
            self.has_arrivals = False
            for queue in self._queues.values():
                arrivals += queue
                queue.clear()
        arrivals.sort(key=_number)
        return arrivals, dropped

    def dropped(self, topic: Topic[Any]) -> int:
        """Return how many messages of `topic` were dropped because nobody took them in time."""
        return self._dropped[topic.name]


def capacity_of(topic: Topic[Any]) -> int:
    """Return how many messages of a topic wait at most; both sides may publish what any may."""
    publishers = 2 if topic.publisher is None else 1
    return max(CAPACITY_MIN, round(BACKLOG_S * topic.rate_hz * publishers))


def _number(arrival: Arrival) -> int:
    return arrival.number
