"""Roster of the processes announced in a session."""

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from queue import Empty, SimpleQueue
from time import monotonic_ns
from typing import Any

import zenoh

from teleop.keys import CertificateError
from teleop.link.challenge import Challenger, Responder
from teleop.link.handshake import Handshake, PairKeys, Peer
from teleop.link.keyring import Keyring
from teleop.link.presence import EXCLUSIVE, Stage, Token, root
from teleop.link.rate_limit import RateLimit
from teleop.link.refusals import Refusals
from teleop.topics import Role

TOKENS = 64  # of a role at a time
CHECKS, CHECKS_HZ = 64, 20.0  # proofs checked of a role: at once, and per second
VISITS = 1024  # processes whose visits are counted
WAITING = 1000  # tokens that came and were not looked at yet; further ones are asked for again

S = 1_000_000_000  # [ns]
EVERY_NS = 2 * S  # between two challenges of a process, and two looks at the certificates
RETRY_NS = S // 20  # after the first challenge without an answer; doubles up to `EVERY_NS`
MISSED = 3  # challenges in succession without an answer, after which a process counts as gone
SILENT_NS = 5 * S  # without an answer, after which a line says so; long, for a loaded machine
DECISION_NS = S  # after which a process without an answer is not waited for


@dataclass(slots=True, eq=False)
class Process:
    """A genuine token, and whether its process has proven that it is here."""

    token: Token
    peer: Peer
    keys: PairKeys
    since_ns: int  # when it arrived, or ceased to answer
    must_answer: bool
    present: bool = False
    unanswered: int = 0  # challenges since the last answer
    due_ns: int = 0  # of the next challenge
    noted: bool = False


