"""A stick like VPforce's Rhino: ids from 101, control by number with disable before enable.

Facts from the reports that telemetry programs send it (walmis/TelemFFB): gain in 16 bits, 4096 is
full; magnitudes up to 4096; direction in a byte; the start delay last. The firmware is closed: how
it treats directions is taken from the PID standard (a force comes *from* its direction), and the
rest from what the open firmwares do.
"""

import math
import struct
from typing import ClassVar

from studies.hid.virtual.pid import PidFirmware, to_seconds

_DISABLE, _ENABLE, _STOP_ALL, _RESET, _PAUSE, _CONTINUE = 1, 2, 3, 4, 5, 6
_ENABLED, _SAFETY, _POWER = 0x04, 0x08, 0x10
_HATS_AT_REST = 0xFFFF


class Rhino(PidFirmware):
    """Two axes, and more inputs that stay where they are."""

    name = "VPforce Rhino FFB Joystick"
    vendor, product, serial = 0xFFFF, 0x2055, "virtual-rhino"
    outputs: ClassVar = {
        101: ("set_effect", 17),
        103: ("set_condition", 15),
        105: ("set_constant", 4),
        110: ("operate_effect", 4),
        111: ("free_block", 2),
        112: ("control_device", 2),
        113: ("set_device_gain", 2),
    }
    creation, loading, pooling = 5, 6, 7
    slots = 64
    full_scale = 4096

    def build_report(self) -> bytes:
        x, y = (round(share * 4096) for share in self.axes)
        first, more = self.buttons & (1 << 48) - 1, self.buttons >> 48
        head = struct.pack("<B3h4x", 0x01, x, y, 0)
        return head + first.to_bytes(6, "little") + struct.pack("<HH13x", _HATS_AT_REST, more)

    def build_state(self) -> bytes:
        """Tell of the motors, as its descriptor has it; what the firmware does is not known."""
        flags = (
            (_ENABLED if self.active else 0)
            | (_SAFETY if self.safety else 0)
            | (_POWER if self.powered else 0)
        )
        return bytes((0x02, 0, flags))

    def set_effect(self, report: bytes) -> None:
        if (effect := self.effects.get(report[1])) is None:
            return
        effect.kind = report[2]
        milliseconds, gain = struct.unpack_from("<H4xH", report, 3)
        effect.duration = to_seconds(milliseconds)
        effect.gain = gain / 4096
        angle = 2 * math.pi * report[13] / 255
        effect.pull = (-math.sin(angle), math.cos(angle)) if report[12] & 4 else (0.0, 0.0)

    def control_device(self, report: bytes) -> None:
        command = report[1]
        if command in (_ENABLE, _CONTINUE):
            self.active = True
        elif command in (_DISABLE, _PAUSE, _RESET):
            self.active = False
        if command == _STOP_ALL:
            self.stop_all()
        elif command == _RESET:
            self.effects.clear()

    def set_device_gain(self, report: bytes) -> None:
        self.gain = report[1] / 255
