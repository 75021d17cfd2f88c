"""A network with delay, jitter and loss, by seed, in front of the live reception."""

from typing import Generic, TypeVar

import numpy as np

from teleop.link.reception import LatestMessage
from teleop.messages.messages import Message
from teleop.messages.packet import Packet
from teleop.messages.topics import Topic

M = TypeVar("M", bound=Message)


class Channel(Generic[M]):
    """One direction of one topic: message bytes with delay, reordering and loss.

    Parameters
    ----------
    topic : Topic
        Topic of the messages.
    sender : int
        Nonce of the sender.
    delay, jitter : float
        A message is under way for `delay` +- `jitter` [s], evenly spread, and not below 0.
    loss : float
        Share of the messages that never arrive.
    seed : int
        Of jitter and loss.
    """

    def __init__(
        self,
        topic: Topic[M],
        sender: int,
        delay: float,
        jitter: float = 0.0,
        loss: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._sender, self._delay, self._jitter, self._loss = sender, delay, jitter, loss
        self._rng = np.random.default_rng(seed)
        self._under_way: list[tuple[int, int, bytes]] = []  # (arrives [ns], number, bytes)
        self._latest = LatestMessage(topic, lambda _nonce: 1)
        self._sent = 0

    def send(self, packet: Packet[M], now_ns: int) -> None:
        """Fill in the head of a message and send it at `now_ns`."""
        self._sent += 1
        data = packet.seal(self._sender, self._sent, now_ns)
        late = self._delay + self._rng.uniform(-self._jitter, self._jitter)
        if self._rng.random() >= self._loss:
            arrives = now_ns + round(max(late, 0.0) * 1e9)
            self._under_way.append((arrives, self._sent, data))

    def newest(self, now_ns: int) -> LatestMessage[M]:
        """Return the live `Latest` at `now_ns`."""
        arrived = sorted(item for item in self._under_way if item[0] <= now_ns)
        self._under_way = [item for item in self._under_way if item[0] > now_ns]
        self._latest.take([(data, now_ns) for *_, data in arrived])
        return self._latest
