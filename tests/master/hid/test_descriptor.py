"""The parser against the published layouts, and against descriptors written byte by byte.

The tables are written by hand from the sources that tests/hid/descriptors.py names.
"""

import pytest

from master.devices.hid.descriptor import DescriptorError, ReportType, parse_descriptor
from tests.hid.descriptors import LAYOUTS

IN, OUT, FEATURE = ReportType.INPUT, ReportType.OUTPUT, ReportType.FEATURE

# number and length of every report that the sources give
LENGTHS = {
    "openffboard 2": {
        (IN, 0x01): 25,
        (IN, 0x02): 2,
        (IN, 0xA1): 25,
        (OUT, 0xA1): 25,
        (OUT, 0x01): 22,
        (OUT, 0x03): 15,
        (OUT, 0x04): 12,
        (OUT, 0x05): 4,
        (OUT, 0x0A): 4,
        (OUT, 0x0B): 2,
        (OUT, 0x0C): 2,
        (OUT, 0x0D): 2,
        (FEATURE, 0x11): 4,
        (FEATURE, 0x12): 5,
        (FEATURE, 0x13): 5,
    },
    "openffboard 1": {(OUT, 0x01): 18, (OUT, 0x05): 4, (IN, 0x01): 25},
    "arduino": {
        (IN, 0x01): 10,
        (IN, 0x02): 3,
        (OUT, 0x01): 18,
        (OUT, 0x03): 15,
        (OUT, 0x05): 4,
        (OUT, 0x0A): 4,
        (OUT, 0x0C): 2,
        (FEATURE, 0x05): 4,
        (FEATURE, 0x06): 5,
        (FEATURE, 0x07): 5,
    },
    "rhino": {
        (IN, 1): 34,
        (OUT, 101): 17,
        (OUT, 103): 15,
        (OUT, 105): 4,
        (OUT, 110): 4,
        (OUT, 112): 2,
        (FEATURE, 5): 4,
        (FEATURE, 6): 5,
    },
    "ffbeast vendor": {(IN, 0xA3): 65, (OUT, 0xA3): 65},
    "dualsense": {(IN, 0x01): 64, (OUT, 0x02): 48, (FEATURE, 0x05): 41},
    "spacemouse": {(IN, 1): 13, (OUT, 4): 2, (IN, 0x17): 3},
    "spacemouse old": {(IN, 1): 7, (IN, 2): 7, (OUT, 4): 2},
    "logitech g29": {(IN, 0): 12, (OUT, 0): 8},
}

