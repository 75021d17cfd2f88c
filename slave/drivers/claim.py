"""Exclusive use of a bus: one process of this machine at a time, and which one it is.

A second program on a bus would take the torque off the motors of the first. The claim is a Unix
socket in the abstract namespace of Linux: the kernel releases it with its process, and tells the
process that holds it. That namespace is part of the network namespace, as CAN interfaces are.
"""

import contextlib
import os
import socket
import struct
import sys
from pathlib import Path

from slave.drivers import ports
from slave.drivers.driver import DriverFault
from teleop.runtime.process import format_process, read_command

_WORKER = "slave.drivers.worker"
_CREDENTIALS = struct.Struct("3i")  # process, user and group of SO_PEERCRED
_BACKLOG = 4096  # processes that may ask for the holder; later ones are not told who it is


def claim_bus(place: str, key: str) -> socket.socket:
    """Return the claim of a bus, held until it is closed.

    Messages call the bus `place`; `key` is the same in every process that uses it. `DriverFault` if
    another process has it; the message names the process.
    """
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    if not sys.platform.startswith("linux"):
        return claim
    try:
        claim.bind(f"\0teleop-bus {key}")
        claim.listen(_BACKLOG)
    except OSError as error:
        with claim:
            raise DriverFault(
                f"{place}: in use by {_find_holder(claim, key)}: end it first"
            ) from error
    return claim


def claim_port(path: str) -> socket.socket:
    """Return the claim of a serial port; `DriverFault` if it is in use or does not exist.

    Also by a program that has not locked it: both would read each other's answers.
    """
    try:
        device = os.stat(path).st_rdev
    except OSError as error:
        reason = f"{error.strerror}{ports.explain_missing(path)}"
        raise DriverFault(f"{path}: cannot be opened: {reason}") from error
    claim = claim_bus(path, f"serial {os.major(device)}:{os.minor(device)}")
    if users := ports.find_users(path):
        claim.close()
        raise DriverFault(f"{path}: {users}")
    return claim


def _find_holder(asking: socket.socket, key: str) -> str:
    """Return the process that holds a claim, in words."""
    try:
        asking.setblocking(False)
        asking.connect(f"\0teleop-bus {key}")
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    except OSError:
        return "another program"
    number = _CREDENTIALS.unpack(credentials)[0]
    if _WORKER in read_command(number):
        with contextlib.suppress(OSError):
            status = Path(f"/proc/{number}/stat").read_text()
            number = int(status.rpartition(")")[2].split()[1])  # of the program that started it
    return format_process(number)
