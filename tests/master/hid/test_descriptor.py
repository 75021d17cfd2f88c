"""The parser against the published layouts, and against descriptors written byte by byte.

The tables are written by hand from the sources that studies/hid/descriptors.py names.
"""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid import descriptor
from master.devices.hid.descriptor import DescriptorError, ReportType, parse_descriptor
from studies.hid.descriptors import LAYOUTS

IN, OUT, FEATURE = ReportType.INPUT, ReportType.OUTPUT, ReportType.FEATURE

# layout, kind, report -> length, some of its fields: usage, byte, bit in it, bits, least, greatest
REPORTS = {
    ("openffboard 2", OUT, 0x01): (
        22,
        [
            (0x0F0022, 1, 0, 8, 1, 40),
            (0x0F0026, 2, 0, 8, 1, 11),
            (0x0F0050, 3, 0, 16, 0, 32767),
            (0x0F00A7, 9, 0, 16, 0, 32767),
            (0x0F0052, 11, 0, 8, 0, 255),
            (0x010031, 13, 1, 1, 0, 1),
            (0x0F0056, 13, 2, 1, 0, 1),
            (0x0A0002, 16, 0, 16, 0, 36000),
        ],
    ),
    ("openffboard 2", FEATURE, 0x11): (
        4,
        [(0x0F0026, 1, 0, 8, 1, 11), (0x01003B, 2, 0, 10, 0, 511)],
    ),
    ("arduino", IN, 0x02): (3, [(0x0F0094, 2, 0, 1, 0, 1), (0x0F0022, 2, 1, 7, 1, 40)]),
    ("rhino", OUT, 101): (17, [(0x0F0056, 12, 2, 1, 0, 1), (0x0F00A7, 15, 0, 16, 0, 65535)]),
    ("rhino", IN, 1): (34, [(0x090001, 11, 0, 1, 0, 1), (0x090031, 19, 0, 1, 0, 1)]),
    ("dualsense", IN, 0x01): (64, [(0x010039, 8, 0, 4, 0, 7), (0x090001, 8, 4, 1, 0, 1)]),
    ("spacemouse old", IN, 2): (7, [(0x010033, 1, 0, 16, -500, 500)]),
    # without a number: an input does not count it, an output does
    ("logitech g29", IN, 0): (12, [(0x010030, 4, 0, 16, 0, 65535), (0x010031, 8, 0, 8, 0, 255)]),
    ("logitech g29", OUT, 0): (8, [(0xFF000003, 1, 0, 8, 0, 255)]),
}


@pytest.mark.parametrize(("name", "kind", "number"), REPORTS)
def test_reports_have_the_published_length_and_fields(name, kind, number):
    length, fields = REPORTS[name, kind, number]
    report = parse_descriptor(LAYOUTS[name]).report(kind, number)
    found = {
        (usage, *divmod(field.offset, 8), field.size, field.minimum, field.maximum)
        for field in report.fields
        for usage in field.usages
    }
    assert report.length == length
    assert set(fields) <= found


# The examples of HID 1.11, appendix E.10 and B.1: every byte is the standard's.
MOUSE = bytes.fromhex(
    "05010902a1010901a1000509190129031500250195037501810295017505810105010930093115"
    "81257f750895028106c0c0"
)
KEYBOARD = bytes.fromhex(
    "05010906a101050719e029e71500250175019508810295017508810195057501050819012905910295017503"
    "910195067508150025650507190029658100c0"
)


def test_the_mouse_of_the_standard():
    (report,) = parse_descriptor(MOUSE).reports
    assert (report.kind, report.number, report.length) == (IN, 0, 3)
    facts = [(f.usage, f.offset, f.size, f.minimum, f.maximum, f.relative) for f in report.fields]
    assert facts == [
        (0x090001, 0, 1, 0, 1, False),
        (0x090002, 1, 1, 0, 1, False),
        (0x090003, 2, 1, 0, 1, False),
        (0x010030, 8, 8, -127, 127, True),
        (0x010031, 16, 8, -127, 127, True),
    ]
    assert [c.usage for c in report.fields[3].path] == [0x010002, 0x010001]
    assert [c.kind for c in report.fields[3].path] == [1, 0]


