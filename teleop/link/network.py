"""Zenoh sessions with explicit endpoints, credentials, no discovery and short timeouts."""

import contextlib
import json
import os
import re
import resource
import socket
import ssl
import struct
import sys
import threading
from collections.abc import Callable, Iterable
from typing import Any, Literal

import zenoh
from cryptography import x509

from teleop.errors import TeleopError, UsageError
from teleop.link.config import Address, LinkConfig
from teleop.link.connection_guard import HANDSHAKE_TIMEOUT_MS, ConnectionGuard
from teleop.link.socket_tables import (
    OPEN_FILES_FOLDER,
    list_open_sockets,
    open_socket_copy,
    parse_endpoint,
    parse_socket_name,
)
from teleop.security import CertificateError, CertificateRole, Credentials
from teleop.security import credentials as stored
from teleop.security.credentials import create_local_credentials

# --- close connections to processes that no longer read without waiting for them
# Zenoh closes a connection that has been silent for a lease within its one receiving thread, with
# SO_LINGER of ten seconds: if bytes are left to send, because the other process was stopped or its
# machine sleeps, the thread receives nothing from anyone for so long (eclipse-zenoh/zenoh issues
# 1101 and 2718). A viewer that was stopped so ended the session it watched. Without SO_LINGER the
# kernel sends what it can and closing takes no time.


_LINGER_OFF = struct.pack("ii", 0, 0)


def _handle_link_event(event: zenoh.LinkEvent) -> None:
    ours = parse_endpoint(event.link.src)  # the other end may be named by its host
    if event.kind != zenoh.SampleKind.PUT or ours is None or not OPEN_FILES_FOLDER.exists():
        return
    for number, _ in list_open_sockets():
        with contextlib.suppress(OSError), open_socket_copy(number) as connection:
            if parse_socket_name(connection.getsockname()) == ours:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER_OFF)


RETRY_MS = 100  # between attempts to connect to a peer
QUEUE = 16  # messages of one priority waiting to be sent to one peer
BATCH_BYTES = 2048  # of one write; holds any message, each of which is sent alone
MESSAGE_BYTES = 65536  # that are received in fragments; a longer message is none of ours
OPEN_MS = 3000  # of the handshake, and of closing with an unresponsive target
CONNECTIONS = 10_000  # of a router; its processor is the limit before (docs/how-to/network.md)
BURST = 16  # that shake hands at a time with one address of a side
OPEN_FILES = 64  # a session runs with as many; with 24 the threads of Zenoh panic
# Of a process that listens: strangers take one for each connection. No more, since all are looked
# through when none is left to list them with
OPEN_FILES_LISTENING = 65536
LEASE_MS = 2000  # timeout of a silent peer; a closed connection is detected at once
# Zenoh's threads of this process. With its default of two receiving threads, each message wakes
# both: 30 us more of a round trip, 11 % more of a core in the recorder. The network's thread would
# be woken first by each message over a connection that this process has opened: 1 % of a core.
# Accepting keeps a thread of its own, so that handshakes of strangers hold up nothing.
THREADS = "(rx: (worker_threads: 1), net: (handover: rx))"

Mode = Literal["peer", "client", "router"]


def open_session(
    credentials: Credentials | None,
    listen: list[str],
    connect: list[str],
    access: dict[str, Any] | None = None,
    mode: Mode = "peer",
    note: Callable[[str], None] = lambda _: None,
) -> zenoh.Session:
    """Open a Zenoh session on `HOST:PORT`s; `UsageError` if one cannot be listened on.

    Without `credentials` everything is plaintext; with `access`, Zenoh's access control, it refuses
    what the certificate at the other end must not send.

    An unreachable target is not an error: it is retried every `RETRY_MS`. A client needs one of its
    targets at the start; later it connects to the next one when it loses one.

    Raises `TeleopError` if no target of a client answers.
    """
    _require_open_files(OPEN_FILES_LISTENING if listen else OPEN_FILES)
    if mode != "router":  # that one serves many connections at once
        os.environ.setdefault("ZENOH_RUNTIME", THREADS)  # read when the first session opens
    flat = build_settings(credentials, listen, connect, access, mode)
    if sys.platform == "linux" and credentials is not None:
        flat["listen/endpoints"] = [
            f"{endpoint}#tls_handshake_timeout_ms={HANDSHAKE_TIMEOUT_MS}"
            for endpoint in flat["listen/endpoints"]
        ]
    try:
        session = zenoh.open(to_zenoh_config(flat))
    except zenoh.ZError as error:
        if mode == "client":
            routers = ", ".join(connect)
            raise TeleopError(
                f"no router answers at {routers}; start one there: teleop router --help"
            ) from error
        problem = f"cannot listen on {', '.join(listen)}" if listen else "cannot open the link"
        raise UsageError(f"{problem}: {_explain_zenoh_error(str(error))}") from error
    direct = zenoh.handlers.Callback(_handle_link_event, indirect=False)  # SO_LINGER off
    session.info.declare_link_events_listener(direct, history=True)
    ConnectionGuard(session, listen, CONNECTIONS if mode == "router" else BURST, note)
    return session


