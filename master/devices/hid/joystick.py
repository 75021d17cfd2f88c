"""Devices without force: any joystick, gamepad or pedal by its descriptor, and the SpaceMouse."""

import struct

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import Controls, DriverError, ReportAccess, Share
from master.devices.hid.input_report import InputReportDecoder


class ForcelessDriver:
    """The part of a `master.devices.hid.driver.HidDriver` that writes nothing to the device."""

    forces: tuple[str, ...] = ()

    def begin(self, device: ReportAccess) -> None:
        """Nothing to set up."""

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:  # noqa: ARG002
        """Return nothing: it has no force."""
        return ()

    def silence(self) -> tuple[bytes, ...]:
        """Return nothing."""
        return ()


class JoystickDriver(ForcelessDriver):
    """A device that is read by its report descriptor.

    `DriverError` if there are no inputs in its descriptor, `DescriptorError`.
    """

    def __init__(self, descriptor: bytes) -> None:
        inputs = InputReportDecoder(parse_descriptor(descriptor))
        if not inputs.axes and not inputs.buttons:
            raise DriverError("no axes and no buttons")
        self.axes, self.buttons = inputs.axes, inputs.buttons
        self._inputs = inputs

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        return self._inputs.decode(controls, report)


# --- 3Dconnexion SpaceMouse: six axes of a spring-centred cap, no force
# Older ones send three axes in report 1 and three in report 2, newer ones all six in report 1,
# distinguished by length. Axes of the device: x right, y towards the user, z down. It reports only
# while the cap is deflected, and once on release, so silence is not a fault. Sources:
# pyspacemouse's list of devices, usbhid-dumps of 256f:c62e and of a SpaceNavigator.


SPACEMOUSE_VENDOR = 0x256F
SPACEMOUSE_OLD_VENDOR = 0x046D  # vendor of the older models
SPACEMOUSE_OLD_PRODUCTS = (
    0xC603,
    0xC605,
    0xC606,
    0xC623,
    0xC625,
    0xC626,
    0xC627,
    0xC628,
    0xC629,
    0xC62B,
)

_FULL_SCALE = 350.0  # SpaceNavigators reach 500, so full scale is at 70 % of their travel
_THREE, _SIX = struct.Struct("<3h"), struct.Struct("<6h")
_BUTTONS = 32


class SpaceMouseDriver(ForcelessDriver):
    """Six axes for rate control."""

    axes: tuple[str, ...] = ("x", "y", "z", "rx", "ry", "rz")
    buttons = _BUTTONS

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        size, kind = len(report), report[0] if report else 0
        if kind == 1 and size >= 13:
            return controls._replace(axes=_unpack_shares(_SIX, report))
        if kind == 1 and size >= 7:
            return controls._replace(axes=_unpack_shares(_THREE, report) + controls.axes[3:])
        if kind == 2 and size >= 7:
            return controls._replace(axes=controls.axes[:3] + _unpack_shares(_THREE, report))
        if kind == 3 and size >= 2:
            buttons = int.from_bytes(report[1:5], "little")
            return Controls(controls.axes, buttons, (1 << _BUTTONS) - 1)
        return controls


def _unpack_shares(layout: struct.Struct, report: bytes) -> tuple[Share, ...]:
    return tuple(
        max(-1.0, min(1.0, count / _FULL_SCALE)) for count in layout.unpack_from(report, 1)
    )
