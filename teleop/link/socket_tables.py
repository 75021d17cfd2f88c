"""The TCP sockets of this process, and the tables that the kernel has of all."""

import contextlib
import errno
import os
import re
import socket
import stat
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import FileIO
from ipaddress import ip_address
from pathlib import Path

from teleop.link.packet_filter import DROP_ALL, filter_packets

SocketAddress = tuple[str, int]  # host and port
OPEN_FILES_FOLDER = Path("/dev/fd")  # of this process; absent on Windows
DISCARD_READS_MAX = 100  # reads of what a connection that is shut down has sent
_ENDPOINT = re.compile(r"\w+/\[?(?P<host>[^\]%]+?)(?:%\w+)?\]?:(?P<port>\d+)")
_BYTES_RECEIVED = 128  # place of tcpi_bytes_received in TCP_INFO


@dataclass(slots=True, eq=False)
class Connection:
    """A TCP socket of this process."""

    number: int  # file descriptor
    inode: int
    local: SocketAddress
    remote: SocketAddress
    since_s: float
    received: int = 0  # [B]
    left: float | None = None  # of its allowance [B]
    charged_s: float = 0.0
    frozen: bool = False
    shut: bool = False

    def shut_down(self) -> None:
        """End the connection."""
        self.shut = True
        self._apply(shut_down_socket)

    def freeze(self) -> None:
        """Receive nothing more, not even the end of the connection."""
        self.frozen = True
        self.filter_packets(DROP_ALL)

    def read_received(self) -> int:
        """Return how many bytes it has received; what was known last if it was closed."""
        received = [self.received]

        def read(copy: socket.socket) -> None:
            state = copy.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _BYTES_RECEIVED + 8)
            received[0] = int.from_bytes(state[_BYTES_RECEIVED:], sys.byteorder)

        self._apply(read)
        return received[0]

    def filter_packets(self, program: list[bytes]) -> str:
        """Let the kernel drop packets to the socket; all pass if `program` is empty.

        Returns why the kernel takes no filter; empty if it does, or if the socket is closed.
        """
        refused = [""]

        def change(copy: socket.socket) -> None:
            try:
                filter_packets(copy, program)
            except OSError as error:
                refused.append(str(error) if program else "")  # there was none to be removed

        self._apply(change)
        return refused[-1]

    def _apply(self, change: Callable[[socket.socket], None]) -> None:
        """Change the socket, unless its file descriptor was closed, or reused."""
        with contextlib.suppress(OSError), open_socket_copy(self.number) as copy:
            if os.fstat(copy.fileno()).st_ino == self.inode:
                change(copy)


def list_open_sockets() -> Iterator[tuple[int, int]]:
    """Yield file descriptor and inode of each socket of this process."""
    for number in list_open_files():
        with contextlib.suppress(OSError):  # closed since it was listed
            status = os.fstat(number)
            if stat.S_ISSOCK(status.st_mode):
                yield number, status.st_ino


def list_open_files() -> Iterable[int]:
    """Return the numbers of the open files of this process, and perhaps further ones."""
    try:
        return map(int, os.listdir(OPEN_FILES_FOLDER))
    except OSError:  # no descriptor is left to list them with: all below the limit are open
        return range(os.sysconf("SC_OPEN_MAX"))


@contextlib.contextmanager
def open_socket_copy(number: int) -> Iterator[socket.socket]:
    """Give a socket of this process under a descriptor of its own, if there is one left.

    Nobody else closes that one meanwhile, after which the number could mean another file.
    """
    try:
        number, is_copy = os.dup(number), True
    except OSError as error:
        if error.errno != errno.EMFILE:
            raise
        is_copy = False
    copy = socket.socket(fileno=number)
    try:
        yield copy
    finally:
        if is_copy:
            copy.close()
        else:
            copy.detach()


def parse_endpoint(endpoint: str) -> SocketAddress | None:
    """Return host and port of Zenoh's `tls/HOST:PORT`; None if it has none."""
    match = _ENDPOINT.fullmatch(endpoint)
    return None if match is None else (match["host"], int(match["port"]))


def parse_socket_name(name: tuple[str, int] | str | bytes) -> SocketAddress:
    """Return host and port of a name of a socket; of no host if it is none of IP."""
    if not isinstance(name, tuple) or not isinstance(name[0], str):
        return "", 0
    return name[0].partition("%")[0], name[1]


def shut_down_socket(connected: socket.socket) -> None:
    """End a connection, with what was received and not read, of which Zenoh would do all."""
    connected.shutdown(socket.SHUT_RDWR)
    for _ in range(DISCARD_READS_MAX):
        if not connected.recv(65536, socket.MSG_DONTWAIT):
            break


def open_tables(paths: Iterable[Path]) -> list[FileIO]:
    """Open tables of the kernel, to read them when no descriptor is left; without those missing."""
    tables = []
    for path in paths:
        with contextlib.suppress(OSError):
            tables.append(path.open("rb", buffering=0))
    return tables


def read_tables(tables: Iterable[FileIO]) -> bytes:
    """Return the present contents of open tables; what cannot be read is left out."""
    contents = b""
    for table in tables:
        with contextlib.suppress(OSError):
            table.seek(0)
            contents += table.read()
    return contents


def format_hex_address(ends: SocketAddress) -> str:
    """Return an address as in /proc/net/tcp."""
    packed = ip_address(ends[0]).packed
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{word:08X}" for word in words) + f":{ends[1]:04X}"
