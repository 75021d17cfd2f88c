"""Packets between the slave and the process of a driver: one kind byte and its values.

Both ends hold a socket of one pair (`SOCK_SEQPACKET`): packets stay whole and in order, and the
end of either process is the end of the file at the other.
"""

import json
import socket
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slave.drivers.driver import BusReading, Counts

READY, READING, FAULT, COUNTS = b"R", b"S", b"F", b"C"  # from the driver
TARGET, STOP, PAUSE = b"T", b"E", b"P"  # to the driver
PACKET_SIZE_MAX = 4096  # [B] of a packet

Values = NDArray[np.float64]


class Orders(NamedTuple):
    """What the slave has sent since the last look."""

    target: Counts | None  # the newest
    stop: bool  # an emergency stop
    pause: bool  # a long pause was announced, after which nothing came
    ended: bool  # the slave is gone


def create_socket_pair() -> tuple[socket.socket, socket.socket]:
    """Return the sockets of the slave and of the driver, neither of which ever waits."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    return ends


def pack_reading(reading: BusReading) -> bytes:
    """Return a reading as a packet."""
    head = np.array([reading.time_s, reading.follows, len(reading.position)])
    return READING + np.concatenate([head, reading.position, reading.cell]).tobytes()


def unpack_reading(packet: bytes) -> BusReading:
    """Return the reading in a packet."""
    values: Values = np.frombuffer(packet, np.float64, offset=1)
    first = 3 + int(values[2])
    return BusReading(float(values[0]), values[3:first], values[first:], bool(values[1]))


def pack_target(target: Counts) -> bytes:
    """Return targets as a packet."""
    return TARGET + np.asarray(target, np.float64).tobytes()


def pack_counts(counts: dict[str, int | float | str]) -> bytes:
    """Return counts as a packet."""
    return COUNTS + json.dumps(counts).encode()


def pack_fault(text: str) -> bytes:
    """Return a fault as a packet."""
    return FAULT + text.encode()[: PACKET_SIZE_MAX - 1]


def receive_packet(end: socket.socket) -> bytes | None:
    """Return the next packet, empty if the other end is gone; None if there is none yet."""
    for _ in range(2):
        try:
            return end.recv(PACKET_SIZE_MAX)
        except BlockingIOError:
            return None
        except ConnectionError:  # told once; what the other end has sent before is still there
            continue
    return b""


def receive_orders(end: socket.socket) -> Orders:
    """Return what the slave has sent since the last look."""
    target: Counts | None = None
    stop = pause = False
    while (packet := receive_packet(end)) is not None:
        if not packet:
            return Orders(None, stop, False, True)
        pause = packet[:1] == PAUSE
        if packet[:1] == TARGET:
            target = np.frombuffer(packet, np.float64, offset=1)
        elif packet[:1] == STOP:
            stop = True
    return Orders(target, stop, pause, False)
