"""Ports of the view, on loopback."""

import os
import secrets
import socket

from teleop.errors import TeleopError

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
