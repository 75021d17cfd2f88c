"""Table of the drivers and the devices they fit, with the udev rules that open these."""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from master.devices.hid import dualsense, joystick, wheels
from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import HidDriver
from master.devices.hid.dualsense import DualSenseDriver
from master.devices.hid.joystick import JoystickDriver, SpaceMouseDriver
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.wheels import FFBeastDriver, LogitechDriver

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
        g923 = (wheels.G923, wheels.G923_CONSOLE)
        if self.vendor != wheels.LOGITECH_VENDOR or self.product not in g923:
            return (self.model,)
        return tuple(f"{self.vendor:04x}:{product:04x}" for product in g923)

    @property
    def identity(self) -> str:
        """Identity; not unique without a serial number."""
        return f"{self.model}:{self.serial}" if self.serial else self.model

    def is_same_as(self, other: "AttachedNode") -> bool:
        """Return whether this is `other`, possibly at another port."""
        return self[1:] == other[1:]

    def __str__(self) -> str:
        """Return its name in messages."""
        return f"{self.name or 'a HID device'} ({self.model}, {self.path})"


class DriverSpec(NamedTuple):
    """A driver and properties of its devices."""

    # (device, its descriptor) -> why not; empty = fits
    misfit: Callable[[AttachedNode, bytes], str]
    # of the device, its descriptor, effects of its own, and the axes to be pushed (None = all);
    # raises DriverError, DescriptorError
    make: Callable[[AttachedNode, bytes, PidConfig, tuple[str, ...] | None], HidDriver]
    forgets: bool = True  # whether a force ends by itself without writes of the host
    heartbeat: float = math.inf  # [s] largest interval between its reports


def _try_driver(driver: Callable[[bytes], HidDriver], descriptor: bytes) -> str:
    try:
        driver(descriptor)
    except ValueError as error:  # DescriptorError, DriverError
        return f"by its report descriptor: {error}"
    return ""


def _find_ffbeast_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    if (item.vendor, item.product) != (wheels.FFBEAST_VENDOR, wheels.FFBEAST_PRODUCT):
        return "not an FFBeast wheel"
    if any(page < _VENDOR_PAGES for page, _ in item.usages):
        return "not the wheel's vendor interface"
    return ""


def _find_dualsense_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    is_match = item.vendor == dualsense.VENDOR and item.product in dualsense.PRODUCTS
    return "" if is_match else "not a DualSense"


def _find_spacemouse_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    is_match = item.vendor == joystick.SPACEMOUSE_VENDOR or (
        item.vendor == joystick.SPACEMOUSE_OLD_VENDOR
        and item.product in joystick.SPACEMOUSE_OLD_PRODUCTS
    )
    if not is_match:
        return "not a SpaceMouse"
    if item.usages and _MULTI_AXIS not in item.usages:
        return "another interface of a SpaceMouse"
    return ""


def _find_logitech_misfit(item: AttachedNode, _descriptor: bytes) -> str:
    if (item.vendor, item.product) == (wheels.LOGITECH_VENDOR, wheels.G923_CONSOLE):
        return "a G923 in console mode"
    if item.vendor != wheels.LOGITECH_VENDOR or item.product not in wheels.LOGITECH_PRODUCTS:
        return "not a classic Logitech wheel"
    return "another interface of a Logitech wheel" if item.interface > 0 else ""


def _find_joystick_misfit(item: AttachedNode, descriptor: bytes) -> str:
    if not {_JOYSTICK, _GAMEPAD, _MULTI_AXIS} & set(item.usages):
        return "not a joystick or gamepad"
    return _try_driver(JoystickDriver, descriptor)


PID = "pid"
INPUTS_ONLY = "joystick"  # fallback for devices without a driver of their own

