"""Ports of the view, on loopback."""

import socket
import time

from teleop.errors import TeleopError

LOOPBACK = "127.0.0.1"
WEB_VIEW = "Web view: "  # of the line that a web view prints first; its address follows
_POLL_S = 0.02


def free_port(first_choice: int, patience_s: float = 0.0) -> int:
    """Return `first_choice` if nobody listens there on loopback, another free port otherwise.

    `patience_s` [s] is how long to wait for the first choice, which a process that was just killed
    may still hold.
    """
    end = time.monotonic() + patience_s
    while (port := _bindable(first_choice)) is None and time.monotonic() < end:
        time.sleep(_POLL_S)
    port = port or _bindable(0)
    if port is None:
        raise TeleopError(f"no free port on {LOOPBACK}")
    return port


def _bindable(port: int) -> int | None:
    """Return `port` (for 0 any) if it can be bound, else None."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return None
        return int(probe.getsockname()[1])