I16, U16 = (-32767, 32767), (0, 65535)
# layout, kind, report -> (usage, first byte, first bit in it, bits, least, greatest)
FIELDS = {
    ("openffboard 2", IN, 0x01): [
        (0x090001, 1, 0, 1, 0, 1),
        (0x090040, 8, 7, 1, 0, 1),
        (0x010030, 9, 0, 16, *I16),
        (0x010031, 11, 0, 16, *I16),
        (0x010035, 19, 0, 16, *I16),
        (0x010037, 21, 0, 16, *I16),
        (0x010036, 23, 0, 16, *I16),
    ],
    ("openffboard 2", IN, 0x02): [(0x0F009F, 1, 0, 1, 0, 1), (0x0F0094, 1, 4, 1, 0, 1)],
    ("openffboard 2", OUT, 0x01): [
        (0x0F0022, 1, 0, 8, 1, 40),
        (0x0F0026, 2, 0, 8, 1, 11),
        (0x0F0050, 3, 0, 16, 0, 32767),
        (0x0F0054, 5, 0, 16, 0, 32767),
        (0x0F0051, 7, 0, 16, 0, 32767),
        (0x0F00A7, 9, 0, 16, 0, 32767),
        (0x0F0052, 11, 0, 8, 0, 255),
        (0x0F0053, 12, 0, 8, 1, 8),
        (0x010030, 13, 0, 1, 0, 1),
        (0x010031, 13, 1, 1, 0, 1),
        (0x0F0056, 13, 2, 1, 0, 1),
        (0x0A0001, 14, 0, 16, 0, 36000),
        (0x0A0002, 16, 0, 16, 0, 36000),
    ],
    ("openffboard 2", OUT, 0x03): [
        (0x0F0023, 2, 0, 4, 0, 3),
        (0x0F0060, 3, 0, 16, *I16),
        (0x0F0061, 5, 0, 16, *I16),
        (0x0F0062, 7, 0, 16, *I16),
        (0x0F0063, 9, 0, 16, 0, 32767),
        (0x0F0064, 11, 0, 16, 0, 32767),
        (0x0F0065, 13, 0, 16, 0, 32767),
    ],
    ("openffboard 2", OUT, 0x04): [
        (0x0F0070, 2, 0, 16, 0, 32767),
        (0x0F0071, 6, 0, 16, 0, 35999),
        (0x0F0072, 8, 0, 32, 0, 32767),
    ],
    ("openffboard 2", OUT, 0x05): [(0x0F0022, 1, 0, 8, 1, 40), (0x0F0070, 2, 0, 16, *I16)],
    ("openffboard 2", OUT, 0x0A): [(0x0F0079, 2, 0, 8, 1, 3), (0x0F007C, 3, 0, 8, 0, 255)],
    ("openffboard 2", OUT, 0x0C): [
        (0x0F0097, 1, 0, 1, 1, 6),
        (0x0F0098, 1, 1, 1, 1, 6),
        (0x0F0099, 1, 2, 1, 1, 6),
        (0x0F009A, 1, 3, 1, 1, 6),
        (0x0F009B, 1, 4, 1, 1, 6),
        (0x0F009C, 1, 5, 1, 1, 6),
    ],
    ("openffboard 2", FEATURE, 0x11): [(0x0F0026, 1, 0, 8, 1, 11), (0x01003B, 2, 0, 10, 0, 511)],
    ("openffboard 2", FEATURE, 0x12): [
        (0x0F0022, 1, 0, 8, 1, 40),
        (0x0F008C, 2, 0, 8, 1, 3),
        (0x0F00AC, 3, 0, 16, *U16),
    ],
    ("openffboard 1", OUT, 0x01): [
        (0x010030, 13, 0, 1, 0, 1),
        (0x0F0056, 13, 1, 1, 0, 1),
        (0x0A0001, 14, 0, 16, 0, 36000),
    ],
    ("arduino", IN, 0x01): [
        (0x090020, 4, 7, 1, 0, 1),
        (0x010039, 5, 0, 4, 0, 7),
        (0x010030, 6, 0, 16, *I16),
        (0x010031, 8, 0, 16, *I16),
    ],
    ("arduino", IN, 0x02): [(0x0F0094, 2, 0, 1, 0, 1), (0x0F0022, 2, 1, 7, 1, 40)],
    ("arduino", OUT, 0x01): [
        (0x0F0050, 3, 0, 16, 0, 32767),
        (0x0F0052, 9, 0, 8, 0, 255),
        (0x0F0053, 10, 0, 8, 1, 8),
        (0x0F0056, 11, 2, 1, 0, 1),
        (0x0A0001, 12, 0, 8, 0, 255),
        (0x0A0002, 13, 0, 8, 0, 255),
    ],
    ("arduino", OUT, 0x05): [(0x0F0070, 2, 0, 16, -10000, 10000)],
    ("rhino", OUT, 101): [
        (0x0F0050, 3, 0, 16, *U16),
        (0x0F0052, 9, 0, 16, 0, 4096),
        (0x0F0053, 11, 0, 8, 1, 8),
        (0x0F0056, 12, 2, 1, 0, 1),
        (0x0A0001, 13, 0, 8, 0, 255),
        (0x0F00A7, 15, 0, 16, *U16),
    ],
    ("rhino", OUT, 105): [(0x0F0070, 2, 0, 16, -4096, 4096)],
    ("rhino", IN, 1): [
        (0x010030, 1, 0, 16, -4096, 4096),
        (0x010031, 3, 0, 16, -4096, 4096),
        (0x090001, 11, 0, 1, 0, 1),
        (0x090031, 19, 0, 1, 0, 1),
    ],
    ("dualsense", IN, 0x01): [
        (0x010030, 1, 0, 8, 0, 255),
        (0x010033, 5, 0, 8, 0, 255),
        (0x010034, 6, 0, 8, 0, 255),
        (0x010039, 8, 0, 4, 0, 7),
        (0x090001, 8, 4, 1, 0, 1),
        (0x090005, 9, 0, 1, 0, 1),
    ],
    ("spacemouse", IN, 1): [
        (0x010030, 1, 0, 16, -350, 350),
        (0x010033, 7, 0, 16, -350, 350),
        (0x010035, 11, 0, 16, -350, 350),
    ],
    ("spacemouse old", IN, 2): [(0x010033, 1, 0, 16, -500, 500), (0x010035, 5, 0, 16, -500, 500)],
    ("logitech g29", IN, 0): [
        (0x010030, 4, 0, 16, *U16),
        (0x010032, 6, 0, 8, 0, 255),
        (0x010031, 8, 0, 8, 0, 255),
    ],
}


