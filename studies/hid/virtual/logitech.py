"""A Logitech G29: commands of seven bytes behind a zero; holds a force until it is told otherwise.

Facts from Linux hid-lg4ff.c: 11 downloads and plays a force in slot 1, type 08 is a constant one of
8 bits about 80; 13 stops the slot; F5 turns the spring off that centres the wheel from power on.
Which side a level above 80 pushes to is not said there: here it is the left.
"""

import struct

from studies.hid.virtual.device import Push, VirtualDevice

_HAT_AT_REST = 8


class Logitech(VirtualDevice):
    """See `VirtualDevice`; one axis, pedals up."""

    name, vendor, product, serial = "Logitech G29", 0x046D, 0xC24F, ""
    interval = 0.002

    def __init__(self, descriptor: bytes) -> None:
        super().__init__(descriptor, axes=1, forces=1)
        self.centred = True

    def build_inputs(self, _now: float) -> list[bytes]:
        """Return hat and buttons, steering, three pedals."""
        steering = round((self.axes[0] + 1.0) * 32767.5)
        return [struct.pack("<IHBBB3x", _HAT_AT_REST | self.buttons << 4, steering, 255, 255, 255)]

    def take_output(self, now: float, report: bytes) -> None:
        known = len(report) == 8 and report[0] == 0
        if known and report[1:3] == b"\x11\x08":
            self.pushes.append(Push(now, ((0x80 - report[3]) / 127,)))
        elif known and report[1] == 0x13:
            self.pushes.append(Push(now, (0.0,)))
        elif known and report[1] == 0xF5:
            self.centred = False
        else:
            self.refused.append(report)
