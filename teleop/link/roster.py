"""Roster of the processes announced in a session."""

from dataclasses import replace
from typing import Any

import zenoh

from teleop.link.presence import Stage, Token, root
from teleop.topics import Role


class Roster:
    """Tracks the tokens of other processes; a slave also relays those of masters.

    Zenoh's thread writes, one call at a time; anyone reads.

    Parameters
    ----------
    zenoh_session : zenoh.Session
        Open session.
    session : str
        Root of the keys.
    nonce : int
        Our own, which is ignored.
    relay : bool
        Whether to repeat the tokens of masters, for other masters.
    """

    def __init__(self, zenoh_session: zenoh.Session, session: str, nonce: int, relay: bool) -> None:
        # replaced atomically, so that reading is thread-safe
        self.others: frozenset[Token] = frozenset()
        self._held: dict[int, Role] = {}  # nonce -> role, of started processes
        self._session, self._nonce, self._relay = session, nonce, relay
        self._visits: dict[int, int] = {}  # nonce -> number of visits
        self._relayed: dict[Token, Any] = {}
        self._liveliness = zenoh_session.liveliness()
        self._watch: Any = self._liveliness.declare_subscriber(
            f"{root(session)}/**", self._on_token, history=True
        )

    def present(self, role: Role, nonce: int | None = None) -> bool:
        """Return whether a process of `role` (and this nonce) is present and has started."""
        return any(
            t.role == role and t.stage == Stage.HELD and not t.relayed and nonce in (None, t.nonce)
            for t in self.others
        )

    def announced(self, nonce: int) -> bool:
        """Return whether a process of this nonce is present and has finished starting."""
        return any(t.nonce == nonce and t.stage == Stage.HELD for t in self.others)

    def visit(self, role: Role, nonce: int) -> int:
        """Return the visit number of `nonce` in `role`, from 1; 0 if it is not present."""
        return self._visits.get(nonce, 1) if self._held.get(nonce) is role else 0

    def replace(self, others: frozenset[Token]) -> None:
        """Replace the tokens of all other processes."""
        self.others = others
        self._held = {t.nonce: t.role for t in others if t.stage == Stage.HELD and not t.relayed}

    def close(self) -> None:
        """Stop watching; before the session is closed."""
        self._watch.undeclare()

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = Token.from_key(str(sample.key_expr))
        if token is None or token.nonce == self._nonce:
            return
        came = sample.kind == zenoh.SampleKind.PUT
        if came and token not in self.others and token.stage == Stage.HELD and not token.relayed:
            self._visits[token.nonce] = self._visits.get(token.nonce, 0) + 1
        self.replace(self.others | {token} if came else self.others - {token})
        if self._relay and token.role == Role.MASTER and not token.relayed:
            if came and token not in self._relayed:
                key = replace(token, relayed=True).key(self._session)
                self._relayed[token] = self._liveliness.declare_token(key)
            elif not came and token in self._relayed:
                self._relayed.pop(token).undeclare()
