"""The vendor interface of an FFBeast wheel: torque as a number; the state in every report.

Facts from the maker's page (ffbeast.github.io): report A3 both ways, 65 bytes; kind 10 is direct
control with a spring, a constant and a periodic force and a drop in percent, then filling. When the
wheel takes itself back is not said there: this one never does.
"""

import math
import struct

from tests.hid.virtual.device import USB, Push

_REPORT, _DIRECT = 0xA3, 0x10
_SIZE = 65


class FFBeast:
    """See `VirtualDevice`; pushes as it is told, positive along the axis."""

    name, vendor, product, serial = "FFBeast", 0x045B, 0x59D7, "virtual-ffbeast"
    bus = USB
    interval = 0.001

    def __init__(self, descriptor: bytes) -> None:
        self.descriptor = descriptor
        self.axes = [0.0]
        self.buttons = 0  # it has none
        self.pushes = [Push(-math.inf, (0.0,))]
        self.refused: list[bytes] = []

    def inputs(self, _now: float) -> list[bytes]:
        """Return firmware, registered, position, torque."""
        counts = round(self.axes[0] * 10_000)
        head = struct.pack("<B4BBhh", _REPORT, 1, 2, 3, 4, 1, counts, 0)
        return [head.ljust(_SIZE, b"\0")]

    def output(self, now: float, report: bytes) -> None:
        """Take the constant force."""
        if len(report) != _SIZE or report[:2] != bytes((_REPORT, _DIRECT)):
            self.refused.append(report)
            return
        (constant,) = struct.unpack_from("<h", report, 4)
        self.pushes.append(Push(now, (constant / 10_000,)))

    def set_feature(self, _now: float, report: bytes) -> None:
        """Nothing is set this way here."""
        self.refused.append(report)

    def get_input(self, _now: float, _number: int) -> bytes | None:
        """Nothing is asked for this way."""
        return None

    def get_feature(self, _now: float, _number: int) -> bytes | None:
        """There is none."""
        return None
