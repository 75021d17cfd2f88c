"""Publish a topic: its messages with their tags, and copies of some of them for viewers.

A viewer draws a tenth of the messages of a fast topic; receiving all of them, a thousand a second
of each, would take more of its processor time than drawing, and as much of a router's. So such a
topic has a second key, `<key>/sampled`, with as many as are drawn (`Topic.sampled_hz`).
"""

from collections.abc import Callable
from typing import Any

import zenoh

from teleop.link.network import declare_publisher
from teleop.runtime.clock import now_ns
from teleop.security.keyring import TagKeys


def build_sampled_key(key: str) -> str:
    """Return the key of the copies of some of a topic's messages."""
    return f"{key}/sampled"


class Publisher:
    """The publisher of a topic.

    Zenoh's thread updates whether there are subscribers, and the addressees of the tags.

    Its messages are tagged with `seals`; of a `live` one old values are dropped, rather than sent
    late, unless it is `patient` and waits for space in a full queue. There are `sampled_hz` [Hz]
    copies for viewers. `sequence` is the number of the last message.
    """

    __slots__ = ("_copied", "_copies", "_period_ns", "_put", "_seals", "_subscribed", "sequence")

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        seals: TagKeys,
        live: bool,
        sampled_hz: float = 0.0,
        patient: bool = False,
    ) -> None:
        self._subscribed = SubscriberAwarePublisher(declare_publisher(session, key, live, patient))
        self._put = self._subscribed.put
        self._seals = seals
        self._copies = (
            SubscriberAwarePublisher(
                declare_publisher(session, build_sampled_key(key), live, patient)
            )
            if sampled_hz
            else None
        )
        self._period_ns = round(1e9 / sampled_hz) if sampled_hz else 0
        self._copied = -1  # period of the last copy; periods are on a fixed grid of stamps
        self.sequence = 0

    @property
    def needed(self) -> bool:
        """Whether somebody waits for the next message, or for a copy of it."""
        return self._subscribed.now or (
            self._copies is not None
            and self._copies.now
            and now_ns() // self._period_ns != self._copied
        )

    def send(self, data: bytes | bytearray, stamp_ns: int) -> None:
        """Send a message of this stamp [ns] with its tags; takes microseconds."""
        tags = b""
        for addressee, base in self._seals.entries:
            mac = base.copy()
            mac.update(data)
            tags += addressee + mac.digest()
        self._put(data, attachment=tags or None)
        if self._copies is not None and stamp_ns // self._period_ns != self._copied:
            self._copied = stamp_ns // self._period_ns
            if self._copies.now:
                self._copies.put(data)


class SubscriberAwarePublisher:
    """A Zenoh publisher that knows whether it has subscribers.

    `put` sends bytes; `now` is whether there is a subscriber.
    """

    __slots__ = ("_listener", "now", "put")

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self.put: Callable[..., None] = publisher.put
        self.now = False
        direct = zenoh.handlers.Callback(self._on_change, indirect=False)
        self._listener: Any = publisher.declare_matching_listener(direct)

    def _on_change(self, status: zenoh.MatchingStatus) -> None:
        self.now = status.matching
