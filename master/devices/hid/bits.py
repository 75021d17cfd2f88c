"""Fields in the bytes of a report."""

import math

from master.devices.hid.descriptor import ReportField


def compute_limits(field: ReportField) -> tuple[int, int]:
    """Return the least and greatest value within both the field's range and its bits.

    The least exceeds the greatest if no bit pattern is in range.
    """
    low, high = compute_representable_range(field)
    return max(low, field.minimum), min(high, field.maximum)


def compute_representable_range(field: ReportField) -> tuple[int, int]:
    """Return the least and the greatest value that the field's bits can hold."""
    if field.minimum < 0:
        return -(1 << field.size - 1), (1 << field.size - 1) - 1
    return 0, (1 << field.size) - 1


def read_field(report: bytes, field: ReportField, k: int = 0) -> int:
    """Return the value of the `k`-th element of a field; truncated bits read as zero."""
    first = field.offset + k * field.size
    last = first + field.size
    bits = int.from_bytes(report[first // 8 : (last + 7) // 8], "little") >> first % 8
    value = bits & (1 << field.size) - 1
    if field.minimum < 0 and value >> field.size - 1:
        value -= 1 << field.size
    return value


def write_field(report: bytearray, field: ReportField, value: int, k: int = 0) -> None:
    """Write the `k`-th element of a field into `report`; other bits are kept.

    Raises `ValueError` if the value does not fit the bits or the report is too short. A value
    outside the declared range is written: in many fields that means "none".
    """
    low, high = compute_representable_range(field)
    if not low <= value <= high:
        raise ValueError(f"{value} does not fit into {field.size} bits of {low} ... {high}")
    first = field.offset + k * field.size
    last = first + field.size
    if last > 8 * len(report):
        raise ValueError(f"bits {first} ... {last - 1} are not in {len(report)} bytes")
    part = slice(first // 8, (last + 7) // 8)
    shift, mask = first % 8, (1 << field.size) - 1
    others = int.from_bytes(report[part], "little") & ~(mask << shift)
    bits = others | (value & mask) << shift
    report[part] = bits.to_bytes(part.stop - part.start, "little")


def scale_share(share: float, full: int) -> int:
    """Return `share` of `full`; the share is clipped to -1 ... 1, NaN is zero."""
    if math.isnan(share):
        return 0
    return round(max(-1.0, min(1.0, share)) * full)