def test_the_keyboard_of_the_standard():
    inputs, leds = parse_descriptor(KEYBOARD).reports
    assert (inputs.length, leds.length) == (8, 2)
    keys = inputs.fields[-1]
    assert keys.array
    assert (keys.offset, keys.size, keys.count) == (16, 8, 6)
    assert keys.usages == tuple(0x070000 + k for k in range(102))
    assert [(f.usage, f.offset) for f in leds.fields] == [(0x080001 + k, 8 + k) for k in range(5)]


def fields(text):
    """Parse hexadecimal items inside one application collection; return all fields."""
    data = bytes.fromhex("05010904a101" + text.replace(" ", "") + "c0")
    return [field for report in parse_descriptor(data).reports for field in report.fields]


@pytest.mark.parametrize(
    ("items", "facts"),
    [
        # a maximum of one byte FF is 255 unless the minimum is negative, whichever comes first
        ("1500 25ff 7508 9501 0930 8102", [(0x010030, 0, 255)]),
        ("25ff 15fe 7508 9501 0930 8102", [(0x010030, -2, -1)]),
        ("27ffff0000 1500 7510 9501 0930 8102", [(0x010030, 0, 65535)]),
        ("1780ffffff 257f 7508 9501 0930 8102", [(0x010030, -128, 127)]),
        # usages of four bytes bring their page
        ("15002501 75089501 0b30000100 8102", [(0x010030, 0, 1)]),
        ("15002501 75089502 050f 0b30000100 0970 8102", [(0x010030, 0, 1), (0x0F0070, 0, 1)]),
        ("15002501 75019503 1b01000900 2b03000900 8102", [(0x090000 + k, 0, 1) for k in (1, 2, 3)]),
        # a page that is declared after its usages holds for them
        ("15002501 75089501 0930 0502 8102", [(0x020030, 0, 1)]),
        ("15002501 75089502 0930 0502 09c5 8102", [(0x010030, 0, 1), (0x0200C5, 0, 1)]),
        # of usages between delimiters the first is meant
        ("15002501 75089501 a901 0930 0931 a900 8102", [(0x010030, 0, 1)]),
        ("15002501 75089502 a901 0930 0931 a900 0932 8102", [(0x010030, 0, 1), (0x010032, 0, 1)]),
        # push and pop bring back the range and the size
        ("150025017508 9501 a4 1580257f b4 0930 8102", [(0x010030, 0, 1)]),
        # a long item is skipped, whatever is in it
        ("15002501 75089501 fe0342ffffff 0930 8102", [(0x010030, 0, 1)]),
        # usages do not outlive their main item
        ("15002501 75089501 0930 8102 8102", [(0x010030, 0, 1), (0, 0, 1)]),
        # constants fill, unless they have a name: the Arduino library writes to one
        ("15002501 75089501 8101 0930 8102", [(0x010030, 0, 1)]),
        ("15002501 75089501 0930 8103", [(0x010030, 0, 1)]),
    ],
)
def test_items(items, facts):
    assert [(f.usage, f.minimum, f.maximum) for f in fields(items)] == facts


@pytest.mark.parametrize(
    ("item", "exponent"), [("550d", -3), ("55fd", -3), ("5502", 2), ("5500", 0), ("57fdffffff", -3)]
)
def test_an_exponent_is_four_bits_or_a_whole_number(item, exponent):
    (field,) = fields(f"15002501 75089501 660310 {item} 3500466400 0930 8102")
    assert field.exponent == exponent
    assert field.unit == 0x1003
    assert (field.physical_minimum, field.physical_maximum) == (0, 100)


def test_reports_of_one_number_go_three_ways():
    data = "8505 15002501 75089501 0930 8102 0931 9102 0932 b102 8507 0930 8102"
    descriptor = parse_descriptor(bytes.fromhex("05010904a101" + data.replace(" ", "") + "c0"))
    assert descriptor.report(IN, 5).fields[0].usage == 0x010030
    assert descriptor.report(OUT, 5).fields[0].usage == 0x010031
    assert descriptor.report(FEATURE, 5).fields[0].usage == 0x010032
    assert descriptor.report(IN, 7).length == 2
    assert descriptor.report(OUT, 7) is None


