"""OpenFFBoard, with one or two axes: control by mask, directions in hundredths of a degree.

Facts read from its source (github.com/Ultrawipf/OpenFFBoard: HidFFB.cpp, EffectsCalculator.cpp,
ffb_defs.h): no watchdog; Set Effect switches the motors on; duration 0 is for ever, too; any of
disable, stop, reset and pause switches them off. The state is sent after each control and cannot
be asked for: paused unless the motors are on, always with power, never with a safety switch.
"""

import math
import struct
from typing import ClassVar

from studies.hid.virtual.pid import INFINITE_MS, OUTPUTS, PidFirmware, to_seconds

_ENABLE, _DISABLE, _STOP, _RESET, _PAUSE, _CONTINUE = (1 << bit for bit in range(6))
_PAUSED, _ON, _POWER = 0x01, 0x02, 0x08


class OpenFFBoard(PidFirmware):
    name = "Open_FFBoard FFBoard"
    vendor, product, serial = 0x1209, 0xFFB0, "virtual-ffb"
    outputs: ClassVar = OUTPUTS | {0x01: ("set_effect", 22)}
    creation, loading, pooling = 0x11, 0x12, 0x13
    slots = 40
    answers_state = False
    full_scale = 32767

    def build_report(self) -> bytes:
        counts = [round(share * 32767) for share in self.axes]
        return struct.pack("<BQ8h", 0x01, self.buttons, *counts, *[0] * (8 - len(counts)))

    def build_state(self) -> bytes:
        return bytes((0x02, (_ON if self.active else _PAUSED) | (_POWER if self.powered else 0)))

    def set_effect(self, report: bytes) -> None:
        """Take duration, gain and direction, and switch the motors on."""
        if (effect := self.effects.get(report[1])) is None:
            return
        effect.kind = report[2]
        (milliseconds,) = struct.unpack_from("<H", report, 3)
        effect.duration = to_seconds(milliseconds or INFINITE_MS)
        effect.gain = (report[11] + 1) / 256
        effect.pull = self._compute_pull(
            report[13], struct.unpack_from(f"<{len(self.axes)}H", report, 14)
        )
        self.active = True

    def _compute_pull(self, enable: int, directions: tuple[int, ...]) -> tuple[float, ...]:
        if enable & 1 << len(self.axes):
            angle = math.radians(directions[0] / 100)
            return (-math.sin(angle), math.cos(angle))[: len(self.axes)]
        linear = [(direction - 18000) / 18000 for direction in directions]
        return tuple(
            sign * share if enable & 1 << axis else 0.0
            for axis, (sign, share) in enumerate(zip((-1, 1), linear, strict=False))
        )

    def control_device(self, report: bytes) -> None:
        """Take a mask; several bits act in this order."""
        mask = report[1]
        if mask & _ENABLE:
            self.active = True
        if mask & (_DISABLE | _STOP | _RESET | _PAUSE):
            self.active = False
        if mask & _RESET:
            self.effects.clear()
        if mask & _CONTINUE:
            self.active = True

    def set_device_gain(self, report: bytes) -> None:
        self.gain = (report[1] + 1) / 256


class OpenFFBoardWheel(OpenFFBoard):
    """One axis: one direction word less, and the direction bit one further down."""

    serial = "virtual-ffb-wheel"
    outputs: ClassVar = OpenFFBoard.outputs | {0x01: ("set_effect", 18)}

    def __init__(self, descriptor: bytes) -> None:
        super().__init__(descriptor, axes=1)
