"""Presence tokens of processes that are gone, played back: they count for nothing.

Whoever plays them back has the certificate of a router, which Zenoh lets announce everything.
"""

import time
from contextlib import ExitStack

import pytest
import zenoh

from teleop.link import Link
from teleop.link import roster as roster_module
from teleop.link.admission import CHALLENGE_BYTES, build_challenge_key
from teleop.link.roster import GROUP_TOKENS_MAX
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import COMMAND, Role
from teleop.security import CERTIFICATE_ROLES, CertificateRole
from teleop.security.credentials import create_local_credentials
from teleop.security.handshake import Handshake
from teleop.security.keyring import ADDRESSEES
from teleop.security.presence import RoleStage, Token
from tests.teleop.link.bench import await_refusals, open_as, pump, rogue_of, session, wait_until

SILENT = "that does not answer: it hangs, or somebody plays its token back"


@pytest.fixture
def short_patience(monkeypatch):
    monkeypatch.setattr(roster_module, "CHALLENGE_PERIOD_NS", 200_000_000)
    monkeypatch.setattr(roster_module, "SILENCE_WARNING_NS", 300_000_000)


def recorded(role, nonce, relayed=False):
    """The genuine token of a process of an earlier run."""
    handshake = Handshake(create_local_credentials("test", CERTIFICATE_ROLES[role]), "test", nonce)
    token = handshake.prove(Token(role, LAYOUT, nonce, RoleStage.HELD))
    return token.to_key("test").replace("/@/", "/@/relay/") if relayed else token.to_key("test")


@pytest.mark.usefixtures("short_patience")
def test_recorded_tokens_evict_and_displace_nobody(config):
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master), rogue_of(config) as rogue:
        pump(master, slave)
        for n in range(1, ADDRESSEES + 2):  # more than a message has tags
            for role in (Role.MASTER, Role.SLAVE, Role.REMOTE):
                rogue.announce_key(recorded(role, n))  # as old as can be
        rogue.announce_key(recorded(Role.MASTER, 99, relayed=True))
        for link in (slave, master):
            await_refusals(link.refusals, *(f"a {name} {SILENT}" for name in ("master", "slave")))
            link.check_peers()
            assert not link.is_present(Role.REMOTE)
        assert {token.nonce for token in slave._roster.others} == {master.nonce}
        assert {token.nonce for token in master._roster.others} == {slave.nonce}
        pump(master, slave, 3)


@pytest.mark.usefixtures("short_patience")
def test_recorded_tokens_keep_nobody_out(config):
    """They stand before the pair comes, older and newer ones, more than are kept."""
    with Link(config, "test", Role.SLAVE) as slave, rogue_of(config, count=1) as rogue:
        for n in range(1, GROUP_TOKENS_MAX + 17):
            rogue.announce_key(recorded(Role.MASTER, n + (n % 2) * 2**63))
        with Link(config, "test", Role.MASTER) as master:
            pump(master, slave, 3)
            assert slave.take_latest(COMMAND).message.sender == master.nonce
            assert {token.nonce for token in slave._roster.others} == {master.nonce}
            time.sleep(0.6)  # for the checks that were too many at once
            assert len(slave._roster._processes) <= GROUP_TOKENS_MAX + 2


@pytest.mark.usefixtures("short_patience")
def test_a_copy_of_a_living_token_outlives_its_process_by_seconds_only(config):
    """Zenoh does not say that a process is gone while somebody else announces the same token."""
    with Link(config, "test", Role.SLAVE) as slave, ExitStack() as ends:
        master = Link(config, "test", Role.MASTER)
        with master:
            pump(master, slave)
            rogue = ends.enter_context(rogue_of(config))
            for key in rogue_tokens(rogue, master):
                rogue.announce_key(key)
            time.sleep(0.1)
        assert slave.is_present(Role.MASTER)  # its end is masked
        wait_until(lambda: not slave.is_present(Role.MASTER))
        with Link(config, "test", Role.MASTER) as next_one:
            pump(next_one, slave, 3)
            next_one.check_peers()
        assert not slave.is_present(Role.MASTER, master.nonce)


def rogue_tokens(rogue, master):
    def of_master():
        return [key for key in rogue.tokens if f"{master.nonce:016x}/held" in key]

    wait_until(lambda: bool(of_master()))
    return list(dict.fromkeys(of_master()))


def test_a_challenge_is_answered_to_genuine_askers_only(config):
    with (
        Link(config, "test", Role.SLAVE) as slave,
        open_as(CertificateRole.ROUTER, config) as asking,
    ):
        genuine = recorded(Role.MASTER, 5)
        challenge = bytes(CHALLENGE_BYTES)

        def answer(role, token, subject=slave.nonce, timeout=0.2):
            payload = challenge + subject.to_bytes(8, "little") + token.encode()
            key = build_challenge_key("test", role, slave.nonce)
            at_once = zenoh.ConsolidationMode.NONE
            replies = asking.get(key, payload=payload, timeout=timeout, consolidation=at_once)
            return next((r.ok.payload.to_bytes() for r in replies if r.ok is not None), None)

        wait_until(lambda: bool(answer("master", genuine)))
        first, again = (answer("master", genuine, timeout=5.0) for _ in range(2))
        assert first == again  # of the same challenge
        assert not answer("viewer", genuine)
        assert not answer("master", genuine, subject=5)  # it has not proven itself
        assert not answer("master", genuine[:-3] + "AAA")
        assert not answer("master", recorded(Role.MASTER, 5).rsplit("/", 1)[0])
        assert not answer("*", genuine)
        for junk in ("", "/", "teleop/test/@/master", "\0" * 3000):
            assert not answer("master", junk)
