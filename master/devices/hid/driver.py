"""The driver interface: the report codec of one kind of device, and its actuator state.

A driver owns no handle, no thread and no clock; only `begin` talks to the device, through its
`ReportAccess` argument. `master.devices.hid.device` transfers the reports.
"""

import math
from contextlib import suppress
from typing import NamedTuple, Protocol

from master.device import DeviceFault
from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.descriptor import ReportDescriptor, ReportType

# --- actuator state of a PID device, from its PID State reports
# A device may say that its actuators are disabled or without power, that its safety switch is open,
# or that it is paused: then it renders no force, whatever is written. Firmware differs in what it
# reports: OpenFFBoard never closes the safety switch that its descriptor has. So a condition counts
# once it was reported as met; until then nothing is known. If it is met only later, a force may
# begin by surprise, which counts as an interruption, too. Most firmware reports changes only: the
# state at the beginning is asked for.


class _ActuatorCondition(NamedTuple):
    """What a device needs to render a force."""

    usage: int
    met: bool  # value of its field if it is met
    unmet: str  # in a message


_CONDITIONS = (
    _ActuatorCondition(U.ACTUATOR_POWER, True, "its actuators have no power; switch them on"),
    _ActuatorCondition(U.SAFETY_SWITCH, True, "its safety switch is open; close it"),
    _ActuatorCondition(
        U.ACTUATORS_ENABLED,
        True,
        "its actuators are disabled; close other programs that use it, then plug it in again",
    ),
    _ActuatorCondition(
        U.PAUSED, False, "it is paused; close other programs that use it, then plug it in again"
    ),
)


class ActuatorState(NamedTuple):
    """Conditions as masks; bit k is condition k."""

    known: int = 0  # reported as met at least once
    unmet: int = 0  # not met in the newest report
    interrupted: int = 0  # unmet at some time since `read`

    @property
    def faults(self) -> tuple[str, ...]:
        """Why a force is not rendered, or was not; empty if nothing is known against it."""
        faults = self.unmet & self.known | self.interrupted
        return tuple(condition.unmet for k, condition in enumerate(_CONDITIONS) if faults >> k & 1)

    def read(self) -> "ActuatorState":
        """Return the state without past interruptions."""
        return self._replace(interrupted=0)


class _ConditionBit(NamedTuple):
    """One bit of a report."""

    condition: int  # its mask
    offset: int  # [bit]
    met: int  # value of the bit


class ActuatorReports:
    """Decodes the PID State reports of one device."""

    def __init__(self, descriptor: ReportDescriptor) -> None:
        self._numbered = any(report.number for report in descriptor.reports)
        self._reports: dict[int, tuple[int, tuple[_ConditionBit, ...]]] = {}  # length and flags
        for report in descriptor.reports:
            if report.kind is not ReportType.INPUT:
                continue
            flags = tuple(
                _ConditionBit(1 << k, field.offset, int(condition.met))
                for field in report.fields
                for k, condition in enumerate(_CONDITIONS)
                if field.usage == condition.usage and field.size == 1 and not field.array
            )
            if flags:
                self._reports[report.number] = (report.length, flags)

    def ask(self, device: "ReportAccess") -> ActuatorState:
        """Return the present state; what the device does not answer stays unknown."""
        state = ActuatorState()
        for number, (length, _) in self._reports.items():
            with suppress(DeviceFault):
                state = self.decode(state, device.get_input(number, length))
        return state

    def decode(self, state: ActuatorState, report: bytes) -> ActuatorState:
        """Return `state` updated with `report`; other reports are ignored. Never raises."""
        if not report:
            return state
        length, flags = self._reports.get(report[0] if self._numbered else 0, (0, ()))
        if not flags or len(report) < length:
            return state
        bits = int.from_bytes(report, "little")
        reported, unmet, interrupted = state
        for condition, offset, expected in flags:
            if bits >> offset & 1 != expected:
                unmet |= condition
                interrupted |= condition & reported
                continue
            if unmet & condition:
                interrupted |= condition
            reported |= condition
            unmet &= ~condition
        return ActuatorState(reported, unmet, interrupted)


Share = float  # of full scale, -1 ... 1


class DriverError(ValueError):
    """The device lacks something its driver needs; the message says what."""


class Controls(NamedTuple):
    """The inputs of a device."""

    axes: tuple[Share, ...]  # in the order of `HidDriver.axes`; a one-sided axis is 0 ... 1
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