# in order of preference
DRIVERS: dict[str, DriverSpec] = {
    PID: DriverSpec(
        lambda _, data: _try_driver(PidDriver, data),
        lambda _, data, config, pushed: PidDriver(data, config, pushed),
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


# --- permission to open HID devices on Linux: a udev rule for each model
# They belong into a file that comes before 73-seat-late.rules, which reads the tag that they set.


# vendor, product (None = every one), and what it is
KNOWN_MODELS: tuple[tuple[int, int | None, str], ...] = (
    (0x1209, 0xFFB0, "OpenFFBoard"),
    (0x2341, 0x8036, "Arduino Leonardo"),
    (0x2341, 0x8037, "Arduino Micro"),
    (0xFFFF, 0x2055, "VPforce Rhino"),
    (0x045B, 0x59D7, "FFBeast wheel"),
    (0x045B, 0x58F9, "FFBeast joystick"),
    (0x045B, 0x5968, "FFBeast rudder"),
    (0x16D0, 0x0D5A, "Simucube 1"),
    (0x16D0, 0x0D61, "Simucube 2 Sport"),
    (0x16D0, 0x0D60, "Simucube 2 Pro"),
    (0x16D0, 0x0D5F, "Simucube 2 Ultimate"),
    (0x346E, 0x0000, "Moza R16, R21"),
    (0x346E, 0x0002, "Moza R9"),
    (0x346E, 0x0004, "Moza R5"),
    (0x346E, 0x0005, "Moza R3"),
    (0x346E, 0x0006, "Moza R12"),
    (0x346E, 0x0010, "Moza R16, R21 (v2)"),
    (0x346E, 0x0012, "Moza R9 (v2)"),
    (0x346E, 0x0014, "Moza R5 (v2)"),
    (0x346E, 0x0015, "Moza R3 (v2)"),
    (0x346E, 0x0016, "Moza R12 (v2)"),
    (0x3416, 0x0301, "Cammus C5"),
    (0x3416, 0x0302, "Cammus C12"),
    (0x0483, 0xA355, "VRS DirectForce Pro"),
    (0x2433, 0xF300, "Asetek Invicta"),
    (0x2433, 0xF301, "Asetek Forte"),
    (0x2433, 0xF303, "Asetek La Prima"),
    (0x2433, 0xF306, "Asetek Tony Kanaan"),
    (0x1FC9, 0x804C, "AccuForce Pro"),
    (0x045E, 0x001B, "Microsoft SideWinder Force Feedback 2"),
    (0x054C, 0x0CE6, "Sony DualSense"),
    (0x054C, 0x0DF2, "Sony DualSense Edge"),
    *(
        (wheels.LOGITECH_VENDOR, one, f"Logitech {name}")
        for one, name in wheels.LOGITECH_PRODUCTS.items()
    ),
    (wheels.LOGITECH_VENDOR, wheels.G923_CONSOLE, "Logitech G923 (PlayStation) in console mode"),
    (joystick.SPACEMOUSE_VENDOR, None, "3Dconnexion SpaceMouse, every model"),
    *(
        (joystick.SPACEMOUSE_OLD_VENDOR, one, "SpaceMouse of Logitech")
        for one in joystick.SPACEMOUSE_OLD_PRODUCTS
    ),
)


def format_rules(other_models: Iterable[tuple[int, int | None, str]] = ()) -> str:
    """Return the rules file for the known models and for `other_models` (vendor, product, name).

    Only the user logged in at the machine may open these devices (`uaccess`).
    """
    models = {model[:2]: model for model in KNOWN_MODELS}
    for model in other_models:
        models.setdefault(model[:2], model)
    lines = [
        "# Haptic devices that the user at this machine may open (tendon-teleop).",
        "# sudo udevadm control --reload , then plug the device in again",
    ]
    for vendor, product, name in models.values():
        lines += ["", f"# {' '.join(name.split())}", _format_usb_rule(vendor, product)]
        lines.append(_format_bluetooth_rule(vendor, product))
    return "\n".join(lines) + "\n"


def _format_usb_rule(vendor: int, product: int | None) -> str:
    model = f', ATTRS{{idProduct}}=="{product:04x}"' if product is not None else ""
    return f'KERNEL=="hidraw*", ATTRS{{idVendor}}=="{vendor:04x}"{model}, TAG+="uaccess"'


def _format_bluetooth_rule(vendor: int, product: int | None) -> str:
    model = f"{product:04X}" if product is not None else "*"
    return f'KERNEL=="hidraw*", KERNELS=="0005:{vendor:04X}:{model}.*", TAG+="uaccess"'
