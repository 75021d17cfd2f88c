"""What a driver is: the bytes of one kind of device, and nothing else.

A driver is a codec. It owns no handle, no thread and no clock; `begin` alone talks to the device,
through the `Features` it is lent. `master.devices.hid.device` carries the bytes.
"""

import math
from typing import NamedTuple, Protocol

Share = float  # of full scale, -1 ... 1


class DriverError(ValueError):
    """The device does not do what its driver needs; the message says what."""


class Controls(NamedTuple):
    """What a device's inputs say."""

    axes: tuple[Share, ...]  # in the order of `Driver.axes`; a one-sided axis is 0 ... 1
    buttons: int  # those held; bit k is button k + 1
    known: int  # those of which the device has told whether they are held


def unknown(axes: int) -> Controls:
    """Return what is known of a device that has not reported anything yet."""
    return Controls((math.nan,) * axes, 0, 0)


class Features(Protocol):
    """The way to a device while it is set up. All bytes begin with the report id."""

    def write(self, report: bytes) -> None:
        """Send an output report; raises `DeviceFault` if it could not be sent."""

    def send_feature(self, report: bytes) -> None:
        """Send a feature report; raises `DeviceFault` if it could not be sent."""

    def get_feature(self, number: int, length: int) -> bytes:
        """Return feature report `number`, at most `length` bytes; `DeviceFault` if it has none."""


class Driver(Protocol):
    """One kind of device.

    Attributes
    ----------
    axes : tuple of str
        Names of the inputs, as a config gives them (`x`, `rz`, `l2`, ...).
    forces : tuple of str
        Those of `axes` that can be pushed; may be empty.
    buttons : int
        How many there are.
    """

    axes: tuple[str, ...]
    forces: tuple[str, ...]
    buttons: int

    def begin(self, device: Features) -> None:
        """Set the device up, without force; `DriverError` if it cannot do it, `DeviceFault`."""

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return what `report` changes in `controls`; a report of another kind changes nothing.

        Never raises, whatever the bytes: what does not fit the layout is ignored.
        """

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:
        """Return the reports that make the device push with `force`: a share for each of `forces`.

        Positive pushes towards larger values of the axis, as far as the driver knows. A share
        beyond -1 ... 1 is taken to the nearer end, one that is not a number is no force. With `arm`
        the reports also restart the device's own clock, after which its force runs out.
        """

    def silence(self) -> tuple[bytes, ...]:
        """Return the reports that take all force away and let go of the device."""
