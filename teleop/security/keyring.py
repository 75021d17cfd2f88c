"""Tags of messages: who sent them to whom, beyond doubt.

A message that moves something carries one tag for each process that acts on it
(`Topic.addressees`), in the attachment of its Zenoh sample: the addressee's nonce and the keyed
BLAKE2b (RFC 7693) of the whole message, under the key of this pair of processes and direction, and
the name of the topic. The message itself is the same with and without tags.

Zenoh's thread adds and removes peers; the loop seals and verifies.
"""

import struct
from collections import OrderedDict
from collections.abc import Mapping
from enum import Enum
from hashlib import blake2b
from hmac import compare_digest
from typing import Any

from teleop.messages.topics import TOPICS, Role, Topic
from teleop.security.handshake import PairKeys, Peer

TAG_BYTES = 16
ENTRY_BYTES = 8 + TAG_BYTES  # the addressee's nonce, and the tag for it
ADDRESSEES = 8  # at most, of a message
DEPARTED_PEERS_MAX = 64  # peers that are gone whose messages are still believed

_NONCE = struct.Struct("<Q")
_TOPICS = {topic.name: topic for topic in TOPICS}


class TagVerdict(Enum):
    """What a message's tags say."""

    GENUINE = 0
    UNKNOWN = 1  # not for us, or of a sender without keys: one of us may not be known there yet
    FORGED = 2  # for us, and wrong


class TagKeys:
    """What a publisher tags its messages with.

    `entries` has for each addressee its nonce (8 bytes) and the keyed hash, before the message.
    """

    __slots__ = ("entries",)

    def __init__(self) -> None:
        self.entries: tuple[tuple[bytes, Any], ...] = ()


class Keyring:
    """The keys that one process shares with each of the others.

    It finds its tags under its `nonce`.
    """

    def __init__(self, role: Role, nonce: int) -> None:
        self.addressee = pack_nonce(nonce)
        self._role = role
        self._seals = {topic.name: TagKeys() for topic in TOPICS}
        # of each topic that we act on: keyed hashes by sender, absent ones too
        self._senders: dict[str, dict[int, Any]] = {
            topic.name: {} for topic in TOPICS if role in topic.addressees
        }
        # as many as the roster admits, and `DEPARTED_PEERS_MAX`
        self._peers: dict[tuple[Role, int], Peer] = {}
        self._gone: OrderedDict[tuple[Role, int], None] = OrderedDict()

    def has_tags_with(self, role: Role) -> bool:
        """Return whether messages between us and `role` are tagged."""
        return any(
            (role in topic.addressees and self._role in topic.publishers)
            or (self._role in topic.addressees and role in topic.publishers)
            for topic in TOPICS
        )

    def find_peer(self, role: Role, nonce: int) -> Peer | None:
        """Return the peer of this role and nonce, if its keys are here."""
        return self._peers.get((role, nonce))

    def add(self, peer: Peer, keys: PairKeys) -> None:
        """Believe and address `peer` from now on."""
        self._peers[peer.role, peer.nonce] = peer
        self._gone.pop((peer.role, peer.nonce), None)
        addressee = pack_nonce(peer.nonce)
        for topic in TOPICS:
            name = topic.name
            if peer.role in topic.addressees and self._role in topic.publishers:
                other_entries = [e for e in self._seals[name].entries if e[0] != addressee]
                entry = (addressee, create_keyed_hash(keys.sending, topic))
                self._seals[name].entries = (*other_entries[-(ADDRESSEES - 1) :], entry)
            if name in self._senders and peer.role in topic.publishers:
                self._senders[name][peer.nonce] = create_keyed_hash(keys.receiving, topic)

    def remove(self, role: Role, nonce: int) -> None:
        """Address a vanished peer no more; what is still on its way is believed."""
        addressee = pack_nonce(nonce)
        for topic in TOPICS:
            if role in topic.addressees:
                seals = self._seals[topic.name]
                seals.entries = tuple(e for e in seals.entries if e[0] != addressee)
        if (role, nonce) in self._peers:
            self._gone[role, nonce] = None
        while len(self._gone) > DEPARTED_PEERS_MAX:
            self.forget(*next(iter(self._gone)))

    def forget(self, role: Role, nonce: int) -> None:
        """Address a peer no more, and believe nothing of it any more."""
        self._peers.pop((role, nonce), None)
        self._gone.pop((role, nonce), None)
        self.remove(role, nonce)
        for name, senders in self._senders.items():
            if role in _TOPICS[name].publishers:
                senders.pop(nonce, None)

    def find_seal_keys(self, topic: Topic[Any]) -> TagKeys:
        """Return what messages of `topic` are tagged with; it follows the peers."""
        return self._seals[topic.name]

    def find_keys(self, topic: Topic[Any]) -> Mapping[int, Any] | None:
        """Return the keyed hashes by sender of a topic; None if we do not act on it."""
        return self._senders.get(topic.name)

    def verify(self, topic: Topic[Any], data: bytes, tags: bytes) -> "TagVerdict":
        """Return whether `data` is of a known sender, to us, and unchanged."""
        base = self._senders[topic.name].get(topic.message.schema.read_sender(data))
        if base is None:
            return TagVerdict.UNKNOWN
        mac = base.copy()
        mac.update(data)
        return check_tags(self.addressee + mac.digest(), tags)


def create_keyed_hash(key: bytes, topic: Topic[Any]) -> Any:
    """Return the hash of a topic's messages, before any message."""
    return blake2b(key=key, digest_size=TAG_BYTES, person=topic.name.encode())


def check_tags(tag: bytes, tags: bytes) -> TagVerdict:
    """Return what the tags of a message say; `tag` is the right one, behind its addressee."""
    verdict = TagVerdict.UNKNOWN
    for begin in range(0, min(len(tags), ADDRESSEES * ENTRY_BYTES), ENTRY_BYTES):
        entry = tags[begin : begin + ENTRY_BYTES]
        if compare_digest(entry, tag):
            return TagVerdict.GENUINE
        if entry[:8] == tag[:8]:
            verdict = TagVerdict.FORGED
    return verdict


def pack_nonce(nonce: int) -> bytes:
    """Return a nonce as it stands in front of a tag."""
    return _NONCE.pack(nonce)
