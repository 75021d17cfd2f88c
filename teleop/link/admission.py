"""Which presence token is checked next, and the challenge that a process must answer.

A presence token (`teleop.security.presence`) is genuine for as long as its certificate is valid, so
whoever has seen one can announce it again. Its process must therefore answer a challenge before the
token counts, and again every few seconds. A challenge is a Zenoh query on

    teleop/<session>/@/prove/<group of who asks>/<nonce of who is asked>

with the payload `challenge (16 random bytes), subject (8), presence token of who asks`. The answer
is the BLAKE2b (RFC 7693) of challenge and subject under the key of this pair of processes and
direction (`Handshake.derive_pair_keys`), which nobody else has. The subject is the nonce of the
process in question: who is asked itself, or a master that a slave is asked to vouch for, since two
masters are not connected to each other.
"""

import random
import secrets
import struct
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from hashlib import blake2b
from hmac import compare_digest
from typing import Any, Literal

import zenoh

from teleop.link.rate_limit import RateLimit
from teleop.messages.topics import Role
from teleop.runtime.clock import now_ns
from teleop.security.handshake import PairKeys
from teleop.security.presence import Token, build_token_root, list_groups, may_stop

# --- challenges: proof that a process is here now, and is not a token that somebody plays back


CHALLENGE_BYTES, ANSWER_BYTES = 16, 32
ANSWER_S = 1.0  # an answer that comes later is none
ANSWERS, ANSWERS_HZ = 128, 200.0  # challenges of a group looked at: at once, and per second

AnswerCallback = Callable[[PairKeys], None]
"""Gives who asks the answer to a challenge, under the keys of the pair."""

_SUBJECT = struct.Struct("<Q")
_PERSON = b"teleop present"  # no topic is called that, so no message has such a hash


def build_challenge_key(session: str, asker: str, nonce: int | Literal["*"]) -> str:
    """Return the key of a challenge by a process of the role `asker`; `*` stands for any."""
    return f"{build_token_root(session)}/prove/{asker}/{nonce if nonce == '*' else f'{nonce:016x}'}"


def compute_answer(key: bytes, challenge: bytes, subject: int) -> bytes:
    """Return the answer under the key of messages from who is asked to who asks."""
    data = challenge + _SUBJECT.pack(subject)
    return blake2b(data, key=key, digest_size=ANSWER_BYTES, person=_PERSON).digest()


class Challenger:
    """Asks other processes for proof of their presence.

    `session` is the root of the keys, `token` our own, with its proof.
    """

    def __init__(self, zenoh_session: zenoh.Session, session: str, token: Token) -> None:
        self._zenoh: Any = zenoh_session
        self._session, self._asker = session, token.group
        self.show_token(token)

    def show_token(self, token: Token) -> None:
        """Show this token of ours, with its proof, in challenges from now on."""
        self._token = token.to_key(self._session).encode()

    def ask(self, nonce: int, subject: int, keys: PairKeys, proven: Callable[[], None]) -> None:
        """Challenge the process `nonce`; `proven` is called, by Zenoh's thread, if it answers."""
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
            build_challenge_key(self._session, self._asker, nonce),
            zenoh.handlers.Callback(on_reply, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWER_S,
            payload=challenge + _SUBJECT.pack(subject) + self._token,
        )


class Responder:
    """Answers the challenges of others; what floods cost is bounded by group of who asks.

    Zenoh's thread calls it.

    `session` is the root of the keys, `nonce` our own. `vouches` returns whether the process of a
    nonce has proven to us that it is here; `show` takes the token of who asks, and what answers it
    under the keys of the pair if the token is genuine.
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

    def _answer(self, query: Any, group: str, challenge: bytes, keys: PairKeys) -> None:
        """Answer a challenge, if it is about us or who we know to be here."""
        (subject,) = _SUBJECT.unpack_from(challenge, CHALLENGE_BYTES)
        if subject == self._nonce or self._vouches(subject):
            answer = compute_answer(keys.sending, challenge[:CHALLENGE_BYTES], subject)
            query.reply(build_challenge_key(self._session, group, self._nonce), answer)


QUEUED_TOKENS_MAX = 64  # tokens in one queue
CERTIFICATES = 64  # that have queues of their own
REJECTED_TOKENS_MAX = 1024  # tokens that are remembered as not genuine
CHECK_BURST = 64  # checks at once
CHECKS_HZ, STOP_CHECKS_HZ = 20.0, 100.0  # checks on average; in groups that may stop a session

Queue = tuple[str, bool]  # the certificate, if it is known, and whether an asker shows the token


class Admission:
    """Queues of the tokens of one group (`Token.group`), before their proofs are checked.

    Each certificate that is known to be of the authority has a queue of its own; all others share
    one. The queues take turns, so worthless proofs keep only those with the same certificate
    waiting. In a queue chance decides which token is checked, and which one makes place for a new
    one, so that copies of a certificate do not keep out its holder for good. Tokens shown by who
    sends a challenge wait apart from those that Zenoh announces.
    """

    def __init__(self, group: str, clock: Callable[[], int] = now_ns) -> None:
        rate_hz = STOP_CHECKS_HZ if may_stop(group) else CHECKS_HZ
        self._is_due = RateLimit(CHECK_BURST, rate_hz, clock)
        self._queues: OrderedDict[Queue, dict[Token, Any]] = OrderedDict()
        self._known: OrderedDict[str, None] = OrderedDict()
        self._worthless: OrderedDict[int, None] = OrderedDict()
        self._chance = random.SystemRandom()

    def __len__(self) -> int:
        """Return the number of waiting tokens."""
        return sum(map(len, tuple(self._queues.values())))

    def put(self, token: Token, asker: Any = None) -> bool:
        """Let a token wait, with who shows it; return whether no other one had to make place."""
        if hash(token) in self._worthless:
            return True
        certificate = token.certificate if token.certificate in self._known else ""
        queue = self._queues.setdefault((certificate, asker is not None), {})
        is_full = len(queue) >= QUEUED_TOKENS_MAX and token not in queue
        if is_full:
            del queue[self._chance.choice(tuple(queue))]
        queue[token] = asker
        return not is_full

    def take(self) -> tuple[Token, Any] | None:
        """Return the next token to be checked, and who shows it; None if none is due."""
        if not self._queues or not self._is_due():
            return None
        name, queue = self._queues.popitem(last=False)
        token = self._chance.choice(tuple(queue))
        asker = queue.pop(token)
        if queue:
            self._queues[name] = queue
        return token, asker

    def remove(self, token: Token) -> None:
        """Forget a token that has vanished."""
        for name, queue in list(self._queues.items()):
            if queue.pop(token, self) is not self and not queue:
                del self._queues[name]

    def add_certificate(self, token: Token) -> None:
        """Give the certificate of a token, which is of the authority, a queue of its own."""
        certificate = token.certificate
        is_new = certificate not in self._known
        self._known[certificate] = None
        self._known.move_to_end(certificate)
        while len(self._known) > CERTIFICATES:
            self._known.popitem(last=False)
        for asks in (False, True) if is_new else ():
            for other, asker in list(self._queues.get(("", asks), {}).items()):
                if other.certificate == certificate:
                    self.remove(other)
                    self.put(other, asker)

    def refuse(self, token: Token) -> None:
        """Remember that a token is not genuine, so that it is not checked again."""
        self._worthless[hash(token)] = None
        while len(self._worthless) > REJECTED_TOKENS_MAX:
            self._worthless.popitem(last=False)
