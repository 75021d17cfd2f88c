"""Why an endpoint is not connected to, in words."""

import socket

from teleop.link import Link, LinkConfig, network
from teleop.link.network import find_connection_fault
from teleop.messages.topics import Role
from teleop.security import CertificateRole
from teleop.security import credentials as stored
from tests.rogue import Rogue
from tests.teleop.keys.folder import make_keys
from tests.teleop.link.bench import await_refusals
from tests.teleop.link.test_played_back import recorded


def insecure(config):
    return LinkConfig(master=config.master, slave=config.slave, insecure=True)


def test_what_is_wrong_with_an_endpoint_is_named(config, tmp_path, monkeypatch):
    theirs = stored.load(make_keys(tmp_path, "test"), "test", CertificateRole.MASTER)
    with Link(config, "test", Role.SLAVE) as slave:
        ours = slave.credentials
        assert find_connection_fault(config.slave, ours, "test") == ""
        assert find_connection_fault(config.slave, ours, "other") == "its certificate is slave.test"
        assert "is of another authority" in find_connection_fault(config.slave, theirs, "test")
        assert "it is secure, and this side is not" in find_connection_fault(
            config.slave, None, "test"
        )
    assert find_connection_fault(config.slave, ours, "test") == ""  # nobody there
    monkeypatch.setattr(network, "PROBE_TIMEOUT_S", 0.2)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        place = f"127.0.0.1:{other.getsockname()[1]}"
        assert "no answer in TLS" in find_connection_fault(place, ours, "test")
        assert find_connection_fault(place, None, "test") == ""


def test_neither_a_secure_nor_an_insecure_side_accepts_the_other_and_both_say_so(
    config, monkeypatch
):
    monkeypatch.setattr(network, "PROBE_PERIOD_S", 0.1)
    monkeypatch.setattr(network, "OPEN_MS", 500)
    for slaves, masters, text in (
        (config, insecure(config), "it is secure, and this side is not (link.insecure)"),
        (insecure(config), config, "no answer in TLS"),
    ):
        with (
            Link(slaves, "test", Role.SLAVE) as slave,
            Link(masters, "test", Role.MASTER) as master,
        ):
            await_refusals(master.refusals, f"a connection to {config.slave}: {text}")
            assert not slave.is_present(Role.MASTER)
            assert not master.is_present(Role.SLAVE)


def test_a_token_of_a_secure_process_is_refused_by_an_insecure_one(config):
    """As through a plaintext router, which a secure process would not connect to."""
    config = insecure(config)
    with Link(config, "test", Role.SLAVE) as slave, Rogue([config.slave], "test", None) as rogue:
        rogue.announce_key(recorded(Role.MASTER, 5))
        await_refusals(slave.refusals, "a master with a certificate: this session is insecure")
        assert not slave.is_present(Role.MASTER)