class Roster:
    """Tracks the tokens of other processes; a slave also relays those of masters.

    A token without a valid proof is ignored. One of a master or slave, and to these one of a
    supervisor, counts only while its process answers challenges (`teleop.link.challenge`): a token
    that is played back neither evicts nor blocks anybody. Nothing counts any more of a certificate
    that expires or is revoked. What an attacker can make us do or keep is bounded: of each role
    `CHECKS_HZ` proofs a second and `TOKENS` tokens. Tokens beyond the bound are asked for again
    later; of those without an answer the oldest one makes place.

    A thread of its own writes; anyone reads.

    Parameters
    ----------
    zenoh_session : zenoh.Session
        Open session.
    session : str
        Root of the keys.
    token : Token
        Our own; tokens of its nonce are ignored.
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
        token: Token,
        relay: bool,
        handshake: Handshake | None = None,
        keyring: Keyring | None = None,
        refusals: Refusals | None = None,
    ) -> None:
        # replaced atomically, so that reading is thread-safe
        self.others: frozenset[Token] = frozenset()
        self._held: frozenset[tuple[Role, int]] = frozenset()  # started processes
        self._session, self._role, self._nonce, self._relay = (
            session, token.role, token.nonce, relay,
        )  # fmt: skip
        self._handshake, self._keyring = handshake, keyring
        self._refusals = refusals or Refusals()
        self._limits = {role: RateLimit(CHECKS, CHECKS_HZ) for role in Role}
        self._missed = False
        self._undecided_ns = 0  # until when the answer of an exclusive process is waited for
        self._look_ns = monotonic_ns() + EVERY_NS
        self._processes: dict[Token, Process] = {}
        self._visits: dict[tuple[Role, int], int] = {}  # number of visits
        self._relayed: dict[Token, Any] = {}
        self._liveliness: Any = zenoh_session.liveliness()
        self._events: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._stack = contextlib.ExitStack()
        if handshake is not None:
            self._challenger = Challenger(zenoh_session, session, handshake.prove(token))
            self._responder = Responder(
                zenoh_session, session, self._nonce, handshake, self._vouches
            )
            self._stack.callback(self._responder.close)
        direct = zenoh.handlers.Callback(self._store, indirect=False)
        watch = self._liveliness.declare_subscriber(f"{root(session)}/**", direct, history=True)
        self._stack.callback(watch.undeclare)
        self._thread = threading.Thread(target=self._work, name="roster", daemon=True)
        self._thread.start()

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
                side = role in EXCLUSIVE
                if right in peer.identity.rights or (side and right == "stop"):
                    return True
        return False

    def visit(self, role: Role, nonce: int) -> int:
        """Return the visit number of `nonce` in `role`, from 1; 0 if it is not present."""
        return self._visits.get((role, nonce), 1) if (role, nonce) in self._held else 0

    @property
    def undecided(self) -> bool:
        """Whether the answer of a process that may have our place is still waited for."""
        return not self._events.empty() or monotonic_ns() < self._undecided_ns

    def replace(self, others: frozenset[Token]) -> None:
        """Replace the tokens of all other processes."""
        self.others = others
        self._held = frozenset(
            (t.role, t.nonce) for t in others if t.stage == Stage.HELD and not t.relayed
        )

    def close(self) -> None:
        """Stop watching; before the session is closed."""
        self._stack.close()
        self._events.put(None)
        self._thread.join()

    def _store(self, sample: zenoh.Sample) -> None:
        """Take a token from Zenoh's thread."""
        if self._events.qsize() < WAITING:
            came = sample.kind == zenoh.SampleKind.PUT
            self._events.put(partial(self._on_token, str(sample.key_expr), came))
        else:
            self._missed = True

    def _work(self) -> None:
        """Process tokens and answers, and challenge, until `close`."""
        while True:
            dues = (p.due_ns for p in self._processes.values() if p.must_answer)
            wait_ns = min((self._look_ns, *dues)) - monotonic_ns()
            try:
                if wait_ns <= 0:
                    self._challenge()
                event = self._events.get(timeout=max(0.0, min(wait_ns, EVERY_NS) * 1e-9))
                if event is None:
                    return
                event()
            except Empty:
                continue
            except zenoh.ZError as error:  # of one event; the next ones are looked at all the same
                self._refusals.note(f"a presence token, for an error of the link: {error}")

    def _on_token(self, key: str, came: bool) -> None:
        token = Token.from_key(key)
        if token is None or token.nonce == self._nonce:
            return
        if token.relayed and self._role is not Role.MASTER:
            return  # its relays are for masters
        if not came:
            self._forget(token)
        elif token not in self.others and token not in self._processes and self._has_place(token):
            self._check(token)

    def _has_place(self, token: Token) -> bool:
        """Return whether one more token of a role may be looked at now, and make place for it."""
        role = token.role
        allowed = self._limits[role]()
        if allowed and sum(t.role == role for t in self.others) < TOKENS:
            silent = [p.token for p in self._processes.values()
                      if p.token.role == role and not p.present]  # fmt: skip
            if len(silent) >= TOKENS:
                self._forget(silent[0])
                self._missed = True
            return True
        self._refusals.note(f"presence tokens of {role.name.lower()}s came too fast")
        self._missed = True
        return False

    def _check(self, token: Token) -> None:
        """Look at a token that has just come."""
        if self._handshake is None:
            if token.proof:
                name = token.role.name.lower()
                self._refusals.note(f"a {name} with a certificate: this session is insecure")
            else:
                self._arrived(token)
            return
        process = self.examine(token)
        if process is None:
            return
        self._processes[token] = process
        if not process.must_answer or self._has_answered(process):
            process.due_ns = process.since_ns + EVERY_NS
            self._admit(process)
        else:
            if token.role in EXCLUSIVE:
                self._undecided_ns = process.since_ns + DECISION_NS
            self._ask(process)

    def examine(self, token: Token) -> Process | None:
        """Return whose token it is; None, with a note, if it is not genuine."""
        if self._handshake is None or self._keyring is None or self._handshake.fault:
            return None  # a fault of ours was said already (`_look_at_certificates`)
        try:
            peer = self._handshake.check(token)
            keys = self._handshake.pair_keys(peer)
        except CertificateError as error:
            self._refusals.note(str(error))
            return None
        if self._is_taken(peer):
            return None
        must_answer = token.role in EXCLUSIVE or self._keyring.shares_with(token.role)
        return Process(token, peer, keys, monotonic_ns(), must_answer)

    def _has_answered(self, process: Process) -> bool:
        """Return whether the process has just proven its presence for another token."""
        return not process.token.relayed and any(
            p.present and p.peer == process.peer and not (p.token.relayed or p.unanswered)
            for p in self._processes.values()
        )

    def _challenge(self) -> None:
        """Send the challenges that are due; now and then look at the certificates too."""
        now = monotonic_ns()
        for process in list(self._processes.values()):
            if process.must_answer and process.due_ns <= now:
                self._ask(process)
        if self._look_ns <= now:
            self._look_ns = now + EVERY_NS
            self._look_at_certificates()
            if self._missed:
                self._missed = False
                self._liveliness.get(
                    f"{root(self._session)}/**", self._on_reply, timeout=EVERY_NS * 0.5e-9
                )

    def _ask(self, process: Process) -> None:
        """Challenge a process; one that has not answered for long is none."""
        now = monotonic_ns()
        name = process.token.role.name.lower()
        if process.present and process.unanswered >= MISSED:
            self._withdraw(process.token)
            process.present, process.since_ns = False, now
        if not process.present and not process.noted and now - process.since_ns > SILENT_NS:
            process.noted = True
            self._refusals.note(
                f"a {name} that does not answer: it hangs, or somebody plays its token back"
            )
        wait_ns = EVERY_NS if process.present else RETRY_NS << min(process.unanswered, 8)
        process.due_ns = now + min(wait_ns, EVERY_NS)
        process.unanswered += 1
        proven = partial(self._events.put, partial(self._answered, process))
        for asked in self._witnesses(process):
            self._challenger.ask(asked.token.nonce, process.token.nonce, asked.keys, proven)

    def _witnesses(self, process: Process) -> list[Process]:
        """Return who can prove the presence of a process: it, or the slave that relays it."""
        if not process.token.relayed:
            return [process]
        return [p for p in self._processes.values() if p.present and p.token.role == Role.SLAVE]

    def _answered(self, process: Process) -> None:
        """Note that a process has proven its presence."""
        process.unanswered = 0
        if not process.present and self._processes.get(process.token) is process:
            process.due_ns = monotonic_ns() + EVERY_NS
            self._admit(process)

    def _admit(self, process: Process) -> None:
        """Let a process take part."""
        token, peer = process.token, process.peer
        if self._is_taken(peer):
            del self._processes[token]
            return
        process.present, process.noted = True, False
        if self._keyring is not None and not token.relayed and self._keyring.shares_with(peer.role):
            self._keyring.add(peer, process.keys)
        self._arrived(token)
        self._decide()

    def _is_taken(self, peer: Peer) -> bool:
        """Return whether another process, which has proven itself, has the number of this one."""
        known = None if self._keyring is None else self._keyring.known(peer.role, peer.nonce)
        taken = known is not None and known.public != peer.public
        if taken:
            self._refusals.note(f"a {peer.role.name.lower()} that takes the number of another one")
        return taken

    def _decide(self) -> None:
        """Stop waiting for answers if none is open."""
        if not any(
            p.must_answer and not p.present and p.token.role in EXCLUSIVE
            for p in self._processes.values()
        ):
            self._undecided_ns = 0

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

    def _forget(self, token: Token) -> None:
        """Forget a token that has vanished."""
        process = self._processes.pop(token, None)
        if process is not None:
            self._decide()
            if self._handshake is not None and (fault := self._handshake.fault_of(process.peer)):
                self._refusals.note(fault)  # which is why TLS has cut the connection
        if token in self.others:
            self._withdraw(token)

    def _withdraw(self, token: Token) -> None:
        """Count a token no more."""
        self.replace(self.others - {token})
        if token in self._relayed:
            self._relayed.pop(token).undeclare()
        gone = not any((t.role, t.nonce) == (token.role, token.nonce) for t in self.others)
        if gone and self._keyring is not None:
            self._keyring.remove(token.role, token.nonce)

    def _look_at_certificates(self) -> None:
        """Part from processes whose certificate has expired or was revoked, or from all if ours."""
        if self._handshake is None or self._keyring is None:
            return
        if self._handshake.read_revoked(self._refusals.note):
            self._responder.forget()
        ours = self._handshake.fault
        if ours and self._processes:
            self._refusals.note(f"{ours}; it is ours: nothing is sent or believed any more")
        for token, process in list(self._processes.items()):
            if ours or self._handshake.fault_of(process.peer):
                self._forget(token)
                self._keyring.forget(token.role, token.nonce)

    def _vouches(self, nonce: int) -> bool:
        """Return whether we have proof that a master is here."""
        return any(
            t.nonce == nonce and t.role is Role.MASTER and not t.relayed for t in self.others
        )

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._store(reply.ok)
