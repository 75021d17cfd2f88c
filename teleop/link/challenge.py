"""Challenges: proof that a process is here now, and is not a token that somebody plays back.

A presence token (`teleop.link.presence`) is genuine for as long as its certificate is valid, so
whoever has seen one can announce it again. Its process must therefore answer a challenge before the
token counts, and again every few seconds. A challenge is a Zenoh query on

    teleop/<session>/@/prove/<role of who asks>/<nonce of who is asked>

with the payload `challenge (16 random bytes), subject (8), presence token of who asks`. The answer
is the BLAKE2b (RFC 7693) of challenge and subject under the key of this pair of processes and
direction (`Handshake.pair_keys`), which nobody else has. The subject is the nonce of the process in
question: who is asked itself, or a master that a slave is asked to vouch for, since two masters are
not connected to each other.
"""

import secrets
import struct
from collections import OrderedDict
from collections.abc import Callable
from hashlib import blake2b
from hmac import compare_digest
from typing import Any, Literal

import zenoh

from teleop.keys import CertificateError
from teleop.link.handshake import Handshake, PairKeys
from teleop.link.presence import Token, root
from teleop.link.rate_limit import RateLimit
from teleop.topics import Role

CHALLENGE_BYTES, ANSWER_BYTES = 16, 32
ANSWER_S = 1.0  # an answer that comes later is none
ASKERS = 64  # whose keys are kept
CHECKS, CHECKS_HZ = 64, 20.0  # unknown askers of a role: at once, and per second
ANSWERS, ANSWERS_HZ = 128, 200.0  # challenges of a role answered: at once, and per second

_SUBJECT = struct.Struct("<Q")
_PERSON = b"teleop present"  # no topic is called that, so no message has such a hash


def challenge_key(session: str, asker: str, asked: int | Literal["*"]) -> str:
    """Return the key of a challenge by a process of the role `asker`; `*` stands for any."""
    return f"{root(session)}/prove/{asker}/{asked if asked == '*' else f'{asked:016x}'}"


def answer_to(key: bytes, challenge: bytes, subject: int) -> bytes:
    """Return the answer under the key of messages from who is asked to who asks."""
    data = challenge + _SUBJECT.pack(subject)
    return blake2b(data, key=key, digest_size=ANSWER_BYTES, person=_PERSON).digest()


class Challenger:
    """Asks other processes for proof of their presence.

    Parameters
    ----------
    zenoh_session : zenoh.Session
        Open session.
    session : str
        Root of the keys.
    token : Token
        Our own, with its proof.
    """

    def __init__(self, zenoh_session: zenoh.Session, session: str, token: Token) -> None:
        self._zenoh: Any = zenoh_session
        self._session, self._asker = session, token.role.name.lower()
        self._token = token.key(session).encode()

    def ask(self, asked: int, subject: int, keys: PairKeys, proven: Callable[[], None]) -> None:
        """Challenge the process `asked`; `proven` is called, by Zenoh's thread, if it answers."""
        challenge = secrets.token_bytes(CHALLENGE_BYTES)
        expected = [answer_to(keys.receiving, challenge, subject)]

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None or not expected:
                return
            if compare_digest(reply.ok.payload.to_bytes(), expected[0]):
                expected.clear()  # a router may bring an answer any number of times
                proven()

        # all who claim to know: one that answers wrongly must not stand in for the right one
        self._zenoh.get(
            challenge_key(self._session, self._asker, asked),
            zenoh.handlers.Callback(on_reply, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWER_S,
            payload=challenge + _SUBJECT.pack(subject) + self._token,
        )


class Responder:
    """Answers the challenges of others; what floods cost is bounded by role of who asks.

    Zenoh's threads call it.

    Parameters
    ----------
    zenoh_session : zenoh.Session
        Open session.
    session : str
        Root of the keys.
    nonce : int
        Our own.
    handshake : Handshake
        Checks who asks.
    vouches : callable
        Returns whether the process of a nonce has proven to us that it is here.
    """

    def __init__(
        self,
        zenoh_session: zenoh.Session,
        session: str,
        nonce: int,
        handshake: Handshake,
        vouches: Callable[[int], bool],
    ) -> None:
        self._session, self._nonce = session, nonce
        self._handshake, self._vouches = handshake, vouches
        self._keys: OrderedDict[tuple[str, str], bytes] = OrderedDict()  # of answers
        self._checks = {role.name.lower(): RateLimit(CHECKS, CHECKS_HZ) for role in Role}
        self._answers = {role.name.lower(): RateLimit(ANSWERS, ANSWERS_HZ) for role in Role}
        everybody = challenge_key(session, "*", nonce)
        direct: Any = zenoh.handlers.Callback(self._on_query, indirect=False)
        self._queryable: Any = zenoh_session.declare_queryable(everybody, direct)

    def close(self) -> None:
        """Answer no more."""
        self._queryable.undeclare()

    def forget(self) -> None:
        """Check all who ask anew: certificates were revoked."""
        self._keys = OrderedDict()

    def _on_query(self, query: Any) -> None:
        asker = str(query.key_expr).split("/")[-2]
        limit = self._answers.get(asker)
        payload = query.payload
        if limit is None or payload is None or not limit():
            return
        answer = self._answer(asker, payload.to_bytes())
        if answer:
            query.reply(challenge_key(self._session, asker, self._nonce), answer)

    def _answer(self, asker: str, payload: bytes) -> bytes:
        """Return the answer to a challenge; empty if it gets none."""
        begin = CHALLENGE_BYTES + _SUBJECT.size
        if len(payload) <= begin:
            return b""
        (subject,) = _SUBJECT.unpack_from(payload, CHALLENGE_BYTES)
        if subject != self._nonce and not self._vouches(subject):
            return b""
        key = self._key(asker, payload[begin:].decode(errors="replace"))
        return answer_to(key, payload[:CHALLENGE_BYTES], subject) if key else b""

    def _key(self, asker: str, text: str) -> bytes:
        """Return the key of answers to who shows this token; empty if it is not believed."""
        keys = self._keys
        key = keys.get((asker, text))
        if key is None:
            token = Token.from_key(text)
            if token is None or token.role.name.lower() != asker or not self._checks[asker]():
                return b""
            try:
                key = self._handshake.pair_keys(self._handshake.check(token)).sending
            except CertificateError:
                return b""
            keys[asker, text] = key
            while len(keys) > ASKERS:
                keys.popitem(last=False)
        return key
