"""The CAN bus of CiA 402 drives: opened by one process of this machine, and one controller."""

import errno
import fcntl
import logging
import socket
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import can
import canopen

from slave.drivers.cia402.config import BusConfig, Cia402Config
from slave.drivers.cia402.monitor import (
    BUS_OFF_TEXT,
    HEARTBEAT,
    BusMonitor,
    find_interface_fault,
    read_interface,
)
from slave.drivers.claim import claim_bus, claim_port
from slave.drivers.driver import DriverFault
from slave.drivers.ports import explain_busy, explain_denied, explain_missing_can

# --- the serial port of an slcan adapter, read in whole chunks

_ASCII = bytes(range(128)) + b"?" * 128  # python-can keeps a line for ever that it cannot decode
_REFUSAL = b"\a"  # an slcan adapter's answer to what it could not do


class BufferedPort:
    """A `serial.Serial` whose small reads are served from memory.

    python-can reads an slcan adapter byte by byte, which costs two system calls a byte: more than
    all else that a frame takes. Everything but reading is passed on to the open `port`.
    """

    def __init__(self, port: Any) -> None:
        self._port = port
        self._data, self._at = b"", 0
        self.refusals = 0  # frames that the adapter could not send

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        return (len(self._data) - self._at) or int(self._port.in_waiting)

    @property
    def write_timeout(self) -> float | None:
        """Time [s] that a write may take."""
        timeout: float | None = self._port.write_timeout
        return timeout

    @write_timeout.setter
    def write_timeout(self, timeout: float | None) -> None:
        self._port.write_timeout = timeout

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes; waits for the port's `timeout` if there are none."""
        if self._at >= len(self._data):
            self._data, self._at = self._port.read(max(size, self._port.in_waiting)), 0
            self.refusals += self._data.count(_REFUSAL)
            self._data = self._data.translate(_ASCII)
        found = self._data[self._at : self._at + size]
        self._at += len(found)
        return found

    def lock(self) -> None:
        """Keep other programs from opening or locking the port; `OSError` if one has it."""
        self._port.exclusive = True
        fcntl.ioctl(self._port.fileno(), termios.TIOCEXCL)

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        self._data, self._at = b"", 0
        self._port.reset_input_buffer()


SYNC = 0x80
NMT, SDO = 0x000, 0x600  # commands to nodes, requests to them
LISTEN_S = 0.15  # [s] for another controller, which sends SYNC at 10 Hz at least
QUEUE_S = 0.010  # [s] in which a queue of frames must have room; our watchdog is 40 ms
RETRY_S = 0.0002
ROUND_S = 0.05  # [s] after which the reader of SDO answers may end; a start waits for that

Send = Callable[..., None]
Receive = Callable[..., can.Message | None]


class ClaimedBus(NamedTuple):
    """An open bus, the claim that is held with it, and what it tells beside answers."""

    bus: can.BusABC
    claim: socket.socket
    monitor: BusMonitor

    def connect(self) -> canopen.Network:
        """Return a network for SDO requests; the monitor takes its frames, too."""
        network = canopen.Network(self.bus)
        network.NOTIFIER_CYCLE = ROUND_S
        network.listeners.append(self.monitor)  # type: ignore[arg-type]
        return network.connect()

    def shutdown(self) -> None:
        """Close the bus and release its claim."""
        try:
            self.bus.shutdown()
        finally:
            self.claim.close()


def open_bus(config: Cia402Config) -> ClaimedBus:
    """Open the CAN bus of a config, and listen for other controllers on it.

    `DriverFault` if it cannot be opened, another program of this machine uses it, or another
    controller does.
    """
    place = format_bus_name(config)
    interface, channel = config.bus.interface, config.bus.channel
    for library in ("can", "canopen"):  # their errors are raised, too
        logging.getLogger(library).addHandler(logging.NullHandler())
    is_serial = interface == "slcan"
    state = read_interface(channel) if interface == "socketcan" else {}
    if fault := find_interface_fault(state, config.bus):
        raise DriverFault(f"{place}: {fault}")
    claim = claim_port(channel) if is_serial else claim_bus(place, f"{interface} {channel}")
    try:
        bus = can.Bus(**config.bus.build_arguments())
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        claim.close()
        reason = _explain_error(config.bus, error) or (
            str(error).rstrip(".") + _suggest_interface(error)
        )
        raise DriverFault(f"{place}: cannot be opened as {interface}: {reason}") from error
    monitor = BusMonitor(config.bus)
    bus.send = retry_full_queue(bus.send)  # type: ignore[method-assign]
    bus.recv = skip_damaged_lines(bus.recv, monitor)  # type: ignore[method-assign]
    opened = ClaimedBus(bus, claim, monitor)
    try:
        if is_serial:
            port = BufferedPort(bus.serialPortOrig)  # type: ignore[attr-defined]
            port.lock()
            bus.serialPortOrig = port  # type: ignore[attr-defined]
        require_sole_controller(opened, config)
        if is_serial:
            port.refusals = 0  # those before are of its set-up
            monitor.count_refusals = lambda: port.refusals
    except (can.CanError, OSError) as error:
        opened.shutdown()
        raise to_driver_fault(config, error) from error
    except DriverFault:
        opened.shutdown()
        raise
    return opened


