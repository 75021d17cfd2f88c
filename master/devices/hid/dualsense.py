"""Sony DualSense: sticks, buttons and the two triggers, each with a resistance.

A trigger renders a stiffness cue, not a streamed torque: the host sets its resistance in each of
ten zones of the pull (here the same in all), in eight steps. It only pushes back, so a force along
the pull has no effect. It keeps a resistance until it is changed. Sources: Linux hid-playstation.c
(the layouts, the checksums, the sequence number), Nielk1's notes on trigger effects.
"""

import math
import struct
import zlib

from master.devices.hid.driver import Controls, ReportAccess, Share

VENDOR = 0x054C
PRODUCTS = (0x0CE6, 0x0DF2)  # DualSense, DualSense Edge

_BUTTONS = 20
STEPS = 8  # strengths of a zone
ZONES = 10

_USB_IN, _BLUETOOTH_IN = 0x01, 0x31
_USB_OUT, _BLUETOOTH_OUT = 0x02, 0x31
_USB_IN_SIZE, _BLUETOOTH_SIZE = 64, 78
_CALIBRATION, _CALIBRATION_SIZE = 0x05, 41  # reading it makes Bluetooth send full reports
_TRIGGERS = 0x04 | 0x08  # valid flags of an output report: right and left trigger only
_CHECKED_SIZE = _BLUETOOTH_SIZE - 4  # bytes covered by the checksum, after a seed
_SEED_IN, _SEED_OUT = zlib.crc32(b"\xa1"), zlib.crc32(b"\xa2")
_CHECKSUM = struct.Struct("<I")
_STICK = tuple(max(-1.0, (count - 128) / 127.0) for count in range(256))
_TRIGGER = tuple(count / 255.0 for count in range(256))


def _build_trigger_effect(strength: int) -> bytes:
    """Return the 11 bytes of a trigger that resists with `strength` of `STEPS` in all zones."""
    if strength == 0:
        return struct.pack("<B10x", 0x05)
    zones, forces = (1 << ZONES) - 1, sum((strength - 1) << 3 * zone for zone in range(ZONES))
    return struct.pack("<BHI4x", 0x21, zones, forces)


_EFFECTS = tuple(_build_trigger_effect(strength) for strength in range(STEPS + 1))


def quantise_force(force: Share) -> int:
    """Return the step of resistance for a share of full force; zero along the pull."""
    return math.ceil(min(-force, 1.0) * STEPS) if force < 0.0 else 0


class DualSenseDriver:
    """A `master.devices.hid.driver.HidDriver` of four stick axes and two triggers (0 ... 1).

    Buttons from 1: square, cross, circle, triangle, L1, R1, L2, R2, create, options, L3, R3, PS,
    touchpad, mute; 17 to 20 are the Edge's. Sticks count right and down as positive.

    `encode` returns a report if a strength has changed since the last call; over Bluetooth each
    report has a sequence number. With `arm` it repeats the report, which may have been lost.
    """

    axes: tuple[str, ...] = ("lx", "ly", "rx", "ry", "l2", "r2")
    forces: tuple[str, ...] = ("l2", "r2")
    buttons = _BUTTONS

    def __init__(self, bluetooth: bool = False) -> None:
        self._bluetooth = bluetooth
        self._sequence = 0
        self._strengths = (-1, -1)  # left, right, last requested

    def begin(self, device: ReportAccess) -> None:
        """Release both triggers; over Bluetooth, request full reports."""
        if self._bluetooth:
            device.get_feature(_CALIBRATION, _CALIBRATION_SIZE)
        device.write(self._report(0, 0))

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return the controls of a full report; over Bluetooth the checksum must match."""
        size, kind = len(report), report[0] if report else 0
        if kind == _USB_IN and size >= _USB_IN_SIZE:
            at = 1
        elif kind == _BLUETOOTH_IN and size >= _BLUETOOTH_SIZE:
            if (zlib.crc32(report[:_CHECKED_SIZE], _SEED_IN),) != _CHECKSUM.unpack_from(
                report, _CHECKED_SIZE
            ):
                return controls
            at = 2
        else:
            return controls
        lx, ly, rx, ry, l2, r2, _, first, second, third = report[at : at + 10]
        sticks = (_STICK[lx], _STICK[ly], _STICK[rx], _STICK[ry])
        buttons = first >> 4 | second << 4 | third << 12
        return Controls((*sticks, _TRIGGER[l2], _TRIGGER[r2]), buttons, (1 << _BUTTONS) - 1)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:
        """Return a report if a resistance changes or with `arm`."""
        strengths = quantise_force(force[0]), quantise_force(force[1])
        if strengths == self._strengths and not arm:
            return ()
        self._strengths = strengths
        return (self._report(*strengths),)

    def silence(self) -> tuple[bytes, ...]:
        """Return a report that releases both triggers."""
        return (self._report(0, 0),)

    def _report(self, left: int, right: int) -> bytes:
        body = bytearray(47)
        body[0] = _TRIGGERS
        body[10:21], body[21:32] = _EFFECTS[right], _EFFECTS[left]
        if not self._bluetooth:
            return bytes((_USB_OUT, *body))
        head = bytes((_BLUETOOTH_OUT, self._sequence << 4, 0x10))
        self._sequence = (self._sequence + 1) % 16
        covered = (head + body).ljust(_CHECKED_SIZE, b"\0")
        return covered + _CHECKSUM.pack(zlib.crc32(covered, _SEED_OUT))
