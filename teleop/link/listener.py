"""Hearing everything, in the order of arrival: for the recorder and the viewer."""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from teleop.clock import now_ns
from teleop.link.reception import Counts, Reception
from teleop.topics import Topic

BACKLOG = 50_000  # messages kept for a slow reader: over 10 s of a whole session, some 50 MB


class Heard(NamedTuple):
    """One message as it came: checked, not unpacked."""

    topic: Topic[Any]
    data: bytes
    received_ns: int  # when Zenoh handed it over, on our clock
    sender: int
    sequence: int
    stamp_ns: int  # on the sender's clock


class Listener:
    """Collects messages of several topics until they are drained.

    Zenoh's thread stamps and queues; checking is done by who drains. A reader that falls behind by
    more than `BACKLOG` messages loses the oldest, which shows as a gap and is counted as lost.
    """

    def __init__(self, visit: Callable[[Topic[Any], int], int]) -> None:
        self._queue: deque[tuple[Topic[Any], bytes, int]] = deque(maxlen=BACKLOG)
        self._visit = visit
        self._receptions: dict[tuple[str, int], Reception] = {}

    def store(self, topic: Topic[Any]) -> Callable[[zenoh.Sample], None]:
        """Return the callback that Zenoh's thread gives the samples of `topic` to."""
        append = self._queue.append
        # copied at once: a payload kept as it is keeps the whole receive buffer it lies in
        return lambda sample: append((topic, sample.payload.to_bytes(), now_ns()))

    def drain(self) -> list[Heard]:
        """Return what has arrived since the last call, oldest first, checked as `Latest` does."""
        heard = []
        for _ in range(len(self._queue)):
            topic, data, received_ns = self._queue.popleft()
            head = self._reception(topic, data).admit(data)
            if head is not None:
                heard.append(Heard(topic, data, received_ns, *head))
        return heard

    def counts(self, topic: Topic[Any]) -> Counts:
        """Return what became of the messages of `topic`, all its senders together."""
        total = Counts()
        for (name, _), reception in self._receptions.items():
            if name == topic.name:
                total += reception.counts
        return total

    def _reception(self, topic: Topic[Any], data: bytes) -> Reception:
        """Return who judges `data`: one a topic, or one a sender if several publish it."""
        sender = 0 if topic.publisher is not None else topic.message.schema.sender(data)
        key = topic.name, sender
        if key not in self._receptions:
            self._receptions[key] = Reception(
                topic,
                (lambda nonce: self._visit(topic, nonce)) if sender == 0 else (lambda _: 1),
            )
        return self._receptions[key]
