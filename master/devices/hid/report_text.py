"""Text of a report descriptor, for `teleop devices probe`."""

from itertools import takewhile

from master.devices.hid import usages
from master.devices.hid.descriptor import Collection, Descriptor, Field, Report

_CHOICES_MAX = 16  # of an array that are listed
_SECONDS, _DEGREES = (0x1001, 0x1003), (0x14, 0x12)  # unit codes; rotation in degrees or radians


def describe(descriptor: Descriptor) -> list[str]:
    """Return lines of text: the device, then one block per report."""
    lines = [f"{usages.name(usage)}" for usage in descriptor.applications]
    for report in descriptor.reports:
        lines.append(_headline(report))
        lines += [f"  {_place(group[0])}: {_meaning(group)}" for group in _groups(report)]
    return lines


def _headline(report: Report) -> str:
    number = f" {report.number} (0x{report.number:02X})" if report.number else ""
    purpose = _purpose(report)
    return f"{report.kind.value} report{number}, {report.length} bytes{purpose}"


def _purpose(report: Report) -> str:
    """Return the name of the innermost collection common to all fields."""
    paths = [field.path for field in report.fields]
    if not paths:
        return ""
    levels = zip(*paths, strict=False)
    shared: list[Collection] = [
        level[0] for level in takewhile(lambda level: len(set(level)) == 1, levels)
    ]
    return f": {usages.name(shared[-1].usage)}" if shared and shared[-1].usage else ""


def _groups(report: Report) -> list[list[Field]]:
    """Return the fields in order, with rows of similar fields grouped."""
    groups: list[list[Field]] = []
    for field in report.fields:
        if groups and _continues(groups[-1][-1], field):
            groups[-1].append(field)
        else:
            groups.append([field])
    return groups


def _continues(before: Field, field: Field) -> bool:
    return (
        before.usage >> 16 in (usages.BUTTON, usages.ORDINAL)
        and not before.array
        and field.usage == before.usage + 1
        and field.path == before.path
        and field.offset == before.offset + before.size
        and (field.size, field.minimum, field.maximum)
        == (before.size, before.minimum, before.maximum)
    )


def _place(field: Field) -> str:
    byte, bit = divmod(field.offset, 8)
    return f"byte {byte}" if not bit and not field.size % 8 else f"byte {byte} bit {bit}"


def _meaning(group: list[Field]) -> str:
    first, last = group[0], group[-1]
    if first.array:
        name = usages.name(first.path[-1].usage) if first.path else "one of"
    else:
        name = usages.name(first.usage) if first.usage else "not named"
        if first.usage >> 16 == usages.ORDINAL:
            name = f"{usages.name(first.path[-1].usage)}, {name}" if first.path else name
    if last is not first:
        name += f" ... {usages.name(last.usage)}"
    bits = f"{first.size} bit{'s' if first.size > 1 else ''}"
    count = len(group) if last is not first else first.count
    shape = f"{count} times {bits}" if count > 1 else bits
    words = [name, shape, f"{first.minimum} ... {first.maximum}{_unit(first)}"]
    words += [word for word, true in _flags(first) if true]
    text = ", ".join(words)
    return f"{text}: {_choices(first)}" if first.array else text


def _flags(field: Field) -> tuple[tuple[str, bool], ...]:
    return (
        ("constant", field.constant),
        ("relative", field.relative),
        ("may be none", field.nullable),
    )


def _choices(field: Field) -> str:
    named = [
        f"{field.minimum + k} {usages.name(usage)}"
        for k, usage in enumerate(field.usages[:_CHOICES_MAX])
    ]
    return ", ".join(named) + (", ..." if len(field.usages) > _CHOICES_MAX else "")


def _unit(field: Field) -> str:
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
