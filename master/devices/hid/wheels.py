"""Wheels with a protocol of their maker: Logitech's classic ones, and FFBeast.

Logitech's classic wheels take commands of seven bytes without a report id, with a force of eight
bits. hidapi expects a zero in place of the id. The wheel holds a force until the next command.
Sources: hid-lg.c, hid-lg4ff.c and hid-ids.h of Linux; for the G923 the same files of
berarma/new-lg4ff. Wheels with the HID++ protocol (G920, G923 for Xbox, G Pro) are others.
"""

import struct

from master.devices.hid.descriptor import ReportDescriptor, scale_share
from master.devices.hid.driver import Controls, DriverError, ReportAccess, Share
from master.devices.hid.input_report import InputReportDecoder

LOGITECH_VENDOR = 0x046D
LOGITECH_PRODUCTS = {
    0xC24F: "G29",  # its switch at PS3
    0xC266: "G923 (PlayStation)",  # in PC mode
    0xC29B: "G27",
    0xC299: "G25",
    0xC29A: "Driving Force GT",
    0xC298: "Driving Force Pro",
    0xC294: "Driving Force, Formula Force EX, or a later wheel in their mode",
    0xC295: "MOMO Force",
    0xCA03: "MOMO Racing",
    0xC29C: "Speed Force Wireless",
    0xC293: "WingMan Formula Force GP",
}
G923, G923_CONSOLE = 0xC266, 0xC267
LEAVE_CONSOLE = bytes((0x30, 0xF8, 0x09, 0x07, 0x01, 0x01, 0, 0))  # report 0x30; detaches

_STEERING = "x"
_FORMULA_FORCE_EX = (0xC294, 0x2100)  # product and release
_CENTRE_OFF = bytes((0, 0xF5, 0, 0, 0, 0, 0, 0))
_CENTRE_OFF_EX = bytes((0, 0xFE, 0x03, 0, 0, 0, 0, 0))  # a centring force of zero
_STOP = bytes((0, 0x13, 0, 0, 0, 0, 0, 0))  # the force in slot 1
_PLAY = tuple(bytes((0, 0x11, 0x08, level, 0x80, 0, 0, 0)) for level in range(256))
_ZERO = 0x80


class LogitechDriver:
    """A `master.devices.hid.driver.HidDriver`: inputs by descriptor, force on the steering.

    Pedals read 1 while released. The direction of a level above 0x80 is not documented; `teleop
    devices test` finds it. `DriverError` if the wheel's descriptor has no steering axis; `product`
    and `release` are of its USB descriptor.
    """

    forces: tuple[str, ...] = (_STEERING,)

    def __init__(self, descriptor: ReportDescriptor, product: int = 0, release: int = 0) -> None:
        formula_force_ex = (product, release) == _FORMULA_FORCE_EX
        self._centre_off = _CENTRE_OFF_EX if formula_force_ex else _CENTRE_OFF
        inputs = InputReportDecoder(descriptor)
        if _STEERING not in inputs.axes:
            raise DriverError("its report descriptor has no steering axis")
        self.axes, self.buttons = inputs.axes, inputs.buttons
        self._inputs = inputs

    def begin(self, device: ReportAccess) -> None:
        """Turn off the centring spring, and stop effects of other programs."""
        device.write(self._centre_off)
        device.write(_STOP)

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        return self._inputs.decode(controls, report)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:  # noqa: ARG002
        """Return the command that plays `force` in slot 1."""
        return (_PLAY[_ZERO + scale_share(force[0], 127)],)

    def silence(self) -> tuple[bytes, ...]:
        """Return the command that stops slot 1."""
        return (_STOP,)


# --- the vendor interface of an FFBeast wheel: torque as a number, the state in every report
# Layout as the maker publishes it (ffbeast.github.io, docs/en/wheel_programming.md). The interface
# has no buttons: those are on the wheel's second interface, a joystick. Without direct control for
# "an extended period" a wheel returns to its default mode; the maker does not specify the time.


FFBEAST_VENDOR, FFBEAST_PRODUCT = 0x045B, 0x59D7

_REPORT = 0xA3  # of both directions
_OVERRIDE = 0x10  # "override data": direct control
_FULL_SCALE = 10_000  # of position and force
_POSITION = struct.Struct("<h")
_POSITION_AT = 6
_CONTROL = struct.Struct("<BBhhhB56x")  # id, kind, spring, constant, periodic, force drop [%]
_REPORT_SIZE_MIN = _POSITION_AT + _POSITION.size


def _pack_control_report(force: Share) -> bytes:
    return _CONTROL.pack(_REPORT, _OVERRIDE, 0, scale_share(force, _FULL_SCALE), 0, 0)


class FFBeastDriver:
    """A `master.devices.hid.driver.HidDriver`: one axis with force, no buttons."""

    axes: tuple[str, ...] = ("x",)
    forces: tuple[str, ...] = ("x",)
    buttons = 0

    def begin(self, device: ReportAccess) -> None:
        """Switch to direct control, without force."""
        device.write(_pack_control_report(0.0))

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return the wheel's position as a share of its motion range."""
        if len(report) < _REPORT_SIZE_MIN or report[0] != _REPORT:
            return controls
        (position,) = _POSITION.unpack_from(report, _POSITION_AT)
        return Controls((max(-1.0, min(1.0, position / _FULL_SCALE)),), 0, 0)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:  # noqa: ARG002
        """Return one report of direct control; each restarts the wheel's own timeout."""
        return (_pack_control_report(force[0]),)

    def silence(self) -> tuple[bytes, ...]:
        """Return direct control without force; the wheel then returns to its default mode."""
        return (_pack_control_report(0.0),)
