"""The haptic devices: one line each. To add one, see docs/devices.md."""

from collections.abc import Callable
from typing import Any

from master.device import Device, DeviceFault
from master.devices.hid.config import HidConfig
from master.devices.hid.device import HidDevice
from master.devices.virtual import VirtualConfig, VirtualDevice
from teleop.errors import UsageError

# all of them, joined by `|`; the key `type` in a config chooses
DeviceConfig = VirtualConfig | HidConfig

DEVICES: dict[type, Callable[[Any], Device]] = {
    VirtualConfig: VirtualDevice,
    HidConfig: HidDevice,
}


def open_device(config: DeviceConfig) -> Device:
    """Open the device that `config` describes; `UsageError` if it is not there."""
    try:
        return DEVICES[type(config)](config)
    except DeviceFault as fault:
        raise UsageError(f"master.device: {fault}") from fault
