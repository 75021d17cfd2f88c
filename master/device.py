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
    clutch: bool = False  # ... holds the clutch: the hand moves, and nothing with it
    stop: bool = False  # ... holds the emergency stop
    finer: bool = False  # ... holds the button for a smaller position scale
    coarser: bool = False  # ... for a larger one
    weaker: bool = False  # ... for a smaller force scale
    stronger: bool = False  # ... for a larger one


class DeviceFault(Exception):
    """The device is gone or cannot be trusted; the message says why."""


class DeviceLost(DeviceFault):
    """The device is away, but looked for: reading it goes on, and succeeds once it is back."""


class Device(Protocol):
    """A haptic device as the master loop sees it.

    Opened by its constructor, which raises `DeviceFault` if the hardware is not there; used from
    one thread; closed exactly once. `read` and `write` never wait for hardware: a driver whose
    transport can block owns a thread and hands over the newest value. A failure raises
    `DeviceFault`; the loop then goes to fault, tries to write zero once, and closes. One that mends
    itself raises `DeviceLost`; the loop goes to fault and on reading. Then a device must not say
    that its switch is open before it knows, nor apply a force from before.
    """

    axes: int

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state at session time `time_s` [s] (never decreasing).

        A real device ignores the time; a simulated one moves on to it.
        """

    def write(self, force: Axes) -> None:
        """Apply forces [N], one for each axis, positive along +position. Only the gate calls this.

        The device holds the force until the next write. It must be without force 250 ms after this
        process was killed or stopped: by a time-out of its own, or by help from outside.
        """

    def close(self) -> None:
        """Set the force to zero and let go of the hardware; must not raise."""
