"""The motion of a hand that follows the commands of another process. Pure: time is an argument.

Between two positions it moves linearly, within the time that lay between them, so that a process of
100 Hz moves the tip without steps. While the switch is open it is where the newest command is.

A loop reads the newest record only, so it may miss that the switch was open in between: one read
with an open switch lies between two engagements, at the new position.
"""

import math
import struct
from typing import NamedTuple

from master.device import Axes, HandState
from teleop.messages.messages import MAX_JOINTS

# --- what the other process tells the master's: fixed-size records

_TEXT_BYTES = 160
_LAYOUT = struct.Struct(f"<qqqq{_TEXT_BYTES}s{MAX_JOINTS}dq")
SIZE = _LAYOUT.size  # below PIPE_BUF: written whole or not at all


class CommandRecord(NamedTuple):
    """State of the commands."""

    written_ns: int = 0  # monotonic
    received_ns: int = 0  # monotonic; 0 = no command yet
    number: int = 0  # count of accepted commands
    engagement: int = 0  # number of the present engagement; 0 = the switch is open
    fault: str = ""
    values: tuple[float, ...] = ()  # [m] or [m/s]
    button: int = 0  # number of a button that was pressed with this command; 0 = none

    def pack(self) -> bytes:
        """Return the bytes of the record."""
        text = self.fault.encode()[:_TEXT_BYTES].decode(errors="ignore").encode()
        values = (*self.values, *(0.0,) * (MAX_JOINTS - len(self.values)))
        head = self.written_ns, self.received_ns, self.number, self.engagement, text
        return _LAYOUT.pack(*head, *values, self.button)

    @classmethod
    def unpack(cls, data: bytes, axes: int) -> "CommandRecord":
        """Return the record of `SIZE` bytes."""
        written, received, number, engagement, text, *values, button = _LAYOUT.unpack(data)
        fault = text.rstrip(b"\0").decode()
        return cls(written, received, number, engagement, fault, tuple(values[:axes]), button)


_STEP_MAX_S = 0.01  # [s] of a velocity integrated over one tick


class CommandMotion:
    """State of the motion; see the module's text.

    Values are positions [m], or velocities [m/s] with `is_velocity`. `span_max_s` [s] is the
    longest time that a motion to the next position takes.
    """

    def __init__(self, axes: int, is_velocity: bool = False, span_max_s: float = math.inf) -> None:
        self._is_velocity, self._span_max_s = is_velocity, span_max_s
        self._record = CommandRecord()
        self._position: Axes = (0.0,) * axes
        self._velocity: Axes = (0.0,) * axes
        self._from: Axes = self._position
        self._begin_s, self._span_s, self._time_s = 0.0, 0.0, 0.0

    def step(self, record: CommandRecord, is_fresh: bool, time_s: float) -> HandState:
        """Return the hand at `time_s` [s], never decreasing, by the newest record of the commands.

        `is_fresh` tells whether its command came within the timeout.
        """
        previous, self._record = self._record, record
        dt, self._time_s = max(0.0, time_s - self._time_s), time_s
        engaged = 0 < record.engagement == previous.engagement
        if self._is_velocity:
            self._integrate(record.values if engaged and is_fresh else (), dt)
        elif record.values:
            if not engaged:
                self._span_s = 0.0
            elif record.number != previous.number:
                passed_s = (record.received_ns - previous.received_ns) * 1e-9
                left_s = self._begin_s + self._span_s - time_s  # commands may come in bursts
                self._from, self._begin_s = self._position, time_s
                self._span_s = min(max(passed_s, left_s), self._span_max_s)
            self._move(record.values, time_s)
        else:
            self.stop_hand()
        return HandState(self._position, self._velocity, engaged)

    def stop_hand(self) -> None:
        """Let the hand rest where it is."""
        self._velocity = (0.0,) * len(self._position)

    def _move(self, target: Axes, time_s: float) -> None:
        """Move to a position, `_span_s` after `_begin_s`."""
        share = (time_s - self._begin_s) / self._span_s if self._span_s > 0.0 else 1.0
        if share >= 1.0:
            self._position = target
            self.stop_hand()
            return
        pairs = tuple(zip(self._from, target, strict=True))
        self._position = tuple(a + (b - a) * share for a, b in pairs)
        self._velocity = tuple((b - a) / self._span_s for a, b in pairs)

    def _integrate(self, velocity: Axes, dt: float) -> None:
        """Move at a commanded velocity; not at all without one."""
        self._velocity = velocity or (0.0,) * len(self._position)
        step = min(dt, _STEP_MAX_S)
        self._position = tuple(
            x + v * step for x, v in zip(self._position, self._velocity, strict=True)
        )
