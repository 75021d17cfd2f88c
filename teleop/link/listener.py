"""Hearing everything, in the order of arrival: for the recorder and the viewer."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from teleop.clock import now_ns
from teleop.link.message_queue import MessageQueue
from teleop.link.reception import Counts, Reception
from teleop.messages import Head
from teleop.topics import Topic

SENDERS = (
    64  # of one topic that are told apart; of more, the one not heard for longest is forgotten
)


class ReceivedMessage(NamedTuple):
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
    more than `message_queue.capacity_of` a topic loses its oldest messages. They are counted in
    `dropped`, and the gap that they leave is `overwritten`, not `lost`.
    """

    def __init__(self, visit: Callable[[Topic[Any], int], int]) -> None:
        self._queue = MessageQueue()
        self._visit = visit
        self._senders: dict[str, _Senders] = {}

    def store(self, topic: Topic[Any]) -> Callable[[zenoh.Sample], None]:
        """Return the callback that Zenoh's thread gives the samples of `topic` to."""
        self._queue.add(topic)
        self._senders[topic.name] = _Senders(topic, self._visit)
        put = self._queue.put
        # copied at once: a payload kept as it is keeps the whole receive buffer it lies in
        return lambda sample: put(topic, sample.payload.to_bytes(), now_ns())

    def drain(self) -> list[ReceivedMessage]:
        """Return what has arrived since the last call, oldest first, checked as `Latest` does."""
        if not self._queue.has_arrivals:
            return []
        arrivals, dropped = self._queue.take()
        for name, count in dropped.items():
            self._senders[name].overflowed_to(count)
        messages = []
        for _, topic, data, received_ns in arrivals:
            head = self._senders[topic.name].admit(data)
            if head is not None:
                messages.append(ReceivedMessage(topic, data, received_ns, *head))
        return messages

    def counts(self, topic: Topic[Any]) -> Counts:
        """Return what became of the messages of `topic`, all its senders together."""
        senders = self._senders.get(topic.name)
        return Counts() if senders is None else senders.counts()

    def dropped(self, topic: Topic[Any]) -> int:
        """Return how many messages of `topic` arrived and were dropped for want of a reader.

        Exact, also where no later message shows a gap: stored = drained + rejected + dropped.
        """
        return self._queue.dropped(topic)


class _Senders:
    """Who judges the messages of a topic: one `Reception`, or one a sender if several publish it.

    Anyone may claim to be one sender more, so a sender is remembered only once a message of it was
    let in, and of no more than `SENDERS` of them; the counts of those forgotten are kept.
    """

    def __init__(self, topic: Topic[Any], visit: Callable[[Topic[Any], int], int]) -> None:
        self._topic, self._visit = topic, visit
        self._receptions: OrderedDict[int, Reception] = OrderedDict()
        self._overflowed: set[int] = set()  # of which the next gap is our own doing
        self._dropped = 0
        self._forgotten = Counts()

    def __len__(self) -> int:
        return len(self._receptions)

    def overflowed_to(self, dropped: int) -> None:
        """Take note of how many messages of the topic were dropped so far."""
        if dropped > self._dropped:
            self._dropped = dropped
            self._overflowed = set(self._receptions)

    def admit(self, data: bytes) -> Head | None:
        """Return the head of `data` if it is let in, else None."""
        shared = self._topic.publisher is None
        sender = self._topic.message.schema.sender(data) if shared else 0
        known = self._receptions.get(sender)
        reception = known or Reception(self._topic, self._announced)
        head = reception.admit(data, overflowed=sender in self._overflowed)
        if head is not None:
            self._overflowed.discard(sender)
        if known is not None:
            self._receptions.move_to_end(sender)
        elif head is not None or not shared:
            self._receptions[sender] = reception
            self._forget()
        else:
            self._forgotten += reception.counts
        return head

    def counts(self) -> Counts:
        """Return what became of all messages that were judged."""
        return sum((r.counts for r in self._receptions.values()), self._forgotten)

    def _announced(self, nonce: int) -> int:
        return 1 if self._topic.publisher is None else self._visit(self._topic, nonce)

    def _forget(self) -> None:
        while len(self._receptions) > SENDERS:
            sender, reception = self._receptions.popitem(last=False)
            self._overflowed.discard(sender)
            self._forgotten += reception.counts
