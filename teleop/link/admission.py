"""Which of the presence tokens that wait is checked next: bounded, and fair to certificates."""

import random
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from teleop.link.rate_limit import RateLimit
from teleop.runtime.clock import now_ns
from teleop.security.presence import Token, may_stop

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

    Parameters
    ----------
    group : str
        The group.
    clock : callable
        Returns the time [ns].
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
        queue = self._queues.setdefault(self._queue_of(token, asker), {})
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

    def know(self, token: Token) -> None:
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

    def _queue_of(self, token: Token, asker: Any) -> Queue:
        certificate = token.certificate
        return certificate if certificate in self._known else "", asker is not None
