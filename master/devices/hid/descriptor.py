"""Parser of HID report descriptors, and access to the fields of a report that they describe.

Device Class Definition for Human Interface Devices 1.11, section 6.2.2 (USB-IF). Ambiguities are
resolved as in Linux, with which every device on sale works: a maximum is unsigned unless its
minimum is negative, and a short usage belongs to the page in force when its field is declared. A
device may send anything, so sizes are bounded by what Linux accepts and by a number of fields far
above that of any device.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

DESCRIPTOR_MAX = 4096  # [byte] HID_MAX_DESCRIPTOR_SIZE of Linux
_REPORT_MAX = 8 * 16384  # [bit] HID_MAX_BUFFER_SIZE of Linux
_SIZE_MAX = 256  # [bit] of a field, as in Linux
_FIELDS_MAX = 8192
_USAGES_MAX = 65536  # named in all fields together
_DEPTH_MAX = 64  # collections in collections

_CONSTANT, _VARIABLE, _RELATIVE, _NULL = 0x01, 0x02, 0x04, 0x40


class DescriptorError(ValueError):
    """Invalid report descriptor; the message gives place and reason."""


class ReportType(Enum):
    """Which way a report goes."""

    INPUT = "input"
    OUTPUT = "output"
    FEATURE = "feature"


class Collection(NamedTuple):
    """A collection of fields."""

    usage: int  # page in the high word; 0 = none
    kind: int  # 0 physical, 1 application, 2 logical, ...
    number: int  # of this collection in the descriptor, from 0


@dataclass(frozen=True, slots=True)
class ReportField:
    """Some bits of a report.

    Attributes
    ----------
    usages : tuple of int
        Its meaning. Of a variable the one usage, or none. Of an array the usages its value selects:
        `minimum` the first, `minimum` + 1 the second, ...
    offset : int
        Its first bit in the bytes of the report.
    size : int
        Number of bits.
    count : int
        Number of consecutive equal elements.
    minimum, maximum : int
        Range of the value, as declared; there are devices on which no bit pattern reaches it.
    physical_minimum, physical_maximum : int
        Physical range; both 0 = the logical one.
    unit, exponent : int
        Of the physical range: code of HID 1.11, 6.2.2.7, and power of ten.
    path : tuple of Collection
        From the outermost in.
    """

    usages: tuple[int, ...]
    array: bool
    constant: bool
    relative: bool
    nullable: bool
    offset: int
    size: int
    count: int
    minimum: int
    maximum: int
    physical_minimum: int
    physical_maximum: int
    unit: int
    exponent: int
    path: tuple[Collection, ...]

    @property
    def usage(self) -> int:
        """The usage of a variable; 0 = it has none."""
        return self.usages[0] if self.usages else 0

    def is_within(self, usage: int) -> bool:
        """Return whether the field is inside a collection of this usage."""
        return any(collection.usage == usage for collection in self.path)


@dataclass(frozen=True, slots=True)
class HidReport:
    """The fields of one report, without padding."""

    kind: ReportType
    number: int  # 0 = the device does not number its reports
    length: int  # [byte] as read and written
    fields: tuple[ReportField, ...]


@dataclass(frozen=True, slots=True)
class ReportDescriptor:
    """All reports of a device.

    Where reports are numbered, byte 0 is the number. Where not, an input report begins with its
    first field, and to the others hidapi prefixes a zero: the offsets count it.
    """

    reports: tuple[HidReport, ...]
    applications: tuple[int, ...]  # usages of the outermost collections

    def report(self, kind: ReportType, number: int) -> HidReport | None:
        """Return a report, if the device has it."""
        matches = (r for r in self.reports if r.kind is kind and r.number == number)
        return next(matches, None)


class _Globals(NamedTuple):
    """Global items of the parser."""

    page: int = 0
    minimum: int = 0
    maximum: bytes = b""  # its sign depends on `minimum`, which may follow
    physical_minimum: int = 0
    physical_maximum: bytes = b""
    unit: int = 0
    exponent: int = 0
    size: int = 0
    repeats: int = 0
    number: int = 0


class _Usage(NamedTuple):
    """One usage, or a range of them, as declared for the next main item."""

    first: int  # without page if `short`
    last: int
    page: int
    short: bool


class _Item(NamedTuple):
    tag: int  # of HID 1.11, the two size bits zero
    data: bytes
    at: int  # [byte]

    @property
    def unsigned(self) -> int:
        return int.from_bytes(self.data, "little")

    @property
    def signed(self) -> int:
        return int.from_bytes(self.data, "little", signed=True)


_MAIN = {0x80: ReportType.INPUT, 0x90: ReportType.OUTPUT, 0xB0: ReportType.FEATURE}
_COLLECTION, _END, _PUSH, _POP = 0xA0, 0xC0, 0xA4, 0xB4
_PAGE, _EXPONENT, _SIZE, _NUMBER, _COUNT = 0x04, 0x54, 0x74, 0x84, 0x94
_MINIMUM, _MAXIMUM, _PHYSICAL_MINIMUM, _PHYSICAL_MAXIMUM, _UNIT = 0x14, 0x24, 0x34, 0x44, 0x64
_USAGE, _USAGE_MINIMUM, _USAGE_MAXIMUM, _DELIMITER = 0x08, 0x18, 0x28, 0xA8
_LONG = 0xFE


def parse_descriptor(data: bytes) -> ReportDescriptor:
    """Parse a report descriptor; raises `DescriptorError` and nothing else."""
    if not 0 < len(data) <= DESCRIPTOR_MAX:
        raise DescriptorError(f"{len(data)} bytes long, must be 1 ... {DESCRIPTOR_MAX}")
    parser = _Parser()
    for item in _split_items(data):
        parser.take(item)
    return parser.finish(len(data))


def _split_items(data: bytes) -> Iterator[_Item]:
    """Split the bytes into short items; long ones are reserved and skipped."""
    at = 0
    while at < len(data):
        prefix, start = data[at], at + 1
        size = (0, 1, 2, 4)[prefix & 3]
        if prefix == _LONG:
            size = 2 + data[start] if start < len(data) else 2
        if start + size > len(data):
            raise DescriptorError(f"byte {at}: the item goes beyond the end")
        if prefix != _LONG:
            yield _Item(prefix & 0xFC, data[start : start + size], at)
        at = start + size


class _Parser:
    """Parser state, and the fields found so far."""

    def __init__(self) -> None:
        self._globals = _Globals()
        self._stack: list[_Globals] = []
        self._path: tuple[Collection, ...] = ()
        self._collections = 0
        self._applications: list[int] = []
        self._fields: dict[tuple[ReportType, int], list[ReportField]] = {}
        self._bits: dict[tuple[ReportType, int], int] = {}
        self._field_count = 0
        self._usage_count = 0
        self._begin_locals()

    def take(self, item: _Item) -> None:
        """Process one item."""
        kind = item.tag & 0x0C
        if kind == 0x00:
            self._main(item)
            self._begin_locals()
        elif kind == 0x04:
            self._parse_global(item)
        elif kind == 0x08:
            self._parse_local(item)

    def finish(self, end: int) -> ReportDescriptor:
        """Return the parsed descriptor."""
        if self._path:
            raise DescriptorError(f"byte {end}: ends within a collection")
        numbered = any(number for _, number in self._bits)
        reports = []
        for (kind, number), bits in self._bits.items():
            prefix = 8 if numbered or kind is not ReportType.INPUT else 0
            fields = self._fields[kind, number]
            if not prefix:
                fields = [replace(field, offset=field.offset - 8) for field in fields]
            reports.append(HidReport(kind, number, (prefix + bits + 7) // 8, tuple(fields)))
        return ReportDescriptor(tuple(reports), tuple(self._applications))

    def _begin_locals(self) -> None:
        self._usages: list[_Usage] = []
        self._first: _Item | None = None  # usage minimum without its maximum yet
        self._alternatives = 0  # usages since a delimiter opened
        self._delimited = False

    def _parse_global(self, item: _Item) -> None:
        tag = item.tag
        if tag in _GLOBALS:
            name, parse = _GLOBALS[tag]
            self._globals = self._globals._replace(**{name: parse(item)})
        if tag == _SIZE and item.unsigned > _SIZE_MAX:
            raise DescriptorError(f"byte {item.at}: fields of more than {_SIZE_MAX} bits")
        if tag == _NUMBER and not 1 <= item.unsigned <= 255:
            raise DescriptorError(f"byte {item.at}: a report number that is not 1 ... 255")
        if tag == _PUSH:
            self._stack.append(self._globals)
        elif tag == _POP:
            if not self._stack:
                raise DescriptorError(f"byte {item.at}: a pop without a push")
            self._globals = self._stack.pop()

    def _parse_local(self, item: _Item) -> None:
        if item.tag == _DELIMITER:
            if self._delimited == bool(item.unsigned):
                raise DescriptorError(f"byte {item.at}: delimiters that do not pair")
            self._delimited, self._alternatives = not self._delimited, 0
        elif item.tag == _USAGE:
            self._declare(item, item)
        elif item.tag == _USAGE_MINIMUM:
            self._first = item
        elif item.tag == _USAGE_MAXIMUM and self._first is not None:
            self._declare(self._first, item)
            self._first = None

    def _declare(self, first: _Item, last: _Item) -> None:
        """Add usages; of alternatives between delimiters only the first, preferred one."""
        self._alternatives += 1
        if self._delimited and self._alternatives > 1:
            return
        short = len(first.data) <= 2
        page = self._globals.page if short else first.unsigned >> 16
        low, high = first.unsigned & 0xFFFF, last.unsigned & 0xFFFF
        self._usages.append(_Usage(low, high, page, short))

    def _main(self, item: _Item) -> None:
        if self._delimited:
            raise DescriptorError(f"byte {item.at}: a delimiter is still open")
        self._complete_usages()
        if item.tag == _COLLECTION:
            self._open(item)
        elif item.tag == _END:
            if not self._path:
                raise DescriptorError(f"byte {item.at}: the end of a collection that never began")
            self._path = self._path[:-1]
        elif item.tag in _MAIN:
            self._add(_MAIN[item.tag], item)

    def _complete_usages(self) -> None:
        """Complete short usages at the end of the list with the page declared after them."""
        page = self._globals.page
        for k in reversed(range(len(self._usages))):
            usage = self._usages[k]
            if usage.short:
                if usage.page == page:
                    break
                self._usages[k] = usage._replace(page=page)

    def _open(self, item: _Item) -> None:
        if len(self._path) == _DEPTH_MAX:
            raise DescriptorError(f"byte {item.at}: more than {_DEPTH_MAX} collections deep")
        usage = next(self._take_usages(1, item), 0)
        if not self._path:
            self._applications.append(usage)
        self._path += (Collection(usage, item.unsigned & 0xFF, self._collections),)
        self._collections += 1

    def _add(self, kind: ReportType, item: _Item) -> None:
        """Append the fields of an input, output or feature item to its report."""
        current, flags = self._globals, item.unsigned
        key = kind, current.number
        fields = self._fields.setdefault(key, [])
        start = self._bits.get(key, 0)
        self._bits[key] = start + current.size * current.repeats
        if self._bits[key] > _REPORT_MAX:
            raise DescriptorError(f"byte {item.at}: a report of more than {_REPORT_MAX} bits")
        constant = bool(flags & _CONSTANT)
        if not current.size or not current.repeats or (constant and not self._usages):
            return
        array = not flags & _VARIABLE
        maximum = _parse_maximum(current.maximum, current.minimum)
        if maximum < current.minimum and not constant:
            raise DescriptorError(f"byte {item.at}: a range {current.minimum} ... {maximum}")
        values = min(maximum - current.minimum + 1, 1 << current.size)
        names = tuple(self._take_usages(values if array else current.repeats, item))
        runs = [(names, current.repeats)] if array else _assign_usages(names, current.repeats)
        offset = 8 + start
        for usages, count in runs:
            self._field_count += 1
            if self._field_count > _FIELDS_MAX:
                raise DescriptorError(f"byte {item.at}: more than {_FIELDS_MAX} fields")
            fields.append(
                ReportField(
                    usages=usages,
                    array=array,
                    constant=constant,
                    relative=bool(flags & _RELATIVE),
                    nullable=bool(flags & _NULL),
                    offset=offset,
                    size=current.size,
                    count=count,
                    minimum=current.minimum,
                    maximum=maximum,
                    physical_minimum=current.physical_minimum,
                    physical_maximum=_parse_maximum(
                        current.physical_maximum, current.physical_minimum
                    ),
                    unit=current.unit,
                    exponent=current.exponent,
                    path=self._path,
                )
            )
            offset += current.size * count

    def _take_usages(self, count_max: int, item: _Item) -> Iterator[int]:
        """Yield the declared usages one by one, at most `count_max`."""
        for usage in self._usages:
            for number in range(usage.first, usage.last + 1):
                if not count_max:
                    return
                count_max -= 1
                self._usage_count += 1
                if self._usage_count > _USAGES_MAX:
                    raise DescriptorError(f"byte {item.at}: more than {_USAGES_MAX} usages")
                yield usage.page << 16 | number


def _assign_usages(names: tuple[int, ...], count: int) -> list[tuple[tuple[int, ...], int]]:
    """Return the usages with their number of fields; the last one gets all remaining."""
    if not names:
        return [((), count)]
    last = len(names) - 1
    return [((name,), 1 if k < last else count - last) for k, name in enumerate(names)]


def _parse_maximum(data: bytes, minimum: int) -> int:
    return int.from_bytes(data, "little", signed=minimum < 0)


def _parse_exponent(item: _Item) -> int:
    """Return a power of ten: four bits by the standard, a whole byte in many devices."""
    value = item.unsigned
    return (value ^ 8) - 8 if value < 16 else item.signed


_GLOBALS: dict[int, tuple[str, Callable[[_Item], Any]]] = {
    _PAGE: ("page", lambda item: item.unsigned & 0xFFFF),
    _MINIMUM: ("minimum", lambda item: item.signed),
    _MAXIMUM: ("maximum", lambda item: item.data),
    _PHYSICAL_MINIMUM: ("physical_minimum", lambda item: item.signed),
    _PHYSICAL_MAXIMUM: ("physical_maximum", lambda item: item.data),
    _UNIT: ("unit", lambda item: item.unsigned),
    _EXPONENT: ("exponent", _parse_exponent),
    _SIZE: ("size", lambda item: item.unsigned),
    _COUNT: ("repeats", lambda item: item.unsigned),
    _NUMBER: ("number", lambda item: item.unsigned),
}
"""Field of `_Globals` that a global item sets, and its value."""


# --- fields in the bytes of a report


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


def read_field(report: bytes, field: ReportField) -> int:
    """Return the value of a field, of an array the first one; truncated bits read as zero."""
    first, last = field.offset, field.offset + field.size
    bits = int.from_bytes(report[first // 8 : (last + 7) // 8], "little") >> first % 8
    value = bits & (1 << field.size) - 1
    if field.minimum < 0 and value >> field.size - 1:
        value -= 1 << field.size
    return value


def write_field(report: bytearray, field: ReportField, value: int) -> None:
    """Write a field, of an array the first element, into `report`; other bits are kept.

    Raises `ValueError` if the value does not fit the bits or the report is too short. A value
    outside the declared range is written: in many fields that means "none".
    """
    low, high = compute_representable_range(field)
    if not low <= value <= high:
        raise ValueError(f"{value} does not fit into {field.size} bits of {low} ... {high}")
    first, last = field.offset, field.offset + field.size
    if last > 8 * len(report):
        raise ValueError(f"bits {first} ... {last - 1} are not in {len(report)} bytes")
    part = slice(first // 8, (last + 7) // 8)
    shift, mask = first % 8, (1 << field.size) - 1
    other_bits = int.from_bytes(report[part], "little") & ~(mask << shift)
    bits = other_bits | (value & mask) << shift
    report[part] = bits.to_bytes(part.stop - part.start, "little")


def scale_share(share: float, full: int) -> int:
    """Return `share` of `full`; the share is clipped to -1 ... 1, NaN is zero."""
    if math.isnan(share):
        return 0
    return round(max(-1.0, min(1.0, share)) * full)
