"""The vendor interface of an FFBeast wheel: torque as a number, the state in every report.

Layout as the maker publishes it (ffbeast.github.io, docs/en/wheel_programming.md). The interface
has no buttons: those are on the wheel's second interface, a joystick. Without direct control for
"an extended period" a wheel returns to its default mode; the maker does not specify the time.
"""

import struct

from master.devices.hid.bits import scale_share
from master.devices.hid.driver import Controls, ReportAccess, Share

VENDOR, PRODUCT = 0x045B, 0x59D7

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
