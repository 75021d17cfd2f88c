"""Devices with force that no driver reaches: in another mode, of another protocol, or no HID.

Sources: hid-ids.h of Linux, usb.ids, berarma/new-lg4ff and oversteer, Kimplul/hid-tmff2,
gotzl/hid-fanatecff.
"""

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

LOGITECH, THRUSTMASTER, FANATEC = 0x046D, 0x044F, 0x0EB7
USB_DEVICES = Path("/sys/bus/usb/devices")

_XBOX = (
    "in its mode for an Xbox: `sudo usb_modeswitch -v 046d -p {product} -m 01 -r 01 -C 03 -M "
    "0f00010142` switches it to HID++, whose force has no driver yet either"
)
MODES = {
    (LOGITECH, 0xC260): "a G29 with its switch at PS4: set it to PS3, and plug it in again",
    (LOGITECH, 0xC261): f"a G920 {_XBOX.format(product='c261')}",
    (LOGITECH, 0xC26D): f"a G923 for Xbox {_XBOX.format(product='c26d')}",
    (LOGITECH, 0xC267): "a G923 in console mode, which `teleop devices test` or a session ends",
    (THRUSTMASTER, 0xB65D): "a Thrustmaster wheel before its set-up, which Linux 5.13 and newer do "
    "(hid-thrustmaster); its force has no driver yet",
    (THRUSTMASTER, 0xB691): "a TS-XW in its mode for an Xbox: set its switch to PC",
    (THRUSTMASTER, 0xB69A): "a T248X in its mode for an Xbox: set it to PC",
}
"""By vendor and product: what a device is, in a mode without forces, and what to do."""

PROTOCOLS = {
    "HID++": (LOGITECH, (0xC262, 0xC26E, 0xC268, 0xC272)),  # G920, G923 for Xbox, G PRO
    "Thrustmaster's": (  # T500RS, TX, T300RS in its modes, T150, TMX, TS-PC, TS-XW, T248 and T818
        THRUSTMASTER,
        (0xB65E, 0xB664, 0xB669, 0xB66D, 0xB66E, 0xB66F, 0xB677, 0xB67F, 0xB689, 0xB692, 0xB696),
    ),
    "Fanatec's": (  # ClubSport, CSR Elite, CSL Elite, Podium, CSL DD and GT DD
        FANATEC,
        (0x0001, 0x0004, 0x0005, 0x0006, 0x0007, 0x0011, 0x0020, 0x0E03),
    ),
    "Simagic's": (0x0483, (0x0522,)),
}
"""Vendor and products of wheels whose force is by a protocol without a driver."""

_GUIDE = "docs/how-to/haptic-device.md#arms-with-a-library-of-their-maker"
_ARMS = {  # by vendor, and product if the vendor has others
    (0x1451, None): "Force Dimension omega, delta or sigma: type `omega` of examples/own_package",
    (0x0403, 0xCB48): "Novint Falcon: type `omega` of examples/own_package",
    (0x2988, None): "3D Systems Touch: pyOpenHaptics in a device of your own",
}


class UsbArm(NamedTuple):
    """An arm that is attached to USB, but is no HID device."""

    model: str  # vendor:product
    advice: str


def find_protocol(vendor: int, product: int) -> str:
    """Return whose protocol the force of a wheel is by; empty if none is known."""
    for name, (maker, products) in PROTOCOLS.items():
        if vendor == maker and product in products:
            return name
    return ""


def list_usb_arms() -> list[UsbArm]:
    """Return the attached arms that are driven by a library of their maker."""
    found = []
    for folder in sorted(USB_DEVICES.glob("*")):
        with suppress(OSError, ValueError):
            vendor, product = (
                int((folder / name).read_text(), 16) for name in ("idVendor", "idProduct")
            )
            if arm := _ARMS.get((vendor, product)) or _ARMS.get((vendor, None)):
                found.append(UsbArm(f"{vendor:04x}:{product:04x}", f"{arm} ({_GUIDE})"))
    return found
