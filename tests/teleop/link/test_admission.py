"""Which tokens are looked at: bounded work, fair to certificates, whatever stands."""

import secrets
import time
from collections import deque
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from types import SimpleNamespace

import pytest
import zenoh

from teleop.link import roster as roster_module
from teleop.link.admission import (
    CERTIFICATES,
    CHALLENGE_BYTES,
    CHECK_BURST,
    QUEUED_TOKENS_MAX,
    STOP_CHECKS_HZ,
    Admission,
)
from teleop.link.rate_limit import RefusalCounter
from teleop.link.roster import GROUP_TOKENS_MAX, PENDING_TOKENS_MAX, Roster
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import STOP, Role
from teleop.security import CERTIFICATE_ROLES, RIGHTS, CertificateRole, Credentials, Identity
from teleop.security import identity as identity_module
from teleop.security.access import build_access_control
from teleop.security.authority import Authority
from teleop.security.handshake import Handshake
from teleop.security.keyring import DEPARTED_PEERS_MAX, Keyring
from teleop.security.presence import LISTENER_ROLES, RoleStage, Token, build_token_root, list_groups
from tests.teleop.link.bench import await_refusals, wait_until
from tests.teleop.link.test_denial import KEYS, MASTER

SECOND = 1_000_000_000
SHOWN = 128  # characters of a proof before the certificate


def a_token(certificate, role=Role.REMOTE, limit=""):
    """A token with a worthless proof of some certificate."""
    proof = secrets.token_urlsafe(96)[:SHOWN] + certificate
    return Token(role, LAYOUT, secrets.randbits(64), RoleStage.HELD, proof=proof, limit=limit)


class Clock:
    def __init__(self):
        self.now = 0

    def __call__(self):
        return self.now


def checks_until(admission, clock, sought, flood):
    """Number of checks, among tokens that come meanwhile, until `sought` is checked."""
    for number in range(1, 10_000):
        for token in flood():
            admission.put(token)
        clock.now += SECOND
        taken = admission.take()
        if taken is not None and taken[0] == sought:
            return number
        if taken is not None:
            admission.refuse(taken[0])
    raise AssertionError("never")


def test_a_flood_of_one_certificate_keeps_only_that_one_waiting():
    clock = Clock()
    admission = Admission("remote", clock)
    attacker, genuine = a_token("attacker"), a_token("genuine")
    admission.add_certificate(attacker)
    admission.add_certificate(genuine)
    for _ in range(3 * QUEUED_TOKENS_MAX):
        admission.put(a_token("attacker"))
    admission.put(genuine)
    assert checks_until(admission, clock, genuine, lambda: [a_token("attacker")] * 20) <= 2


def test_a_new_certificate_waits_beside_the_unknown_ones_and_then_no_more():
    clock = Clock()
    admission = Admission("remote", clock)
    claim, held = a_token("new"), a_token("new")
    for _ in range(QUEUED_TOKENS_MAX - 2):
        admission.put(a_token(secrets.token_hex(8)))
    admission.put(claim)
    admission.put(held)
    first = None
    while first not in (claim, held):
        clock.now += SECOND
        first, _ = admission.take() or (None, None)
    admission.add_certificate(claim)
    second = held if first == claim else claim
    assert checks_until(admission, clock, second, list) <= 2


def test_copies_of_a_certificate_do_not_keep_its_holder_out_for_good():
    """He shows his token again and again; chance takes one of all that wait."""
    clock = Clock()
    admission = Admission("remote", clock)
    genuine = a_token("copied")
    admission.add_certificate(genuine)
    checks_until(
        admission, clock, genuine, lambda: [*(a_token("copied") for _ in range(10)), genuine]
    )


def test_worthless_tokens_are_checked_once_and_all_is_bounded():
    clock = Clock()
    admission = Admission("remote", clock)
    worthless = a_token("x")
    admission.put(worthless)
    taken = admission.take()
    assert taken == (worthless, None)
    admission.refuse(worthless)
    admission.put(worthless)
    assert len(admission) == 0
    for n in range(2 * CERTIFICATES):
        admission.add_certificate(a_token(f"{n}"))
    made_place = [not admission.put(a_token(f"{n % 3}")) for n in range(5 * QUEUED_TOKENS_MAX)]
    assert (
        len(admission) == QUEUED_TOKENS_MAX
    )  # those of certificates that are forgotten share a queue
    assert sum(made_place) == 4 * QUEUED_TOKENS_MAX


