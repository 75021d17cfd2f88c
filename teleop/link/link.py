"""The link of one process to a session: publish, latest value, listen, presence."""

import time
from collections.abc import Container, Iterable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Self, TypeVar

import zenoh

from teleop.errors import PeerError, UsageError
from teleop.link.config import LinkConfig
from teleop.link.listener import Listener
from teleop.link.network import ConnectionProbe, Mode, load_credentials, open_session
from teleop.link.publisher import Publisher, build_sampled_key
from teleop.link.rate_limit import RefusalCounter
from teleop.link.reception import NEVER_NS, Inbox, LatestMessage, MessageCounts
from teleop.link.roster import DECISION_TIMEOUT_NS, Roster
from teleop.messages.messages import LAYOUT, TOPIC_SLOTS, Message
from teleop.messages.packet import Packet
from teleop.messages.topics import TOPICS, Role, Topic
from teleop.runtime.clock import now_ns
from teleop.security import CERTIFICATE_ROLES, Identity, presence
from teleop.security.access import build_access_control
from teleop.security.handshake import Handshake
from teleop.security.keyring import Keyring, TagKeys
from teleop.security.presence import RoleStage, Token

M = TypeVar("M", bound=Message)

INSECURE_WARNING = "INSECURE: whoever reaches the endpoints may move the robot (link.insecure)"
SETTLE_S = 0.3  # time for connecting, and again for detecting peers, before a start
INBOX_SIZE = 16  # messages kept between reads, so that a late read does not lose any


