"""One direction of the proxy: the model of each topic, the clock, the switch and the counts."""

import heapq
import itertools
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from teleop.impair import model
from teleop.impair.config import DirectionConfig
from teleop.impair.model import DeliveryFlags, StreamState
from teleop.link.bridge import BridgeEnd
from teleop.messages.topics import TOPICS, Topic
from teleop.runtime.clock import Durations

# --- a queue that delivers messages at their due time, within a fraction of a millisecond

WAIT_S = 0.02  # longest wait of `send_due`, so that its caller can stop
# Both directions of a session at 1 kHz are 2200 messages/s of 420 bytes; with the longest delay,
# jitter and hold-back that a config may ask for, 30 s, that is 41 MB.
CAPACITY_BYTES = 64_000_000
ENTRY_BYTES = 200  # that a waiting message takes beside its own


class DelayQueue:
    """Messages with due times; filled from any thread, emptied by one.

    It holds `capacity_bytes` at most. If it is full, new messages are dropped, as in a network
    queue; accepted ones keep their order and time.

    A message that waits counts as its length plus `ENTRY_BYTES` [bytes], together `held_bytes`;
    `lateness` is that of deliveries.
    """

    def __init__(self, capacity_bytes: int = CAPACITY_BYTES) -> None:
        self.lateness = Durations()
        self._capacity_bytes, self.held_bytes = capacity_bytes, 0
        self._queue: list[tuple[int, int, Callable[[bytes], None], bytes]] = []
        self._numbers = itertools.count()  # tie-breaker: first in, first out
        self._changed = threading.Condition()

    def __len__(self) -> int:
        return len(self._queue)

    def send(self, due_ns: int, put: Callable[[bytes], None], data: bytes) -> bool:
        """Schedule `put(data)` at `due_ns` of the machine's monotonic clock.

        Returns whether it was accepted; False = the queue is full and the message is dropped.
        """
        size = len(data) + ENTRY_BYTES
        with self._changed:
            if self.held_bytes + size > self._capacity_bytes:
                return False
            self.held_bytes += size
            heapq.heappush(self._queue, (due_ns, next(self._numbers), put, data))
            if self._queue[0][0] == due_ns:
                self._changed.notify()
        return True

    def wake(self) -> None:
        """Make `send_due` return soon."""
        with self._changed:
            self._changed.notify()

    def send_due(self) -> None:
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
                self.held_bytes -= len(data) + ENTRY_BYTES
            put(data)
            self.lateness.add(now - due_ns)


_COUNTER_NAMES = {
    DeliveryFlags.CUT: "cut",
    DeliveryFlags.LOST: "lost",
    DeliveryFlags.LOST_IN_BURST: "lost_in_bursts",
    DeliveryFlags.CORRUPTED: "corrupted",
    DeliveryFlags.DUPLICATED: "duplicated",
    DeliveryFlags.HELD_BACK: "held_back",
}


class Direction:
    """Messages and announcements from the `near` bank to the `far` one.

    Zenoh's thread calls `take`; everything else is called by whoever runs the delay queue.

    `cut` is whether transmission is cut by command.
    """

    def __init__(
        self,
        name: str,
        config: DirectionConfig,
        seed: int,
        near: BridgeEnd,
        far: BridgeEnd,
        queue: DelayQueue,
    ) -> None:
        self.cut = False
        self._near, self._far, self._queue = near, far, queue
        self._keys = {topic.name: model.compute_key(seed, name, topic.name) for topic in TOPICS}
        self._puts = {topic.name: far.put(topic) for topic in TOPICS}
        self._memories = dict.fromkeys(self._keys, StreamState())
        self._counts: dict[str, Counter[str]] = {topic: Counter() for topic in self._keys}
        self._start_ns = 0  # time of the first live message; reference of cuts and jitter
        self._cut_ns = 0  # start of the present cut, 0 = none
        self._lock = threading.Lock()
        self.configure(config)

    def configure(self, config: DirectionConfig) -> None:
        """Use `config` from the next message on."""
        self._configs = {
            True: config.select_impairments(live=True),
            False: config.select_impairments(live=False),
        }

    def take(self, topic: Topic[Any], data: bytes) -> None:
        """Process a new message and pass it to the delay queue."""
        now, name = time.monotonic_ns(), topic.name
        with self._lock:
            if topic.live and not self._start_ns:
                self._start_ns = now
            deliveries, flags, self._memories[name] = model.step(
                self._configs[topic.live],
                self._keys[name],
                self._memories[name],
                (now - self._start_ns) * 1e-9 if self._start_ns else 0.0,
                data,
                self.cut,
            )
            counts = self._counts[name]
            counts["came"] += 1
            for flag in flags:
                counts[_COUNTER_NAMES[flag]] += 1
            start, put = self._start_ns or now, self._puts[name]
            for delivery in deliveries:
                due_ns = start + round(delivery.due * 1e9)
                sent = self._queue.send(due_ns, put, delivery.data)
                counts["sent" if sent else "overflowed"] += 1

    def mirror(self, presence_s: float) -> None:
        """Mirror subscriptions and presence of each bank on the other."""
        for topic in TOPICS:
            self._near.follow(topic, self._far.has_listener(topic), self.take)
        now = time.monotonic_ns()
        if not self._is_cut(now):
            self._cut_ns = 0
            self._far.announce(self._near.tokens)
            return
        self._cut_ns = self._cut_ns or now
        if now - self._cut_ns >= presence_s * 1e9:
            self._far.announce(frozenset())

    def count_messages(self) -> dict[str, dict[str, int]]:
        """Return the message counts of each topic with messages."""
        with self._lock:
            return {
                topic: {
                    name: counts[name]
                    for name in ("came", "sent", *_COUNTER_NAMES.values(), "overflowed")
                }
                for topic, counts in self._counts.items()
                if counts["came"]
            }

    def _is_cut(self, now_ns: int) -> bool:
        started = self._start_ns > 0
        return self.cut or (
            started and self._configs[True].cut_at((now_ns - self._start_ns) * 1e-9)
        )
