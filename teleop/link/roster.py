"""Roster of the processes announced in a session."""

from collections import Counter
from dataclasses import replace
from typing import Any

import zenoh

from teleop.keys import CertificateError
from teleop.link.handshake import Handshake
from teleop.link.keyring import Keyring
from teleop.link.presence import Stage, Token, root
from teleop.link.rate_limit import RateLimit
from teleop.link.refusals import Refusals
from teleop.topics import Role

TOKENS = 64  # believed of a role at a time
CHECKS, CHECKS_HZ = 64, 20.0  # proofs checked of a role: at once, and per second
VISITS = 1024  # processes whose visits are counted


class Roster:
    """Tracks the tokens of other processes; a slave also relays those of masters.

    A token without a valid proof is ignored, and what an attacker can make us do or keep is
    bounded: of each role `CHECKS_HZ` proofs a second and `TOKENS` tokens. Tokens beyond the bound
    are asked for again later (`refresh`).

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
    handshake, keyring : Handshake and Keyring, optional
        Checks the proofs, and gets the keys that follow; None in an insecure session.
    refusals : Refusals, optional
        Told why tokens are ignored.
    """

    def __init__(
        self,
        zenoh_session: zenoh.Session,
        session: str,
        nonce: int,
        relay: bool,
        handshake: Handshake | None = None,
        keyring: Keyring | None = None,
        refusals: Refusals | None = None,
    ) -> None:
        # replaced atomically, so that reading is thread-safe
        self.others: frozenset[Token] = frozenset()
        self._held: frozenset[tuple[Role, int]] = frozenset()  # started processes
        self._session, self._nonce, self._relay = session, nonce, relay
        self._handshake, self._keyring = handshake, keyring
        self._refusals = refusals or Refusals()
        self._limits = {role: RateLimit(CHECKS, CHECKS_HZ) for role in Role}
        self._missed = False
        self._visits: dict[tuple[Role, int], int] = {}  # number of visits
        self._relayed: dict[Token, Any] = {}
        self._liveliness = zenoh_session.liveliness()
        self._watch: Any = self._liveliness.declare_subscriber(
            f"{root(session)}/**", self._on_token, history=True
        )

    def present(self, role: Role, nonce: int | None = None) -> bool:
        """Return whether a process of `role` (and this nonce) is present and has started."""
        held = self._held
        return any(r is role and nonce in (None, n) for r, n in held)

    def announced(self, nonce: int) -> bool:
        """Return whether a process of this nonce is present and has finished starting."""
        return any(t.nonce == nonce and t.stage == Stage.HELD for t in self.others)

    def may(self, nonce: int, right: str) -> bool:
        """Return whether the process of this nonce is present and has a right of a supervisor.

        The two sides may stop. In an insecure session everyone may do everything.
        """
        if self._keyring is None:
            return right == "stop" or self.announced(nonce)
        for role, n in self._held:
            peer = self._keyring.known(role, nonce) if n == nonce else None
            if peer is not None:
                side = role in (Role.MASTER, Role.SLAVE)
                if right in peer.identity.rights or (side and right == "stop"):
                    return True
        return False

    def visit(self, role: Role, nonce: int) -> int:
        """Return the visit number of `nonce` in `role`, from 1; 0 if it is not present."""
        return self._visits.get((role, nonce), 1) if (role, nonce) in self._held else 0

    def replace(self, others: frozenset[Token]) -> None:
        """Replace the tokens of all other processes."""
        self.others = others
        self._held = frozenset(
            (t.role, t.nonce) for t in others if t.stage == Stage.HELD and not t.relayed
        )

    def refresh(self) -> None:
        """Ask again for tokens that came too fast; at once if there were none."""
        if self._missed:
            self._missed = False
            self._liveliness.get(f"{root(self._session)}/**", self._on_reply, timeout=1.0)

    def close(self) -> None:
        """Stop watching; before the session is closed."""
        self._watch.undeclare()

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._on_token(reply.ok)

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = Token.from_key(str(sample.key_expr))
        if token is None or token.nonce == self._nonce:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            if token not in self.others and self._believes(token):
                self._arrived(token)
        elif token in self.others:
            self._left(token)

    def _believes(self, token: Token) -> bool:
        """Return whether a token is genuine, and note the keys of its process."""
        count = Counter(other.role for other in self.others)[token.role]
        if count >= TOKENS or not self._limits[token.role]():
            self._refusals.note(f"presence tokens of {token.role.name.lower()}s came too fast")
            self._missed = True
            return False
        if self._handshake is None or self._keyring is None:
            return not token.proof
        try:
            peer = self._handshake.check(token)
            keys = self._handshake.pair_keys(peer)
        except CertificateError as error:
            self._refusals.note(str(error))
            return False
        known = self._keyring.known(peer.role, peer.nonce)
        if known is not None and known.public != peer.public:
            role = peer.role.name.lower()
            self._refusals.note(f"a {role} that takes the number of another one")
            return False
        if not token.relayed and self._keyring.shares_with(peer.role):
            self._keyring.add(peer, keys)
        return True

    def _arrived(self, token: Token) -> None:
        process = (token.role, token.nonce)
        if token.stage == Stage.HELD and not token.relayed:
            self._visits[process] = self._visits.pop(process, 0) + 1
            while len(self._visits) > VISITS:
                del self._visits[next(iter(self._visits))]
        self.replace(self.others | {token})
        if self._relay and token.role == Role.MASTER and not token.relayed:
            key = replace(token, relayed=True).key(self._session)
            self._relayed[token] = self._liveliness.declare_token(key)

    def _left(self, token: Token) -> None:
        self.replace(self.others - {token})
        if token in self._relayed:
            self._relayed.pop(token).undeclare()
        gone = not any((t.role, t.nonce) == (token.role, token.nonce) for t in self.others)
        if gone and self._keyring is not None:
            self._keyring.remove(token.role, token.nonce)
