"""The Arduino FFB library on a Leonardo: control by number, directions in a byte, no start delay.

Facts read from its source (github.com/YukMingLaw/ArduinoJoystickWithFFBLibrary: Joystick.cpp,
DynamicHID/PIDReportHandler.cpp): no watchdog; "disable actuators" and the device gain do nothing;
the direction counts only if the enable byte is exactly 4; X and Y push the other way round than
OpenFFBoard's (in some versions); reading the pool frees all effects; reading a block load clears
its block.
"""

import math
import struct
from typing import ClassVar

from studies.hid.virtual.pid import OUTPUTS, PidFirmware, to_seconds

_DIRECTION_ONLY = 0x04
_BOTH = 0x03
_STOP_ALL, _RESET, _PAUSE, _CONTINUE = 3, 4, 5, 6
_STOP = 3
_FOR_EVER = 0xFF
_ALL = 0xFF
_HAT_AT_REST = 0x0F


class Arduino(PidFirmware):
    """A sketch with 32 buttons, a hat and two axes."""

    name = "Arduino LLC Arduino Leonardo"
    vendor, product, serial = 0x2341, 0x8036, "virtual-arduino"
    outputs: ClassVar = OUTPUTS | {0x01: ("set_effect", 18)}
    creation, loading, pooling = 0x05, 0x06, 0x07
    slots = 13
    full_scale = 10000

    def __init__(self, descriptor: bytes) -> None:
        super().__init__(descriptor)
        self.active = True

    def build_report(self) -> bytes:
        x, y = (round(share * 32767) for share in self.axes)
        return struct.pack("<BIBhh", 0x01, self.buttons, _HAT_AT_REST, x, y)

    def set_effect(self, report: bytes) -> None:
        if (effect := self.effects.get(report[1])) is None:
            return
        effect.kind = report[2]
        (milliseconds,) = struct.unpack_from("<H", report, 3)
        effect.duration = to_seconds(milliseconds)
        effect.gain = report[9] / 255
        effect.pull = _compute_pull(enable=report[11], x=report[12], y=report[13])

    def operate_effect(self, report: bytes) -> None:
        """Start or stop an effect; a loop count of 255 changes its duration."""
        if report[2] != _STOP and report[3] == _FOR_EVER and report[1] in self.effects:
            self.effects[report[1]].duration = to_seconds(0x7FFF)
        super().operate_effect(report)

    def free_block(self, report: bytes) -> None:
        """Forget one effect, or all."""
        if report[1] == _ALL:
            self.effects.clear()
        super().free_block(report)

    def control_device(self, report: bytes) -> None:
        command = report[1]
        if command == _STOP_ALL:
            self.stop_all()
        elif command == _RESET:
            self.effects.clear()
        elif command == _PAUSE:
            self.active = False
        elif command == _CONTINUE:
            self.active = True

    def set_device_gain(self, report: bytes) -> None:
        """Stored by the firmware, and never used."""

    def read_load(self) -> tuple[int, int]:
        """Return the last creation, its block only once."""
        loaded, self.loaded = self.loaded, (0, self.loaded[1])
        return loaded

    def read_pool(self) -> tuple[int, int]:
        self.effects.clear()
        return self.slots + 1, 3


def _compute_pull(enable: int, x: int, y: int) -> tuple[float, float]:
    """Return what each axis feels: one direction for both, or else one each, of those enabled."""
    if enable == _DIRECTION_ONLY:
        enable, y = _BOTH, x
    angles = 2 * math.pi * x / 255, 2 * math.pi * y / 255
    return (math.sin(angles[0]) if enable & 1 else 0.0, -math.cos(angles[1]) if enable & 2 else 0.0)
