"""Certificates that expire, or are revoked, while their processes run."""

import time
from datetime import UTC, datetime

import pytest

from teleop.link import Link, LinkConfig
from teleop.link import roster as roster_module
from teleop.messages.messages import Command
from teleop.messages.topics import COMMAND, Role
from teleop.security import CertificateRole, Identity
from teleop.security.authority import Authority
from teleop.security.revocation import REVOKED
from tests.teleop.keys.folder import make_keys, put
from tests.teleop.link.bench import await_refusals, pump, session, wait_until

DAY_S = 86_400.0


@pytest.fixture(autouse=True)
def short_patience(monkeypatch):
    monkeypatch.setattr(roster_module, "CHALLENGE_PERIOD_NS", 100_000_000)


@pytest.fixture
def authority():
    return Authority.create("test authority", 2)


def with_keys(config, keys):
    return LinkConfig(master=config.master, slave=config.slave, keys=keys)


def is_parted(slave, master):
    """Neither counts the other as present, and no command is believed."""
    wait_until(lambda: not slave.is_present(Role.MASTER) and not master.is_present(Role.SLAVE))
    before = slave.take_latest(COMMAND).counts
    received, unknown = before.received, before.unknown

    def refused():
        master.publish(COMMAND, Command(state=1))
        return slave.take_latest(COMMAND).counts.unknown > unknown + 5

    wait_until(refused)
    assert slave.take_latest(COMMAND).counts.received == received


def test_a_master_that_is_revoked_is_parted_from_within_seconds(tmp_path, config, authority):
    keys = make_keys(tmp_path, authority=authority)
    with session(with_keys(config, keys), Role.SLAVE, Role.MASTER) as (slave, master):
        pump(master, slave, 3)
        assert master.credentials is not None
        authority.revoke(master.credentials.certificate.serial_number).publish(keys)
        await_refusals(slave.refusals, "refused: the certificate master.test was revoked")
        await_refusals(master.refusals, "the certificate master.test was revoked; it is ours")
        is_parted(slave, master)


def test_a_list_that_is_not_genuine_takes_nobody_back(tmp_path, config, authority):
    keys = make_keys(tmp_path / "keys", authority=authority)
    Authority.create("another", 2).publish(tmp_path / "other")
    empty = (keys / REVOKED).read_bytes()
    config = with_keys(config, keys)
    with Link(config, "test", Role.SLAVE) as slave:
        master = Link(config, "test", Role.MASTER).__enter__()
        (keys / REVOKED).write_bytes((tmp_path / "other" / REVOKED).read_bytes())
        await_refusals(
            slave.refusals, "not signed by the authority beside it; the earlier one stays"
        )
        pump(master, slave, 3)
        assert master.credentials is not None
        authority.revoke(master.credentials.certificate.serial_number).publish(keys)
        await_refusals(slave.refusals, "was revoked")
        (keys / REVOKED).write_bytes(empty)  # an older list, genuine
        time.sleep(0.3)  # until it was read
        master.__exit__()
        slave.refusals.take()
        with Link(config, "test", Role.MASTER) as again:  # a process that knows no better
            await_refusals(slave.refusals, "was revoked")
            assert not slave.is_present(Role.MASTER)
            assert not again.is_present(Role.SLAVE)  # which does not answer it either


def test_a_certificate_that_expires_ends_the_pair(tmp_path, config, authority):
    keys = make_keys(tmp_path, authority=authority)
    put(authority, keys, Identity(CertificateRole.MASTER, "test"), 3.0 / DAY_S)
    with session(with_keys(config, keys), Role.SLAVE, Role.MASTER) as (slave, master):
        pump(master, slave, 3)
        assert master.credentials is not None
        end = master.credentials.certificate.not_valid_after_utc
        assert slave.is_present(Role.MASTER)
        await_refusals(slave.refusals, "refused: the certificate master.test expired on")
        assert datetime.now(UTC) >= end
        wait_until(lambda: not slave.is_present(Role.MASTER) and not master.is_present(Role.SLAVE))
        pumped = slave.take_latest(COMMAND).counts.received
        for _ in range(20):
            master.publish(COMMAND, Command(state=1))
        assert slave.take_latest(COMMAND).counts.received == pumped
        wait_until(lambda: not slave._zenoh.info.peers_zid())  # nor can it listen
