"""A packet's record and its bytes are the same message, and the bytes are what `pack` makes."""

import dataclasses
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.messages.messages import MESSAGES, Command, Message, MessageError, SlaveState
from teleop.messages.packet import Packet, build_packet, crc32


def some(cls: type[Message], seed: int) -> Message:
    """Return a message with a random value in every field."""
    random = np.random.default_rng(seed)
    values: dict[str, Any] = {}
    for name, wire in list(cls.schema.wires.items())[5:]:
        size = wire.count if wire.count > 1 else None
        if wire.code == "d":
            value: Any = random.normal(size=size)
        else:
            value = random.integers(0, 200, size=size or 1)
        values[name] = tuple(value.tolist()) if size else np.ravel(value)[0].item()
    return cls(**values)


@given(data=st.binary(max_size=700), seed=st.integers(0, 2**32 - 1))
def test_the_checksum_is_that_of_zlib(data: bytes, seed: int) -> None:
    assert crc32(np.frombuffer(data, dtype=np.uint8).copy(), seed) == zlib.crc32(data, seed)


@pytest.mark.parametrize("cls", MESSAGES)
def test_sealed_bytes_are_the_packed_message(cls: type[Message]) -> None:
    message = some(cls, 1)
    sender, sequence, stamp = 2**64 - 3, 41, 1_700_000_000_123_456_789
    sealed = build_packet(message).seal(sender, sequence, stamp)
    assert sealed == message.pack(sender, sequence, stamp)


@pytest.mark.parametrize("cls", MESSAGES)
def test_bytes_written_into_a_packet_are_read_from_its_record(cls: type[Message]) -> None:
    message = some(cls, 2)
    received: Packet[Any] = Packet(cls)
    received.data[:] = message.pack(7, 8, 9)
    for item in dataclasses.fields(cls)[5:]:
        assert np.array_equal(getattr(received.record, item.name), getattr(message, item.name))
    assert (received.record.sender, received.record.sequence) == (7, 8)


def test_a_change_after_sealing_is_noticed() -> None:
    one = build_packet(some(SlaveState, 3))
    one.seal(1, 2, 3)
    one.record.force[0] += 1.0
    with pytest.raises(MessageError):
        SlaveState.unpack(one.data.tobytes())


def test_two_packets_share_nothing() -> None:
    one, other = build_packet(some(Command, 4)), build_packet(Command())
    assert one.record.position.any()
    assert not other.record.position.any()
