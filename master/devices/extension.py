"""Base class of the configs of haptic devices in other packages."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from master.device import Axes, Device, DeviceFault, DeviceLost, HandState
from teleop.config.extensions import Extension, close_extension, format_call_failure

# --- what a device of another package returns, checked before the loop takes it

_REQUIRED = ("axes", "read", "write", "close")
_SWITCHES = ("engage", "clutch", "stop", "finer", "coarser", "weaker", "stronger")
_get_switches = attrgetter(*_SWITCHES)
_BOOLS = {bool, np.bool_}  # a text is true whatever it says, and NaN is too


class CheckedDevice:
    """A `master.device.Device` of another package whose mistakes are a fault that names them.

    Values that are not finite are a `DeviceLost`: the loop goes on reading, without force. The
    device is open; messages call it `place`. `DeviceFault` if it lacks an attribute or a method.
    """

    def __init__(self, device: Device, place: str) -> None:
        missing = [name for name in _REQUIRED if not hasattr(device, name)]
        if missing:
            raise DeviceFault(f"{place}: {type(device).__name__} has no {', '.join(missing)}")
        self._device, self._place = device, place
        self.axes = device.axes

    def read(self, time_s: float) -> HandState:
        """Return the hand's state; `DeviceFault` if it is not as `HandState` says."""
        hand: HandState = self._call(self._device.read, time_s)
        try:
            position, velocity = hand.position, hand.velocity
            if (
                isinstance(hand, HandState)
                and position.__class__ is tuple
                and velocity.__class__ is tuple
                and len(position) == self.axes
                and len(velocity) == self.axes
                and _BOOLS.issuperset(map(type, _get_switches(hand)))
                and (hand.buttons == () or _is_button_tuple(hand.buttons))
            ):
                if math.isfinite(sum(position) + sum(velocity)):
                    return hand
                raise DeviceLost(
                    f"{self._read}: position {position}, velocity {velocity}, not finite"
                )
        except (AttributeError, TypeError) as error:
            raise DeviceFault(f"{self._read}: {self._build_mistake(hand)}") from error
        raise DeviceFault(f"{self._read}: {self._build_mistake(hand)}")

    def write(self, force: Axes) -> None:
        """Apply forces [N]."""
        self._call(self._device.write, force)

    def close(self) -> None:
        """Close the device; a failure is a warning, which replaces no fault."""
        close_extension(self._place, self._device)

    def _call(self, method: Callable[..., Any], argument: Any) -> Any:
        try:
            return method(argument)
        except DeviceFault:
            raise
        except Exception as error:
            name = str(getattr(method, "__name__", type(method).__name__))  # a partial
            raise DeviceFault(format_call_failure(self._place, name, error)) from error

    @property
    def _read(self) -> str:
        return f"{self._place}: {type(self._device).__name__}.read"

    def _build_mistake(self, hand: Any) -> str:
        """Return what is wrong with a hand's state."""
        if not isinstance(hand, HandState):
            return f"returned {type(hand).__name__}, must be HandState"
        for name in ("position", "velocity"):
            values = getattr(hand, name)
            if not isinstance(values, tuple):
                return f"{name} is a {type(values).__name__}, must be a tuple of floats"
            if len(values) != self.axes:
                return f"{name} has {len(values)} numbers, must have {self.axes}, one an axis"
        for name, value in zip(_SWITCHES, _get_switches(hand), strict=True):
            if type(value) not in _BOOLS:
                return f"{name} is {value!r}, must be a bool"
        if not _is_button_tuple(hand.buttons):
            return f"buttons is {hand.buttons!r}, must be a tuple of numbers from 1"
        return f"position {hand.position} and velocity {hand.velocity}: must be floats"


def _is_button_tuple(buttons: Any) -> bool:
    return isinstance(buttons, tuple) and all(type(n) is int and n >= 1 for n in buttons)


@dataclass(frozen=True)
class DeviceExtension(Extension):
    """Base of the configs of devices of other packages (docs/how-to/haptic-device.md).

    Attributes
    ----------
    axis_count : int
        Number of axes of the device; 1 by default.
    """

    GROUP: ClassVar[str] = "teleop.devices"

    @property
    def axis_count(self) -> int:
        """Number of axes of the device."""
        return 1

    def open(self) -> Device:
        """Open the device; raises `master.device.DeviceFault` on failure."""
        raise NotImplementedError
