"""Reception of a topic: its inbox, accepted messages, losses, age of the newest one."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from hmac import compare_digest
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeAlias, TypeVar

from teleop.messages.messages import Head, Message, MessageError
from teleop.messages.packet import Packet
from teleop.messages.topics import Topic
from teleop.runtime.clock import now_ns
from teleop.security.keyring import TagVerdict, check_tags

# --- inbox of one topic, with a wait that ends at an arrival
# Zenoh's receiving thread stores, the loop's thread waits and takes. Zenoh calls the C method
# `SimpleQueue.put`, which wakes the reader without running Python code that would still hold the
# interpreter lock. This wait has the latency of polling at the least processor time
# (docs/explanation/coupling.md).


TimedBytes: TypeAlias = tuple[bytes, int]
"""A received message with its tags, and when the loop first took it, on our clock [ns]."""


class Inbox:
    """The newest messages of a topic.

    Of more than `size` messages the oldest are dropped; if it is `tagged` each has its tags behind
    it. Zenoh's thread calls `store` with each sample.
    """

    def __init__(self, size: int, tagged: bool = False) -> None:
        self._size, self._tagged = size, tagged
        self._queue: SimpleQueue[Any] = SimpleQueue()
        self._taken: list[TimedBytes] = []  # by `wait`, not yet by `take`
        self.store: Callable[[Any], None] = self._queue.put

    def wake(self) -> None:
        """End a wait now; every signal handler must call it.

        A `SimpleQueue.get` interrupted by a signal continues to wait for the rest of its time, or
        for ever if the handler took longer (CPython 3.11 and 3.12, _queuemodule.c).
        """
        self._queue.put(None)

    def wait(self, deadline_ns: int) -> bool:
        """Wait for a message, at most until a time of the monotonic clock [ns].

        In CPython 3.11 and 3.12, `SimpleQueue.get(timeout)` waits for ever if the lock of the queue
        is free and the deadline passes before the wait begins: the thread was not running. The lock
        is free after each `get` that waited for its item, and taken after a `get_nowait` that found
        none.
        """
        if self._taken:
            return True
        try:
            sample = self._queue.get_nowait()
        except Empty:
            timeout = (deadline_ns - time.monotonic_ns()) * 1e-9
            if timeout <= 0.0:
                return False
            try:
                sample = self._queue.get(timeout=timeout)
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


M = TypeVar("M", bound=Message)

CLOCK_JUMP_NS = 1_000_000_000  # a message that much faster than any before: the clock jumped
REJECTION_COUNTERS = ("corrupted", "layout", "repeated", "out_of_order", "foreign", "forged")
# of MessageCounts, those that a LoopReport has too
REPORTED_COUNTERS = (
    "received", "lost", "rejected", "corrupted", "repeated", "out_of_order", "foreign", "forged",
    "unknown", "delayed", "clock_jumps", "restarts",
)  # fmt: skip
ENDED_SENDERS_MAX = 256  # earlier senders whose last sequence number is kept
SETTLE_NS = 200_000_000  # after a clock was set: hundreds of messages, one of which is not late
UNSETTLED_NS = 10_000_000_000  # age of the messages until then: beyond every timeout
NEVER_NS = 2**63 - 1  # age of a missing message: beyond every limit
DRIFT = 1000  # inverse of the largest drift between two clocks; NTP slews by half of that


@dataclass(slots=True)
class MessageCounts:
    """Message counts of one topic."""

    received: int = 0
    lost: int = 0  # gaps in the sender's sequence
    overwritten: int = 0  # arrived, but a newer one did before the reader looked
    corrupted: int = 0
    layout: int = 0  # of another message layout
    repeated: int = 0
    out_of_order: int = 0
    foreign: int = 0  # from another sender while ours is alive
    unknown: int = 0  # from a sender without a believed token, or not tagged for us; ignored
    forged: int = 0  # with a wrong tag for us
    delayed: int = 0  # accepted, but too old on arrival
    clock_jumps: int = 0  # the sender's clock was set, forward or back
    restarts: int = 0  # the sender's process was replaced

    @property
    def rejected(self) -> int:
        """Number of rejected messages."""
        return sum(getattr(self, kind) for kind in REJECTION_COUNTERS)

    def __add__(self, other: "MessageCounts") -> "MessageCounts":
        return MessageCounts(
            *(getattr(self, f.name) + getattr(other, f.name) for f in fields(self))
        )


class Reception:
    """Decides which messages of a topic are accepted, and counts them.

    `visit` returns the visit number of a nonce in the publishing role: 0 while it is not announced,
    1 at first, incremented each time it comes back. With `senders`, keyed hashes by sender
    (`Keyring.find_keys`), messages come with their tags behind them, ours under `addressee`, and
    nothing in one without the right tag is believed.
    """

    def __init__(
        self,
        topic: Topic[M],
        visit: Callable[[int], int],
        senders: Mapping[int, Any] | None = None,
        addressee: bytes = b"",
    ) -> None:
        self.counts = MessageCounts()
        self.sender: int | None = None
        self.sequence = 0
        self._schema = topic.message.schema
        self._visit = visit
        self._senders, self._addressee = senders, addressee
        self._ended: dict[int, int] = {}  # last sequence numbers of earlier senders

    def admit(self, data: bytes, overflowed: bool = False) -> Head | None:
        """Return the head of `data` if it is accepted, else None.

        `overflowed`: the channel was full, so a gap before `data` is not a loss of the network. A
        sender not (yet) announced is ignored: its first messages may overtake its token, so
        `unknown` is not counted as rejected.
        """
        counts = self.counts
        tags = b""
        if self._senders is not None:
            data, tags = data[: self._schema.size], data[self._schema.size :]
        try:
            head = self._schema.check(data)
        except MessageError as error:
            if error.kind == "layout":
                counts.layout += 1
            else:
                counts.corrupted += 1
            return None
        if self._senders is not None:
            base = self._senders.get(head.sender)
            if base is None:
                counts.unknown += 1
                return None
            mac = base.copy()
            mac.update(data)
            tag = self._addressee + mac.digest()
            # usually there is one tag, which costs no call of Python
            if not compare_digest(tags, tag):
                verdict = check_tags(tag, tags)
                counts.forged += verdict is TagVerdict.FORGED
                counts.unknown += verdict is TagVerdict.UNKNOWN
                if verdict is not TagVerdict.GENUINE:
                    return None
        if head.sender == self.sender:
            gap = head.sequence - self.sequence
            if gap <= 0:
                counts.repeated += gap == 0
                counts.out_of_order += gap < 0
                return None
            if overflowed:
                counts.overwritten += gap - 1
            else:
                counts.lost += gap - 1
        elif self.sender is not None and self._visit(self.sender):
            counts.foreign += 1
            return None
        elif not self._visit(head.sender):
            counts.unknown += 1
            return None
        elif head.sequence <= self._ended.get(head.sender, -1):
            counts.out_of_order += 1  # an earlier sender's message, played back
            return None
        else:
            if self.sender is not None:
                counts.restarts += 1
                self._ended[self.sender] = self.sequence
                if len(self._ended) > ENDED_SENDERS_MAX:
                    del self._ended[next(iter(self._ended))]
            self.sender = head.sender
        self.sequence = head.sequence
        counts.received += 1
        return head


class LatestMessage(Generic[M]):
    """The newest message of a topic and its age.

    The age of a message is the time since its arrival, plus its delay in excess of the fastest
    message of its sender. So a message from a stalled network is old when it arrives, without
    synchronised clocks:

        delay = seen - stamp            (both clocks: unknown offset + travelling time)
        least = running minimum of delay, rising by 1/DRIFT of the time for clock drift
        age   = (now - seen) + (delay - least)

    The constant part of the travelling time is not observable and not included.

    A machine resumes from sleep with its clock far behind, but over a new connection without old
    messages: its token has vanished and returned, and `least` is reset, as for a new sender.

    A clock that is set needs no restart. Numbers rise, so a stamp below the one before was made by
    a clock set back: `least` is reset. So it is if the loop finds in another way, by the round trip
    (`teleop.link.health`), that messages look too old because a clock was set (`was_clock_set`).
    For `SETTLE_NS` after that `settles` is true: all messages count as old, and the session must
    hold. A clock set forward lowers `least` by itself. Jumps are counted.

    A message older than `limit_ns` [ns] on arrival is counted as delayed; for the others see
    `Reception`.
    """

    def __init__(
        self,
        topic: Topic[M],
        visit: Callable[[int], int],
        limit_ns: int = NEVER_NS,
        senders: Mapping[int, Any] | None = None,
        addressee: bytes = b"",
    ) -> None:
        self.packet = Packet(topic.message)  # the newest message, if any
        self.is_there = False  # whether there is
        self.new = False  # whether the last `take` had a new message
        self.received_ns = 0  # when the message was first read
        self._reception = Reception(topic, visit, senders, addressee)
        self._visit = visit
        self._seen_visit = (0, 0)  # sender and visit of the clock comparison
        self._message, self._size = topic.message, topic.message.schema.size
        self._object: M | None = None  # of `message`, made on demand
        self._limit_ns = limit_ns
        self.stamp_ns = 0  # when it was sent, on its sender's clock
        self._least_ns = 0
        self._late_ns = 0
        self._settled_ns = 0
        self.settles = False  # whether a clock was set shortly before the newest message

    def was_clock_set(self) -> None:
        """Find anew which messages are late, if they count as too old now."""
        if self._late_ns > self._limit_ns and not self.settles:
            self._reception.counts.clock_jumps += 1
            self._settled_ns = self.received_ns + SETTLE_NS
            self.settles = True
            self._late_ns = UNSETTLED_NS
            self._least_ns = self.received_ns - self.stamp_ns

    @property
    def counts(self) -> MessageCounts:
        """Counts of all messages so far."""
        return self._reception.counts

    @property
    def message(self) -> M | None:
        """The newest message as an object (slow); None if there is none."""
        if self._object is None and self.is_there:
            self._object = self._message.unpack(self.packet.data.tobytes())
        return self._object

    def compute_age_ns(self, now_ns: int) -> int:
        """Return the age [ns] of the message at `now_ns`; `NEVER_NS` if there is none."""
        if not self.is_there:
            return NEVER_NS
        return max(0, now_ns - self.received_ns) + self._late_ns

    def is_fresh(self, now_ns: int, limit_ns: int) -> bool:
        """Return whether there is a message not older than `limit_ns` [ns]."""
        return self.compute_age_ns(now_ns) <= limit_ns

    def take(self, arrived: list[TimedBytes], overflowed: bool = False) -> None:
        """Process the messages since the last call, oldest first."""
        newest, newest_head, now_ns = None, None, 0
        for data, received_ns in arrived:
            head = self._reception.admit(data, overflowed)
            overflowed = False
            if head is not None:
                newest, newest_head, now_ns = data, head, received_ns
        self.new = newest is not None
        if newest is None or newest_head is None:
            return
        delay = now_ns - newest_head.stamp_ns
        sender, visit = newest_head.sender, self._visit(newest_head.sender)
        known, seen = self._seen_visit
        counts = self._reception.counts
        if sender == known and visit in (0, seen):  # 0: between two visits
            risen = self._least_ns + max(0, now_ns - self.received_ns) // DRIFT
            if newest_head.stamp_ns < self.stamp_ns:
                counts.clock_jumps += 1
                self._settled_ns = now_ns + SETTLE_NS
                self._least_ns = delay
            else:
                counts.clock_jumps += delay < self._least_ns - CLOCK_JUMP_NS
                self._least_ns = min(risen, delay)
        else:
            self._seen_visit = sender, visit
            self._least_ns = delay
        self.stamp_ns = newest_head.stamp_ns
        self.settles = now_ns < self._settled_ns
        self._late_ns = UNSETTLED_NS if self.settles else delay - self._least_ns
        counts.delayed += self._late_ns > self._limit_ns
        self.received_ns = now_ns
        self.packet.data[:] = newest if len(newest) == self._size else newest[: self._size]
        self.is_there, self._object = True, None