def _require_open_files(required: int) -> None:
    """Let this process open `required` files, or as many as it may.

    `UsageError` if they are fewer than `OPEN_FILES`: Zenoh would hang for ever.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = resource.RLIM_INFINITY
    if hard != unlimited and hard < OPEN_FILES:
        raise UsageError(
            f"this process may open {hard} files only; allow it {OPEN_FILES}: "
            f"ulimit -n {OPEN_FILES}"
        )
    if hard != unlimited:
        required = min(required, hard)
    if soft != unlimited and soft < required:
        resource.setrlimit(resource.RLIMIT_NOFILE, (required, hard))


def to_zenoh_config(settings: dict[str, Any]) -> zenoh.Config:
    """Return Zenoh's form of settings by their path, such as `connect/endpoints`."""
    zenoh_config = zenoh.Config()
    for key, value in settings.items():
        zenoh_config.insert_json5(key, json.dumps(value))
    return zenoh_config


def build_settings(
    credentials: Credentials | None,
    listen: list[str],
    connect: list[str],
    access: dict[str, Any] | None,
    mode: Mode,
) -> dict[str, Any]:
    """Return the settings of a Zenoh session by their path."""
    client = mode == "client"
    protocol = "tcp" if credentials is None else "tls"
    settings: dict[str, Any] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "open/return_conditions/connect_scouted": False,
        "listen/endpoints": [f"{protocol}/{address}" for address in listen],
        "listen/exit_on_failure": True,
        "connect/endpoints": [f"{protocol}/{address}" for address in connect],
        "connect/timeout_ms": 0 if client else -1,  # 0: each target once
        "connect/exit_on_failure": client,
        "connect/retry": {
            "period_init_ms": RETRY_MS,
            "period_max_ms": RETRY_MS,
            "period_increase_factor": 1,
        },
        "transport/unicast/open_timeout": OPEN_MS,
        "transport/unicast/accept_timeout": OPEN_MS,
        "transport/shared_memory/enabled": False,
        "transport/link/protocols": [protocol],
        "transport/link/tx/lease": LEASE_MS,
        # A full queue drops at once: waiting for space, 1 ms by default, would be a missed tick. Of
        # the default two places, a hiccup of the sending thread made 2 % of messages drop; of
        # sixteen, none.
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        # Each sample keeps the receive buffer that it lies in, which is as long as a batch may be,
        # and 256 samples wait before each callback when a process is held up. With Zenoh's 64 KB a
        # recorder that was stopped for one second grew by up to 50 MB.
        "transport/link/rx/max_message_size": MESSAGE_BYTES,
        "transport/link/tx/batch_size": BATCH_BYTES,
        "transport/link/tx/queue/size/real_time": QUEUE,
        "transport/link/tx/queue/size/interactive_high": QUEUE,
        "timestamping/enabled": False,  # by routers; a message has the stamp of its sender
    }
    if mode == "router":
        # Zenoh's 1000 connections would be 250 sessions of four processes; a hundred at a time that
        # shake hands is too few when a router comes back to all of them
        settings["transport/unicast/max_sessions"] = CONNECTIONS
        settings["transport/unicast/accept_pending"] = CONNECTIONS
    if credentials is not None:
        settings["transport/link/tls"] = {
            "enable_mtls": True,
            # a certificate names a role, which the other side checks, and no host
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
            **credentials.build_tls_settings(),
        }
        if access is not None:
            settings["access_control"] = access
    return settings


