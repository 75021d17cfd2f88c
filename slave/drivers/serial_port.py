"""Serial ports that this process alone has."""

import errno
import fcntl
import os
import socket
import termios
from typing import Any

import serial

from slave.drivers.claim import claim_port
from slave.drivers.driver import DriverFault
from slave.drivers.ports import explain_busy, explain_denied


def open_serial(path: str, baud: int, **settings: Any) -> tuple[serial.Serial, socket.socket]:
    """Return a serial port that no other program can open or lock, and its claim.

    `DriverFault` if it is in use, does not exist, or has no such baud rate.
    """
    claim = claim_port(path)
    try:
        port = serial.Serial(path, baud, exclusive=True, **settings)
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    except (serial.SerialException, OSError, ValueError) as error:
        claim.close()
        raise DriverFault(f"{path}: cannot be opened: {format_port_error(error, path)}") from error
    return port, claim


def format_port_error(error: Exception, path: str) -> str:
    """Return what the system says of an error, without the path that pyserial repeats."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY):
        return explain_busy(path)
    if number in (errno.EACCES, errno.EPERM) and (reason := explain_denied(path)):
        return reason
    if os.path.isdir(path) or os.path.isfile(path):
        return "it is no serial port (`teleop rig scan` lists them)"
    return os.strerror(number) if number else str(error)
