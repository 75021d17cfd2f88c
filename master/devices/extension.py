"""Base class of the configs of haptic devices in other packages."""

from dataclasses import dataclass
from typing import ClassVar

from master.device import Device
from teleop.config.extensions import Extension


@dataclass(frozen=True)
class DeviceExtension(Extension):
    """Base of the configs of devices of other packages (docs/devices.md).

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