def declare_publisher(
    session: zenoh.Session, key: str, live: bool, patient: bool, to_remote: bool = False
) -> zenoh.Publisher:
    """Declare a publisher of a live topic (old values are dropped) or of a reliable one.

    Neither waits for space unless `patient`: reliable topics are retransmitted, but a control loop
    must not wait for a stalled recorder. Messages `to_remote` are not delivered to subscribers of
    the same Zenoh session.
    """
    drop, block = zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK
    return session.declare_publisher(
        key,
        encoding=zenoh.Encoding.APPLICATION_CDR,
        congestion_control=block if patient else drop,
        priority=zenoh.Priority.REAL_TIME if live else zenoh.Priority.INTERACTIVE_HIGH,
        reliability=zenoh.Reliability.BEST_EFFORT if live else zenoh.Reliability.RELIABLE,
        express=True,
        allowed_destination=zenoh.Locality.REMOTE if to_remote else zenoh.Locality.ANY,
    )


def _explain_zenoh_error(text: str) -> str:
    """Return the reason in a Zenoh error, with a remedy if known."""
    if "Address already in use" in text:
        return "another process uses this port; stop it, or set another port in link of the config"
    if "Cannot assign requested address" in text:
        return "not an address of this machine; set another one in link of the config"
    return re.sub(r"\s*at /\S+?:\d+\.", "", text).strip()


# --- the credentials that the config of a link asks for


def load_credentials(config: LinkConfig, session: str, role: CertificateRole) -> Credentials | None:
    """Return the credentials of a role in a session; None if the config asks for plaintext.

    Raises `UsageError` if there are none, or they are not valid.
    """
    if config.insecure:
        return None
    if config.keys is not None:
        return stored.load(config.keys, session, role)
    return create_local_credentials(session, role)


# --- why an endpoint that answers does not become a connection
# Zenoh keeps to itself why a handshake of TLS failed, so without this a side with keys of another
# authority, or in plaintext beside a secure one, would wait for ever without a word.


PROBE_PERIOD_S = 5.0
PROBE_TIMEOUT_S = 1.0  # for a connection, and for an answer


class ConnectionProbe:
    """Looks, in a thread of its own, at endpoints that are not connected; as a context manager.

    `endpoints` are the `HOST:PORT`s that Zenoh connects to; without `credentials` the session is
    insecure; `connected` returns the far ends of the connections, `PROTOCOL/HOST:PORT`; `note` is
    told what is wrong with an endpoint, when that changes.
    """

    def __init__(
        self,
        endpoints: Iterable[str],
        credentials: Credentials | None,
        session: str,
        connected: Callable[[], Iterable[str]],
        note: Callable[[str], None],
    ) -> None:
        self._found = dict.fromkeys(endpoints, "")
        self._credentials, self._session = credentials, session
        self._connected, self._note = connected, note
        self._end = threading.Event()

    def __enter__(self) -> "ConnectionProbe":
        if self._found:
            threading.Thread(target=self._run, name="connection probe", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()

    def _run(self) -> None:
        while not self._end.wait(PROBE_PERIOD_S):
            try:
                connected = {end.rpartition("/")[2] for end in self._connected()}
            except zenoh.ZError:  # closed
                return
            for endpoint in self._found.keys() - connected:
                fault = find_connection_fault(endpoint, self._credentials, self._session)
                if fault and fault != self._found[endpoint] and not self._end.is_set():
                    self._note(f"a connection to {endpoint}: {fault}")
                self._found[endpoint] = fault


def find_connection_fault(endpoint: str, credentials: Credentials | None, session: str) -> str:
    """Return why whoever listens at `endpoint` is not connected to; empty if unknown or nobody."""
    try:
        certificate = fetch_certificate(endpoint)
    except ValueError:
        return "its certificate cannot be read"
    except OSError:
        return ""
    if credentials is None:
        return "" if certificate is None else "it is secure, and this side is not (link.insecure)"
    if certificate is None:
        return "no answer in TLS: another program, a hanging one, or a side with link.insecure"
    try:
        identity = credentials.identify(certificate)
    except CertificateError as error:
        return str(error)
    return "" if identity.may_join(session) else f"its certificate is {identity.common_name}"


def fetch_certificate(endpoint: str) -> x509.Certificate | None:
    """Return the certificate of whoever listens at `HOST:PORT`; None if it speaks no TLS.

    Raises `OSError` if nobody listens, or answers; `ValueError` if the certificate cannot be read.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # it is only looked at; nothing is sent
    address = Address.parse(endpoint)
    with socket.create_connection(address, PROBE_TIMEOUT_S) as connection:
        try:
            with context.wrap_socket(connection) as secured:
                der = secured.getpeercert(binary_form=True)
        except (ssl.SSLError, ConnectionError, TimeoutError):
            return None
    return x509.load_der_x509_certificate(der) if der else None
