"""A session's two links in one thread: the real `Link`, on lists in place of a network."""

from collections import defaultdict
from collections.abc import Callable
from types import SimpleNamespace

from teleop.link import Link, LinkConfig
from teleop.link.presence import Stage, Token
from teleop.messages import LAYOUT
from teleop.topics import Role
from tests.tick.profile import Calls


class Sample:
    """What Zenoh gives a subscriber; reading it is a call of C, as there."""

    __slots__ = ("payload",)

    def __init__(self, data: bytes) -> None:
        self.payload = SimpleNamespace(to_bytes=data.__bytes__)


class Session:
    """Stands in for a Zenoh session: what is published is kept until it is carried over."""

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = defaultdict(list)
        self.stores: dict[str, Callable[[Sample], None]] = {}

    def liveliness(self):
        nothing = SimpleNamespace(undeclare=lambda: None)
        return SimpleNamespace(
            declare_subscriber=lambda *_, **__: nothing, declare_token=lambda _: nothing
        )

    def declare_subscriber(self, key, handler):
        self.stores[key] = getattr(handler, "callback", handler)

    def declare_publisher(self, key, **_):
        def tell(handler):
            handler.callback(SimpleNamespace(matching=True))

        return SimpleNamespace(put=self.sent[key].append, declare_matching_listener=tell)

    def close(self) -> None:
        """Nothing is open."""


class MemoryLink(Link):
    """One side's link.

    Attributes
    ----------
    world : callable
        What happens while this side waits.
    calls : Calls or None
        What is counted of this side, but not the wait.
    way : callable or None
        What becomes of a message on the way to the peer: other bytes, or None if it is lost.
    """

    def __init__(self, role: Role) -> None:
        super().__init__(LinkConfig(), "tick", role)
        self.world: Callable[[], None] = lambda: None
        self.calls: Calls | None = None
        self.way: Callable[[bytes], bytes | None] | None = None

    def _open(self):
        return Session()

    def _settle(self) -> None:
        """Nobody else is there."""

    def wait(self, topic, deadline_ns):
        counting = self.calls is not None and self.calls.pause()
        self.world()
        arrived = super().wait(topic, deadline_ns)
        if counting:
            self.calls.resume()
        return arrived

    def sent(self, topic) -> list[bytes]:
        """What was published on `topic` and not carried over yet."""
        return self._zenoh.sent[self._key(topic)]

    def meet(self, peers: "list[Link]") -> None:
        """Announce the others of the session to this side."""
        self._roster.replace(
            frozenset(Token(peer.role, LAYOUT, peer.nonce, Stage.HELD) for peer in peers)
        )

    def carry(self, peer: "MemoryLink") -> None:
        """Give `peer` what this side has published since the last time; see `way`."""
        for key, messages in self._zenoh.sent.items():
            store = peer._zenoh.stores.get(key)
            for data in messages if store else ():
                carried = data if self.way is None else self.way(data)
                if carried is not None:
                    store(Sample(carried))
            messages.clear()
