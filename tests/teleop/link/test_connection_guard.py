"""What strangers and holders of a certificate can cost a side by connections."""

import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from ipaddress import ip_network

import pytest
import zenoh

from teleop.link import Link, LinkConfig, connection_guard
from teleop.link.connection_guard import ConnectionGuard
from teleop.link.network import open_session
from teleop.messages.topics import Role
from teleop.security import CertificateRole, Identity
from teleop.security.local import create_local_credentials
from tests.rogue import Rogue
from tests.teleop.link.bench import session, wait_until
from tests.teleop.link.test_played_back import lines_of

STRANGER = """
import encodings.idna, os, socket, ssl, sys, threading, time
kind, host, port = sys.argv[1], sys.argv[2], int(sys.argv[3])
context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
os.setuid(12345)
def fail():
    try:
        with socket.create_connection((host, port), 3) as plain:
            plain.settimeout(20)
            context.wrap_socket(plain).recv(10)
    except OSError:
        pass
kept = []
if kind == "silent":
    kept = [socket.create_connection((host, port)) for _ in range(300)]
print("attacks", flush=True)
while True:
    if kind == "failing":
        threading.Thread(target=fail, daemon=True).start()
    time.sleep(0.02)
"""
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="becomes another user")


@contextmanager
def stranger(kind: str, endpoint: str) -> Iterator[None]:
    """Another user of this machine, without keys."""
    words = [sys.executable, "-c", STRANGER, kind, *endpoint.rsplit(":", 1)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield
        finally:
            process.kill()


def connects(endpoint: str, seconds: float) -> None:
    """Assert that a holder of a certificate is let in."""
    with open_session(
        create_local_credentials("test", CertificateRole.VIEWER), [], [endpoint]
    ) as viewer:
        wait_until(lambda: bool(viewer.info.peers_zid()), seconds)


@needs_root
@pytest.mark.parametrize("kind", ["silent", "failing"])
def test_a_stranger_keeps_nobody_out(
    kind: str, config: LinkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fifty failing connections a second, or 300 that say nothing."""
    monkeypatch.setattr(connection_guard, "BLOCK_S", 60.0)
    with Link(config, "test", Role.SLAVE) as slave:
        with stranger(kind, config.slave):
            wait_until(lines_of(slave, "without a certificate from 127.0.0.0/8"), 30.0)
            for _ in range(3):
                connects(config.slave, 20.0)
        connects(config.slave, 20.0)


def test_half_open_connections_are_ended(
    config: LinkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_guard, "HALF_OPEN_S", 0.2)
    host, port = config.slave.split(":")
    with Link(config, "test", Role.SLAVE), ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection((host, int(port)))) for _ in range(3)
        ]
        for connection in silent:
            connection.settimeout(30.0)
            assert connection.recv(1) == b""
        connects(config.slave, 20.0)


@pytest.mark.parametrize(("host", "network"), [("127.0.0.1", "127.0.0.0/8"), ("::1", "::1/128")])
def test_a_filter_drops_a_source_and_passes_ports_of_ours(host: str, network: str) -> None:
    version = ip_network(network).version
    family = socket.AF_INET if version == 4 else socket.AF_INET6
    with ExitStack() as stack:
        listening, ours, others = (
            stack.enter_context(socket.socket(family, socket.SOCK_STREAM)) for _ in range(3)
        )
        for one in (listening, ours, others):
            one.bind((host, 0))
            one.settimeout(0.3)
        listening.listen()
        allowed = [*range(1, 300), ours.getsockname()[1]]
        elsewhere = {ip_network("192.0.2.0/24"): False, ip_network("2001:db8::/64"): False}
        blocked = elsewhere | {ip_network(network): True}
        connection_guard._filter_packets(
            listening, connection_guard._build_filter(version, blocked, allowed)
        )
        with pytest.raises(TimeoutError):
            others.connect(listening.getsockname())
        ours.connect(listening.getsockname())
        listening.accept()[0].close()
        connection_guard._filter_packets(
            listening, connection_guard._build_filter(version, elsewhere, [])
        )
        with socket.create_connection(listening.getsockname()[:2], 5.0):
            listening.accept()[0].close()


def test_a_viewer_that_declares_too_much_is_cut_off(config: LinkConfig) -> None:
    with session(config, Role.SLAVE, Role.VIEWER) as (slave, viewer):
        tls = create_local_credentials("test", CertificateRole.VIEWER).for_tls()
        said = lines_of(slave, "a connection of the certificate viewer.test: it sends too much")
        with Rogue([config.slave], "test", tls) as rogue:
            wait_until(rogue.connected)
            number = iter(range(10**6))

            def is_cut_off() -> bool:
                rogue.announce_key(f"teleop/test/@/viewer/{next(number):08x}/{'x' * 30_000}")
                return said()

            wait_until(is_cut_off, 60.0)
        assert viewer.present(Role.SLAVE)


def test_who_cannot_stop_and_sends_too_much_gets_no_new_connection(
    config: LinkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peer that was cut off declares all again when it connects again."""
    monkeypatch.setattr(connection_guard, "NAME_BLOCK_S", 1000.0)
    with Link(config, "test", Role.SLAVE) as slave:
        said = lines_of(slave, "a connection of the certificate viewer.test: it sends too much")
        with open_session(
            create_local_credentials("test", CertificateRole.RECORDER), [], [config.slave]
        ) as other:
            with open_session(
                create_local_credentials("test", CertificateRole.VIEWER), [], [config.slave]
            ) as one:
                wait_until(lambda: bool(one.info.peers_zid()))
                names, kept = itertools.count(), []

                def is_cut_off() -> bool:
                    key = f"teleop/test/{next(names)}{'x' * 1000}"
                    kept.append(one.declare_subscriber(key, zenoh.handlers.RingChannel(1)))
                    return said()

                wait_until(is_cut_off, 30.0)
                time.sleep(1.0)  # ten times as long as it takes to connect again
                seen = []
                for _ in range(50):
                    seen.append(bool(one.info.peers_zid()))
                    time.sleep(0.01)
                assert not all(seen)  # it is let in for a moment, until its name is known
            assert other.info.peers_zid()


@pytest.mark.parametrize(
    ("rights", "office", "passes"),
    [
        (("stop",), CertificateRole.SUPERVISOR, True),
        (("reset", "set"), CertificateRole.SUPERVISOR, False),
        ((), CertificateRole.VIEWER, False),
    ],
)
def test_a_watch_may_go_on_for_good_and_who_cannot_stop_may_not(
    rights: tuple[str, ...], office: CertificateRole, passes: bool
) -> None:
    """An hour of what `teleop stop --watch` sends: 20 times a second 400 bytes."""

    class Connection(connection_guard._Connection):
        def read_received(self) -> int:
            return round(8000.0 * self.charged_s)

    guard = ConnectionGuard.__new__(ConnectionGuard)
    guard._note, guard._barred = print, {}
    connection = Connection(-1, 0, ("", 0), ("", 0), 0.0)
    for tick in range(36_000):
        guard._charge(connection, Identity(office, "test", rights).common_name, 1, 0.1 * tick)
    assert connection.shut is not passes
    assert bool(guard._barred) is not passes


def test_subscribers_are_let_in_of_topics_only(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        tls = create_local_credentials("test", CertificateRole.VIEWER).for_tls()
        of_topic, of_other = (
            slave._zenoh.declare_publisher(f"teleop/test/{name}") for name in ("state", "other")
        )
        with Rogue([config.slave], "test", tls) as rogue:
            for name in ("other", "**", "state"):
                rogue.listen(name)
            wait_until(lambda: of_topic.matching_status.matching, 20.0)
            assert not of_other.matching_status.matching


def test_one_certificate_has_a_bounded_number_of_connections(
    config: LinkConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_guard, "CONNECTIONS_PER_NAME_MAX", 2)
    with Link(config, "test", Role.SLAVE) as slave, ExitStack() as stack:
        credentials = create_local_credentials("test", CertificateRole.VIEWER)
        for _ in range(4):
            stack.enter_context(open_session(credentials, [], [config.slave]))
        wait_until(lines_of(slave, "a connection of the certificate viewer.test: it has 2"))
        connects_as = create_local_credentials("test", CertificateRole.RECORDER)
        with open_session(connects_as, [], [config.slave]) as recorder:
            wait_until(lambda: bool(recorder.info.peers_zid()), 20.0)
