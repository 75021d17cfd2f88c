"""Logitech's classic wheels: commands of seven bytes, no report id, a force of eight bits.

hidapi expects a zero in place of the id. The wheel holds a force until the next command. Source:
Linux hid-lg4ff.c. Wheels with the HID++ protocol (G920, G923 for Xbox, G Pro) are others.
"""

from master.devices.hid.bits import scaled
from master.devices.hid.descriptor import Descriptor
from master.devices.hid.driver import Controls, DriverError, Features, Share
from master.devices.hid.inputs import Inputs

VENDOR = 0x046D
# G29 with its switch at PS3, Driving Force GT, G25, G27, Driving Force Pro, G923 for PlayStation
PRODUCTS = (0xC24F, 0xC29A, 0xC299, 0xC29B, 0xC298, 0xC267)

_STEERING = "x"
_CENTRE_OFF = bytes((0, 0xF5, 0, 0, 0, 0, 0, 0))
_STOP = bytes((0, 0x13, 0, 0, 0, 0, 0, 0))  # the force in slot 1
_PLAY = tuple(bytes((0, 0x11, 0x08, level, 0x80, 0, 0, 0)) for level in range(256))
_ZERO = 0x80


class LogitechDriver:
    """A `master.devices.hid.driver.Driver`: inputs by descriptor, force on the steering.

    Pedals read 1 while released. The direction of a level above 0x80 is not documented; `teleop
    devices test` finds it.

    Parameters
    ----------
    descriptor : Descriptor
        Of the wheel; `DriverError` if it has no steering axis.
    """

    forces: tuple[str, ...] = (_STEERING,)

    def __init__(self, descriptor: Descriptor) -> None:
        inputs = Inputs(descriptor)
        if _STEERING not in inputs.axes:
            raise DriverError("its report descriptor has no steering axis")
        self.axes, self.buttons = inputs.axes, inputs.buttons
        self._inputs = inputs

    def begin(self, device: Features) -> None:
        """Turn off the centring spring, and stop effects of other programs."""
        device.write(_CENTRE_OFF)
        device.write(_STOP)

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        return self._inputs.decode(controls, report)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:  # noqa: ARG002
        """Return the command that plays `force` in slot 1."""
        return (_PLAY[_ZERO + scaled(force[0], 127)],)

    def silence(self) -> tuple[bytes, ...]:
        """Return the command that stops slot 1."""
        return (_STOP,)
