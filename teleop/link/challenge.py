"""Challenges: proof that a process is here now, and is not a token that somebody plays back.

A presence token (`teleop.security.presence`) is genuine for as long as its certificate is valid, so
whoever has seen one can announce it again. Its process must therefore answer a challenge before the
token counts, and again every few seconds. A challenge is a Zenoh query on

    teleop/<session>/@/prove/<group of who asks>/<nonce of who is asked>

with the payload `challenge (16 random bytes), subject (8), presence token of who asks`. The answer
is the BLAKE2b (RFC 7693) of challenge and subject under the key of this pair of processes and
direction (`Handshake.pair_keys`), which nobody else has. The subject is the nonce of the process in
question: who is asked itself, or a master that a slave is asked to vouch for, since two masters are
not connected to each other.
"""

import secrets
import struct
from collections.abc import Callable
from functools import partial
from hashlib import blake2b
from hmac import compare_digest
from typing import Any, Literal

import zenoh

from teleop.link.rate_limit import RateLimit
from teleop.messages.topics import Role
from teleop.security.handshake import PairKeys
from teleop.security.presence import Token, build_token_root, list_groups

CHALLENGE_BYTES, ANSWER_BYTES = 16, 32
ANSWER_S = 1.0  # an answer that comes later is none
ANSWERS, ANSWERS_HZ = 128, 200.0  # challenges of a group looked at: at once, and per second

AnswerCallback = Callable[[PairKeys], None]
"""Gives who asks the answer to a challenge, under the keys of the pair."""

_SUBJECT = struct.Struct("<Q")
_PERSON = b"teleop present"  # no topic is called that, so no message has such a hash


def build_challenge_key(session: str, asker: str, asked: int | Literal["*"]) -> str:
    """Return the key of a challenge by a process of the role `asker`; `*` stands for any."""
    return f"{build_token_root(session)}/prove/{asker}/{asked if asked == '*' else f'{asked:016x}'}"


def compute_answer(key: bytes, challenge: bytes, subject: int) -> bytes:
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
        self._session, self._asker = session, token.group
        self.show_token(token)

    def show_token(self, token: Token) -> None:
        """Show this token of ours, with its proof, in challenges from now on."""
        self._token = token.key(self._session).encode()

    def ask(self, asked: int, subject: int, keys: PairKeys, proven: Callable[[], None]) -> None:
        """Challenge the process `asked`; `proven` is called, by Zenoh's thread, if it answers."""
        challenge = secrets.token_bytes(CHALLENGE_BYTES)
        expected = [compute_answer(keys.receiving, challenge, subject)]

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None or not expected:
                return
            if compare_digest(reply.ok.payload.to_bytes(), expected[0]):
                expected.clear()  # a router may bring an answer any number of times
                proven()

        # all who claim to know: one that answers wrongly must not stand in for the right one
        self._zenoh.get(
            build_challenge_key(self._session, self._asker, asked),
            zenoh.handlers.Callback(on_reply, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWER_S,
            payload=challenge + _SUBJECT.pack(subject) + self._token,
        )


class Responder:
    """Answers the challenges of others; what floods cost is bounded by group of who asks.

    Zenoh's thread calls it.

    Parameters
    ----------
    zenoh_session : zenoh.Session
        Open session.
    session : str
        Root of the keys.
    nonce : int
        Our own.
    vouches : callable
        Returns whether the process of a nonce has proven to us that it is here.
    show : callable
        Takes the token of who asks, and what answers it under the keys of the pair if the token is
        genuine.
    """

    def __init__(
        self,
        zenoh_session: zenoh.Session,
        session: str,
        nonce: int,
        vouches: Callable[[int], bool],
        show: Callable[[Token, AnswerCallback], None],
    ) -> None:
        self._session, self._nonce = session, nonce
        self._vouches, self._show = vouches, show
        self._limits = {
            group: RateLimit(ANSWERS, ANSWERS_HZ) for role in Role for group in list_groups(role)
        }
        everybody = build_challenge_key(session, "*", nonce)
        direct: Any = zenoh.handlers.Callback(self._on_query, indirect=False)
        self._queryable: Any = zenoh_session.declare_queryable(everybody, direct)

    def close(self) -> None:
        """Answer no more."""
        self._queryable.undeclare()

    def _on_query(self, query: Any) -> None:
        group = str(query.key_expr).split("/")[-2]
        is_allowed, begin = self._limits.get(group), CHALLENGE_BYTES + _SUBJECT.size
        if is_allowed is None or not is_allowed() or query.payload is None:
            return
        payload = query.payload.to_bytes()
        if len(payload) <= begin:
            return
        token = Token.from_key(payload[begin:].decode(errors="replace"))
        if token is not None and token.group == group:
            self._show(token, partial(self._answer, query, group, payload[:begin]))

    def _answer(self, query: Any, group: str, asked: bytes, keys: PairKeys) -> None:
        """Answer a challenge, if it is about us or who we know to be here."""
        (subject,) = _SUBJECT.unpack_from(asked, CHALLENGE_BYTES)
        if subject == self._nonce or self._vouches(subject):
            answer = compute_answer(keys.sending, asked[:CHALLENGE_BYTES], subject)
            query.reply(build_challenge_key(self._session, group, self._nonce), answer)
