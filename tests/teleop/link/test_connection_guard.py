"""What strangers and holders of a certificate can cost a side by connections."""

import itertools
import os
import resource
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from ipaddress import ip_network
from pathlib import Path

import pytest
import zenoh

from teleop.link import Link, connection_guard, packet_filter, socket_tables
from teleop.link.connection_guard import ConnectionGuard
from teleop.messages.topics import Role
from teleop.security import CertificateRole, Identity
from teleop.security.credentials import create_local_credentials
from tests.rogue import Rogue
from tests.teleop.link.bench import await_refusals, no_descriptor_left, open_as, wait_until

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
def stranger(kind, endpoint):
    """Another user of this machine, without keys."""
    words = [sys.executable, "-c", STRANGER, kind, *endpoint.rsplit(":", 1)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield
        finally:
            process.kill()


def connects(config, role=CertificateRole.VIEWER):
    """Assert that a holder of a certificate is let in."""
    with open_as(role, config) as viewer:
        wait_until(lambda: bool(viewer.info.peers_zid()), 20.0)


@needs_root
@pytest.mark.parametrize("kind", ["failing", pytest.param("silent", marks=pytest.mark.slow)])
def test_a_stranger_keeps_nobody_out(kind, config, monkeypatch):
    """Fifty failing connections a second, or 300 that say nothing."""
    monkeypatch.setattr(connection_guard, "BLOCK_S", 60.0)
    with Link(config, "test", Role.SLAVE) as slave:
        with stranger(kind, config.slave):
            await_refusals(slave.refusals, "without a certificate from 127.0.0.0/8")
            connects(config)
        connects(config)


def test_half_open_connections_are_ended(config, monkeypatch):
    monkeypatch.setattr(connection_guard, "HALF_OPEN_S", 0.2)
    host, port = config.slave.split(":")
    with Link(config, "test", Role.SLAVE), ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection((host, int(port)))) for _ in range(3)
        ]
        for connection in silent:
            connection.settimeout(30.0)
            assert connection.recv(1) == b""
        connects(config)


@pytest.mark.parametrize(("host", "network"), [("127.0.0.1", "127.0.0.0/8"), ("::1", "::1/128")])
def test_a_filter_drops_a_source_and_passes_ports_of_ours(host, network):
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
        packet_filter.filter_packets(
            listening, packet_filter.build_filter(version, blocked, allowed)
        )
        with pytest.raises(TimeoutError):
            others.connect(listening.getsockname())
        ours.connect(listening.getsockname())
        listening.accept()[0].close()
        packet_filter.filter_packets(listening, packet_filter.build_filter(version, elsewhere, []))
        with socket.create_connection(listening.getsockname()[:2], 5.0):
            listening.accept()[0].close()


FEW, STUCK, BURST = (
    (1, 0),
    (connection_guard.BLOCK_HALF_OPEN_COUNT, connection_guard.BLOCK_HALF_OPEN_COUNT),
    (16, 0),
)


def addresses(network, count, counts):
    """Half-open connections of the first addresses of a network."""
    hosts = itertools.islice(ip_network(network).hosts(), count)
    return {ip_network(host): counts for host in hosts}


FOREIGN, OWN = "2001:db8:1::/64", "2001:db8:2::/64"
CHOICES = {
    "many addresses with few connections together": (addresses(FOREIGN, 15, FEW), []),
    "many connections of one address": (addresses(FOREIGN, 1, BURST), ["2001:db8:1::1/128"]),
    "one stuck address among others": (
        addresses(FOREIGN, 6, FEW) | addresses(FOREIGN, 1, STUCK),
        ["2001:db8:1::1/128"],
    ),
    "many bad addresses": (addresses(FOREIGN, 8, STUCK), [FOREIGN]),
    "many addresses, each stuck once": (addresses(FOREIGN, 8, (1, 1)), [FOREIGN]),
    "many addresses with a burst together": (addresses(FOREIGN, 8, (2, 0)), [FOREIGN]),
    "many bad addresses of our subnet": (addresses(OWN, 20, STUCK), addresses(OWN, 20, STUCK)),
    "many addresses of our subnet": (addresses(OWN, 100, (1, 1)), []),
    "many bad link-local addresses": (
        addresses("fe80::/64", 9, STUCK),
        addresses("fe80::/64", 9, STUCK),
    ),
    "many bad addresses of IPv4 at a socket of both": (
        addresses("::ffff:192.0.2.0/120", 9, STUCK),
        addresses("::ffff:192.0.2.0/120", 9, STUCK),
    ),
    "addresses of IPv4": (
        addresses("192.0.2.0/24", 20, FEW) | addresses("198.51.100.0/24", 9, BURST),
        addresses("198.51.100.0/24", 9, BURST),
    ),
}


