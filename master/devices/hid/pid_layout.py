"""Layout of the reports of a PID class force-feedback device.

Report numbers, widths and ranges differ between devices: all fields are found by their usages in
the descriptor. Device Class Definition for Physical Interface Devices 1.0 (USB-IF).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.descriptor import (
    ReportDescriptor,
    ReportField,
    ReportType,
    compute_limits,
    compute_representable_range,
    write_field,
)
from master.devices.hid.driver import DriverError
from master.devices.hid.input_report import InputReportDecoder

FORCE_AXES = {"x": 90.0, "y": 0.0}  # [deg] direction of an effect along the axis, clockwise from -y


class FieldValue(NamedTuple):
    """A value for a field."""

    field: ReportField
    value: int


@dataclass(frozen=True, slots=True)
class ReportPart:
    """The fields of one purpose, and the report they are in."""

    name: str
    number: int
    length: int  # [byte]
    fields: tuple[ReportField, ...]

    def find(self, usage: int) -> ReportField | None:
        """Return the field of `usage`, or the array that can select it."""
        return next((field for field in self.fields if usage in field.usages), None)

    def get_field(self, usage: int) -> ReportField:
        """Return the field of `usage`; `DriverError` if there is none."""
        field = self.find(usage)
        if field is None:
            raise DriverError(f"{self.name} has no {U.format_usage(usage)}")
        return field

    def choose(self, usage: int) -> FieldValue:
        """Return the value that selects `usage`: its index in an array, or its own bit."""
        field = self.get_field(usage)
        return FieldValue(field, field.minimum + field.usages.index(usage) if field.array else 1)

    def list_fields_within(self, usage: int) -> tuple[ReportField, ...]:
        """Return the fields in a collection inside this one, in order."""
        return tuple(field for field in self.fields if field.is_within(usage))

    def pack(self, choices: Iterable[FieldValue]) -> bytes:
        """Return the report with these values, else zeros; `DriverError` if one does not fit."""
        report = bytearray(self.length)
        report[0] = self.number
        for field, value in choices:
            low, high = compute_representable_range(field)
            if not low <= value <= high:
                name = U.format_usage(field.usage)
                raise DriverError(f"{self.name}: {name} cannot hold {value}, only {low} ... {high}")
            write_field(report, field, value)
        return bytes(report)


@dataclass(frozen=True, slots=True)
class PidLayout:
    """The reports and fields of a PID device."""

    set_effect: ReportPart
    constant_force: ReportPart
    operation: ReportPart
    control: ReportPart
    creation: ReportPart
    block_load: ReportPart
    block_free: ReportPart | None
    gain: ReportPart | None
    condition: ReportPart | None
    forces: tuple[str, ...]  # the axes with a force, of those that it reads
    polar: bool  # whether effects are directed by an angle; otherwise by an axes-enable bit


def has_pid_collection(descriptor: ReportDescriptor) -> bool:
    """Return whether the descriptor has a PID collection."""
    return any(
        usage >> 16 == U.PID
        for report in descriptor.reports
        for field in report.fields
        for usage in field.usages
    )


def build_layout(descriptor: ReportDescriptor, inputs: InputReportDecoder) -> PidLayout:
    """Return the layout; `DriverError` lists everything that is missing."""
    if not has_pid_collection(descriptor):
        raise DriverError("no force feedback of the USB PID class")
    missing: list[str] = []

    def find_part(kind: ReportType, purpose: int, *contents: int) -> ReportPart:
        part = _find_part(descriptor, kind, purpose)
        if part is None:
            missing.append(f"no {U.format_usage(purpose)} report")
            return ReportPart(U.format_usage(purpose), 0, 1, ())
        lacking = [U.format_usage(usage) for usage in contents if part.find(usage) is None]
        if lacking:
            missing.append(f"{part.name} has no {', '.join(lacking)}")
        return part

    out = ReportType.OUTPUT
    set_effect = find_part(out, U.SET_EFFECT, U.BLOCK_INDEX, U.CONSTANT_FORCE, U.DURATION)
    constant_force = find_part(out, U.SET_CONSTANT_FORCE, U.BLOCK_INDEX, U.MAGNITUDE)
    operation = find_part(out, U.EFFECT_OPERATION, U.BLOCK_INDEX, U.OP_START, U.OP_STOP)
    control = find_part(out, U.DEVICE_CONTROL, U.ENABLE_ACTUATORS)
    creation = find_part(ReportType.FEATURE, U.CREATE_NEW_EFFECT, U.CONSTANT_FORCE)
    block_load = find_part(ReportType.FEATURE, U.BLOCK_LOAD, U.BLOCK_INDEX, U.LOAD_SUCCESS)

    magnitude = constant_force.find(U.MAGNITUDE)
    if (
        magnitude is not None
        and not compute_limits(magnitude)[0] < 0 < compute_limits(magnitude)[1]
    ):
        missing.append("its constant force has one direction only")
    forces = _find_force_axes(set_effect, inputs)
    if not forces:
        missing.append("it has no force on any axis that it reads")
    if missing:
        raise DriverError("; ".join(missing))
    block_free = _find_part(descriptor, out, U.BLOCK_FREE)
    if block_free is not None and block_free.find(U.BLOCK_INDEX) is None:
        block_free = None
    return PidLayout(
        set_effect=set_effect,
        constant_force=constant_force,
        operation=operation,
        control=control,
        creation=creation,
        block_load=block_load,
        block_free=block_free,
        gain=_find_part(descriptor, out, U.DEVICE_GAIN),
        condition=_find_part(descriptor, out, U.SET_CONDITION),
        forces=forces,
        polar=bool(
            set_effect.find(U.DIRECTION_ENABLE) and set_effect.list_fields_within(U.DIRECTION)
        ),
    )


def _find_part(descriptor: ReportDescriptor, kind: ReportType, purpose: int) -> ReportPart | None:
    """Return the fields of the first report with a collection of this usage."""
    purposes = (purpose, U.DEVICE_CONTROL_REPORT) if purpose == U.DEVICE_CONTROL else (purpose,)
    for report in descriptor.reports:
        if report.kind is not kind:
            continue
        fields = tuple(field for field in report.fields if any(map(field.is_within, purposes)))
        if fields:
            return ReportPart(U.format_usage(purpose), report.number, report.length, fields)
    return None


def _find_force_axes(set_effect: ReportPart, inputs: InputReportDecoder) -> tuple[str, ...]:
    """Return the axes that effects can act along.

    From the axes-enable bits, or else one per direction field.
    """
    enabled = {U.AXES.get(field.usage) for field in set_effect.list_fields_within(U.AXES_ENABLE)}
    if not enabled:
        enabled = set(list(FORCE_AXES)[: max(1, len(set_effect.list_fields_within(U.DIRECTION)))])
    return tuple(axis for axis in FORCE_AXES if axis in enabled and axis in inputs.axes)