def test_checks_are_limited_and_a_token_that_vanishes_is_not_checked():
    clock = Clock()
    admission = Admission("remote-stop", clock)
    for _ in range(CHECK_BURST + 30):
        admission.add_certificate(token := a_token(secrets.token_hex(4)))
        admission.put(token)
    assert sum(admission.take() is not None for _ in range(CHECK_BURST + 30)) == CHECK_BURST
    clock.now += SECOND // 10
    rest = sum(admission.take() is not None for _ in range(CHECK_BURST + 30))
    assert rest == STOP_CHECKS_HZ / 10
    gone = a_token("gone")
    admission.put(gone)
    admission.remove(gone)
    clock.now += 100 * SECOND
    while (taken := admission.take()) is not None:
        assert taken[0] != gone


def test_each_group_of_tokens_may_be_announced_by_its_certificates_only():
    access = build_access_control(["test"])
    names = {s["id"]: s["cert_common_names"] for s in access["subjects"] if s["id"] != "anyone"}
    announced = {}
    for rule in access["rules"]:
        if "liveliness_token" in rule["messages"] and rule["flows"] == ["ingress"]:
            holders = {
                name
                for policy in access["policies"]
                if rule["id"] in policy["rules"]
                for subject in policy["subjects"]
                for name in names[subject]
            }
            for key in rule["key_exprs"]:
                announced.setdefault(key, set()).update(holders)
    by_name = {"launcher": "supervisor", "remote": "supervisor", "watch": "supervisor"}
    groups = [group for role in Role for group in list_groups(role) if role not in LISTENER_ROLES]
    assert len(groups) == 3 * 7 + 2
    assert not [key for key in announced if "/viewer/" in key or "/recorder/" in key]
    for group in groups:
        role, dash, rights = group.partition("-")
        holder = f"{by_name.get(role, role)}{dash}{rights}.test"
        assert announced[f"{build_token_root('test')}/{group}/**"] == {holder}
    assert announced[f"{build_token_root('test')}/relay/master/**"] == {"slave.test"}


class Network:
    """Stands in for a Zenoh session: the tokens that a test announces, kept as Zenoh keeps them."""

    def __init__(self):
        self.rings = {}
        self.asked = []  # keys of the challenges
        self.shown = []  # tokens in them

    def liveliness(self):
        return SimpleNamespace(declare_subscriber=self._watch)

    def declare_queryable(self, *_):
        return SimpleNamespace(undeclare=lambda: None)

    def get(self, key, *_, payload, **__):
        self.asked.append(key)
        self.shown.append(payload[CHALLENGE_BYTES + 8 :])

    def announce(self, token, kind=zenoh.SampleKind.PUT):
        key = token.to_key("test")
        ring = self.rings[f"{build_token_root('test')}/{token.group}/**"]
        ring.append(SimpleNamespace(key_expr=key, kind=kind))

    def _watch(self, key, handler, history):
        assert isinstance(handler, zenoh.handlers.RingChannel)
        assert history
        ring = self.rings[key] = deque(maxlen=PENDING_TOKENS_MAX)
        return SimpleNamespace(
            try_recv=lambda: ring.popleft() if ring else None, undeclare=lambda: None
        )


