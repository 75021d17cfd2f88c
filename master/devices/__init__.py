"""Table of the haptic devices. To add one, see docs/how-to/haptic-device.md."""

from collections.abc import Callable
from typing import Any

from master.device import Device, DeviceFault
from master.devices.combined import CombinedConfig, CombinedDevice, SingleConfig
from master.devices.extension import CheckedDevice, DeviceExtension
from master.devices.hid.device import HidDevice
from master.devices.hid.input_map import HidConfig
from master.devices.program import ProgramConfig, ProgramDevice
from master.devices.ros_device import RosDevice, RosDeviceConfig
from master.devices.virtual import VirtualConfig, VirtualDevice
from teleop.config.extensions import format_opening_failure
from teleop.errors import UsageError
from teleop.messages.messages import MAX_JOINTS

DeviceConfig = SingleConfig | CombinedConfig | ProgramConfig


def open_combined(config: CombinedConfig) -> Device:
    """Open several devices as one; `DeviceFault` if one of them is not available."""
    return CombinedDevice(config, _open_any_device)


def _open_any_device(config: DeviceConfig) -> Device:
    if isinstance(config, DeviceExtension):
        return CheckedDevice(config.open(), config.type)
    return DEVICES[type(config)](config)


DEVICES: dict[type, Callable[[Any], Device]] = {
    VirtualConfig: VirtualDevice,
    HidConfig: HidDevice,
    RosDeviceConfig: RosDevice,
    ProgramConfig: ProgramDevice,
    CombinedConfig: open_combined,
}


def open_device(config: DeviceConfig) -> Device:
    """Open the device that `config` describes; `UsageError` if it is not available.

    Likewise if its axes are no joints: compiled functions do not check them.
    """
    try:
        device = _open_any_device(config)
    except DeviceFault as fault:
        raise UsageError(f"master.device: {fault}") from fault
    except Exception as error:
        if isinstance(config, DeviceExtension):
            raise UsageError(format_opening_failure("master.device", config, error)) from error
        raise
    if not 1 <= device.axes <= MAX_JOINTS:
        device.close()
        raise UsageError(
            f"master.device: {config.type} has {device.axes} axes, must be 1 to {MAX_JOINTS}"
        )
    return device
