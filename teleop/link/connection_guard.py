"""Bound what the connections of a process can cost it, whoever opens them.

Zenoh serves all listening sockets of TLS with one loop each, which sleeps for 100 ms after every
connection whose handshake fails or times out (`TLS_ACCEPT_THROTTLE_TIME`, fixed when Zenoh is
built), and accepts without a limit in between. Whoever lets 12 connections fail a second, or 600
time out, so keeps everybody out, for as long as that and a minute longer. It keeps, too, whatever a
peer declares: subscribers, tokens and names of keys up to 64 KB, for as long as the connection
lasts. No setting of Zenoh bounds either, so a thread looks at our own sockets, on Linux:

- A source of connections that stay half open for `BLOCK_HALF_OPEN_AGE_S`, or of too many at once,
  is blocked by a filter of packets in the listening socket. A source is an address, or on this
  machine all users but ours and root: there the kernel tells whose a connecting socket is, and
  those of ours pass with their second SYN, after one second. Of IPv6, where one machine has as many
  addresses as it likes, it is the /64 as soon as `MISBEHAVING_ADDRESSES_MAX` addresses in it
  misbehave, unless we are in it ourselves: that is the local subnet. A block lasts `BLOCK_S`, or a
  second for each of its connections, and twice as long each time, up to `BLOCK_MAX_S`.
- The connections that it has half open are frozen, by a filter too, so that they do not fail all
  at once when it closes them: nobody would get in until the last of them.
- Of more than `HALF_OPEN_MAX` half-open connections of all sources together the oldest are shut
  down, so that descriptors are left; without any the guard goes on, by those that Zenoh has.
- Connections that are half open for `HALF_OPEN_S` are shut down, one at a time, so that the loop
  is awake in between.
- A connection that has received more than the role in its certificate ever sends is shut down
  (`find_allowance`), and so is the newest of more than `CONNECTIONS_PER_NAME_MAX` of one
  certificate's name. When Zenoh has forgotten it, the memory is given back to the system. A peer
  that was cut off connects again and declares everything at once, so new connections of a name that
  cannot stop a session are shut down for `NAME_BLOCK_S`.
"""

import atexit
import contextlib
import ctypes
import math
import os
import re
import resource
import select
import socket
import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import FileIO
from ipaddress import IPv6Address, ip_address, ip_network
from pathlib import Path
from time import monotonic, sleep, thread_time
from typing import NamedTuple

import zenoh

from teleop.link.packet_filter import Network, build_filter, filter_packets
from teleop.link.socket_tables import (
    Connection,
    SocketAddress,
    format_hex_address,
    list_open_sockets,
    open_socket_copy,
    open_tables,
    parse_endpoint,
    parse_socket_name,
    read_tables,
    shut_down_socket,
)
from teleop.security.identity import CertificateRole, Identity

SCAN_PERIOD_S = 0.1  # between two looks; longer if a look takes more than a tenth of it
# likewise, while each connection has a certificate and no source is blocked: a look costs a
# millisecond, and a listening socket tells when a new one comes
QUIET_SCAN_PERIOD_S = 1.0
# likewise, at the bytes alone; Zenoh reads a thousand declarations in it
BYTE_COUNT_PERIOD_S = 0.01
NEW_CONNECTION_DELAY_S = 0.005  # after a connection has come, until the next look
# age and number of half-open connections after which a source is blocked
BLOCK_HALF_OPEN_AGE_S, BLOCK_HALF_OPEN_COUNT = 1.0, 8
# addresses of a /64 that misbehave, after which it is blocked as one source
MISBEHAVING_ADDRESSES_MAX = 8
HALF_OPEN_MAX = 500  # connections of all sources; of more the oldest are shut down
HALF_OPEN_S = 2.0  # after which a half-open connection is shut down
HALF_OPEN_CLOSE_PERIOD_S = 0.2  # between two of them, of which Zenoh sleeps for half
BLOCK_S, BLOCK_MAX_S = 5.0, 600.0
BLOCK_RESET_S = 300.0  # after the end of a block, the next one is short again
# for which a socket of ours may connect past a block; its handshake takes less
PORT_EXEMPTION_S = 5.0
CONNECTIONS_PER_NAME_MAX = 32  # connections of one certificate's name
CLOSE_DELAY_S = 1.0  # in which Zenoh forgets a connection that was shut down
NAME_BLOCK_S = 5.0  # for which a name that sent too much, and cannot stop, gets no new connection