class Session:
    """The roster of a process that starts, and the certificates of others."""

    def __init__(self, role=Role.SLAVE):
        self.authority = Authority.create("ours", 2)
        self.network, self.refusals = Network(), RefusalCounter()
        self.keyring = Keyring(role, 1)
        token = Token(role, LAYOUT, 1, RoleStage.CLAIM)
        rights = ("stop",) if CERTIFICATE_ROLES[role] is CertificateRole.SUPERVISOR else ()
        handshake = Handshake(self.issue(CERTIFICATE_ROLES[role], rights), "test", 1)
        network = self.network
        self.roster = Roster(network, "test", token, False, handshake, self.keyring, self.refusals)

    def issue(self, role, rights=(), start=None):
        identity = Identity(role, "test", rights)
        certificate, key = self.authority.issue(identity, 1, start)
        return Credentials(identity, certificate, key, self.authority.certificate)

    def genuine(self, credentials, role, nonce):
        token = Token(role, LAYOUT, nonce, RoleStage.HELD)
        return Handshake(credentials, "test", nonce).prove(token)

    def worthless(self, token):
        """A token with the certificate of another one, and nothing else."""
        copied = a_token(token.certificate, token.role, token.limit)
        assert copied.group == token.group
        return copied

    def is_asked(self, nonce):
        """Whether this process was believed, and challenged."""
        return any(key.endswith(f"{nonce:016x}") for key in tuple(self.network.asked))


@pytest.fixture
def session():
    session = Session()
    yield session
    session.roster.close()


def test_worthless_proofs_without_the_right_do_not_keep_out_who_may_stop(session):
    attacker = session.genuine(session.issue(CertificateRole.SUPERVISOR, ("set",)), Role.REMOTE, 5)
    for _ in range(1000):
        session.network.announce(session.worthless(attacker))
    stopper = session.genuine(session.issue(CertificateRole.SUPERVISOR, ("stop",)), Role.REMOTE, 6)
    session.network.announce(stopper)
    wait_until(lambda: session.is_asked(6))
    assert stopper.group == "remote-stop"
    assert any("does not hold the key" in line for line in session.refusals.take())


def test_a_group_that_the_certificate_does_not_give_is_refused(session):
    """Zenoh's access control does it before; a router could pass it on."""
    credentials = session.issue(CertificateRole.SUPERVISOR, ("set",))
    handshake = Handshake(credentials, "test", 7)
    limited = handshake.prove(Token(Role.REMOTE, LAYOUT, 7, RoleStage.HELD))
    assert limited.group == "remote-set"
    session.network.announce(replace(limited, limit="-stop"))
    await_refusals(session.refusals, "a remote with the certificate supervisor-set.test")
    assert not session.is_asked(7)


def test_tokens_of_one_certificate_make_place_for_those_of_another(session, monkeypatch):
    monkeypatch.setattr(roster_module, "SILENCE_WARNING_NS", 10**15)  # nobody here answers
    credentials = session.issue(CertificateRole.SUPERVISOR, RIGHTS)
    for nonce in range(10, 10 + GROUP_TOKENS_MAX):
        session.network.announce(session.genuine(credentials, Role.REMOTE, nonce))
        wait_until(lambda nonce=nonce: session.is_asked(nonce))
    other = session.genuine(session.issue(CertificateRole.SUPERVISOR, RIGHTS), Role.REMOTE, 6)
    session.network.announce(other)
    wait_until(lambda: session.is_asked(6))
    assert len(session.roster._processes) == GROUP_TOKENS_MAX


def test_an_error_of_one_token_is_noted_and_the_next_ones_are_looked_at(session, monkeypatch):
    credentials = session.issue(CertificateRole.SUPERVISOR, ("stop",))
    examine = session.roster.examine

    def fail(token):
        if token.nonce == 5:
            raise ArithmeticError("unforeseen")
        return examine(token)

    monkeypatch.setattr(session.roster, "examine", fail)
    session.network.announce(session.genuine(credentials, Role.REMOTE, 5))
    await_refusals(session.refusals, "ArithmeticError: unforeseen")
    session.network.announce(session.genuine(credentials, Role.REMOTE, 6))
    wait_until(lambda: session.is_asked(6))


def test_who_challenges_is_looked_at_though_its_token_was_lost(session):
    """And not if its token has vanished: a challenge may come late."""
    credentials = session.issue(CertificateRole.SUPERVISOR, RIGHTS)
    answered = []
    session.roster._show(session.genuine(credentials, Role.WATCH, 8), answered.append)
    wait_until(lambda: session.is_asked(8))
    late = session.genuine(credentials, Role.WATCH, 9)
    session.network.announce(late, zenoh.SampleKind.DELETE)
    wait_until(lambda: len(session.roster._departed) == 1)
    session.roster._show(late, answered.append)
    wait_until(lambda: len(answered) == 2)
    assert not session.is_asked(9)


