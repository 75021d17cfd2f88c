"""A haptic device of another package."""

from dataclasses import dataclass
from typing import ClassVar

from master.device import Device
from teleop.extensions import Extension


@dataclass(frozen=True)
class DeviceExtension(Extension):
    """Base of the configs of devices of other packages (docs/devices.md).

    Attributes
    ----------
    axis_count : int
        How many axes the device has; 1 unless a subclass says otherwise.
    """

    GROUP: ClassVar[str] = "teleop.devices"

    @property
    def axis_count(self) -> int:
        """How many axes the device has."""
        return 1

    def open(self) -> Device:
        """Open the device; `master.device.DeviceFault` if that cannot be done."""
        raise NotImplementedError
