"""Sony's DualSense, complete enough for the Linux kernel's own driver to accept it.

Facts from the kernel's hid-playstation.c: the driver asks for features 0x05 (calibration), 0x09
(pairing, with the address) and 0x20 (firmware), and wants them in full; over Bluetooth each report
ends in a CRC-32 that begins with 0xA1 (input), 0xA2 (output) or 0xA3 (feature).
"""

import struct
import zlib

from studies.hid.virtual.device import USB, Push, VirtualDevice

LEFT, RIGHT = 0, 1
_FEEDBACK = 0x21
_ADDRESS = bytes((0x01, 0x00, 0x00, 0x5E, 0x00, 0x02))  # lowest byte first


class DualSense(VirtualDevice):
    """See `VirtualDevice`.

    `axes` are left stick x and y, right stick x and y (-1 ... 1), left and right trigger (0 ... 1).
    `pushes` holds what the left and the right trigger resist with: the strongest of its ten zones,
    -1 ... 0, against the pull. `buttons` are bits of bytes 8 (high nibble), 9 and 10: square is 0.
    """

    name = "Sony Interactive Entertainment Wireless Controller"
    vendor, product, serial = 0x054C, 0x0CE6, "02:00:5e:00:00:01"

    def __init__(self, descriptor: bytes, bus: int = USB) -> None:
        super().__init__(descriptor, axes=6, forces=2)
        self.bus = bus
        self.interval = 0.004 if bus == USB else 0.00125
        self.effects = [bytes(11), bytes(11)]
        self._sequence = 0

    def build_inputs(self, now: float) -> list[bytes]:
        """Return the one report there is; nobody touches the pad."""
        self._sequence = (self._sequence + 1) & 0xFF
        body = bytearray(63)
        body[:4] = (128 + round(share * 127) for share in self.axes[:4])
        body[4:6] = (round(share * 255) for share in self.axes[4:])
        body[6] = self._sequence
        body[7] = 0x08 | (self.buttons & 0x0F) << 4
        body[8], body[9] = self.buttons >> 4 & 0xFF, self.buttons >> 12 & 0xFF
        struct.pack_into("<I", body, 27, int(now * 3e6) & 0xFFFFFFFF)
        body[32] = body[36] = 0x80
        body[52] = 0x08
        if self.bus == USB:
            return [b"\x01" + body]
        return [_sign(0xA1, b"\x31\x01" + bytes(body) + bytes(9))]

    def take_output(self, now: float, report: bytes) -> None:
        """Take triggers, and ignore lights and rumble; without its CRC nothing is taken."""
        common = self._read_common(report)
        if common is None:
            self.refused.append(report)
            return
        for side, flag, start in ((RIGHT, 0x04, 10), (LEFT, 0x08, 21)):
            if common[0] & flag:
                self.effects[side] = common[start : start + 11]
        push = Push(now, tuple(-_find_strongest(effect) for effect in self.effects))
        if push.force != self.pushes[-1].force:
            self.pushes.append(push)

    def _read_common(self, report: bytes) -> bytes | None:
        if self.bus == USB:
            return report[1:] if report[0] == 0x02 and len(report) in (48, 63) else None
        whole = report[0] == 0x31 and len(report) == 78 and report[2] == 0x10
        return report[3:74] if whole and report == _sign(0xA2, report[:74]) else None

    def get_feature(self, _now: float, number: int) -> bytes | None:
        if number == 0x05:  # gyro: bias 0, +-8192 at 540 deg/s; accelerometer: +-8192 at 1 g
            gyro = (0, 0, 0, 8192, -8192, 8192, -8192, 8192, -8192, 540, 540)
            body = struct.pack("<11h6h6x", *gyro, 8192, -8192, 8192, -8192, 8192, -8192)
        elif number == 0x09:
            body = _ADDRESS + bytes(13)
        elif number == 0x20:
            body = (
                b"Nov 21 202512:00:00"  # day and time of the build
                + struct.pack("<4xII12xH18x", 0x0616, 0x0110002A, 0x0630)
            )
        else:
            return None
        report = bytes((number,)) + body
        return report if self.bus == USB else _sign(0xA3, report[:-4])


def list_zones(effect: bytes) -> tuple[int, ...]:
    """Return the strength 0 ... 8 of each of the ten zones of a trigger effect."""
    if effect[0] != _FEEDBACK:
        return (0,) * 10
    active, strengths = struct.unpack_from("<HI", effect, 1)
    return tuple((strengths >> 3 * n & 7) + 1 if active >> n & 1 else 0 for n in range(10))


def _find_strongest(effect: bytes) -> float:
    return max(list_zones(effect)) / 8


def _sign(seed: int, report: bytes) -> bytes:
    return report + struct.pack("<I", zlib.crc32(bytes((seed,)) + report))