HANDSHAKE_TIMEOUT_MS = 600_000  # of Zenoh, which must not have many of them time out together


class Allowance(NamedTuple):
    """Bytes that a connection may bring at once, per second, and in all."""

    burst: float
    rate: float
    total: float = math.inf


# A listener sends 3.5 kB when it connects, then 0.4 kB/s of challenges. What Zenoh keeps of it is
# removed in 2 ms when it goes. Of a supervisor it keeps tokens, which take 10 us each: a bound in
# all, behind which it connects again. One that may stop a session needs 8 kB/s to watch, 20 kB/s
# for a call that nobody answers, and can interrupt the session anyway.
LISTENER_ALLOWANCE = Allowance(16e3, 4e3)
SETTER_ALLOWANCE = Allowance(16e3, 1e3, 32e3)
STOPPER_ALLOWANCE = Allowance(256e3, 16e3)


def find_allowance(identity: Identity) -> Allowance | None:
    """Return what a connection of a holder may bring; None: everything."""
    if identity.role is CertificateRole.SUPERVISOR:
        return STOPPER_ALLOWANCE if "stop" in identity.rights else SETTER_ALLOWANCE
    is_listener = identity.role in (CertificateRole.RECORDER, CertificateRole.VIEWER)
    return LISTENER_ALLOWANCE if is_listener else None


@lru_cache(maxsize=256)  # asked every `BYTE_COUNT_PERIOD_S`
def find_bounds(name: str) -> tuple[Identity, Allowance] | None:
    """Return the holder of a certificate of this name and its allowance; None if it has none."""
    try:
        identity = Identity.parse(name)
    except ValueError:
        return None
    allowance = find_allowance(identity)
    return None if allowance is None else (identity, allowance)


_TABLES = Path("/proc/net/tcp"), Path("/proc/net/tcp6")  # TCP sockets of this machine
_INTERFACES = Path("/proc/net/if_inet6")  # its addresses of IPv6
_LINUX = sys.platform == "linux"
_LOOPBACK = ip_network("127.0.0.0/8"), ip_network("::1/128")
_SYN_SENT = b"02"


@dataclass(slots=True)
class _Block:
    until_s: float
    seconds: float
    local: bool  # a source on this machine