@pytest.mark.parametrize("name", LENGTHS)
def test_reports_have_the_published_numbers_and_lengths(name):
    found = {(r.kind, r.number): r.length for r in parse_descriptor(LAYOUTS[name]).reports}
    assert {key: found.get(key) for key in LENGTHS[name]} == LENGTHS[name]


@pytest.mark.parametrize(("name", "kind", "number"), FIELDS)
def test_fields_are_where_the_sources_say_and_range_as_they_say(name, kind, number):
    report = parse_descriptor(LAYOUTS[name]).report(kind, number)
    found = {
        (usage, *divmod(field.offset, 8), field.size, field.minimum, field.maximum)
        for field in report.fields
        for usage in field.usages
    }
    assert set(FIELDS[name, kind, number]) <= found


@pytest.mark.parametrize(
    ("name", "kind", "number", "order"),
    [
        ("openffboard 2", OUT, 0x0A, [0x0F0079, 0x0F007A, 0x0F007B]),
        ("openffboard 2", FEATURE, 0x12, [0x0F008C, 0x0F008D, 0x0F008E]),
        ("arduino", OUT, 0x0C, [0x0F0097, 0x0F0098, 0x0F0099, 0x0F009A, 0x0F009B, 0x0F009C]),
        ("rhino", OUT, 112, [0x0F0098, 0x0F0097, 0x0F0099, 0x0F009A, 0x0F009B, 0x0F009C]),
    ],
)
def test_arrays_keep_the_order_of_the_device(name, kind, number, order):
    report = parse_descriptor(LAYOUTS[name]).report(kind, number)
    (array,) = [field for field in report.fields if field.array]
    assert list(array.usages) == order
    assert array.minimum == 1


def test_control_bits_without_a_name_of_their_own_go_with_the_last():
    *_, last = parse_descriptor(LAYOUTS["openffboard 2"]).report(OUT, 0x0C).fields
    assert (last.usage, last.offset, last.count) == (0x0F009C, 13, 3)


def test_a_numbered_report_counts_its_number_an_input_without_does_not():
    descriptor = parse_descriptor(LAYOUTS["logitech g29"])
    assert descriptor.report(IN, 0).fields[0].offset == 0
    assert descriptor.report(OUT, 0).fields[0].offset == 8


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


def test_flags():
    (field,) = fields("15012508 75049501 0939 8146")
    assert field.nullable
    assert field.relative
    assert not field.array
    assert not field.constant


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


def test_collections_of_the_same_name_are_not_the_same():
    first, second = fields("15002501 75089501 0901a100 0930 8102 c0 0901a100 0931 8102 c0")
    assert first.path[0] == second.path[0]
    assert first.path[1] != second.path[1]
    assert first.within(0x010001)
    assert not first.within(0x010005)


def test_several_devices_in_one():
    data = MOUSE + KEYBOARD
    assert parse_descriptor(data).applications == (0x010002, 0x010006)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 bytes long"),
        (bytes(4097), "4097 bytes long"),
        (bytes.fromhex("050126ff"), "beyond the end"),
        (bytes.fromhex("fe"), "beyond the end"),
        (bytes.fromhex("a101"), "within a collection"),
        (bytes.fromhex("c0"), "never began"),
        (bytes.fromhex("b4"), "pop without a push"),
        (bytes.fromhex("8500"), "report number"),
        (bytes.fromhex("860001"), "report number"),
        (bytes.fromhex("760101"), "more than 256 bits"),
        (bytes.fromhex("7508 97ffffffff 8102"), "a report of more than"),
        (bytes.fromhex("150525017508950109308102"), "a range 5 ... 1"),
        (bytes.fromhex("a900"), "do not pair"),
        (bytes.fromhex("a901a901"), "do not pair"),
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


def test_a_push_for_every_byte_is_survived():
    assert parse_descriptor(b"\xa4" * 4096).reports == ()
