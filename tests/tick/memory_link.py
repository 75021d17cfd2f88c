"""A session's two links in one thread: the real `Link`, on lists in place of a network."""

from collections import defaultdict, deque
from collections.abc import Callable
from types import SimpleNamespace

from teleop.link import Link, LinkConfig
from teleop.messages.topics import TOPICS, Role
from tests.tick.profile import Calls


class Payload(bytes):
    """A payload of Zenoh."""

    to_bytes = bytes.__bytes__


class Sample:
    """What Zenoh gives a subscriber; reading it is a call of C, as there."""

    __slots__ = ("attachment", "payload")

    def __init__(self, data: bytes, tags: bytes | None = None) -> None:
        self.payload = Payload(data)
        self.attachment = None if tags is None else Payload(tags)


class Session:
    """Stands in for a Zenoh session: what is published is kept until it is carried over."""

    def __init__(self) -> None:
        self.sent: dict[str, list[bytes]] = defaultdict(list)
        self.tags: dict[str, list[bytes | None]] = defaultdict(list)
        self.puts: dict[str, Callable[..., None]] = {}
        self.stores: dict[str, Callable[[Sample], None]] = {}

    def liveliness(self):
        nothing = SimpleNamespace(undeclare=lambda: None, try_recv=lambda: None)
        return SimpleNamespace(
            declare_subscriber=lambda *_, **__: nothing, declare_token=lambda _: nothing
        )

    def declare_queryable(self, *_):
        return SimpleNamespace(undeclare=lambda: None)

    def declare_subscriber(self, key, handler):
        self.stores[key] = getattr(handler, "callback", handler)

    def declare_publisher(self, key, **_):
        def tell(handler):
            handler.callback(SimpleNamespace(matching=True))

        sent, tags = self.sent[key], self.tags[key]

        def put(data, attachment=None):
            sent.append(data)
            tags.append(attachment)

        self.puts[key] = put
        return SimpleNamespace(put=put, declare_matching_listener=tell)

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
    delay_ns : int
        For which a message is on the way, of the clock `now`.
    """

    def __init__(self, role: Role) -> None:
        super().__init__(LinkConfig(), "tick", role)
        self.world: Callable[[], None] = lambda: None
        self.calls: Calls | None = None
        self.way: Callable[[bytes], bytes | None] | None = None
        self.delay_ns = 0
        self.now: Callable[[], int] = lambda: 0
        self._on_the_way: deque[tuple[int, Callable[[Sample], None], Sample]] = deque()

    def _open(self):
        return Session()

    def _find_endpoints(self):
        return [], []

    def _settle(self) -> None:
        """Nobody else is there."""

    def wait(self, topic, deadline_ns):  # noqa: ARG002
        counting = self.calls is not None and self.calls.pause()
        self.world()
        arrived = super().wait(topic, 0)  # nothing more comes: the other side has had its tick
        if counting:
            self.calls.resume()
        return arrived

    def sent(self, topic) -> list[bytes]:
        """What was published on `topic` and not carried over yet."""
        return self._zenoh.sent[self._build_key(topic.name)]

    def putting(self, topic):
        """The code of the function that sends messages of `topic`."""
        self._get_publisher(topic)
        return self._zenoh.puts[self._build_key(topic.name)].__code__

    def meet(self, peers: "list[Link]") -> None:
        """Announce the others of the session to this side."""
        for peer in peers:
            peer_process = self._roster.examine(peer._token)
            peer_process.must_answer = False  # nobody carries challenges
            self._roster._processes[peer._token] = peer_process
            self._roster._admit(peer_process)

    def carry(self, peer: "MemoryLink") -> None:
        """Give `peer` what this side has published since the last time; see `way`."""
        for key, messages in self._zenoh.sent.items():
            store = peer._zenoh.stores.get(key)
            tags = self._zenoh.tags[key]
            for data, tag in zip(messages, tags, strict=True) if store else ():
                if self.way is None:
                    self._send(store, Sample(data, tag))
                elif (carried := self.way(data)) is not None:
                    self._send(store, Sample(carried, self._tags(key, carried)))
            messages.clear()
            tags.clear()
        while self._on_the_way and self._on_the_way[0][0] <= self.now():
            _, store, sample = self._on_the_way.popleft()
            store(sample)

    def _send(self, store: Callable[[Sample], None], sample: Sample) -> None:
        self._on_the_way.append((self.now() + self.delay_ns, store, sample))

    def _tags(self, key: str, data: bytes) -> bytes:
        """The tags of a message that was altered: as if its sender had sent it so."""
        (topic,) = (topic for topic in TOPICS if self._build_key(topic.name) == key)
        tags = b""
        for addressee, base in self._keyring.find_seal_keys(topic).entries:
            mac = base.copy()
            mac.update(data)
            tags += addressee + mac.digest()
        return tags