class ConnectionGuard:
    """Watches the connections of a Zenoh session in a thread, for as long as it is open.

    It listens on the `HOST:PORT`s `listen`; a source with `burst` half-open connections is blocked,
    however new they are; `note` is told what was refused.
    """

    def __init__(
        self, session: zenoh.Session, listen: list[str], burst: int, note: Callable[[str], None]
    ) -> None:
        self._session, self._burst, self._note = session, burst, note
        # of certificates, by the ends
        self._names: dict[tuple[SocketAddress, SocketAddress | None], str] = {}
        self._sockets: dict[int, Connection | None] = {}  # by inode; None: not a connection
        self._blocks: dict[Network, _Block] = {}
        self._ports: dict[int, float] = {}  # of ours that connect past a block, and until when
        self._barred: dict[str, float] = {}  # names that get no new connection, and until when
        self._filter: tuple[dict[Network, bool], list[int]] = {}, []
        self._charged: list[tuple[Connection, str, int]] = []  # with a number by name
        self._has_new = False
        self._shut_s = self._trim_s = 0.0
        self._tables: list[FileIO] = []
        self._interfaces: list[FileIO] = []
        self._listening: dict[SocketAddress, Connection] = {}
        ports = {int(address.rpartition(":")[2]) for address in listen}
        for number, inode in list_open_sockets():
            with contextlib.suppress(OSError), open_socket_copy(number) as copy:
                if copy.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                    ends = parse_socket_name(copy.getsockname())
                    if ends[1] in ports:
                        # no copy is kept, which would keep the port after the session's end
                        self._listening[ends] = Connection(number, inode, ends, ("", 0), 0.0)
        hexadecimal = "|".join(map(format_hex_address, self._listening)).encode()
        self._row = re.compile(  # of /proc/net/tcp: ends, state, user and inode
            rb"(\w+:\w+) (%s) (\w\w) \S+ \S+ \S+ +(\d+) +\d+ (\d+)" % hexadecimal
        )
        direct = zenoh.handlers.Callback(self._on_link, indirect=False)
        self._links = session.info.declare_link_events_listener(direct, history=True)
        if _LINUX:
            self._tables = open_tables(_TABLES)
            self._interfaces = open_tables([_INTERFACES])
            self._thread = threading.Thread(target=self._run, name="connection guard", daemon=True)
            self._thread.start()
            # a thread that Python ends inside of Zenoh aborts the process
            atexit.register(self._join)

    def _on_link(self, event: zenoh.LinkEvent) -> None:
        """Keep whose a connection is."""
        local = parse_endpoint(event.link.src)
        if local is None:
            return
        # the other end of a connection that we opened may be named by its host
        ends = local, parse_endpoint(event.link.dst) if local in self._listening else None
        if event.kind == zenoh.SampleKind.DELETE:
            self._names.pop(ends, None)
            return
        name = self._names[ends] = event.link.auth_identifier or ""
        self._has_new = True
        is_barred = self._barred.get(name, 0.0) > monotonic()
        if local in self._listening and (self._blocks or is_barred):
            for number, _ in list_open_sockets():
                with contextlib.suppress(OSError), open_socket_copy(number) as copy:
                    if (
                        parse_socket_name(copy.getsockname()),
                        parse_socket_name(copy.getpeername()),
                    ) == ends:
                        if is_barred:
                            shut_down_socket(copy)
                        else:
                            filter_packets(copy, [])  # it has that of the listening socket

    def _run(self) -> None:
        arrivals = select.epoll()
        for listening in self._listening.values():
            with contextlib.suppress(OSError):  # closed already
                arrivals.register(listening.number, select.EPOLLIN | select.EPOLLET)
        while not _is_closed(self._session):
            begin_s = thread_time()  # not of other processes, on a busy machine
            is_quiet = self._look(monotonic())
            took_s = thread_time() - begin_s
            period_s = QUIET_SCAN_PERIOD_S if is_quiet else SCAN_PERIOD_S
            end_s = monotonic() + max(period_s, 10 * took_s)
            pause_s = SCAN_PERIOD_S if is_quiet and not self._charged else BYTE_COUNT_PERIOD_S
            while (left_s := end_s - monotonic()) > 0 and not self._has_new:
                if _is_closed(self._session):
                    break
                if arrivals.poll(min(left_s, pause_s)):
                    sleep(max(NEW_CONNECTION_DELAY_S, 3 * took_s))
                    break
                begin_s = thread_time()
                for charged in self._charged:
                    self._charge_connection(*charged, monotonic())
                pause_s = max(BYTE_COUNT_PERIOD_S, 10 * (thread_time() - begin_s))
        arrivals.close()
        for table in self._tables + self._interfaces:
            table.close()
        atexit.unregister(self._join)

    def _join(self) -> None:
        """Wait for the thread to see that the session is closed; not for one that is left open."""
        self._thread.join(2 * SCAN_PERIOD_S)

    def _look(self, now_s: float) -> bool:
        """Look at all connections once; return whether none is half open and none is blocked."""
        half_open, named = [], Counter[str]()
        self._has_new, self._charged = False, []
        for connection in self._list_connections(now_s):
            ends = connection.local, connection.remote
            name = self._names.get(ends, self._names.get((connection.local, None)))
            if name is not None:
                named[name] += 1
                if find_bounds(name) is not None:
                    self._charged.append((connection, name, named[name]))
                    self._charge_connection(connection, name, named[name], now_s)
            elif connection.local in self._listening:
                half_open.append(connection)
        is_stuck = any(now_s - c.since_s > BLOCK_HALF_OPEN_AGE_S for c in half_open)
        if is_stuck or len(half_open) >= self._burst or self._blocks:
            self._update_blocks(half_open, now_s)
        self._limit_half_open([c for c in half_open if not c.shut])
        old = [c for c in half_open if now_s - c.since_s > HALF_OPEN_S and not c.shut]
        if old and now_s - self._shut_s >= HALF_OPEN_CLOSE_PERIOD_S:
            self._shut_s = now_s
            old[0].shut_down()
        if 0.0 < self._trim_s < now_s:
            self._trim_s = 0.0
            _release_free_memory()
        return not (half_open or self._blocks or self._trim_s)

    def _limit_half_open(self, half_open: list[Connection]) -> None:
        """Shut down the oldest of too many half-open connections, from however many sources."""
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        limit = max(HALF_OPEN_MAX, self._burst)
        if soft != resource.RLIM_INFINITY:
            limit = min(limit, soft // 2)
        excess = half_open[: max(0, len(half_open) - limit)]
        if excess:
            self._note(f"more than {limit} connections without a certificate at a time")
        for connection in excess:
            connection.shut_down()

    def _list_connections(self, now_s: float) -> list[Connection]:
        """Return the connections of this process, oldest first."""
        known_sockets, self._sockets = self._sockets, {}
        for number, inode in list_open_sockets():
            connection = known_sockets.get(inode)
            if connection is not None:
                connection.number = number
            elif inode not in known_sockets:
                try:
                    with open_socket_copy(number) as copy:
                        ends = (
                            parse_socket_name(copy.getsockname()),
                            parse_socket_name(copy.getpeername()),
                        )
                        if copy.family in (socket.AF_INET, socket.AF_INET6):
                            connection = Connection(number, inode, *ends, now_s)
                except OSError:  # listens, or is not connected yet
                    continue
            self._sockets[inode] = connection
        return sorted((c for c in self._sockets.values() if c is not None), key=lambda c: c.since_s)

    def _charge_connection(
        self, connection: Connection, name: str, count: int, now_s: float
    ) -> None:
        """Charge a connection for what it has received since the last time."""
        bounds = find_bounds(name)
        if bounds is None or connection.shut:
            return
        identity, allowance = bounds
        received = connection.read_received()
        budget = allowance.burst if connection.left is None else connection.left
        budget = min(allowance.burst, budget + allowance.rate * (now_s - connection.charged_s))
        connection.left = budget - (received - connection.received)
        connection.received, connection.charged_s = received, now_s
        if connection.left < 0 or received > allowance.total:
            self._note(f"a connection of the certificate {name}: it sends too much")
            if connection.left < 0 and "stop" not in identity.rights:
                self._barred[name] = now_s + NAME_BLOCK_S
        elif count > CONNECTIONS_PER_NAME_MAX:
            self._note(
                f"a connection of the certificate {name}: it has {CONNECTIONS_PER_NAME_MAX} already"
            )
        else:
            return
        connection.shut_down()
        self._trim_s = now_s + CLOSE_DELAY_S

    def _update_blocks(self, half_open: list[Connection], now_s: float) -> None:
        """Block the sources of stuck or many connections, and end blocks."""
        rows = {
            (local, remote): (state, int(user), inode)
            for local, remote, state, user, inode in self._row.findall(read_tables(self._tables))
        }
        ours = 0, os.getuid()
        by_source: dict[Network, list[Connection]] = {}
        local_sources = set()
        for connection in (c for c in half_open if not c.frozen):
            ends = format_hex_address(connection.remote), format_hex_address(connection.local)
            _, user, inode = rows.get((ends[0].encode(), ends[1].encode()), (b"", -1, b""))
            if user in ours and inode != b"0":
                continue
            address = ip_network(connection.remote[0])  # all of this machine count as one
            source = next((n for n in _LOOPBACK if address[0] in n), address)
            by_source.setdefault(source, []).append(connection)
            if user != -1 or source in _LOOPBACK:
                local_sources.add(source)
        counts = {
            source: (
                len(connections),
                sum(now_s - c.since_s > BLOCK_HALF_OPEN_AGE_S for c in connections),
            )
            for source, connections in by_source.items()
        }
        active = {source for source, block in self._blocks.items() if now_s <= block.until_s}
        interfaces = read_tables(self._interfaces).decode()
        ours_too = _find_own_networks((host for host, _ in self._listening), interfaces)
        for source in _choose_blocks(counts, active, self._burst, ours_too):
            block = self._blocks.get(source)
            number = sum(n for s, (n, _) in counts.items() if source in (s, _to_network(s)))
            seconds = BLOCK_S if block is None else 2 * block.seconds
            seconds = min(max(seconds, number), BLOCK_MAX_S)
            self._blocks[source] = _Block(now_s + seconds, seconds, source in local_sources)
            self._note(f"connections without a certificate from {source}")
        self._blocks = {s: b for s, b in self._blocks.items() if now_s < b.until_s + BLOCK_RESET_S}
        blocked = {s: b.local for s, b in self._blocks.items() if now_s < b.until_s}
        if any(blocked.values()):
            for (local, _), (state, user, _) in rows.items():
                if state == _SYN_SENT and user in ours:
                    self._ports[int(local.rpartition(b":")[2], 16)] = now_s + PORT_EXEMPTION_S
        self._ports = {port: until_s for port, until_s in self._ports.items() if now_s < until_s}
        wanted = blocked, sorted(self._ports) if blocked else []
        if wanted != self._filter:
            self._filter = wanted
            for (host, _), listening in self._listening.items():
                program = build_filter(ip_address(host).version, *wanted)
                if refused := listening.filter_packets(program):
                    self._note(f"a filter for blocked sources, by the kernel: {refused}")
        for source, connections in by_source.items():
            if source in blocked or _to_network(source) in blocked:
                for connection in connections:
                    connection.freeze()


def _is_closed(session: zenoh.Session) -> bool:
    try:
        return session.is_closed()
    except RuntimeError:  # it is being closed: the object is borrowed until it is
        return True


def _to_network(source: Network) -> Network | None:
    """Return the /64 of an address of IPv6; None of anything that has none of its own."""
    if source.version == 4 or source.prefixlen != source.max_prefixlen:
        return None
    address = IPv6Address(int(source.network_address))
    if address.is_loopback or address.is_link_local or address.ipv4_mapped is not None:
        return None
    return source.supernet(new_prefix=64)


def _find_own_networks(listening: Iterable[str], interfaces: str) -> set[Network]:
    """Return the /64s of the addresses that we listen at, and of those in /proc/net/if_inet6."""
    addresses = {ip_address(host) for host in listening}
    addresses |= {ip_address(bytes.fromhex(row.split()[0])) for row in interfaces.splitlines()}
    networks = {_to_network(ip_network(address)) for address in addresses}
    return {network for network in networks if network is not None}


def _choose_blocks(
    half_open: Mapping[Network, tuple[int, int]],
    blocked: Collection[Network],
    burst: int,
    own_networks: Collection[Network],
) -> list[Network]:
    """Return the sources to block.

    An address is blocked for its own connections. Its /64 is blocked in its place if
    `MISBEHAVING_ADDRESSES_MAX` addresses there are, or if as many that are not have too many
    together; never one in `own_networks`.

    `half_open` has the number of half-open connections of each source, and how many of them are
    stuck; `burst` is the number after which a source is blocked; `own_networks` are the /64s that
    we are in.
    """
    offenders = {
        s
        for s, (number, stuck) in half_open.items()
        if stuck >= BLOCK_HALF_OPEN_COUNT or number >= burst
    }
    members = Counter(_to_network(source) for source in {*offenders, *blocked})
    other_networks: dict[Network | None, list[tuple[int, int]]] = {}
    for source, count in half_open.items():
        other_networks.setdefault(_to_network(source), []).extend(
            [count] * (source not in offenders)
        )
    wide = set()
    for network, counts in other_networks.items():
        if network is None or network in own_networks:
            continue
        is_burst = (
            len(counts) >= MISBEHAVING_ADDRESSES_MAX
            and sum(number for number, _ in counts) >= burst
        )
        is_stuck = sum(stuck > 0 for _, stuck in counts) >= MISBEHAVING_ADDRESSES_MAX
        if members[network] >= MISBEHAVING_ADDRESSES_MAX or is_burst or is_stuck:
            wide.add(network)
    chosen = [*wide, *(s for s in offenders if not {_to_network(s)} & {*wide, *blocked})]
    return [source for source in chosen if source not in blocked]


def _release_free_memory() -> None:
    """Return free memory to the system, if the C library can."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
