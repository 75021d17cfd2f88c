"""Virtual CAN interfaces of the kernel, and error frames on them, without the program `ip`."""

import fcntl
import socket
import struct

_NEW_LINK, _REQUEST, _ACK, _CREATE, _EXCLUSIVE = 16, 1, 4, 0x400, 0x200
_NAME, _LINK_INFO, _KIND = 3, 18, 1  # attributes
_SET_FLAGS, _UP = 0x8914, 1
_ERROR_FRAME, _BUS_OFF = 1 << 29, 0x40


def create(name: str) -> None:
    """Create a virtual CAN interface and set it up; `OSError`."""
    kind = _attribute(_LINK_INFO, _attribute(_KIND, b"vcan\0"))
    body = struct.pack("=BxHiII", 0, 0, 0, 0, 0) + _attribute(_NAME, name.encode() + b"\0") + kind
    flags = _REQUEST | _ACK | _CREATE | _EXCLUSIVE
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as link:
        link.send(struct.pack("=IHHII", 16 + len(body), _NEW_LINK, flags, 1, 0) + body)
        (error,) = struct.unpack_from("=i", link.recv(4096), 16)
    if error:
        raise OSError(-error, f"interface {name}")
    switch(name, up=True)


def switch(name: str, up: bool) -> None:
    """Set an interface up or down; `OSError`."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
        fcntl.ioctl(can, _SET_FLAGS, struct.pack("16sH14x", name.encode(), _UP if up else 0))


def send_bus_off(name: str) -> None:
    """Send the frame by which a controller says that it is off the bus."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
        can.bind((name,))
        can.send(struct.pack("=IB3x8x", _ERROR_FRAME | _BUS_OFF, 8))


def _attribute(number: int, value: bytes) -> bytes:
    padding = bytes(-len(value) % 4)
    return struct.pack("=HH", 4 + len(value), number) + value + padding
