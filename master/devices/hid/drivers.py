"""Table of the drivers and the devices they fit."""

import math
from collections.abc import Callable
from typing import NamedTuple

from master.devices.hid import dualsense, ffbeast, logitech, spacemouse
from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import HidDriver
from master.devices.hid.dualsense import DualSenseDriver
from master.devices.hid.ffbeast import FFBeastDriver
from master.devices.hid.joystick import JoystickDriver
from master.devices.hid.logitech import LogitechDriver
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.spacemouse import SpaceMouseDriver

_JOYSTICK, _GAMEPAD, _MULTI_AXIS = (0x01, 0x04), (0x01, 0x05), (0x01, 0x08)  # page and usage
_VENDOR_PAGES = 0xFF00  # and above


class AttachedNode(NamedTuple):
    """One HID node as listed by the system."""

    path: str
    vendor: int
    product: int
    serial: str = ""
    name: str = ""
    interface: int = -1  # of a USB device with several
    bluetooth: bool = False
    usages: tuple[tuple[int, int], ...] = ()  # page and usage of its outermost collections
    release: int = 0  # of the device, a number in BCD

    @property
    def model(self) -> str:
        """Its vendor:product."""
        return f"{self.vendor:04x}:{self.product:04x}"

    @property
    def models(self) -> tuple[str, ...]:
        """Its vendor:product in each of its modes."""
        g923 = (logitech.G923, logitech.G923_CONSOLE)
        if self.vendor != logitech.VENDOR or self.product not in g923:
            return (self.model,)
        return tuple(f"{self.vendor:04x}:{product:04x}" for product in g923)

    @property
    def identity(self) -> str:
        """Identity; not unique without a serial number."""
        return f"{self.model}:{self.serial}" if self.serial else self.model

    def same_as(self, other: "AttachedNode") -> bool:
        """Return whether this is `other`, possibly at another port."""
        return self[1:] == other[1:]

    def __str__(self) -> str:
        """Return its name in messages."""
        return f"{self.name or 'a HID device'} ({self.model}, {self.path})"


class DriverSpec(NamedTuple):
    """A driver and properties of its devices."""

    misfit: Callable[
        [AttachedNode, bytes], str
    ]  # (device, its descriptor) -> why not; empty = fits
    # of the device, its descriptor, effects of its own, and the axes to be pushed (None = all);
    # raises DriverError, DescriptorError
    make: Callable[[AttachedNode, bytes, PidConfig, tuple[str, ...] | None], HidDriver]
    forgets: bool = True  # whether a force ends by itself without writes of the host
    heartbeat: float = math.inf  # [s] largest interval between its reports


def _find_pid_misfit(_item: AttachedNode, descriptor: bytes) -> str:
    try:
        PidDriver(descriptor)
    except ValueError as error:  # DescriptorError, DriverError
        return f"by its report descriptor: {error}"
    return ""


def _find_ffbeast_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    if (item.vendor, item.product) != (ffbeast.VENDOR, ffbeast.PRODUCT):
        return "not an FFBeast wheel"
    if any(page < _VENDOR_PAGES for page, _ in item.usages):
        return "not the wheel's vendor interface"
    return ""


def _find_dualsense_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    fits = item.vendor == dualsense.VENDOR and item.product in dualsense.PRODUCTS
    return "" if fits else "not a DualSense"


def _find_spacemouse_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    fits = item.vendor == spacemouse.VENDOR or (
        item.vendor == spacemouse.LOGITECH and item.product in spacemouse.LOGITECH_PRODUCTS
    )
    if not fits:
        return "not a SpaceMouse"
    if item.usages and _MULTI_AXIS not in item.usages:
        return "another interface of a SpaceMouse"
    return ""


def _find_logitech_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    if (item.vendor, item.product) == (logitech.VENDOR, logitech.G923_CONSOLE):
        return "a G923 in console mode"
    if item.vendor != logitech.VENDOR or item.product not in logitech.PRODUCTS:
        return "not a classic Logitech wheel"
    return "another interface of a Logitech wheel" if item.interface > 0 else ""


def _find_joystick_misfit(item: AttachedNode, descriptor: bytes) -> str:
    if not {_JOYSTICK, _GAMEPAD, _MULTI_AXIS} & set(item.usages):
        return "not a joystick or gamepad"
    try:
        JoystickDriver(descriptor)
    except ValueError as error:  # DescriptorError, DriverError
        return f"by its report descriptor: {error}"
    return ""


PID = "pid"
INPUTS_ONLY = "joystick"  # fallback for devices without a driver of their own

# in order of preference
DRIVERS: dict[str, DriverSpec] = {
    PID: DriverSpec(
        _find_pid_misfit, lambda _, data, config, pushed: PidDriver(data, config, pushed)
    ),
    "ffbeast": DriverSpec(_find_ffbeast_misfit, lambda *_: FFBeastDriver(), forgets=False),
    "dualsense": DriverSpec(
        _find_dualsense_misfit,
        lambda item, *_: DualSenseDriver(item.bluetooth),
        forgets=False,
        heartbeat=0.1,
    ),
    "spacemouse": DriverSpec(_find_spacemouse_misfit, lambda *_: SpaceMouseDriver()),
    "logitech": DriverSpec(
        _find_logitech_misfit,
        lambda item, data, *_: LogitechDriver(parse_descriptor(data), item.product, item.release),
        forgets=False,
    ),
    INPUTS_ONLY: DriverSpec(_find_joystick_misfit, lambda _item, data, *_: JoystickDriver(data)),
}
