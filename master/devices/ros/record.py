"""What the receiver of ROS commands tells the master's process: fixed-size records on a pipe."""

import struct
from typing import NamedTuple

from teleop.messages.messages import MAX_JOINTS

_TEXT_BYTES = 160
_LAYOUT = struct.Struct(f"<qqqq{_TEXT_BYTES}s{MAX_JOINTS}d")
SIZE = _LAYOUT.size  # below PIPE_BUF: written whole or not at all


class CommandRecord(NamedTuple):
    """State of the commands."""

    written_ns: int = 0  # monotonic
    received_ns: int = 0  # monotonic; 0 = no command yet
    number: int = 0  # count of accepted commands
    engagement: int = 0  # number of the present engagement; 0 = the switch is open
    fault: str = ""
    values: tuple[float, ...] = ()  # [m] or [m/s]

    def pack(self) -> bytes:
        """Return the bytes of the record."""
        text = self.fault.encode()[:_TEXT_BYTES].decode(errors="ignore").encode()
        values = (*self.values, *(0.0,) * (MAX_JOINTS - len(self.values)))
        head = self.written_ns, self.received_ns, self.number, self.engagement, text
        return _LAYOUT.pack(*head, *values)

    @classmethod
    def unpack(cls, data: bytes, axes: int) -> "CommandRecord":
        """Return the record of `SIZE` bytes."""
        written, received, number, engagement, text, *values = _LAYOUT.unpack(data)
        fault = text.rstrip(b"\0").decode()
        return cls(written, received, number, engagement, fault, tuple(values[:axes]))
