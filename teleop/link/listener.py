"""Receive all messages in the order of arrival: for the recorder and the viewer."""

import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

import zenoh

from teleop.link.rate_limit import RateLimit
from teleop.link.reception import MessageCounts, Reception
from teleop.messages.messages import Head
from teleop.messages.topics import Topic
from teleop.runtime.clock import now_ns
from teleop.security.keyring import Keyring, TagVerdict

# --- bounded queues of raw messages, one per topic, read in the order of arrival

BACKLOG_S = 10.0  # [s] capacity for a topic at its expected rate
CAPACITY_MIN = 256  # messages, for event topics


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

    `has_arrivals` says whether anything was put since the last `take`.
    """

    def __init__(self) -> None:
        self.has_arrivals = False
        self._lock = threading.Lock()
        self._queues: dict[str, deque[Arrival]] = {}
        self._dropped: dict[str, int] = {}
        self._number = 0

    def add(self, topic: Topic[Any], capacity: int | None = None) -> None:
        """Accept messages of `topic` from now on, `compute_capacity(topic)` of them at a time."""
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
        arrivals.sort(key=attrgetter("number"))
        return arrivals, dropped

    def find_oldest_ns(self) -> int | None:
        """Return when the oldest waiting message was received [ns]; None if none waits."""
        with self._lock:
            heads = [queue[0].received_ns for queue in self._queues.values() if queue]
        return min(heads, default=None)

    def count_dropped(self, topic: Topic[Any]) -> int:
        """Return how many messages of `topic` were dropped."""
        return self._dropped[topic.name]


def compute_capacity(topic: Topic[Any]) -> int:
    """Return the capacity for a topic; twice as many if both sides publish it."""
    publishers = 2 if topic.publisher is None else 1
    return max(CAPACITY_MIN, round(BACKLOG_S * topic.rate_hz * publishers))


# messages of a topic whose tags are checked: at once, per second
VERIFY_BURST, VERIFY_HZ = 50, 500.0
VERIFY_RATIO = 4.0  # and at least so many times those that are expected
SENDERS = 64  # senders tracked per topic; beyond that the least recent one is dropped


class ReceivedMessage(NamedTuple):
    """A received message: checked, not unpacked."""

    topic: Topic[Any]
    data: bytes
    received_ns: int  # on our clock, from Zenoh's callback
    sender: int
    sequence: int
    stamp_ns: int  # on the sender's clock


class Listener:
    """Collects messages of several topics until they are drained.

    Zenoh's thread stamps and queues; `drain` checks. A reader that falls behind by more than
    `compute_capacity` of a topic loses its oldest messages. They are counted in `dropped`,
    and their gap in the sequence as `overwritten`, not `lost`.

    Of topics that we act on (`Keyring.find_keys`), Zenoh's thread queues only messages with the tag
    of their sender, and looks at `VERIFY_HZ` a second at most: others cost neither the loop's time
    nor memory.

    `visit` is as of `Reception`, with the topic; without a `keyring` the session is insecure.
    """

    def __init__(
        self, visit: Callable[[Topic[Any], int], int], keyring: Keyring | None = None
    ) -> None:
        self._queue = MessageQueue()
        self._visit, self._keyring = visit, keyring
        self._refused: dict[str, int] = {}
        self._forged: dict[str, int] = {}
        self._senders: dict[str, _SenderChecks] = {}
        self.subscribers: list[Any] = []  # of Zenoh; `close` ends them

    def close(self) -> None:
        """End it before the link: nothing arrives any more."""
        while self.subscribers:
            self.subscribers.pop().undeclare()

    def store(self, topic: Topic[Any], sampled: bool = False) -> Callable[[zenoh.Sample], None]:
        """Return the callback for Zenoh's samples of `topic`, or of copies of some of them."""
        self._queue.add(topic)
        self._senders[topic.name] = _SenderChecks(topic, self._visit, sampled)
        put = self._queue.put
        if self._keyring is not None and self._keyring.find_keys(topic) is not None:
            return self._build_verifier(topic, self._keyring.verify)
        # copied at once: a payload keeps its whole receive buffer alive
        return lambda sample: put(topic, sample.payload.to_bytes(), now_ns())

    def count_refused(self, topic: Topic[Any]) -> int:
        """Return how many messages of `topic` had no right tag, or came too fast."""
        return self._refused.get(topic.name, 0)

    def count_forged(self, topic: Topic[Any]) -> int:
        """Return how many of them had a wrong tag for us."""
        return self._forged.get(topic.name, 0)

    def _build_verifier(
        self, topic: Topic[Any], verify: Callable[[Topic[Any], bytes, bytes], TagVerdict]
    ) -> Callable[[zenoh.Sample], None]:
        """Return the callback that queues messages of `topic` with the right tag only."""
        allowed = RateLimit(VERIFY_BURST, max(VERIFY_HZ, VERIFY_RATIO * topic.rate_hz))
        size, name = topic.message.schema.size, topic.name
        put, refused, forged = self._queue.put, self._refused, self._forged

        def store(sample: zenoh.Sample) -> None:
            tags = sample.attachment
            if tags is not None and len(sample.payload) == size and allowed():
                data = sample.payload.to_bytes()
                found = verify(topic, data, tags.to_bytes())
                if found is TagVerdict.GENUINE:
                    put(topic, data, now_ns())
                    return
                if found is TagVerdict.FORGED:
                    forged[name] = forged.get(name, 0) + 1
            refused[name] = refused.get(name, 0) + 1

        return store

    def drain(self, limit: int | None = None) -> list[ReceivedMessage]:
        """Return the messages since the last call, oldest first, checked as by `Latest`.

        With a `limit` at most so many are taken; the others wait for the next call.
        """
        if not self._queue.has_arrivals:
            return []
        arrivals, dropped = self._queue.take(limit)
        for name, count in dropped.items():
            self._senders[name].note_dropped(count)
        messages = []
        for _, topic, data, received_ns in arrivals:
            head = self._senders[topic.name].admit(data)
            if head is not None:
                messages.append(ReceivedMessage(topic, data, received_ns, *head))
        return messages

    def find_oldest_ns(self) -> int | None:
        """Return when the oldest waiting message was received [ns]; None if none waits."""
        return self._queue.find_oldest_ns()

    def count_messages(self, topic: Topic[Any]) -> MessageCounts:
        """Return the message counts of `topic`, all senders together."""
        senders = self._senders.get(topic.name)
        return MessageCounts() if senders is None else senders.count_messages()

    def count_dropped(self, topic: Topic[Any]) -> int:
        """Return how many received messages of `topic` were dropped before they were read.

        Exact even without a later message: stored = drained + rejected + dropped.
        """
        return self._queue.count_dropped(topic)