def test_a_report_goes_on_where_it_stopped():
    data = "8501 15002501 75049501 0930 8102 8502 0931 8102 8501 0932 8102"
    report = parse_descriptor(bytes.fromhex("05010904a101" + data.replace(" ", "") + "c0")).report(
        IN, 1
    )
    assert [(f.usage, f.offset) for f in report.fields] == [(0x010030, 8), (0x010032, 12)]
    assert report.length == 2


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 bytes long"),
        (bytes(4097), "4097 bytes long"),
        (bytes.fromhex("050126ff"), "beyond the end"),
        (bytes.fromhex("a101"), "within a collection"),
        (bytes.fromhex("c0"), "never began"),
        (bytes.fromhex("b4"), "pop without a push"),
        (bytes.fromhex("8500"), "report number"),
        (bytes.fromhex("760101"), "more than 256 bits"),
        (bytes.fromhex("7508 97ffffffff 8102"), "a report of more than"),
        (bytes.fromhex("150525017508950109308102"), "a range 5 ... 1"),
        (bytes.fromhex("a900"), "do not pair"),
        (bytes.fromhex("a9018102"), "still open"),
        (bytes.fromhex("a100") * 65, "64 collections"),
        (bytes.fromhex("75011500250119002affff96ffff8102") * 2, "more than 8192 fields"),
    ],
)
def test_what_is_no_descriptor_is_refused_with_the_place(data, why):
    with pytest.raises(DescriptorError, match=why):
        parse_descriptor(data)


def test_arrays_of_many_names_do_not_fill_memory():
    array = bytes.fromhex("7510150027ffff000019002affff95018100")
    with pytest.raises(DescriptorError, match="more than 65536 usages"):
        parse_descriptor(array * 2)


def field(offset, size, low, high):
    (blank,) = fields("15002501 75089501 0930 8102")
    return replace(blank, offset=offset, size=size, minimum=low, maximum=high)


def as_text(report):
    return "".join(f"{byte:08b}"[::-1] for byte in report)


@given(
    st.binary(min_size=20, max_size=20),
    st.integers(0, 90),
    st.integers(1, 64),
    st.booleans(),
    st.data(),
)
def test_what_is_put_is_got_and_nothing_else_changes(report, offset, size, signed, data):
    low = -(1 << size - 1) if signed else 0
    where = field(offset, size, low, low + (1 << size) - 1)
    value = data.draw(st.integers(where.minimum, where.maximum))
    buffer = bytearray(report)
    descriptor.write_field(buffer, where, value)
    assert descriptor.read_field(bytes(buffer), where) == value
    before, after = as_text(report), as_text(buffer)
    assert after[:offset] == before[:offset]
    assert after[offset + size :] == before[offset + size :]
    assert int(after[offset : offset + size][::-1], 2) == value % (1 << size)


def test_a_value_is_written_if_its_bits_hold_it():
    report = bytearray(2)
    descriptor.write_field(report, field(8, 8, 1, 8), 0xFF)
    assert report == b"\x00\xff"
    for value in (256, -1):
        with pytest.raises(ValueError, match="does not fit"):
            descriptor.write_field(report, field(8, 8, 0, 9), value)
    with pytest.raises(ValueError, match="not in 2 bytes"):
        descriptor.write_field(report, field(9, 8, 0, 9), 1)


def test_limits_are_those_of_range_and_bits():
    assert descriptor.compute_limits(field(0, 8, 0, 65535)) == (0, 255)
    assert descriptor.compute_limits(field(0, 16, -40000, 100)) == (-32768, 100)
    low, high = descriptor.compute_limits(field(0, 1, 2, 6))
    assert low > high


@given(st.floats(), st.integers(-40000, 40000))
def test_a_share_never_exceeds_the_whole_nor_turns_around(share, full):
    value = descriptor.scale_share(share, full)
    assert abs(value) <= abs(full)
    if math.isnan(share):
        assert value == 0
    else:
        assert not value or (value > 0) == ((share > 0) == (full > 0))
        if abs(share) >= 1.0:
            assert abs(value) == abs(full)
