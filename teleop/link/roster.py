"""Roster of the processes announced in a session."""

import contextlib
import threading
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from queue import Empty, Queue
from time import monotonic_ns
from typing import Any

import zenoh

from teleop.link.admission import Admission, AnswerCallback, Challenger, Responder
from teleop.link.rate_limit import RefusalCounter
from teleop.messages.topics import Role
from teleop.security import CertificateError, NotYetValidError
from teleop.security.handshake import Handshake, PairKeys, Peer, SignatureError
from teleop.security.keyring import Keyring
from teleop.security.presence import (
    EXCLUSIVE_ROLES,
    LISTENER_ROLES,
    RoleStage,
    Token,
    build_token_root,
    list_groups,
    list_watched_groups,
)

GROUP_TOKENS_MAX = 64  # of a group at a time
COUNTED_PROCESSES_MAX = 1024  # processes whose visits are counted
DEPARTED_TOKENS_MAX = 256  # tokens that are remembered as vanished
PENDING_TOKENS_MAX = 64  # tokens of a group that wait in Zenoh; a newer one displaces the oldest
TOKENS_PER_STEP = 16  # of them taken at a time
CHALLENGES_PER_STEP = 8  # challenges sent at a time

SECOND_NS = 1_000_000_000  # [ns]
# [s] between two steps: with much to do, which takes turns; with none
BUSY_PERIOD_S, IDLE_PERIOD_S = 0.001, 0.02
# between two challenges of a process, and two looks at the certificates
CHALLENGE_PERIOD_NS = 2 * SECOND_NS
# after the first challenge without an answer; doubles up to `CHALLENGE_PERIOD_NS`
RETRY_NS = SECOND_NS // 20
# challenges in succession without an answer, after which a process counts as gone
MISSED_ANSWERS_MAX = 3
# for which a challenge of a vanished token is late; longer than any way takes
DEPARTED_NS = 5 * SECOND_NS
# without an answer, after which a line says so; long, for a loaded machine
SILENCE_WARNING_NS = 5 * SECOND_NS
DECISION_TIMEOUT_NS = SECOND_NS  # after which a process without an answer is not waited for


