"""Any joystick, gamepad or pedal: axes and buttons, no force, from its report descriptor."""

from master.devices.hid.descriptor import parse_descriptor
from master.devices.hid.driver import Controls, DriverError, ReportAccess, Share
from master.devices.hid.inputs import Inputs


class JoystickDriver:
    """A `master.devices.hid.driver.HidDriver` that writes nothing to the device.

    Parameters
    ----------
    descriptor : bytes
        Of the device; `DriverError` if there are no inputs in it, `DescriptorError`.
    """

    forces: tuple[str, ...] = ()

    def __init__(self, descriptor: bytes) -> None:
        inputs = Inputs(parse_descriptor(descriptor))
        if not inputs.axes and not inputs.buttons:
            raise DriverError("no axes and no buttons")
        self.axes, self.buttons = inputs.axes, inputs.buttons
        self._inputs = inputs

    def begin(self, device: ReportAccess) -> None:
        """Nothing to set up."""

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        return self._inputs.decode(controls, report)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:  # noqa: ARG002
        """Return nothing: it has no force."""
        return ()

    def silence(self) -> tuple[bytes, ...]:
        """Return nothing."""
        return ()
