"""The contract of a haptic device."""

from dataclasses import dataclass
from typing import Protocol

Axes = tuple[float, ...]
"""One number for each axis of a device. Plain floats: at these sizes arrays cost ten times more."""


@dataclass(frozen=True, slots=True)
class HandState:
    """What one read of a device returns."""

    position: Axes  # [m]
    velocity: Axes  # [m/s]
    engage: bool  # the operator holds the engage switch


class DeviceFault(Exception):
    """The device is gone or cannot be trusted; the message says why."""


class Device(Protocol):
    """A haptic device as the master loop sees it.

    Opened by its constructor, which raises `DeviceFault` if the hardware is not there; used from
    one thread; closed exactly once. `read` and `write` never wait for hardware: a driver whose
    transport can block owns a thread and hands over the newest value. A failure raises
    `DeviceFault`; the loop then goes to fault, tries to write zero once, and closes.
    """

    axes: int

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state at session time `time_s` [s] (never decreasing).

        A real device ignores the time; a simulated one moves on to it.
        """

    def write(self, force: Axes) -> None:
        """Apply forces [N], one for each axis, positive along +position. Only the gate calls this.

        The device holds the force until the next write. One that can time out by itself must,
        within 50 ms: nothing else protects the hand when this process is killed.
        """

    def close(self) -> None:
        """Set the force to zero and let go of the hardware; must not raise."""