@pytest.mark.parametrize(("half_open", "blocked"), CHOICES.values(), ids=CHOICES)
def test_a_network_is_blocked_only_for_many_of_its_addresses_and_never_our_own(half_open, blocked):
    chosen = connection_guard._choose_blocks(half_open, [], 16, {ip_network(OWN)})
    assert sorted(map(str, chosen)) == sorted(map(str, blocked))


def test_a_network_follows_its_addresses_that_are_blocked_one_after_another():
    blocked = [*addresses(FOREIGN, 7, FEW)]
    for last, chosen in ((FEW, []), (STUCK, [ip_network(FOREIGN)])):
        half_open = {ip_network("2001:db8:1::99"): last}
        assert connection_guard._choose_blocks(half_open, blocked, 16, set()) == chosen
    assert connection_guard._choose_blocks(half_open, [ip_network(FOREIGN)], 16, set()) == []


def test_our_networks_are_those_of_the_interfaces_and_of_what_is_listened_at():
    table = (
        "20010db8000200000000000000000005 02 40 00 80     eth0\n"
        "fe800000000000000000000000000005 02 40 20 80     eth0\n"
        "00000000000000000000000000000001 01 80 10 80       lo\n"
    )
    found = connection_guard._find_own_networks(["127.0.0.1", "2001:db8:3::7"], table)
    assert found == {ip_network(OWN), ip_network("2001:db8:3::/64")}


LARGEST = """
import pathlib, socket
from ipaddress import ip_network
from teleop.link.packet_filter import FILTER_BYTES, build_filter, filter_packets, measure_filter
allowed = pathlib.Path("/proc/sys/net/core/optmem_max")
if allowed.exists():  # of this network
    allowed.write_text("20480")
addresses = {
    4: [ip_network(f"198.18.{n // 256}.{n % 256}") for n in range(1000)],
    6: [ip_network(f"2001:db8:{n:x}:{n:x}:8000:{n:x}:ffff:{n:x}") for n in range(1000)],
}
for version, family in ((4, socket.AF_INET), (6, socket.AF_INET6)):
    blocks = [dict.fromkeys(addresses[version], False), dict.fromkeys(addresses[version], True)]
    with socket.socket(family) as listening:
        for blocked, ports in [(blocks[0], []), (blocks[1], range(40000, 41000))] * 3:
            program = build_filter(version, blocked, ports)
            assert FILTER_BYTES * 0.2 < measure_filter(program) <= FILTER_BYTES + 16
            filter_packets(listening, program)
        print(version, len(build_filter(version, blocks[0], [])))
"""


@needs_root
def test_the_largest_filter_fits_into_what_kernels_allow_beside_the_one_before_it():
    """In a network of its own, whose limit is the default before Linux 6.8."""
    words = ["unshare", "--net", sys.executable, "-c", LARGEST]
    run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")


def test_the_newest_sources_are_in_a_filter_that_is_full():
    blocked = dict.fromkeys((ip_network(f"198.18.{n}.1") for n in range(250)), False)
    program = b"".join(packet_filter.build_filter(4, blocked, []))
    assert b"".join(packet_filter._build_drop(ip_network("198.18.249.1"), [])) in program
    assert b"".join(packet_filter._build_drop(ip_network("198.18.0.1"), [])) not in program


def test_nothing_is_forgotten_when_no_descriptor_is_left():
    guard = ConnectionGuard.__new__(ConnectionGuard)
    guard._sockets = {}
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        ends = []
        for _ in range(2):
            ends.append(stack.enter_context(socket.create_connection(server.getsockname())))
            ends[-1].settimeout(10.0)
            stack.enter_context(server.accept()[0])
        before = {c.inode: c.since_s for c in guard._list_connections(1.0)}
        ends.append(stack.enter_context(socket.create_connection(server.getsockname())))
        stack.enter_context(server.accept()[0])
        with no_descriptor_left():
            after = guard._list_connections(2.0)
            assert {c.inode: c.since_s for c in after if c.inode in before} == before
            assert sum(c.since_s == 2.0 for c in after) == 2  # both ends of the new one
            for connection in after:
                if connection.remote == ends[0].getsockname():
                    connection.shut_down()
            assert ends[0].recv(1) == b""
        ends[1].send(b"still open")


def test_the_tables_of_the_machine_are_read_when_no_descriptor_is_left():
    tables = socket_tables.open_tables([Path("/proc/net/tcp"), Path("/no/such")])
    with socket.create_server(("127.0.0.1", 0)) as server, no_descriptor_left():
        row = socket_tables.format_hex_address(server.getsockname()).encode()
        assert row in socket_tables.read_tables(tables)
        assert row in socket_tables.read_tables(tables)
    for table in tables:
        table.close()


