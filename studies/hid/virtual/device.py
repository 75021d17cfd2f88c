"""The base of virtual devices, and the record of what they do to the hand."""

import math
from typing import NamedTuple

USB, BLUETOOTH = 0x03, 0x05  # bus numbers as the Linux kernel has them


class Push(NamedTuple):
    """What a device does to the hand from `time` on."""

    time: float  # [s]
    force: tuple[float, ...]  # share of full scale on each axis, positive along the axis


class VirtualDevice:
    """One HID device as its firmware sees it. All bytes begin with the report id.

    Set `axes` and `buttons` as you like.
    """

    name: str
    bus = USB
    vendor: int
    product: int
    serial: str
    interval = 0.001  # [s] between two input reports; call `inputs` that often

    def __init__(self, descriptor: bytes, axes: int, forces: int) -> None:
        self.descriptor = descriptor
        self.axes = [0.0] * axes  # where the hand has moved the device, shares of full scale
        self.buttons = 0  # bit k is button k + 1
        self.pushes = [Push(-math.inf, (0.0,) * forces)]  # what it did to the hand, each change
        self.refused: list[bytes] = []  # reports that are unknown, or of the wrong length

    def build_inputs(self, now: float) -> list[bytes]:
        """Return the input reports of this moment; also moves the device's own clock on."""
        raise NotImplementedError

    def take_output(self, now: float, report: bytes) -> None:
        raise NotImplementedError

    def set_feature(self, _now: float, report: bytes) -> None:
        """Take a feature report; here there is none."""
        self.refused.append(report)

    def get_feature(self, _now: float, _number: int) -> bytes | None:
        """Return feature report `number`; None if there is none."""
        return None

    def get_input(self, _now: float, _number: int) -> bytes | None:
        """Return input report `number` as it is now; None if that cannot be asked for."""
        return None
