"""The serial port of an slcan adapter, read in whole chunks."""

from typing import Any


class BufferedPort:
    """A `serial.Serial` whose small reads are served from memory.

    python-can reads an slcan adapter byte by byte, which costs two system calls a byte: more than
    all else that a frame takes.

    Parameters
    ----------
    port : serial.Serial
        Open; everything but reading is passed on to it.
    """

    def __init__(self, port: Any) -> None:
        self._port = port
        self._data, self._at = b"", 0

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
        found = self._data[self._at : self._at + size]
        self._at += len(found)
        return found

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        self._data, self._at = b"", 0
        self._port.reset_input_buffer()
