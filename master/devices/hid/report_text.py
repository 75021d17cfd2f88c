"""Text of a report descriptor, for `teleop devices probe`."""

from itertools import takewhile

from master.devices.hid import usages
from master.devices.hid.descriptor import Collection, HidReport, ReportDescriptor, ReportField

_CHOICES_MAX = 16  # of an array that are listed
_SECONDS, _DEGREES = (0x1001, 0x1003), (0x14, 0x12)  # unit codes; rotation in degrees or radians


def describe_descriptor(descriptor: ReportDescriptor) -> list[str]:
    """Return lines of text: the device, then one block per report."""
    lines = [f"{usages.format_usage(usage)}" for usage in descriptor.applications]
    for report in descriptor.reports:
        lines.append(_format_headline(report))
        lines += [
            f"  {_format_position(group[0])}: {_format_meaning(group)}"
            for group in _group_fields(report)
        ]
    return lines


def _format_headline(report: HidReport) -> str:
    number = f" {report.number} (0x{report.number:02X})" if report.number else ""
    purpose = _format_purpose(report)
    return f"{report.kind.value} report{number}, {report.length} bytes{purpose}"


def _format_purpose(report: HidReport) -> str:
    """Return the name of the innermost collection common to all fields."""
    paths = [field.path for field in report.fields]
    if not paths:
        return ""
    levels = zip(*paths, strict=False)
    shared: list[Collection] = [
        level[0] for level in takewhile(lambda level: len(set(level)) == 1, levels)
    ]
    return f": {usages.format_usage(shared[-1].usage)}" if shared and shared[-1].usage else ""


def _group_fields(report: HidReport) -> list[list[ReportField]]:
    """Return the fields in order, with rows of similar fields grouped."""
    groups: list[list[ReportField]] = []
    for field in report.fields:
        if groups and _is_continuation(groups[-1][-1], field):
            groups[-1].append(field)
        else:
            groups.append([field])
    return groups


def _is_continuation(before: ReportField, field: ReportField) -> bool:
    return (
        before.usage >> 16 in (usages.BUTTON, usages.ORDINAL)
        and not before.array
        and field.usage == before.usage + 1
        and field.path == before.path
        and field.offset == before.offset + before.size
        and (field.size, field.minimum, field.maximum)
        == (before.size, before.minimum, before.maximum)
    )


def _format_position(field: ReportField) -> str:
    byte, bit = divmod(field.offset, 8)
    return f"byte {byte}" if not bit and not field.size % 8 else f"byte {byte} bit {bit}"


def _format_meaning(group: list[ReportField]) -> str:
    first, last = group[0], group[-1]
    if first.array:
        name = usages.format_usage(first.path[-1].usage) if first.path else "one of"
    else:
        name = usages.format_usage(first.usage) if first.usage else "not named"
        if first.usage >> 16 == usages.ORDINAL:
            name = f"{usages.format_usage(first.path[-1].usage)}, {name}" if first.path else name
    if last is not first:
        name += f" ... {usages.format_usage(last.usage)}"
    bits = f"{first.size} bit{'s' if first.size > 1 else ''}"
    count = len(group) if last is not first else first.count
    shape = f"{count} times {bits}" if count > 1 else bits
    words = [name, shape, f"{first.minimum} ... {first.maximum}{_format_unit(first)}"]
    words += [word for word, true in _list_flags(first) if true]
    text = ", ".join(words)
    return f"{text}: {_format_choices(first)}" if first.array else text


def _list_flags(field: ReportField) -> tuple[tuple[str, bool], ...]:
    return (
        ("constant", field.constant),
        ("relative", field.relative),
        ("may be none", field.nullable),
    )


def _format_choices(field: ReportField) -> str:
    named = [
        f"{field.minimum + k} {usages.format_usage(usage)}"
        for k, usage in enumerate(field.usages[:_CHOICES_MAX])
    ]
    return ", ".join(named) + (", ..." if len(field.usages) > _CHOICES_MAX else "")


def _format_unit(field: ReportField) -> str:
    """Return the physical range if it differs from the logical one."""
    symbol = " s" if field.unit in _SECONDS else ""
    if field.unit in _DEGREES:
        symbol = " deg" if field.unit == _DEGREES[0] else " rad"
    low, high = field.physical_minimum, field.physical_maximum
    ranged = (low, high) not in ((0, 0), (field.minimum, field.maximum))
    power = f"e{field.exponent}" if field.exponent else ""
    if ranged:
        return f" (physical {low}{power} ... {high}{power}{symbol})"
    return f" (times 1{power}{symbol})" if symbol else ""
