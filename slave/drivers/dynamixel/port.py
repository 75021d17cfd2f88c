"""The vendor's port with waits that are short enough for a loop, and its errors in words."""

import select
import time

import serial
from dynamixel_sdk import PortHandler
from dynamixel_sdk.robotis_def import (
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
)

POLL_PERIOD_S = 0.001  # [s] between two looks at the time while nothing arrives

RESULT_TEXT = {COMM_RX_TIMEOUT: "no answer", COMM_RX_CORRUPT: "damaged answer"}


class WaitingPort(PortHandler):  # type: ignore[misc] # the SDK has no types
    """A `PortHandler` that sleeps while it waits, and waits no longer than it is told to.

    The SDK's own polls without sleep and waits 34 ms for a missing answer, as long as a servo's
    watchdog.

    Parameters
    ----------
    name : str
        Device file.
    wait_s : float
        Time to wait for an answer, beyond its bytes' own time on the line.
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
