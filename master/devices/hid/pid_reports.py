"""Reports of a PID class force-feedback device: their layout, and its effects.

Report numbers, widths and ranges differ between devices: all fields are found by their usages in
the descriptor. Device Class Definition for Physical Interface Devices 1.0 (USB-IF).
"""

from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.descriptor import (
    ReportDescriptor,
    ReportField,
    ReportType,
    compute_limits,
    compute_representable_range,
    read_field,
    scale_share,
    write_field,
)
from master.devices.hid.driver import DriverError, ReportAccess, Share
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


# --- effects in the memory of a PID device: create, set, start and free

DURATION_S = 0.2  # [s] of every effect; must be restarted well within
_SECONDS = (0x1001, 0x1003)  # unit codes
_LOAD_READS = 60  # hid-pidff of Linux asks as often


def create_effect(layout: PidLayout, device: ReportAccess, usage: int, ours: Container[int]) -> int:
    """Return the number of a new effect; `DriverError` if the device has none free.

    If its memory is full, effects of earlier programs are freed: all numbers except `ours`.
    """
    report = layout.creation.pack([layout.creation.choose(usage)])
    device.send_feature(report)
    block, full, answer = _read_block_load(layout.block_load, device)
    if full and layout.block_free is not None:
        low, high = compute_limits(layout.block_free.get_field(U.BLOCK_INDEX))
        for number in range(max(low, 1), min(high, 255) + 1):
            if number not in ours:
                device.write(_build_block_report(layout.block_free, number))
        device.send_feature(report)
        block, full, answer = _read_block_load(layout.block_load, device)
    if full:
        raise DriverError("its memory for effects is full")
    if not block:
        raise DriverError(
            f"it did not create the effect ({U.format_usage(usage)}); it answers "
            f"{answer.hex(' ') or 'nothing'} to Block Load (report {layout.block_load.number}): "
            "switch it off and on; if that does not help, run `teleop devices dump` for a report"
        )
    return block


def _read_block_load(part: ReportPart, device: ReportAccess) -> tuple[int, bool, bytes]:
    """Return the number of the effect just made, 0 = none, whether memory is full, and the answer.

    The first valid answer is used: some firmware clears it on reading.
    """
    status, index = part.get_field(U.LOAD_SUCCESS), part.get_field(U.BLOCK_INDEX)
    success = part.choose(U.LOAD_SUCCESS).value
    full = part.choose(U.LOAD_FULL).value if part.find(U.LOAD_FULL) else None
    reply = b""
    for _ in range(_LOAD_READS):
        reply = device.get_feature(part.number, part.length)
        if len(reply) < part.length or reply[0] != part.number:
            continue
        load_status, block = read_field(reply, status), read_field(reply, index)
        if load_status == success and block > 0:
            return block, False, reply
        if load_status == full:
            return 0, True, reply
    return 0, False, reply


def build_effect_report(layout: PidLayout, usage: int, block: int, axis: str) -> bytes:
    """Return Set Effect: `DURATION_S`, full gain, no delay, no trigger button, along `axis`.

    No axis may be enabled with the direction: the Arduino library uses the angle only then.
    """
    part = layout.set_effect
    duration = part.get_field(U.DURATION)
    choices = [part.choose(usage), FieldValue(duration, compute_duration_ticks(duration))]
    gain = part.find(U.EFFECT_GAIN)
    if gain is not None:
        choices.append(FieldValue(gain, compute_limits(gain)[1]))
    if layout.polar:
        choices.append(part.choose(U.DIRECTION_ENABLE))
    else:
        enable = [f for f in part.list_fields_within(U.AXES_ENABLE) if U.AXES.get(f.usage) == axis]
        choices += [FieldValue(field, 1) for field in enable]
    directions = part.list_fields_within(U.DIRECTION)
    if directions:
        low, high = compute_limits(directions[0])
        angle = low + round((high - low) * FORCE_AXES[axis] / 360.0)
        choices.append(FieldValue(directions[0], angle))
    return _build_block_report(part, block, *choices)


def compute_duration_ticks(duration: ReportField) -> int:
    """Return `DURATION_S` in units of the field; `DriverError` if it does not fit."""
    exponent = duration.exponent if duration.unit in _SECONDS else -3
    tick = 10.0 ** max(-9, min(9, exponent))  # [s]
    count = round(DURATION_S / tick)
    if not 1 <= count <= compute_limits(duration)[1]:  # zero would be infinite
        raise DriverError(f"its effects cannot have a duration of {DURATION_S} s")
    return count


def build_condition_reports(layout: PidLayout, block: int, share: Share) -> tuple[bytes, ...]:
    """Return Set Condition for each axis: centred, no dead band, `share` of the maximum.

    `DriverError` if the device has no conditions, or not per axis.
    """
    part = layout.condition
    if part is None:
        raise DriverError("no Set Condition report, so neither spring nor damper")
    choices = [
        FieldValue(field, scale_share(share, compute_limits(field)[1]))
        for usage in _CONDITION_USAGES
        if (field := part.find(usage)) is not None
    ]
    if not choices:
        raise DriverError(f"{part.name} has no {U.format_usage(U.POSITIVE_COEFFICIENT)}")
    if layout.forces == ("x",) and part.find(U.PARAMETER_BLOCK_OFFSET) is None:
        return (_build_block_report(part, block, *choices),)
    offset = part.get_field(U.PARAMETER_BLOCK_OFFSET)
    numbers = [list(FORCE_AXES).index(axis) for axis in layout.forces]
    return tuple(
        _build_block_report(part, block, FieldValue(offset, number), *choices) for number in numbers
    )


_CONDITION_USAGES = (
    *(U.POSITIVE_COEFFICIENT, U.NEGATIVE_COEFFICIENT),
    *(U.POSITIVE_SATURATION, U.NEGATIVE_SATURATION),
)


def build_zero_force_report(layout: PidLayout, block: int) -> bytes:
    """Return Set Constant Force with zero force."""
    return _build_block_report(layout.constant_force, block)


def build_start_report(layout: PidLayout, block: int) -> bytes:
    """Return the report that starts or restarts an effect, with a loop count of one."""
    part = layout.operation
    loops = part.find(U.LOOP_COUNT)
    once = [FieldValue(loops, 1)] if loops is not None else []
    return _build_block_report(part, block, part.choose(U.OP_START), *once)


def build_stop_report(layout: PidLayout, block: int) -> bytes:
    """Return the report that stops an effect."""
    return _build_block_report(layout.operation, block, layout.operation.choose(U.OP_STOP))


def build_free_reports(layout: PidLayout, block: int) -> tuple[bytes, ...]:
    """Return the report that frees an effect, if the device has one."""
    return (_build_block_report(layout.block_free, block),) if layout.block_free is not None else ()


def _build_block_report(part: ReportPart, block: int, *choices: FieldValue) -> bytes:
    return part.pack([FieldValue(part.get_field(U.BLOCK_INDEX), block), *choices])