@pytest.mark.parametrize(("files", "limit"), [(10_000, 20), (24, 12)])
def test_half_open_connections_of_all_sources_are_bounded(files, limit, monkeypatch):
    """Each of them has fewer than are blocked."""

    class Connection(socket_tables.Connection):
        def shut_down(self):
            self.shut = True

    monkeypatch.setattr(connection_guard, "HALF_OPEN_MAX", 20)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (files, files))
    guard = ConnectionGuard.__new__(ConnectionGuard)
    noted = []
    guard._burst, guard._note = 16, noted.append
    guard._names, guard._blocks, guard._shut_s, guard._trim_s = {}, {}, 0.0, 0.0
    guard._listening = {("", 0): Connection(-1, 0, ("", 0), ("", 0), 0.0)}
    monkeypatch.setattr(guard, "_update_blocks", lambda *_: None)
    connections = [Connection(-1, n, ("", 0), (f"192.0.2.{n}", 1), 0.0) for n in range(30)]
    monkeypatch.setattr(guard, "_list_connections", lambda _: connections[:limit])
    guard._look(0.5)
    assert not noted
    monkeypatch.setattr(guard, "_list_connections", lambda _: connections)
    guard._look(0.5)
    assert [c.inode for c in connections if not c.shut] == list(range(30 - limit, 30))
    assert noted == [f"more than {limit} connections without a certificate at a time"]


def test_who_cannot_stop_and_sends_too_much_gets_no_new_connection(config, monkeypatch):
    """A peer that was cut off declares all again when it connects again."""
    monkeypatch.setattr(connection_guard, "NAME_BLOCK_S", 1000.0)
    with Link(config, "test", Role.SLAVE) as slave:
        refusal = "a connection of the certificate viewer.test: it sends too much"
        with open_as(CertificateRole.RECORDER, config) as other:
            with open_as(CertificateRole.VIEWER, config) as one:
                wait_until(lambda: bool(one.info.peers_zid()))
                names, kept = itertools.count(), []

                def is_cut_off():
                    key = f"teleop/test/{next(names)}{'x' * 1000}"
                    kept.append(one.declare_subscriber(key, zenoh.handlers.RingChannel(1)))
                    return any(refusal in line for line in slave.refusals.take())

                wait_until(is_cut_off, 30.0)
                time.sleep(1.0)  # ten times as long as it takes to connect again
                # it is let in for a moment, until its name is known
                wait_until(lambda: not one.info.peers_zid(), 1.0)
            assert other.info.peers_zid()


@pytest.mark.parametrize(
    ("rights", "role", "passes"),
    [
        (("stop",), CertificateRole.SUPERVISOR, True),
        (("reset", "set"), CertificateRole.SUPERVISOR, False),
        ((), CertificateRole.VIEWER, False),
    ],
)
def test_a_watch_may_go_on_for_good_and_who_cannot_stop_may_not(rights, role, passes):
    """An hour of what `teleop stop --watch` sends: 20 times a second 400 bytes."""

    class Connection(socket_tables.Connection):
        def read_received(self):
            return round(8000.0 * self.charged_s)

    guard = ConnectionGuard.__new__(ConnectionGuard)
    guard._note, guard._barred = print, {}
    connection = Connection(-1, 0, ("", 0), ("", 0), 0.0)
    for tick in range(36_000):
        guard._charge_connection(
            connection, Identity(role, "test", rights).common_name, 1, 0.1 * tick
        )
    assert connection.shut is not passes
    assert bool(guard._barred) is not passes


def test_subscribers_are_let_in_of_topics_only(config):
    with Link(config, "test", Role.SLAVE) as slave:
        tls = create_local_credentials("test", CertificateRole.VIEWER).build_tls_settings()
        of_topic, of_other = (
            slave._zenoh.declare_publisher(f"teleop/test/{name}") for name in ("state", "other")
        )
        with Rogue([config.slave], "test", tls) as rogue:
            for name in ("other", "**", "state"):
                rogue.listen(name)
            wait_until(lambda: of_topic.matching_status.matching, 20.0)
            assert not of_other.matching_status.matching


def test_one_certificate_has_a_bounded_number_of_connections(config, monkeypatch):
    monkeypatch.setattr(connection_guard, "CONNECTIONS_PER_NAME_MAX", 2)
    with Link(config, "test", Role.SLAVE) as slave, ExitStack() as stack:
        for _ in range(4):
            stack.enter_context(open_as(CertificateRole.VIEWER, config))
        await_refusals(slave.refusals, "a connection of the certificate viewer.test: it has 2")
        connects(config, CertificateRole.RECORDER)
