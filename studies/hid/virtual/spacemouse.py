"""A 3Dconnexion SpaceMouse: six axes in, a light out; silent while nobody touches it."""

import struct

from studies.hid.virtual.device import VirtualDevice

_AXES = 6


class SpaceMouse(VirtualDevice):
    """See `VirtualDevice`; the newer kind with all axes in one report, or the older with two."""

    name = "3Dconnexion SpaceMouse"
    vendor, serial = 0x256F, "virtual-spacemouse"
    interval = 0.008

    def __init__(self, descriptor: bytes, older: bool = False) -> None:
        super().__init__(descriptor, axes=_AXES, forces=0)
        self.product = 0xC626 if older else 0xC62E
        self.light = False
        self._full = 500 if older else 350
        self._older = older
        self._said = ((0,) * _AXES, 0)

    def build_inputs(self, _now: float) -> list[bytes]:
        """Return reports while the cap is off its centre, and once when it is back."""
        counts = tuple(round(share * self._full) for share in self.axes)
        said, self._said = self._said, (counts, self.buttons)
        reports = []
        if any(counts) or any(said[0]):
            if self._older:
                reports += [
                    struct.pack("<B3h", 1, *counts[:3]),
                    struct.pack("<B3h", 2, *counts[3:]),
                ]
            else:
                reports.append(struct.pack("<B6h", 1, *counts))
        if self.buttons != said[1]:
            reports.append(struct.pack("<BH", 3, self.buttons))
        return reports

    def take_output(self, _now: float, report: bytes) -> None:
        if len(report) == 2 and report[0] == 4:
            self.light = bool(report[1])
        else:
            self.refused.append(report)
