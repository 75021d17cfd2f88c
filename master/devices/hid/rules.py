"""Permission to open HID devices on Linux: a udev rule for each model.

They belong into a file that comes before 73-seat-late.rules, which reads the tag that they set.
"""

from collections.abc import Iterable

from master.devices.hid import logitech, spacemouse

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
    *((logitech.VENDOR, one, f"Logitech {name}") for one, name in logitech.PRODUCTS.items()),
    (logitech.VENDOR, logitech.G923_CONSOLE, "Logitech G923 (PlayStation) in console mode"),
    (spacemouse.VENDOR, None, "3Dconnexion SpaceMouse, every model"),
    *((spacemouse.LOGITECH, one, "SpaceMouse of Logitech") for one in spacemouse.LOGITECH_PRODUCTS),
)


def format_rules(others: Iterable[tuple[int, int | None, str]] = ()) -> str:
    """Return the rules file for the known models and for `others` (vendor, product, name).

    Only the user logged in at the machine may open these devices (`uaccess`).
    """
    known = {one[:2]: one for one in KNOWN_MODELS}
    for one in others:
        known.setdefault(one[:2], one)
    lines = [
        "# Haptic devices that the user at this machine may open (tendon-teleop).",
        "# sudo udevadm control --reload , then plug the device in again",
    ]
    for vendor, product, name in known.values():
        lines += ["", f"# {' '.join(name.split())}", _format_usb_rule(vendor, product)]
        lines.append(_format_bluetooth_rule(vendor, product))
    return "\n".join(lines) + "\n"


def _format_usb_rule(vendor: int, product: int | None) -> str:
    model = f', ATTRS{{idProduct}}=="{product:04x}"' if product is not None else ""
    return f'KERNEL=="hidraw*", ATTRS{{idVendor}}=="{vendor:04x}"{model}, TAG+="uaccess"'


def _format_bluetooth_rule(vendor: int, product: int | None) -> str:
    model = f"{product:04X}" if product is not None else "*"
    return f'KERNEL=="hidraw*", KERNELS=="0005:{vendor:04X}:{model}.*", TAG+="uaccess"'