def test_a_token_that_vanished_a_while_ago_may_come_back_by_a_challenge(session, monkeypatch):
    """Its announcement may be lost."""
    credentials = session.issue(CertificateRole.SUPERVISOR, RIGHTS)
    token = session.genuine(credentials, Role.WATCH, 9)
    session.network.announce(token, zenoh.SampleKind.DELETE)
    wait_until(lambda: len(session.roster._departed) == 1)
    later = partial(lambda clock: clock() + 10 * SECOND, time.monotonic_ns)
    monkeypatch.setattr(roster_module, "monotonic_ns", later)
    session.roster._show(token, lambda _: None)
    wait_until(lambda: session.is_asked(9))


def test_a_certificate_that_becomes_valid_is_believed_then(session, monkeypatch):
    """Not for the rest of the run worthless: a clock may be set."""
    now = datetime.now(UTC)
    credentials = session.issue(CertificateRole.SUPERVISOR, RIGHTS, now + timedelta(hours=1))
    token = session.genuine(credentials, Role.WATCH, 9)
    session.network.announce(token)
    await_refusals(session.refusals, "UTC on; check the clock")
    later = SimpleNamespace(now=lambda _: now + timedelta(hours=2))
    monkeypatch.setattr(identity_module, "datetime", later)
    session.roster._show(token, lambda _: None)
    wait_until(lambda: session.is_asked(9))


def test_a_challenge_announces_a_supervisor_and_leaves_the_claim_of_a_side_a_claim():
    for role, shown in ((Role.REMOTE, b"/remote-stop/"), (Role.SLAVE, b"/slave/")):
        session = Session(role)
        master = session.genuine(session.issue(CertificateRole.MASTER), Role.MASTER, 11)
        session.network.announce(master)
        wait_until(lambda session=session: session.is_asked(11))
        session.roster.close()
        (token, *_) = session.network.shown
        assert shown in token
        assert (b"/held/" in token) == (role is Role.REMOTE)


def test_a_listener_is_answered_and_not_announced_nor_challenged(session, monkeypatch):
    """Its proof is checked once, and until it has shown itself again after others."""
    checked = []
    check = session.roster.examine
    monkeypatch.setattr(session.roster, "examine", lambda t: checked.append(t) or check(t))
    credentials, answered = session.issue(CertificateRole.VIEWER), []
    viewer = session.genuine(credentials, Role.VIEWER, 10)
    for count in range(1, 4):
        session.roster._show(viewer, answered.append)
        wait_until(lambda count=count: len(answered) == count)
    assert checked == [viewer]
    assert len(set(answered)) == 1
    assert not session.roster.is_present(Role.VIEWER)
    assert not session.roster.others
    assert not session.network.asked
    for nonce in range(100, 100 + GROUP_TOKENS_MAX):
        session.roster._show(session.genuine(credentials, Role.VIEWER, nonce), answered.append)
    wait_until(lambda: len(answered) == 3 + GROUP_TOKENS_MAX)
    assert len(session.roster._processes) == GROUP_TOKENS_MAX
    session.roster._show(viewer, answered.append)
    wait_until(lambda: len(answered) == 4 + GROUP_TOKENS_MAX)
    assert answered[-1] == answered[0]


def test_peers_that_come_and_go_do_not_displace_one_that_is_there():
    keyring = Keyring(Role.SLAVE, 2)
    launcher = MASTER._replace(role=Role.LAUNCHER, nonce=9)
    keyring.add(launcher, KEYS)
    for nonce in range(10, 10 + 2 * DEPARTED_PEERS_MAX):
        keyring.add(MASTER._replace(role=Role.REMOTE, nonce=nonce), KEYS)
        keyring.remove(Role.REMOTE, nonce)
    assert keyring.find_peer(Role.LAUNCHER, 9) == launcher
    senders = keyring.find_keys(STOP)
    assert senders is not None
    assert 9 in senders
    assert len(senders) == DEPARTED_PEERS_MAX + 1