class _SenderChecks:
    """The checks of a topic: one `Reception`, or one per sender if several publish it.

    Only senders with an accepted message are tracked, at most `SENDERS`; counts of dropped ones
    are kept.
    """

    def __init__(
        self, topic: Topic[Any], visit: Callable[[Topic[Any], int], int], sampled: bool
    ) -> None:
        self._topic, self._visit = topic, visit
        self._sampled = sampled  # all gaps are due to us
        self._receptions: OrderedDict[int, Reception] = OrderedDict()
        self._overflowed: set[int] = set()  # whose next gap is due to our queue
        self._dropped = 0
        self._forgotten = MessageCounts()

    def __len__(self) -> int:
        return len(self._receptions)

    def note_dropped(self, dropped: int) -> None:
        """Update the number of dropped messages of the topic."""
        if dropped > self._dropped:
            self._dropped = dropped
            self._overflowed = set(self._receptions)

    def admit(self, data: bytes) -> Head | None:
        """Return the head of `data` if it is accepted, else None."""
        shared = self._topic.publisher is None
        sender = self._topic.message.schema.read_sender(data) if shared else 0
        known = self._receptions.get(sender)
        reception = known or Reception(self._topic, self._find_visit)
        head = reception.admit(data, overflowed=self._sampled or sender in self._overflowed)
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

    def count_messages(self) -> MessageCounts:
        """Return the counts of all checked messages."""
        return sum((r.counts for r in self._receptions.values()), self._forgotten)

    def _find_visit(self, nonce: int) -> int:
        return 1 if self._topic.publisher is None else self._visit(self._topic, nonce)

    def _forget(self) -> None:
        while len(self._receptions) > SENDERS:
            sender, reception = self._receptions.popitem(last=False)
            self._overflowed.discard(sender)
            self._forgotten += reception.counts