@contextmanager
def open_network(config: Cia402Config) -> Iterator[tuple[canopen.Network, BusMonitor]]:
    """Open the bus for SDO requests; errors of the bus in the context are a `DriverFault`."""
    opened = open_bus(config)
    network = opened.connect()
    try:
        yield network, opened.monitor
    except (can.CanError, OSError) as error:
        raise to_driver_fault(config, error) from error
    finally:
        with suppress(can.CanError, OSError):
            network.disconnect()
        opened.claim.close()


def format_bus_name(config: Cia402Config) -> str:
    """Return the name of the bus in messages."""
    return f"CAN {config.bus.channel}"


def to_driver_fault(config: Cia402Config, error: Exception) -> DriverFault:
    """Return an error of the bus in words."""
    reason = _explain_error(config.bus, error)
    return DriverFault(
        f"{format_bus_name(config)}: "
        + (reason or f"{error}: adapter unplugged, bus off, or no drive on the bus")
    )


def _explain_error(bus: BusConfig, error: Exception) -> str:
    """Return what an error number of the system means on a CAN bus; empty if it tells nothing."""
    show = f"`ip -details link show {bus.channel}`"
    number = _read_error_number(error)
    if number in (errno.EAGAIN, errno.EBUSY):
        return explain_busy(bus.channel)
    if number in (errno.EACCES, errno.EPERM):
        return explain_denied(bus.channel)
    return {
        errno.ENOBUFS: "no node acknowledges frames, the send queue is full: are the drives "
        f"powered, bit rate and termination right? ({show})",
        errno.ENETDOWN: f"the interface is down, or {BUS_OFF_TEXT}: sudo ip link set {bus.channel} "
        f"down; sudo ip link set {bus.channel} up type can bitrate {bus.bitrate} ({show})",
        errno.EAFNOSUPPORT: "this kernel has no SocketCAN: sudo modprobe can_raw (WSL and some "
        "containers have none: an adapter with slcan needs only a serial port)",
        errno.ENODEV: f"no such interface, or its adapter is unplugged{explain_missing_can()}",
    }.get(number or 0, "")


def _suggest_interface(error: Exception) -> str:
    """Return what to do where python-can lacks a library, knows no such interface or no channel."""
    if _read_error_number(error):
        return ""
    return (
        "; most USB adapters (candleLight, PEAK, Kvaser, IXXAT) need none of this on Linux: set "
        "bus.interface to socketcan, bus.channel to can0 (`teleop rig scan` lists them), or slcan "
        "and the adapter's port"
    )


def _read_error_number(error: Exception) -> int | None:
    """Return the number of a system's error, of whatever library."""
    numbers = (getattr(error, name, None) for name in ("error_code", "errno"))
    cause = error.__cause__
    of_cause = _read_error_number(cause) if isinstance(cause, Exception) else None
    return next((number for number in numbers if number), of_cause)


def skip_damaged_lines(receive: Receive, monitor: BusMonitor) -> Receive:
    """Return a `recv` of python-can that counts what an slcan adapter did not send in full."""

    def receive_frame(timeout: float | None = None) -> can.Message | None:
        try:
            return receive(timeout)
        except (ValueError, IndexError):
            monitor.damaged += 1
            return None

    return receive_frame


def retry_full_queue(send: Send) -> Send:
    """Return a `send` of python-can that waits up to `QUEUE_S` while the queue is full."""

    def send_in_time(message: can.Message, timeout: float | None = None) -> None:
        until_s = time.monotonic() + QUEUE_S
        while True:
            try:
                return send(message, timeout)
            except (can.CanError, OSError) as error:
                is_queue_full = _read_error_number(error) == errno.ENOBUFS
                if not is_queue_full or time.monotonic() > until_s:
                    raise
            time.sleep(RETRY_S)

    return send_in_time


def require_sole_controller(opened: ClaimedBus, config: Cia402Config) -> None:
    """Listen for a moment; `DriverFault` if another controller speaks to the nodes."""
    until_s = time.monotonic() + LISTEN_S
    while (left_s := until_s - time.monotonic()) > 0.0:
        message = opened.bus.recv(left_s)
        if message is not None:
            opened.monitor.on_message_received(message)
        if message is not None and (text := identify_controller_frame(message, config.master)):
            raise DriverFault(
                f"{format_bus_name(config)}: another controller is on the bus ({text} was "
                f"received): "
                "end it first; nothing was sent"
            )


def identify_controller_frame(message: can.Message, master: int) -> str:
    """Return what a frame is that only a controller sends; empty for any other."""
    if message.is_error_frame or message.is_extended_id:
        return ""
    identifier = message.arbitration_id
    if identifier == NMT:
        return "a command to nodes"
    if identifier == SYNC:
        return "SYNC"
    if identifier & 0x780 == HEARTBEAT and message.is_remote_frame:
        return "node guarding"
    if identifier == HEARTBEAT + master:
        return f"the heartbeat of node {master}, our number"
    return "an SDO request" if identifier & 0x780 == SDO else ""
