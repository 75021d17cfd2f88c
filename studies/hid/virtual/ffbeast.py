"""The vendor interface of an FFBeast wheel: torque as a number; the state in every report.

Facts from the maker's page (ffbeast.github.io): report A3 both ways, 65 bytes; kind 10 is direct
control with a spring, a constant and a periodic force and a drop in percent, then filling. When the
wheel takes itself back is not said there: this one never does.
"""

import struct

from studies.hid.virtual.device import Push, VirtualDevice

_REPORT, _DIRECT = 0xA3, 0x10
_SIZE = 65


class FFBeast(VirtualDevice):
    """See `VirtualDevice`; pushes as it is told, positive along the axis."""

    name, vendor, product, serial = "FFBeast", 0x045B, 0x59D7, "virtual-ffbeast"

    def __init__(self, descriptor: bytes) -> None:
        super().__init__(descriptor, axes=1, forces=1)

    def build_inputs(self, _now: float) -> list[bytes]:
        """Return firmware, registered, position, torque."""
        counts = round(self.axes[0] * 10_000)
        head = struct.pack("<B4BBhh", _REPORT, 1, 2, 3, 4, 1, counts, 0)
        return [head.ljust(_SIZE, b"\0")]

    def take_output(self, now: float, report: bytes) -> None:
        if len(report) != _SIZE or report[:2] != bytes((_REPORT, _DIRECT)):
            self.refused.append(report)
            return
        (constant,) = struct.unpack_from("<h", report, 4)
        self.pushes.append(Push(now, (constant / 10_000,)))
