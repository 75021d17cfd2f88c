import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid import descriptor
from master.devices.hid.descriptor import ReportField

SIZES = st.integers(1, 64)


def field(offset, size, low, high, count=1):
    return ReportField(
        usages=(),
        array=False,
        constant=False,
        relative=False,
        nullable=False,
        offset=offset,
        size=size,
        count=count,
        minimum=low,
        maximum=high,
        physical_minimum=0,
        physical_maximum=0,
        unit=0,
        exponent=0,
        path=(),
    )


@pytest.mark.parametrize(
    ("report", "where", "value"),
    [
        ("05 01 ff 7f", field(16, 16, -32767, 32767), 32767),
        ("05 01 01 80", field(16, 16, -32767, 32767), -32767),
        ("05 01 01 80", field(16, 16, 0, 65535), 0x8001),
        ("00 f0", field(12, 4, 0, 15), 15),
        ("00 f0", field(12, 4, -8, 7), -1),
        ("00 80 01", field(15, 2, 0, 3), 3),
        ("00", field(8, 16, 0, 65535), 0),
    ],
)
def test_values_by_hand(report, where, value):
    assert descriptor.read_field(bytes.fromhex(report), where) == value


def as_text(report):
    """The bits of a report, the first one first."""
    return "".join(f"{byte:08b}"[::-1] for byte in report)


@given(st.binary(min_size=20, max_size=20), st.integers(0, 90), SIZES, st.booleans(), st.data())
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


@given(st.binary(min_size=20, max_size=20), st.integers(0, 3), st.integers(1, 9))
def test_elements_follow_one_another(report, k, size):
    where = field(11, size, 0, 1, count=4)
    text = as_text(report)[11 + k * size :][:size]
    assert descriptor.read_field(report, where, k) == int(text[::-1], 2)


@pytest.mark.parametrize(("value", "where"), [(256, field(8, 8, 0, 9)), (-1, field(8, 8, 0, 9))])
def test_a_value_that_does_not_fit_is_refused(value, where):
    with pytest.raises(ValueError, match="does not fit"):
        descriptor.write_field(bytearray(4), where, value)


def test_a_field_outside_the_report_is_refused():
    with pytest.raises(ValueError, match="not in 2 bytes"):
        descriptor.write_field(bytearray(2), field(9, 8, 0, 9), 1)


def test_a_value_outside_the_range_that_fits_is_written():
    report = bytearray(2)
    descriptor.write_field(report, field(8, 8, 1, 8), 0xFF)
    assert report == b"\x00\xff"


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
