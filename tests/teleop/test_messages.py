"""Packed messages: against numpy, against ROS 2's own reader, and against damage."""

import re
import struct
import zlib
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic

from docs.messages_page import format_page
from teleop.messages.messages import (
    LAYOUT,
    MESSAGES,
    TEXT_BYTES,
    Command,
    MessageError,
    decode_text,
    encode_text,
    pad_values,
)
from teleop.messages.packet import Packet

HEAD = ("checksum", "layout", "sender", "sequence", "stamp_ns")
RANGES = {
    "B": st.integers(0, 2**8 - 1),
    "I": st.integers(0, 2**32 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "d": st.floats(),
}


@st.composite
def messages(draw):
    """Any message with any values its wire types can hold, NaN and infinities among them."""
    cls = draw(st.sampled_from(MESSAGES))
    values = {}
    for name, wire in list(cls.schema.wires.items())[len(HEAD) :]:
        one = RANGES[wire.code]
        if wire.count == 1:
            values[name] = draw(one)
        else:  # a few drawn values, repeated: drawing 256 of them would be slow
            few = draw(st.lists(one, min_size=1, max_size=3))
            values[name] = tuple(few[k % len(few)] for k in range(wire.count))
    return cls(**values)


HEADS = st.tuples(RANGES["Q"], RANGES["Q"], RANGES["q"])


def same(one, two):
    """Equality that takes NaN for equal to NaN, and bytes for a sequence of numbers."""
    one, two = (list(x) if isinstance(x, bytes) else x for x in (one, two))
    return bool(np.array_equal(np.asarray(one), np.asarray(two), equal_nan=True))


@given(messages(), HEADS)
def test_what_is_packed_is_unpacked(message, head):
    data = message.pack(*head)
    assert len(data) == message.schema.size
    back = type(message).unpack(data)
    assert (back.sender, back.sequence, back.stamp_ns) == head
    assert back.layout == LAYOUT
    for item in fields(message):
        if item.name not in HEAD:
            assert same(getattr(back, item.name), getattr(message, item.name))
    assert message.schema.check(data) == head
    assert message.schema.read_sender(data) == head[0]


@given(messages(), HEADS)
def test_numpy_and_an_independent_ros2_reader_see_the_same_values(message, head):
    schema, data = message.schema, message.pack(*head)
    kind = f"teleop/msg/{schema.name}"
    decoded = generate_dynamic(kind, schema.ros_definition)[kind](data)
    row = np.frombuffer(data, schema.dtype)[0]
    back = type(message).unpack(data)
    for name in schema.wires:
        assert same(getattr(decoded, name), getattr(back, name))
        assert same(row[name], getattr(back, name))


@given(messages(), HEADS)
def test_a_packet_is_sealed_to_the_bytes_of_its_message_and_read_from_them(message, head):
    head = head[0], head[1] >> 2, head[2]  # our numbers are counted from 0
    packet = Packet(type(message))
    packet.fill(message)
    assert packet.seal(*head) == message.pack(*head)
    received = Packet(type(message))
    received.data[:] = message.pack(*head)
    for item in fields(message)[len(HEAD) :]:
        assert same(getattr(received.record, item.name), getattr(message, item.name))
    assert (received.record.sender, received.record.sequence) == head[:2]
    packet.record.sequence += 1
    with pytest.raises(MessageError):
        type(message).unpack(packet.data.tobytes())


@pytest.mark.parametrize("cls", MESSAGES)
def test_every_single_changed_byte_is_noticed(cls):
    whole = cls().pack(1, 2, 3)
    for position in range(len(whole)):
        packed = bytearray(whole)
        packed[position] ^= 0x80
        with pytest.raises(MessageError):
            cls.unpack(bytes(packed))


@given(st.sampled_from(MESSAGES), st.binary(max_size=800))
def test_any_bytes_at_all_are_a_message_error(cls, data):
    with pytest.raises(MessageError):
        cls.unpack(data)
    with pytest.raises(MessageError):
        cls.unpack(data[: cls.schema.size].ljust(cls.schema.size, b"\0"))


def test_the_messages_of_another_version_are_told_from_damaged_ones(monkeypatch):
    cls = MESSAGES[0]
    monkeypatch.setattr("teleop.messages.messages.LAYOUT", 0xABCDEF01)
    theirs = cls().pack(1, 2, 3)
    monkeypatch.undo()
    with pytest.raises(MessageError, match=rf"abcdef01, ours is {LAYOUT:08x}") as caught:
        cls.unpack(theirs)
    assert caught.value.kind == "layout"
    with pytest.raises(MessageError) as caught:
        cls.unpack(theirs[:-1])
    assert caught.value.kind == "layout"
    damaged = bytearray(cls().pack(1, 2, 3))
    damaged[-1] ^= 1
    with pytest.raises(MessageError) as caught:
        cls.unpack(bytes(damaged))
    assert caught.value.kind == "corruption"


def test_text_is_cut_between_characters():
    for text in ("", "engaged", "Zugspannung 5 µN", "é" * 200, "a" + "é" * 200, "x" * 1000):
        raw = encode_text(text)
        assert len(raw) == TEXT_BYTES
        assert text.startswith(decode_text(raw))
        assert len(decode_text(raw).encode()) >= min(len(text.encode()), TEXT_BYTES - 1)


def test_padding_fills_up_and_too_many_values_do_not_pass():
    assert pad_values([1.0, 2.0], 4) == (1.0, 2.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="9 values do not fit into a field of 8"):
        pad_values([0.0] * 9, 8)
    with pytest.raises(struct.error):
        Command(position=(0.0,) * 9).pack(1, 2, 3)


def test_the_checksum_of_the_docs_is_that_of_every_message():
    (code,) = re.findall(r"```python\n(.*?)```", format_page(), re.DOTALL)
    scope = {"zlib": zlib}
    exec(code, scope)  # noqa: S102 - our own page
    for cls in MESSAGES:
        data = cls().pack(1, 2, 3)
        message = bytearray(data)
        message[4:8] = b"\0\0\0\0"
        scope["seal"](cls.__name__, message)
        assert message == data
