"""Closing a connection never waits, not even if a process had no file descriptor left."""

import socket
import struct
from types import SimpleNamespace

import zenoh

from teleop.link import network
from tests.teleop.link.bench import no_descriptor_left

ON = struct.pack("ii", 1, 10)


def lingers(connection):
    return struct.unpack("ii", connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0] > 0


def test_a_connection_does_not_linger_though_no_descriptor_is_left():
    with socket.create_server(("127.0.0.1", 0)) as server:
        end = socket.create_connection(server.getsockname())
        other = socket.create_connection(server.getsockname())
        for one in (end, other):
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ON)
        host, port = end.getsockname()
        link = SimpleNamespace(src=f"tls/{host}:{port}")
        event = SimpleNamespace(link=link, kind=zenoh.SampleKind.PUT)
        with no_descriptor_left():
            network._handle_link_event(event)
        assert (lingers(end), lingers(other)) == (False, True)
        end.send(b"still open")
        end.close()
        other.close()
