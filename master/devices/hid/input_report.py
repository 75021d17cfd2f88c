"""Decoder of HID input reports: axes, buttons and hats of a device, by its report descriptor."""

from typing import NamedTuple

from master.devices.hid import usages
from master.devices.hid.descriptor import (
    ReportDescriptor,
    ReportField,
    ReportType,
    compute_limits,
)
from master.devices.hid.driver import Controls

# sticks and wheels, whatever their range; other unsigned axes are one-sided
_CENTRED_AXES = ("x", "y")
_BUTTONS_MAX = 128
_UP, _RIGHT, _DOWN, _LEFT = 1, 2, 4, 8
_EIGHT_WAYS = (_UP, _UP | _RIGHT, _RIGHT, _RIGHT | _DOWN, _DOWN, _DOWN | _LEFT, _LEFT, _LEFT | _UP)
_FOUR_WAYS = _EIGHT_WAYS[::2]


class _Axis(NamedTuple):
    place: int  # in `Controls.axes`
    offset: int  # [bit]
    mask: int
    sign: int  # the highest bit, 0 = unsigned
    low: int
    high: int
    nullable: bool
    centre: float  # reads as 0
    half: float  # from there to 1


class _Buttons(NamedTuple):
    """A row of consecutive button bits."""

    offset: int  # [bit]
    mask: int
    first: int  # bit of `Controls.buttons`


class _Hat(NamedTuple):
    offset: int  # [bit]
    mask: int
    low: int
    ways: tuple[int, ...]
    first: int  # bit of `Controls.buttons`


class _ReportLayout(NamedTuple):
    """How to read one report."""

    length: int  # [byte]
    axes: tuple[_Axis, ...]
    buttons: tuple[_Buttons, ...]
    hats: tuple[_Hat, ...]
    reported: int  # mask of the buttons in this report


class InputReportDecoder:
    """Axes and buttons of a device, from its input reports.

    The axes are `x`, `rz`, `slider`, ...; a second one of a kind is `slider2`. Behind the buttons
    each hat has four: up, right, down, left.
    """

    def __init__(self, descriptor: ReportDescriptor) -> None:
        found = [
            (report, [field for field in report.fields if not (field.relative or field.constant)])
            for report in descriptor.reports
            if report.kind is ReportType.INPUT
        ]
        self._numbered = any(report.number for report in descriptor.reports)
        pressed = [field for _, fields in found for field in fields if _is_button(field)]
        next_hat = max((field.usage & 0xFFFF for field in pressed), default=0)
        names: list[str] = []
        plans: dict[int, _ReportLayout] = {}
        for report, fields in found:
            axes, hats = [], []
            for field in fields:
                low, high = compute_limits(field)
                if not field.array and field.usage in usages.AXES and low < high:
                    axes.append(_build_axis(field, len(names), usages.AXES[field.usage]))
                    names.append(_make_name_unique(usages.AXES[field.usage], names))
                elif not field.array and field.usage == usages.HAT and low < high:
                    hats.append(_build_hat(field, next_hat))
                    next_hat += 4
            rows = _group_button_rows([field for field in fields if _is_button(field)])
            if axes or rows or hats:
                reported = sum(row.mask << row.first for row in rows)
                reported |= sum(0b1111 << hat.first for hat in hats)
                plans[report.number] = _ReportLayout(
                    report.length, tuple(axes), tuple(rows), tuple(hats), reported
                )
        self.axes = tuple(names)
        self.buttons = next_hat

        self._plans = plans

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`; never raises."""
        if not report:
            return controls
        plan = self._plans.get(report[0] if self._numbered else 0)
        if plan is None or len(report) < plan.length:
            return controls
        bits = int.from_bytes(report, "little")
        axes = controls.axes
        if plan.axes:
            values = list(axes)
            for place, offset, mask, sign, low, high, nullable, centre, half in plan.axes:
                value = bits >> offset & mask
                if value & sign:
                    value -= mask + 1
                if not low <= value <= high:
                    if nullable:
                        continue
                    value = low if value < low else high
                values[place] = (value - centre) / half
            axes = tuple(values)
        buttons = controls.buttons & ~plan.reported
        for offset, mask, first in plan.buttons:
            buttons |= (bits >> offset & mask) << first
        for offset, mask, low, ways, first in plan.hats:
            offset_value = (bits >> offset & mask) - low
            if 0 <= offset_value < len(ways):
                buttons |= ways[offset_value] << first
        return Controls(axes, buttons, controls.known | plan.reported, controls.actuators)


def _is_button(field: ReportField) -> bool:
    number = field.usage & 0xFFFF
    return (
        field.usage >> 16 == usages.BUTTON
        and 1 <= number <= _BUTTONS_MAX
        and field.size == 1
        and not field.array
    )


def _make_name_unique(name: str, names: list[str]) -> str:
    occurrences = sum(other.rstrip("0123456789") == name for other in names)
    return f"{name}{occurrences + 1}" if occurrences else name


def _build_axis(field: ReportField, place: int, name: str) -> _Axis:
    low, high = compute_limits(field)
    if low < 0:
        centre, half = 0.0, float(max(-low, high))
    elif name in _CENTRED_AXES:
        centre, half = (low + high) / 2, (high - low) / 2
    else:
        centre, half = float(low), float(high - low)
    sign = 1 << field.size - 1 if field.minimum < 0 else 0
    mask = (1 << field.size) - 1
    return _Axis(place, field.offset, mask, sign, low, high, field.nullable, centre, half)


def _build_hat(field: ReportField, first: int) -> _Hat:
    low, high = compute_limits(field)
    ways = _FOUR_WAYS if high - low == 3 else _EIGHT_WAYS
    return _Hat(field.offset, (1 << field.size) - 1, low, ways[: high - low + 1], first)


def _group_button_rows(fields: list[ReportField]) -> list[_Buttons]:
    rows: list[_Buttons] = []
    for field in fields:
        first, last = (field.usage & 0xFFFF) - 1, rows[-1] if rows else None
        if last is not None:
            length = last.mask.bit_length()
            if field.offset == last.offset + length and first == last.first + length:
                rows[-1] = last._replace(mask=last.mask << 1 | 1)
                continue
        rows.append(_Buttons(field.offset, 1, first))
    return rows
