"""Who is let in: certificates of one authority, and nothing in the clear."""

import socket
import ssl
import time

import pytest

from teleop.link import Link, LinkConfig, MessageCounts
from teleop.messages.messages import Command
from teleop.messages.topics import COMMAND, Role
from tests.teleop.keys.folder import make_keys
from tests.teleop.link.bench import pump, session


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Ours, and those of someone with an authority of his own."""
    folder = tmp_path_factory.mktemp("keys")
    return make_keys(folder / "ours"), make_keys(folder / "theirs")


def with_keys(keys, like, insecure=False):
    return LinkConfig(master=like.master, slave=like.slave, keys=keys, insecure=insecure)


def test_another_authority_the_local_one_and_plaintext_are_kept_out(folders, config):
    ours, theirs = folders
    with Link(with_keys(ours, config), "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        intruders = (with_keys(theirs, config), config, with_keys(None, config, insecure=True))
        for intruder in intruders:
            with Link(intruder, "test", Role.MASTER) as master:
                for _ in range(100):
                    master.publish(COMMAND, Command())
                    time.sleep(0.003)
                    assert not slave.is_present(Role.MASTER)
                    assert not master.is_present(Role.SLAVE)
        assert slave.take_latest(COMMAND).counts == MessageCounts()


def test_a_plaintext_session_is_possible_if_asked_for(config):
    with session(with_keys(None, config, insecure=True), Role.SLAVE, Role.MASTER) as (
        slave,
        master,
    ):
        pump(master, slave, 20)


def test_only_tls_1_3_is_spoken_which_has_no_renegotiation(folders, config):
    host, port = config.slave.split(":")
    newest, older = (ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT) for _ in range(2))
    older.maximum_version = ssl.TLSVersion.TLSv1_2
    for context in (newest, older):
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        context.load_cert_chain(folders[0] / "test.viewer.pem", folders[0] / "test.viewer.key")
    with Link(with_keys(folders[0], config), "test", Role.SLAVE):
        with (
            socket.create_connection((host, int(port)), 20.0) as plain,
            newest.wrap_socket(plain) as secured,
        ):
            assert secured.version() == "TLSv1.3"
        with (
            socket.create_connection((host, int(port)), 20.0) as plain,
            pytest.raises(ssl.SSLError, match="PROTOCOL_VERSION"),
        ):
            older.wrap_socket(plain)