@dataclass(slots=True, eq=False)
class RemoteProcess:
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
    supervisor, counts only while its process answers challenges (`teleop.link.admission`): a token
    that is played back neither evicts nor blocks anybody. Nothing counts any more of a certificate
    that expires or is revoked.

    What an attacker can make us do or keep is bounded for each group of tokens (`Token.group`),
    whatever stands. Zenoh keeps the newest `PENDING_TOKENS_MAX` tokens, without our interpreter, of
    which `TOKENS_PER_STEP` are taken at a time; `Admission` says which proofs are checked.
    `GROUP_TOKENS_MAX` are kept, of which the certificate with the most makes place. A token that is
    lost by that is seen in the challenge of its process, which repeats it until it is answered.
    That of a listener is seen there only; its keys are kept to answer the next one.

    A thread of its own writes; anyone reads.

    `session` is the root of the keys; tokens of the nonce of `token`, our own, are ignored; with
    `relay` those of masters are repeated, for other masters. `handshake` checks the proofs, and
    `keyring` gets the keys that follow; None in an insecure session. `refusals` is told why tokens
    are ignored.
    """

    def __init__(
        self,
        zenoh_session: zenoh.Session,
        session: str,
        token: Token,
        relay: bool,
        handshake: Handshake | None = None,
        keyring: Keyring | None = None,
        refusals: RefusalCounter | None = None,
    ) -> None:
        # replaced atomically, so that reading is thread-safe
        self.others: frozenset[Token] = frozenset()
        self._held: frozenset[tuple[Role, int]] = frozenset()  # started processes
        self._session, self._role, self._nonce, self._relay = (
            session, token.role, token.nonce, relay,
        )  # fmt: skip
        self._handshake, self._keyring = handshake, keyring
        self._refusals = refusals or RefusalCounter()
        announced = list_watched_groups(token.role)
        asking = LISTENER_ROLES if token.role in EXCLUSIVE_ROLES else ()
        self._admissions = {
            group: Admission(group)
            for group in (*announced, *(group for role in asking for group in list_groups(role)))
        }
        self._turns = deque(self._admissions.values())
        self._take_ns = 0
        self._departed: OrderedDict[int, int] = OrderedDict()  # when tokens vanished, by hash
        self._undecided_ns = 0  # until when the answer of an exclusive process is waited for
        self._look_ns = monotonic_ns() + CHALLENGE_PERIOD_NS
        self._processes: dict[Token, RemoteProcess] = {}
        self._visits: dict[tuple[Role, int], int] = {}  # number of visits
        self._relayed: dict[Token, Any] = {}
        self._liveliness: Any = zenoh_session.liveliness()
        # no `SimpleQueue`, whose waits may have no end (`teleop.link.reception.Inbox.wait`)
        self._events: Queue[Callable[[], None] | None] = Queue()
        self._stack = contextlib.ExitStack()
        if handshake is not None:
            # a side must not say that it holds its role while it claims it
            shown = token if token.role in EXCLUSIVE_ROLES else replace(token, stage=RoleStage.HELD)
            self._challenger = Challenger(zenoh_session, session, handshake.prove(shown))
            if token.role not in LISTENER_ROLES:  # which nobody challenges
                responder = Responder(
                    zenoh_session, session, self._nonce, self._has_master_proof, self._show
                )
                self._stack.callback(responder.close)
        self._arrivals = [
            self._liveliness.declare_subscriber(
                f"{build_token_root(session)}/{group}/**",
                zenoh.handlers.RingChannel(PENDING_TOKENS_MAX),
                history=True,
            )
            for group in announced
        ]
        for arrivals in self._arrivals:
            self._stack.callback(arrivals.undeclare)
        self._thread = threading.Thread(target=self._run, name="roster", daemon=True)
        self._thread.start()

    def is_present(self, role: Role, nonce: int | None = None) -> bool:
        """Return whether a process of `role` (and this nonce) is present and has started."""
        held = self._held
        return any(r is role and nonce in (None, n) for r, n in held)

    def is_announced(self, nonce: int) -> bool:
        """Return whether a process of this nonce is present and has finished starting."""
        return any(t.nonce == nonce and t.stage == RoleStage.HELD for t in self.others)

    def has_right(self, nonce: int, right: str) -> bool:
        """Return whether the process of this nonce is present and has a right of a supervisor.

        The two sides may stop. In an insecure session everyone may do everything.
        """
        if self._keyring is None:
            return right == "stop" or self.is_announced(nonce)
        for role, n in self._held:
            peer = self._keyring.find_peer(role, nonce) if n == nonce else None
            if peer is not None:
                is_side = role in EXCLUSIVE_ROLES
                if right in peer.identity.rights or (is_side and right == "stop"):
                    return True
        return False

    def find_visit(self, role: Role, nonce: int) -> int:
        """Return the visit number of `nonce` in `role`, from 1; 0 if it is not present."""
        return self._visits.get((role, nonce), 1) if (role, nonce) in self._held else 0

    @property
    def is_undecided(self) -> bool:
        """Whether the answer of a process that may have our place is still waited for."""
        waits = any(self._admissions[role.name.lower()] for role in EXCLUSIVE_ROLES)
        return waits or not self._events.empty() or monotonic_ns() < self._undecided_ns

    def show_token(self, token: Token) -> None:
        """Show this token of ours to those that are challenged; once it has been announced."""
        if self._handshake is not None:
            self._challenger.show_token(token)

    def replace(self, others: frozenset[Token]) -> None:
        """Replace the tokens of all other processes."""
        self.others = others
        self._held = frozenset(
            (t.role, t.nonce) for t in others if t.stage == RoleStage.HELD and not t.relayed
        )

    def close(self) -> None:
        """Stop watching; before the session is closed."""
        self._events.put(None)
        self._thread.join()
        self._stack.close()

    def _run(self) -> None:
        """Process tokens and answers, and challenge, until `close`."""
        wait_s = 0.0
        while True:
            try:
                with contextlib.suppress(Empty):
                    event = self._events.get(timeout=wait_s)
                    if event is None:
                        return
                    event()
                wait_s = self._step(monotonic_ns())
            except zenoh.ZError as error:  # of one token; the next ones are looked at all the same
                self._refusals.note(f"a presence token, for an error of the link: {error}")
            except Exception as error:  # presence and revocation need this thread
                wait_s = IDLE_PERIOD_S
                name = type(error).__name__
                self._refusals.note(f"a presence token, for an error of ours: {name}: {error}")

    def _step(self, now_ns: int) -> float:
        """Do a small part of what is to be done; return how long to wait for the next one [s]."""
        if self._take_ns <= now_ns:
            self._take_ns = now_ns + round(IDLE_PERIOD_S * SECOND_NS)
            self._take_arrivals()
        if self._look_ns <= now_ns:
            self._look_ns = now_ns + CHALLENGE_PERIOD_NS
            self._look_at_certificates()
        due = [p for p in self._processes.values() if p.must_answer and p.due_ns <= now_ns]
        for process in due[:CHALLENGES_PER_STEP]:
            self._ask(process)
        return (
            BUSY_PERIOD_S if self._check_next() or len(due) > CHALLENGES_PER_STEP else IDLE_PERIOD_S
        )

    def _take_arrivals(self) -> None:
        """Take tokens that have come, or vanished, from Zenoh."""
        for arrivals in self._arrivals:
            for _ in range(TOKENS_PER_STEP):
                sample = arrivals.try_recv()
                if sample is None:
                    break
                token = Token.from_key(str(sample.key_expr))
                if token is None or token.nonce == self._nonce:
                    continue
                if sample.kind == zenoh.SampleKind.PUT:
                    self._departed.pop(hash(token), None)
                    self._queue(token)
                else:
                    self._admissions[token.group].remove(token)
                    self._forget(token)
                    self._departed[hash(token)] = monotonic_ns()
                    while len(self._departed) > DEPARTED_TOKENS_MAX:
                        self._departed.popitem(last=False)

    def _queue(self, token: Token, asker: AnswerCallback | None = None) -> None:
        """Let a token wait for its check."""
        if token in self.others or token in self._processes:
            if asker is not None:
                self._answer(token, asker)
        elif not self._admissions[token.group].put(token, asker):
            self._note_excess(token)

    def _note_excess(self, token: Token) -> None:
        self._refusals.note(f"presence tokens of {token.role.name.lower()}s came too fast")

    def _show(self, token: Token, asker: AnswerCallback) -> None:
        """Take the token of a process that challenges us, from Zenoh's thread."""
        if token.group in self._admissions:
            self._events.put(partial(self._queue, token, asker))

    def _answer(self, token: Token, asker: AnswerCallback) -> None:
        process = self._processes.get(token)
        if process is not None:
            asker(process.keys)

    def _check_next(self) -> bool:
        """Check the token whose turn it is; return whether there was one."""
        for _ in range(len(self._turns)):
            admission = self._turns[0]
            self._turns.rotate(-1)
            waiting = admission.take()
            if waiting is not None:
                self._check(*waiting)
                return True
        return False

    def _check(self, token: Token, asker: AnswerCallback | None) -> None:
        """Look at a token that has come, or that a process shows which challenges us."""
        if self._handshake is None:
            if token.proof:
                name = token.role.name.lower()
                self._refusals.note(f"a {name} with a certificate: this session is insecure")
            elif sum(t.group == token.group for t in self.others) < GROUP_TOKENS_MAX:
                self._add(token)
            else:
                self._note_excess(token)
            return
        process = self.examine(token)
        if process is None:
            return
        if asker is not None:
            asker(process.keys)
            departed_ns = self._departed.get(hash(token), -DEPARTED_NS)
            if monotonic_ns() - departed_ns < DEPARTED_NS:  # a challenge may come late
                return
        if not self._has_place(process):
            self._note_excess(token)
            return
        self._processes[token] = process
        if not process.must_answer:
            return  # kept to answer it again
        if self._has_answered(process):
            process.due_ns = process.since_ns + CHALLENGE_PERIOD_NS
            self._admit(process)
        else:
            if token.role in EXCLUSIVE_ROLES:
                self._undecided_ns = process.since_ns + DECISION_TIMEOUT_NS
            self._ask(process)

    def _has_place(self, process: RemoteProcess) -> bool:
        """Return whether there is place for a process in its group, and make it."""
        token = process.token
        members = [p for p in self._processes.values() if p.token.group == token.group]
        if len(members) < GROUP_TOKENS_MAX:
            return True
        counts = Counter(p.token.certificate for p in members)
        # the first of the largest: the oldest one without an answer
        last = max(members, key=lambda p: (counts[p.token.certificate], not p.present))
        if last.present and (
            token.role in EXCLUSIVE_ROLES or last.token.certificate == token.certificate
        ):
            return False
        self._forget(last.token)
        return True

    def examine(self, token: Token) -> RemoteProcess | None:
        """Return whose token it is; None, with a note, if it is not genuine."""
        if self._handshake is None or self._keyring is None or self._handshake.fault:
            return None  # a fault of ours was said already (`_look_at_certificates`)
        admission = self._admissions[token.group]
        try:
            peer = self._handshake.check(token)
            keys = self._handshake.derive_pair_keys(peer)
        except CertificateError as error:
            self._refusals.note(str(error))
            if not isinstance(error, NotYetValidError):
                admission.refuse(token)
            if isinstance(error, SignatureError):
                admission.add_certificate(token)
            return None
        admission.add_certificate(token)
        if self._is_taken(peer):
            return None
        return RemoteProcess(token, peer, keys, monotonic_ns(), token.role not in LISTENER_ROLES)

    def _has_answered(self, process: RemoteProcess) -> bool:
        """Return whether the process has just proven its presence for another token."""
        return not process.token.relayed and any(
            p.present and p.peer == process.peer and not (p.token.relayed or p.unanswered)
            for p in self._processes.values()
        )

    def _ask(self, process: RemoteProcess) -> None:
        """Challenge a process; one that has not answered for long is none."""
        now = monotonic_ns()
        name = process.token.role.name.lower()
        if process.present and process.unanswered >= MISSED_ANSWERS_MAX:
            self._withdraw(process.token)
            process.present, process.since_ns = False, now
        if (
            not process.present
            and not process.noted
            and now - process.since_ns > SILENCE_WARNING_NS
        ):
            process.noted = True
            self._refusals.note(
                f"a {name} that does not answer: it hangs, or somebody plays its token back"
            )
            if process.token.role not in EXCLUSIVE_ROLES:
                self._forget(process.token)  # when it goes on, it challenges us
                return
        wait_ns = CHALLENGE_PERIOD_NS if process.present else RETRY_NS << min(process.unanswered, 8)
        process.due_ns = now + min(wait_ns, CHALLENGE_PERIOD_NS)
        process.unanswered += 1
        proven = partial(self._events.put, partial(self._note_answer, process))
        for witness in self._list_witnesses(process):
            self._challenger.ask(witness.token.nonce, process.token.nonce, witness.keys, proven)

    def _list_witnesses(self, process: RemoteProcess) -> list[RemoteProcess]:
        """Return who can prove the presence of a process: it, or the slave that relays it."""
        if not process.token.relayed:
            return [process]
        return [p for p in self._processes.values() if p.present and p.token.role == Role.SLAVE]

    def _note_answer(self, process: RemoteProcess) -> None:
        """Note that a process has proven its presence."""
        process.unanswered = 0
        if not process.present and self._processes.get(process.token) is process:
            process.due_ns = monotonic_ns() + CHALLENGE_PERIOD_NS
            self._admit(process)

    def _admit(self, process: RemoteProcess) -> None:
        """Let a process take part."""
        token, peer = process.token, process.peer
        if self._is_taken(peer):
            del self._processes[token]
            return
        process.present, process.noted = True, False
        if (
            self._keyring is not None
            and not token.relayed
            and self._keyring.has_tags_with(peer.role)
        ):
            self._keyring.add(peer, process.keys)
        self._add(token)
        self._decide()

    def _is_taken(self, peer: Peer) -> bool:
        """Return whether another process, which has proven itself, has the number of this one."""
        owner = None if self._keyring is None else self._keyring.find_peer(peer.role, peer.nonce)
        is_taken = owner is not None and owner.public != peer.public
        if is_taken:
            self._refusals.note(f"a {peer.role.name.lower()} that takes the number of another one")
        return is_taken

    def _decide(self) -> None:
        """Stop waiting for answers if none is open."""
        if not any(
            not p.present and p.token.role in EXCLUSIVE_ROLES for p in self._processes.values()
        ):
            self._undecided_ns = 0

    def _add(self, token: Token) -> None:
        process = (token.role, token.nonce)
        if token.stage == RoleStage.HELD and not token.relayed:
            self._visits[process] = self._visits.pop(process, 0) + 1
            while len(self._visits) > COUNTED_PROCESSES_MAX:
                del self._visits[next(iter(self._visits))]
        self.replace(self.others | {token})
        if self._relay and token.role == Role.MASTER and not token.relayed:
            key = replace(token, relayed=True).to_key(self._session)
            self._relayed[token] = self._liveliness.declare_token(key)

    def _forget(self, token: Token) -> None:
        """Forget a token that has vanished."""
        process = self._processes.pop(token, None)
        if process is not None:
            self._decide()
            if self._handshake is not None and (fault := self._handshake.find_fault(process.peer)):
                self._refusals.note(fault)  # which is why TLS has cut the connection
        if token in self.others:
            self._withdraw(token)

    def _withdraw(self, token: Token) -> None:
        """Count a token no more."""
        self.replace(self.others - {token})
        if token in self._relayed:
            self._relayed.pop(token).undeclare()
        is_gone = not any((t.role, t.nonce) == (token.role, token.nonce) for t in self.others)
        if is_gone and self._keyring is not None:
            self._keyring.remove(token.role, token.nonce)

    def _look_at_certificates(self) -> None:
        """Part from processes whose certificate has expired or was revoked, or from all if ours."""
        if self._handshake is None or self._keyring is None:
            return
        self._handshake.read_revoked(self._refusals.note)
        ours = self._handshake.fault
        if ours and self._processes:
            self._refusals.note(f"{ours}; it is ours: nothing is sent or believed any more")
        for token, process in list(self._processes.items()):
            if ours or self._handshake.find_fault(process.peer):
                self._forget(token)
                self._keyring.forget(token.role, token.nonce)

    def _has_master_proof(self, nonce: int) -> bool:
        """Return whether we have proof that a master is here."""
        return any(
            t.nonce == nonce and t.role is Role.MASTER and not t.relayed for t in self.others
        )
