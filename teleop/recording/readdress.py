"""Rewrite recorded messages to come from another sender."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from teleop.messages.topics import TOPICS, Role, Topic
from teleop.recording.reader import RecordedMessage

_TOPICS = {topic.name: topic for topic in TOPICS}


class AddressedMessage(NamedTuple):
    """A message ready to be sent by the link of `role`."""

    role: Role
    topic: Topic[Any]
    data: bytes


class SenderRewriter:
    """Rewrites recorded messages so that they come from present senders.

    Listeners accept a present sender and rising numbers. So sender, sequence and checksum are
    rewritten; gaps in the recording are kept. The stamp is shifted if requested; everything else is
    unchanged.

    Parameters
    ----------
    nonces : mapping
        The new senders of the master's and the slave's messages. Messages of other processes get
        the slave's.
    """

    def __init__(self, nonces: Mapping[Role, int]) -> None:
        self._nonces = nonces
        self._sent: dict[tuple[Role, str], int] = {}  # last number of each topic
        self._seen: dict[tuple[str, int], int] = {}  # newest number recorded, by topic and sender

    def __call__(self, recorded: RecordedMessage, shift_ns: int = 0) -> AddressedMessage:
        """Return `recorded` under its new address, its stamp moved by `shift_ns`."""
        topic = _TOPICS[recorded.topic]
        schema = topic.message.schema
        head = schema.check(recorded.data)
        content = bytearray(recorded.data)
        row = np.frombuffer(content, schema.dtype)
        role = topic.publisher
        if role is None:
            role = Role.MASTER if row["role"][0] == Role.MASTER else Role.SLAVE
        before = self._seen.get((topic.name, head.sender), head.sequence)
        self._seen[topic.name, head.sender] = head.sequence
        sequence = self._sent.get((role, topic.name), 0) + max(1, head.sequence - before)
        self._sent[role, topic.name] = sequence
        row["sender"], row["sequence"] = self._nonces[role], sequence
        row["stamp_ns"] = head.stamp_ns + shift_ns
        checked_from = schema.dtype.fields["layout"][1]
        row["checksum"] = schema.checksum(memoryview(content)[checked_from:])
        return AddressedMessage(role, topic, bytes(content))
