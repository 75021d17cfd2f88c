"""HTTP on loopback that answers nobody but the user whose process serves it.

Every program of every user reaches a port on loopback, and so does every web page that a browser
here shows. So a request is answered only if

* the process at its other end belongs to this user or to root (Linux tells; elsewhere not checked),
* its path begins with a secret of 128 bits, which the printed address has,
* its `Host` is loopback by number or name, so no name that an attacker resolves to here,
* a page that asks (`Origin`, `Sec-Fetch-Site`) comes from this server, or is one that may,
* it only reads (GET).
"""

import hmac
import os
import secrets
import socket
import sys
import threading
import urllib.parse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

from teleop.errors import TeleopError
from teleop.link.socket_tables import format_hex_address

# --- ports of the view, on loopback

LOOPBACK = "127.0.0.1"
WEB_VIEW = "Web view: "  # of the line that a web view prints first; its address follows
HELD_PORT_VARIABLE = "TELEOP_VIEW_PORT"  # of a socket that listens, and the secret of its address
_BACKLOG = 64  # connections that are not accepted yet


def hold_port(first_choice: int) -> tuple[socket.socket, dict[str, str]]:
    """Return a socket that listens for a child, and what its environment tells it of that.

    So the page comes back at its address if the child is started again, and nobody else takes the
    port meanwhile, to whom the page in a browser would tell the secret.
    """
    held = socket.create_server((LOOPBACK, find_free_port(first_choice)), backlog=_BACKLOG)
    return held, {HELD_PORT_VARIABLE: f"{held.fileno()} {create_secret()}"}


def take_held_port() -> tuple[socket.socket, str] | None:
    """Return the socket that the process which started this one holds, and its secret."""
    number, _, secret = os.environ.get(HELD_PORT_VARIABLE, "").partition(" ")
    return (socket.socket(fileno=int(number)), secret) if secret else None


def create_secret() -> str:
    """Return a secret for an address: 128 bits."""
    return secrets.token_urlsafe(16)


def find_free_port(first_choice: int) -> int:
    """Return `first_choice` if nobody listens there on loopback, another free port otherwise."""
    port = _find_bindable_port(first_choice) or _find_bindable_port(0)
    if port is None:
        raise TeleopError(f"no free port on {LOOPBACK}")
    return port


def _find_bindable_port(port: int) -> int | None:
    """Return `port` (for 0 any) if it can be bound, else None."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return None
        return int(probe.getsockname()[1])


_NAMES = (LOOPBACK, "localhost")
_CONNECTIONS_MAX = 32  # connections at once; a browser opens six
_IDLE_S = 30  # [s] without a request, after which a connection is closed
_FOREIGN_SITES = ("cross-site", "same-site")  # a server on another port here is the same site
_TCP = Path("/proc/net/tcp")


class LocalServer:
    """Serves from its start until `close`.

    `port` is the preferred one, another if it is in use, or a socket that listens; "" makes a
    `secret`, with which the path of each request begins. `address` is `127.0.0.1:port/secret/`,
    after a scheme.
    """

    def __init__(
        self, handler: type["GuardedHandler"], port: int | socket.socket, secret: str = ""
    ) -> None:
        self._server = _Server(handler, port, secret or create_secret())
        self.address = f"{LOOPBACK}:{self._server.server_port}/{self._server.secret}/"
        self._thread = threading.Thread(
            target=self._server.serve_forever, name=handler.__name__, daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # do not wait for open connections of a browser
    request_queue_size = 64

    def __init__(
        self, handler: type["GuardedHandler"], port: int | socket.socket, secret: str
    ) -> None:
        self.secret = secret
        self._served = threading.BoundedSemaphore(_CONNECTIONS_MAX)
        if isinstance(port, int):
            super().__init__((LOOPBACK, find_free_port(port)), handler)
            return
        super().__init__(port.getsockname(), handler, bind_and_activate=False)
        self.socket.close()
        self.socket = port
        self.server_name, self.server_port = LOOPBACK, port.getsockname()[1]

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Return whether a connection is of this user, and there are not too many."""
        return is_own_connection(client_address, request.getsockname())

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own, or close it if there are too many."""
        if self._served.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._served.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that disconnected, which is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def is_own_connection(theirs: tuple[str, int], ours: tuple[str, int]) -> bool:
    """Return whether the other end of a connection on loopback is of this user or of root.

    Where the system does not tell, it is taken for one.
    """
    if not _TCP.exists():
        return True
    ends = [format_hex_address(end) for end in (theirs, ours)]
    for line in _TCP.read_text().splitlines()[1:]:
        fields = line.split()
        if fields[1:3] == ends:
            return int(fields[7]) in (os.geteuid(), 0)
    return False  # closed by now


class GuardedHandler(BaseHTTPRequestHandler):
    """Answers requests that the guard lets through: `answer` gets their path, after the secret."""

    server: _Server
    protocol_version = "HTTP/1.1"
    timeout: ClassVar[float | None] = _IDLE_S
    disable_nagle_algorithm = True
    origins: tuple[str, ...] = ()  # of other servers' pages that may ask
    server_version, sys_version = "teleop", ""

    def answer(self, path: str) -> None:
        """Answer a request, whose path without its query is `path`."""
        raise NotImplementedError

    def do_GET(self) -> None:
        """Answer a request that the guard lets through, refuse another."""
        secret, _, path = urllib.parse.urlsplit(self.path).path.removeprefix("/").partition("/")
        if not hmac.compare_digest(secret.encode(), self.server.secret.encode()):
            self.send_error(403, "the address lacks its secret: open the one that was printed")
        elif not self._is_from_here():
            self.send_error(403, "asked for by another page, or under another name")
        else:
            self.answer(path)

    def _is_from_here(self) -> bool:
        """Return whether `Host` is this machine, and a page that asks is one that may."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or hosts[0].rpartition(":")[0] not in _NAMES:
            return False
        origin = self.headers.get("Origin")
        if origin is not None:
            return origin in (f"http://{hosts[0]}", *self.origins)
        opened = self.headers.get("Sec-Fetch-Mode") == "navigate"
        opened = opened and self.headers.get("Sec-Fetch-Dest") == "document"
        return opened or self.headers.get("Sec-Fetch-Site") not in _FOREIGN_SITES

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class's name
        """Do not log to the terminal."""
