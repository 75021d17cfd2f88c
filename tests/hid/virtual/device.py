"""The protocol of a virtual device, and the record of what it does to the hand."""

from typing import NamedTuple, Protocol

USB, BLUETOOTH = 0x03, 0x05  # bus numbers as the Linux kernel has them


class Push(NamedTuple):
    """What a device does to the hand from `time` on."""

    time: float  # [s]
    force: tuple[float, ...]  # share of full scale on each axis, positive along the axis


class VirtualDevice(Protocol):
    """One HID device as its firmware sees it. All bytes begin with the report id.

    Attributes
    ----------
    interval : float
        Time between two input reports [s]; call `inputs` that often.
    axes : list of float
        Where the hand has moved the device, shares of full scale; set it as you like.
    buttons : int
        Bit k is button k + 1; set it as you like.
    pushes : list of Push
        What it did to the hand, an entry for each change, from the moment of power on.
    refused : list of bytes
        Reports that this firmware does not know, or that have the wrong length.
    """

    name: str
    bus: int
    vendor: int
    product: int
    serial: str
    descriptor: bytes
    interval: float
    axes: list[float]
    buttons: int
    pushes: list[Push]
    refused: list[bytes]

    def inputs(self, now: float) -> list[bytes]:
        """Return the input reports of this moment; also moves the device's own clock on."""

    def output(self, now: float, report: bytes) -> None:
        """Take an output report."""

    def set_feature(self, now: float, report: bytes) -> None:
        """Take a feature report."""

    def get_feature(self, now: float, number: int) -> bytes | None:
        """Return feature report `number`; None if there is none."""

    def get_input(self, now: float, number: int) -> bytes | None:
        """Return input report `number` as it is now; None if that cannot be asked for."""
