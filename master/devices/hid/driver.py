"""The driver interface: the report codec of one kind of device.

A driver owns no handle, no thread and no clock; only `begin` talks to the device, through its
`ReportAccess` argument. `master.devices.hid.device` transfers the reports.
"""

import math
from typing import NamedTuple, Protocol

from master.devices.hid.actuators import ActuatorState

Share = float  # of full scale, -1 ... 1


class DriverError(ValueError):
    """The device lacks something its driver needs; the message says what."""


class Controls(NamedTuple):
    """The inputs of a device."""

    axes: tuple[Share, ...]  # in the order of `Driver.axes`; a one-sided axis is 0 ... 1
    buttons: int  # those held; bit k is button k + 1
    known: int  # mask of the buttons reported so far
    actuators: ActuatorState | None = None  # None before the first report, or without any


def build_unknown_controls(axes: int) -> Controls:
    """Return the inputs of a device that has not reported yet."""
    return Controls((math.nan,) * axes, 0, 0)


class ReportAccess(Protocol):
    """Access to a device during setup. All bytes begin with the report id."""

    def write(self, report: bytes) -> None:
        """Send an output report; raises `DeviceFault` if it could not be sent."""

    def send_feature(self, report: bytes) -> None:
        """Send a feature report; raises `DeviceFault` if it could not be sent."""

    def get_feature(self, number: int, length: int) -> bytes:
        """Return feature report `number`, at most `length` bytes; `DeviceFault` if it has none."""

    def get_input(self, number: int, length: int) -> bytes:
        """Return input report `number`, at most `length` bytes; `DeviceFault` if it has none."""


class HidDriver(Protocol):
    """One kind of device.

    Attributes
    ----------
    axes : tuple of str
        Names of the inputs, as a config gives them (`x`, `rz`, `l2`, ...).
    forces : tuple of str
        Those of `axes` with a force; may be empty.
    buttons : int
        Their number.
    """

    axes: tuple[str, ...]
    forces: tuple[str, ...]
    buttons: int

    def begin(self, device: ReportAccess) -> None:
        """Set the device up, without force; raises `DriverError` or `DeviceFault`."""

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`; other reports are ignored.

        Never raises; bytes that do not fit the layout are ignored.
        """

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:
        """Return the reports that render `force`: a share for each of `forces`.

        Positive pushes towards larger values of the axis, as far as the driver knows. Shares are
        clipped to -1 ... 1, NaN is zero. With `arm` the reports also restart the device's own force
        timeout.
        """

    def silence(self) -> tuple[bytes, ...]:
        """Return the reports that remove all force and release the device."""
