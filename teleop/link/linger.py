"""Close connections to processes that no longer read without waiting for them.

Zenoh closes a connection that has been silent for a lease within its one receiving thread, with
SO_LINGER of ten seconds: if bytes are left to send, because the other process was stopped or its
machine sleeps, the thread receives nothing from anyone for so long (eclipse-zenoh/zenoh issues 1101
and 2718). A viewer that was stopped so ended the session it watched. Without SO_LINGER the kernel
sends what it can and closing takes no time.
"""

import os
import re
import socket
import stat
import struct
from collections.abc import Iterable
from pathlib import Path

import zenoh

_OPEN_FILES = Path("/dev/fd")  # of this process; absent on Windows
_LINGER_OFF = struct.pack("ii", 0, 0)
_ENDPOINT = re.compile(r"\w+/\[?(?P<host>[^\]]+?)\]?:(?P<port>\d+)")


def disable_linger(session: zenoh.Session) -> None:
    """Turn SO_LINGER off for the connections that a session has and will have."""
    direct = zenoh.handlers.Callback(_handle_link_event, indirect=False)
    session.info.declare_link_events_listener(direct, history=True)


def _handle_link_event(event: zenoh.LinkEvent) -> None:
    ours = _parse_endpoint(event.link.src)  # the other end may be named by its host
    if event.kind != zenoh.SampleKind.PUT or ours is None or not _OPEN_FILES.exists():
        return
    for number in _list_open_files():
        try:
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue
            connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM, fileno=number)
        except OSError:  # closed since it was listed
            continue
        try:
            if connection.getsockname()[:2] == ours:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER_OFF)
        except OSError:
            continue
        finally:
            connection.detach()  # it is Zenoh's


def _list_open_files() -> Iterable[int]:
    """Return the numbers of the open files of this process, and perhaps further ones."""
    try:
        return map(int, os.listdir(_OPEN_FILES))
    except OSError:  # no descriptor is left to list them with: all below the limit are open
        return range(os.sysconf("SC_OPEN_MAX"))


def _parse_endpoint(endpoint: str) -> tuple[str, int] | None:
    """Return host and port of Zenoh's `tls/HOST:PORT`; None if it has none."""
    match = _ENDPOINT.fullmatch(endpoint)
    return None if match is None else (match["host"], int(match["port"]))
