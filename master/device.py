"""The haptic device interface."""

import math
from dataclasses import dataclass
from typing import Protocol

Axes = tuple[float, ...]
"""One number for each axis of a device. Plain floats: at these sizes arrays cost ten times more."""


@dataclass(slots=True)  # made every tick: frozen, that would take seven times as long
class HandState:
    """State of the hand from one read of a device."""

    position: Axes  # [m], [rad] of an axis that turns
    velocity: Axes  # [m/s], [rad/s]
    engage: bool  # the engage switch is held
    clutch: bool = False  # the clutch is held: the hand moves without the tips
    stop: bool = False  # the emergency stop is held
    finer: bool = False  # button held: smaller position scale
    coarser: bool = False  # ... for a larger one
    weaker: bool = False  # ... for a smaller force scale
    stronger: bool = False  # ... for a larger one
    buttons: tuple[int, ...] = ()  # numbers of the held buttons without a function, from 1


class DeviceFault(Exception):
    """The device has failed; the message gives the reason."""


class DeviceLost(DeviceFault):
    """The device is unplugged; reads may continue and succeed once it is back."""


def require_force(force: Axes, axes: int) -> None:
    """Raise `DeviceFault` unless a device of so many axes can be given this force."""
    if len(force) != axes or not all(map(math.isfinite, force)):
        raise DeviceFault(f"refuses force {force}")


class Device(Protocol):
    """Interface of a haptic device to the master loop.

    Opened by its constructor, which raises `DeviceFault` if the hardware is not available; used
    from one thread; closed exactly once. `read` and `write` never wait for hardware: a driver whose
    transport can block owns a thread and exchanges the newest value. A failure raises
    `DeviceFault`; the loop then goes to fault, tries to write zero once, and closes. A recoverable
    failure raises `DeviceLost`; the loop goes to fault and keeps reading. After that a device must
    not report an open switch before it knows, nor apply an old force.
    """

    axes: int

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state at session time `time_s` [s] (never decreasing).

        A real device ignores the time; a simulated one moves on to it.
        """

    def write(self, force: Axes) -> None:
        """Apply forces [N], or torques [N m], one per axis, positive along +position.

        Only what the gate let through comes here.

        The device holds the force until the next write. Its force must be zero 250 ms after this
        process was killed or stopped, by a timeout of the device or a watchdog process.
        """

    def close(self) -> None:
        """Set the force to zero and release the hardware; must not raise."""
