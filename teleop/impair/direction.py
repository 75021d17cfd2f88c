"""One direction of the proxy: the model of each topic, the clock, the switch and the counts."""

import threading
import time
from collections import Counter
from typing import Any

from teleop.impair import model
from teleop.impair.config import DirectionConfig
from teleop.impair.delay_queue import DelayQueue
from teleop.impair.model import Fate, StreamState
from teleop.link.bridge import BridgeEnd
from teleop.messages.topics import TOPICS, Topic

_COUNTER_NAMES = {
    Fate.CUT: "cut",
    Fate.LOST: "lost",
    Fate.LOST_IN_BURST: "lost_in_bursts",
    Fate.CORRUPTED: "corrupted",
    Fate.DUPLICATED: "duplicated",
    Fate.HELD_BACK: "held_back",
}


class Direction:
    """Messages and announcements from the `near` bank to the `far` one.

    Zenoh's thread calls `take`; everything else is called by whoever runs the delay queue.

    Attributes
    ----------
    cut : bool
        Whether transmission is cut by command.
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
        self._keys = {topic.name: model.key_of(seed, name, topic.name) for topic in TOPICS}
        self._puts = {topic.name: far.put(topic) for topic in TOPICS}
        self._memories = dict.fromkeys(self._keys, StreamState())
        self._counts: dict[str, Counter[str]] = {topic: Counter() for topic in self._keys}
        self._start_ns = 0  # time of the first live message; reference of cuts and jitter
        self._cut_ns = 0  # start of the present cut, 0 = none
        self._lock = threading.Lock()
        self.configure(config)

    def configure(self, config: DirectionConfig) -> None:
        """Use `config` from the next message on."""
        self._configs = {True: config.of(live=True), False: config.of(live=False)}

    def take(self, topic: Topic[Any], data: bytes) -> None:
        """Process a new message and pass it to the delay queue."""
        now, name = time.monotonic_ns(), topic.name
        with self._lock:
            if topic.live and not self._start_ns:
                self._start_ns = now
            deliveries, fate, self._memories[name] = model.step(
                self._configs[topic.live],
                self._keys[name],
                self._memories[name],
                (now - self._start_ns) * 1e-9 if self._start_ns else 0.0,
                data,
                self.cut,
            )
            counts = self._counts[name]
            counts["came"] += 1
            for flag in fate:
                counts[_COUNTER_NAMES[flag]] += 1
            start, put = self._start_ns or now, self._puts[name]
            for delivery in deliveries:
                due_ns = start + round(delivery.due * 1e9)
                sent = self._queue.send(due_ns, put, delivery.data)
                counts["sent" if sent else "overflowed"] += 1

    def mirror(self, presence_s: float) -> None:
        """Mirror subscriptions and presence of each bank on the other."""
        for topic in TOPICS:
            self._near.follow(topic, self._far.listens(topic), self.take)
        now = time.monotonic_ns()
        if not self._is_cut(now):
            self._cut_ns = 0
            self._far.announce(self._near.tokens)
            return
        self._cut_ns = self._cut_ns or now
        if now - self._cut_ns >= presence_s * 1e9:
            self._far.announce(frozenset())

    def counts(self) -> dict[str, dict[str, int]]:
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