class Link:
    """The network link of a process, as a context manager; used from one thread.

    Nothing blocks once the link is open, and the network never raises: a lost peer shows in
    `present`, in ages and in counts.

    Parameters
    ----------
    session : str
        Root of all keys.
    role : Role
        Role of this process. The master listens and connects to the slave, the slave listens, the
        others connect to both. With routers, all connect to one of them.
    at_once : bool
        Whether to skip the detection of peers, which takes up to twice `SETTLE_S`: for listeners
        that repeat their messages until they are answered.

    Raises
    ------
    PeerError
        On entering: the session has a master (slave) already, or a peer of another message layout.
    UsageError
        There are no valid keys for this role; on entering: an endpoint cannot be listened on.
    TeleopError
        On entering: no router answers, if the config names some.
    """

    def __init__(self, config: LinkConfig, session: str, role: Role, at_once: bool = False) -> None:
        if at_once and role in presence.EXCLUSIVE_ROLES:
            raise ValueError(f"a {role!r} must look about before it takes its place")
        self._at_once = at_once
        self.config, self.session, self.role = config, session, role
        self.credentials = load_credentials(config, session, CERTIFICATE_ROLES[role])
        self.nonce = presence.create_nonce()
        self.refusals = RefusalCounter()
        self._handshake: Handshake | None = None
        self._keyring: Keyring | None = None
        if self.credentials is not None:
            self._handshake = Handshake(self.credentials, session, self.nonce)
            self._keyring = Keyring(role, self.nonce)
        self._token = Token(role, LAYOUT, self.nonce, RoleStage.CLAIM)
        self._publishers: dict[str, Publisher] = {}
        self._latest: dict[str, tuple[LatestMessage[Any], Inbox]] = {}
        self._subscribers: list[Any] = []

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            self._zenoh: Any = self._open()
            opening.callback(self._zenoh.close)
            relay = self.role == Role.SLAVE and not self.config.routers
            self._roster = Roster(
                self._zenoh, self.session, self._token, relay,
                self._handshake, self._keyring, self.refusals,
            )  # fmt: skip
            opening.callback(self._roster.close)
            announces = self.role not in presence.LISTENER_ROLES
            claim = self._announce() if announces else None
            if not self._at_once:
                self._settle()
            self._token = replace(self._token, stage=RoleStage.HELD)
            if claim is not None:
                self._held = self._announce()
                # the end of a claim shown later is told to nobody
                self._roster.show_token(self._token)
                claim.undeclare()
            probe = ConnectionProbe(
                self._find_endpoints()[1], self.credentials, self.session,
                lambda: [link.dst for link in self._zenoh.info.links()], self.refusals.note,
            )  # fmt: skip
            opening.enter_context(probe)
            self._closing = opening.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    @property
    def insecure(self) -> bool:
        """Whether nothing is authenticated nor encrypted."""
        return self.credentials is None

    @property
    def warning(self) -> str:
        """What is wrong with the protection of this link; empty if nothing."""
        return INSECURE_WARNING if self.credentials is None else self.credentials.warning

    def publish(self, topic: Topic[M], message: M) -> int:
        """Send `message` and return its stamp [ns]; takes microseconds."""
        publisher = self._get_publisher(topic)
        stamp = now_ns()
        publisher.sequence += 1
        data = topic.message.schema.pack(message, self.nonce, publisher.sequence, stamp)
        publisher.send(data, stamp)
        return stamp

    def publish_packet(self, topic: Topic[M], packet: Packet[M]) -> int:
        """Send `packet` and return its stamp [ns]; the head is filled in."""
        publisher = self._publishers.get(topic.name) or self._get_publisher(topic)
        stamp = now_ns()
        publisher.sequence += 1
        publisher.send(packet.seal(self.nonce, publisher.sequence, stamp), stamp)
        return stamp

    def skip_unsubscribed(self, topic: Topic[Any]) -> bool:
        """Return whether nobody needs the next message of `topic`, which then counts as sent.

        For messages to listeners only, to save composing them. The sequence number is used up, so
        that a reconnected listener detects the gap.
        """
        publisher = self._get_publisher(topic)
        if publisher.needed:
            return False
        publisher.sequence += 1
        return True

    def publish_raw(self, topic: Topic[Any], data: bytes) -> None:
        """Send a packed message; for a replay, which waits for space in the queue.

        It is rejected unless its sender is our `nonce`. It has no tags, so that nobody acts on it.
        """
        self._get_publisher(topic, patient=True).send(data, now_ns())

    def has_listener(self, topic: Topic[Any]) -> bool:
        """Return whether somebody subscribes to `topic`, or to copies of it; for a replay."""
        return self._get_publisher(topic, patient=True).needed

    def subscribe_latest(self, topic: Topic[M], limit_ns: int = NEVER_NS) -> LatestMessage[M]:
        """Subscribe to the latest value of `topic`; call it before the loop starts.

        Messages older than `limit_ns` [ns] on arrival are counted as delayed. A topic subscribed to
        already gives what it gave then, with the limit of then: a second inbox, which nobody reads,
        would keep all its messages.
        """
        if topic.name in self._latest:
            return self._latest[topic.name][0]
        if topic.publisher is None:
            raise ValueError(f"{topic.name} has several publishers, so no one latest value")
        keyring = self._keyring
        senders = None if keyring is None else keyring.find_keys(topic)
        addressee = b"" if keyring is None else keyring.addressee
        latest = LatestMessage(
            topic, partial(self._roster.find_visit, topic.publisher), limit_ns, senders, addressee
        )
        inbox = Inbox(INBOX_SIZE, tagged=senders is not None)
        direct = zenoh.handlers.Callback(inbox.store, indirect=False)  # no thread in between
        self._subscribers.append(
            self._zenoh.declare_subscriber(self._build_key(topic.name), direct)
        )
        self._latest[topic.name] = latest, inbox
        return latest

    def wait(self, topic: Topic[Any], deadline_ns: int) -> bool:
        """Wait for a message of `topic`, which must be subscribed to as a latest value.

        Returns whether there is one that `latest` has not processed; at the latest at `deadline_ns`
        of the machine's monotonic clock.
        """
        return self._latest[topic.name][1].wait(deadline_ns)

    def wake(self) -> None:
        """End a `wait` now; called by signal handlers, see `Inbox.wake`."""
        for _, inbox in self._latest.values():
            inbox.wake()

    def take_latest(self, topic: Topic[M]) -> LatestMessage[M]:
        """Process new messages of `topic`; return the newest with its age."""
        if topic.name not in self._latest:
            self.subscribe_latest(topic)
        latest, inbox = self._latest[topic.name]
        latest.take(*inbox.take())
        return latest

    def listen(self, topics: Iterable[Topic[Any]], sampled: Container[Topic[Any]] = ()) -> Listener:
        """Return a queue of everything published on `topics` from now on.

        Of those in `sampled`, which have copies, it gets `Topic.sampled_hz` messages a second; the
        others are counted as `overwritten`, not lost. Without a thread in between: that would keep
        256 samples a topic, with their buffers.
        """
        listener = Listener(self._visit, self._keyring)
        for topic in topics:
            key = self._build_key(topic.name)
            if topic in sampled:
                key = build_sampled_key(key)
            store = listener.store(topic, topic in sampled)
            direct = zenoh.handlers.Callback(store, indirect=False)
            listener.subscribers.append(self._zenoh.declare_subscriber(key, direct))
        return listener

    def is_present(self, role: Role, nonce: int | None = None) -> bool:
        """Return whether a process of `role` is connected to this one and has finished starting.

        With a `nonce`: whether that process is. Recorders and viewers do not announce themselves
        (`has_listener`).
        """
        return self._roster.is_present(role, nonce)

    def has_right(self, nonce: int, right: str) -> bool:
        """Return whether the process of this nonce is here and has a right (`teleop.security`)."""
        return self._roster.has_right(nonce, right)

    def check_peers(self) -> None:
        """Raise `PeerError` if this process must leave the session; costs microseconds."""
        conflict = presence.find_conflict(self._token, self._roster.others)
        if conflict is not None:
            raise PeerError(f"session {self.session!r} {conflict}")

    def count_messages(self) -> MessageCounts:
        """Return the message counts of all latest-value topics together."""
        return sum((latest.counts for latest, _ in self._latest.values()), MessageCounts())

    def list_last_sequences(self) -> tuple[int, ...]:
        """Return the sequence number of our last message of each of `TOPICS`, 0 = none."""
        publishers = (self._publishers.get(topic.name) for topic in TOPICS)
        numbers = [0 if publisher is None else publisher.sequence for publisher in publishers]
        return (*numbers, *(0,) * (TOPIC_SLOTS - len(numbers)))

    def _build_key(self, name: str) -> str:
        return f"teleop/{self.session}/{name}"

    def _visit(self, topic: Topic[Any], nonce: int) -> int:
        return 0 if topic.publisher is None else self._roster.find_visit(topic.publisher, nonce)

    def _get_publisher(self, topic: Topic[Any], patient: bool = False) -> Publisher:
        """Return the publisher of a topic of this role, declared at its first use."""
        publisher = self._publishers.get(topic.name)
        if publisher is None:
            if topic.publisher not in (None, self.role):
                raise ValueError(
                    f"{topic.name} is published by {topic.publisher!r}, not {self.role!r}"
                )
            seals = TagKeys() if self._keyring is None else self._keyring.find_seal_keys(topic)
            publisher = self._publishers[topic.name] = Publisher(
                self._zenoh, self._build_key(topic.name), seals,
                live=topic.live and not patient, sampled_hz=topic.sampled_hz, patient=patient,
            )  # fmt: skip
        return publisher

    def _announce(self) -> Any:
        """Declare our token."""
        if self._handshake is not None:
            self._token = self._handshake.prove(self._token)
        return self._zenoh.liveliness().declare_token(self._token.to_key(self.session))

    def _find_endpoints(self) -> tuple[list[str], list[str]]:
        """Return the endpoints to listen on and to connect to."""
        master, slave = self.config.master, self.config.slave
        if self.config.routers:
            return [], list(self.config.routers)
        if self.role == Role.MASTER:
            return [master], [slave]
        return ([slave], []) if self.role == Role.SLAVE else ([], [master, slave])

    def _open(self) -> Any:
        listen, connect = self._find_endpoints()
        mode: Mode = "client" if self.config.routers else "peer"
        access = None if self.credentials is None else build_access_control([self.session])
        try:
            session = open_session(
                self.credentials, listen, connect, access, mode, self.refusals.note
            )
        except UsageError:
            if listen:
                self._blame_rival(listen)
            raise
        if self.credentials is not None:
            direct = zenoh.handlers.Callback(self._on_connection, indirect=False)
            self._connections: Any = session.info.declare_link_events_listener(direct, history=True)
        return session

    def _blame_rival(self, endpoints: list[str]) -> None:
        """Raise `PeerError` if it is our own session's peer that has the endpoint."""
        with open_session(self.credentials, [], endpoints) as session:
            roster = Roster(
                session, self.session, self._token, False, self._handshake,
                None if self._keyring is None else Keyring(self.role, self.nonce),
            )  # fmt: skip
            begin = now_ns()
            while self._is_waiting(roster, begin):
                time.sleep(0.01)
            roster.close()
        if any(t.role == self.role and not t.relayed for t in roster.others):
            name = self.role.name.lower()
            raise PeerError(
                f"session {self.session!r} has a {name} already, at {endpoints[0]}; stop that one "
                "first, or choose another session name and other endpoints"
            )

    def _on_connection(self, event: zenoh.LinkEvent) -> None:
        """Note a connection of a certificate that has nothing to do here; it is not served."""
        name = event.link.auth_identifier or ""
        try:
            ours = Identity.parse(name).may_join(self.session)
        except ValueError:
            ours = False
        if event.kind == zenoh.SampleKind.PUT and not ours:
            self.refusals.note(f"a connection with the certificate {name}")

    def _settle(self) -> None:
        """Detect peers before claiming a role: at most twice `SETTLE_S`, half of it to connect.

        A peer that is there but has not answered yet gets `DECISION_NS` more.
        """
        begin = now_ns()
        linked = None
        while True:
            self.check_peers()
            now = now_ns()
            info = self._zenoh.info
            if linked is None and (info.peers_zid() or info.routers_zid()):
                linked = now
            if not self._is_waiting(self._roster, begin if linked is None else linked):
                return
            time.sleep(0.01)

    def _is_waiting(self, roster: Roster, begin_ns: int) -> bool:
        """Return whether a start at `begin_ns` goes on detecting peers."""
        waited_s = (now_ns() - begin_ns) * 1e-9
        return waited_s <= SETTLE_S or (
            roster.is_undecided and waited_s <= SETTLE_S + DECISION_TIMEOUT_NS * 1e-9
        )
