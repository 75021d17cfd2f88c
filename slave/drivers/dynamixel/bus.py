"""A bus of Dynamixel servos: one register at a time, by the vendor's SDK."""

import contextlib
import select
import socket
import termios
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import serial
from dynamixel_sdk import PacketHandler, PortHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS

from slave.drivers.driver import DriverFault
from slave.drivers.dynamixel.registers import Register
from slave.drivers.ports import find_slow_timer
from slave.drivers.serial_port import open_serial

# --- the vendor's port with waits that are short enough for a loop, and its errors in words

POLL_PERIOD_S = 0.001  # [s] between two looks at the time while nothing arrives

RESULT_TEXT = {COMM_RX_TIMEOUT: "no answer", COMM_RX_CORRUPT: "damaged answer"}

TWINS_TEXT = "two servos of this number? Connect one at a time and change its ID"


class WaitingPort(PortHandler):  # type: ignore[misc] # the SDK has no types
    """A `PortHandler` that sleeps while it waits, and waits no longer than it is told to.

    The SDK's own polls without sleep and waits 34 ms for a missing answer, as long as a servo's
    watchdog; this one `wait_s`, beyond the answer's own time on the line.
    """

    def __init__(self, name: str, wait_s: float) -> None:
        super().__init__(name)
        self._wait_ms = wait_s * 1e3

    def take(self, port: serial.Serial) -> None:
        """Use a port that is open; the SDK's own opens few baud rates, and for everybody."""
        self.ser, self.baudrate, self.is_open = port, port.baudrate, True
        self.tx_time_per_byte = 10.0 * 1e3 / port.baudrate  # [ms]

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802 - the SDK's name
        """Begin to wait for an answer of so many bytes."""
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self._wait_ms)

    def getCurrentTime(self) -> float:  # noqa: N802 - the SDK's name
        """Return a monotonic time [ms]; the SDK's is that of the system clock."""
        return time.monotonic_ns() * 1e-6

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        """Return up to `length` bytes; sleeps a moment if there are none."""
        data: bytes = self.ser.read(length)
        if not data:
            select.select([self.ser.fileno()], [], [], POLL_PERIOD_S)
            data = self.ser.read(length)
        return data


def format_result(result: int) -> str:
    """Return the result of a communication in words; empty if it succeeded."""
    if result == COMM_SUCCESS:
        return ""
    return RESULT_TEXT.get(result, f"communication error {result}")


Result = TypeVar("Result")

TRIES_MAX = 5  # of a single register
LATE_S = 0.03  # [s] after a failure: a late answer would be taken for that of the next register


class ServoBus:
    """The servos on one adapter, a device file; `DriverFault` for whatever goes wrong."""

    def __init__(self, path: str, wait_s: float) -> None:
        self.path = path
        self.port = WaitingPort(path, wait_s)
        self.packets = PacketHandler(2.0)
        self._claim: socket.socket | None = None

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._claim is not None

    def open(self, baud: int) -> None:
        """Open the port, for this process alone, at any baud rate that the adapter has."""
        opened, self._claim = open_serial(self.path, baud, timeout=0)
        self.port.take(opened)

    def close(self) -> None:
        """Release the port; never raises."""
        if self._claim is None:
            return
        with contextlib.suppress(serial.SerialException, OSError):
            self.port.closePort()
        self._claim.close()
        self._claim = None

    def call(self, action: Callable[[], Result]) -> Result:
        """Call with the errors of an unplugged adapter as a `DriverFault`."""
        try:
            return action()
        except (serial.SerialException, termios.error, OSError) as error:
            raise DriverFault(f"{self.path}: unplugged ({error})") from error

    def ping(self, number: int) -> int:
        """Return the model of a servo; `DriverFault` if it does not answer."""
        text, result = "", COMM_SUCCESS
        for _ in range(TRIES_MAX):
            model, result, _ = self.packets.ping(self.port, number)
            text = format_result(result)
            if not text:
                return int(model)
            time.sleep(LATE_S)
        hint = find_slow_timer(self.path) or "has the bus power? See `teleop rig scan`"
        raise DriverFault(
            f"{self.path}: servo {number}: {text} at {self.port.baudrate} baud; "
            f"{TWINS_TEXT if result == COMM_RX_CORRUPT else hint}"
        )

    def get(self, number: int, register: Register) -> int:
        """Read a register, unsigned."""
        text = ""
        for _ in range(TRIES_MAX):
            data, result, error = self.packets.readTxRx(
                self.port, number, register.address, register.size
            )
            text = format_result(result)
            if not text and error & 0x7F:
                text = f"refused: {self.packets.getRxPacketError(error & 0x7F)}"
                break
            if not text and len(data) == register.size:
                return int.from_bytes(bytes(data), "little")
            time.sleep(LATE_S)
        raise DriverFault(f"servo {number}: {register.name}: {text}")

    def put(self, number: int, register: Register, value: int) -> None:
        """Write a register and read it back; `DriverFault` if the servo does not take the value."""
        text = ""
        data = register.pack(value)
        for _ in range(TRIES_MAX):
            result, error = self.packets.writeTxRx(
                self.port, number, register.address, register.size, data
            )
            text = format_result(result)
            if not text and error & 0x7F:
                text = f"refused: {self.packets.getRxPacketError(error & 0x7F)}"
            if not text and self.get(number, register) != int.from_bytes(data, "little"):
                text = "reads back another value than was written"
            if not text:
                return
            time.sleep(LATE_S)
        raise DriverFault(f"servo {number}: {register.name}: {text}")

    def put_unconfirmed(self, number: int, register: Register, value: int) -> None:
        """Write a register of a servo that may have been told to answer no write."""
        result, _ = self.packets.writeTxRx(
            self.port, number, register.address, register.size, register.pack(value)
        )
        if format_result(result):
            time.sleep(LATE_S)

    def describe(self, settings: Sequence[str]) -> dict[str, str]:
        """Return what the summary says of a slow adapter and of settings of other programs."""
        texts = {"adapter": find_slow_timer(self.path), "settings": "; ".join(settings)}
        return {key: text for key, text in texts.items() if text}
