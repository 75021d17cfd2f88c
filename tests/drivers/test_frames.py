"""The line protocol, here and in the firmware: two implementations of one description."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slave.drivers.microcontroller import frames
from slave.drivers.microcontroller.frames import BoardFlags, FrameError, FrameReader, FrameType
from studies.rigs.models.board import Firmware

STATE = struct.pack("<BHHBB3i2i", 1, 0, 7, 3, 2, 0, -1, 2**31 - 1, 256, frames.MISSING)


@given(st.binary(max_size=600))
def test_cobs_leaves_no_zero_and_loses_nothing(data):
    coded = frames.encode_cobs(data)
    assert 0 not in coded
    assert frames.decode_cobs(coded) == data


def test_cobs_at_the_borders_of_its_blocks():
    for size in (253, 254, 255, 508):
        for end in (b"", b"\0", b"\0\0x"):
            data = b"\1" * size + end
            assert frames.decode_cobs(frames.encode_cobs(data)) == data


def test_a_state_is_read_as_it_was_written():
    frame = frames.decode(frames.encode(FrameType.STATE, 65535, 2**32 - 1, STATE)[:-1])
    state = frames.parse_state(frame.body)
    assert (frame.kind, frame.sequence, frame.time_us) == (FrameType.STATE, 65535, 2**32 - 1)
    assert state.flags == BoardFlags.ENABLED
    assert state.position == (0, -1, 2**31 - 1)
    assert state.cell == (256, frames.MISSING)


def test_no_damaged_byte_makes_another_frame():
    whole = frames.encode(FrameType.STATE, 3, 1234, STATE)
    good = frames.decode(whole[:-1])
    for at in range(len(whole)):
        for wrong in range(256):
            data = whole[:at] + bytes([wrong]) + whole[at + 1 :]
            found = FrameReader().feed(data + b"\0")
            assert all(frame == good for frame in found)
            assert not found or wrong == whole[at]


def test_after_damage_the_next_frame_is_read_again():
    one, two = (frames.encode(FrameType.STATE, k, k, STATE) for k in (1, 2))
    for at in range(len(one)):
        reader = FrameReader()
        damaged = one[:at] + bytes([one[at] ^ 0x40]) + one[at + 1 :]
        found = reader.feed(damaged + two + frames.encode(FrameType.STATE, 3, 3, STATE))
        assert 3 in [frame.sequence for frame in found]
        assert reader.bad >= 1


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_frames_come_out_however_the_bytes_are_cut(cuts):
    stream = b"".join(frames.encode(FrameType.STATE, k, k, STATE) for k in range(4))
    reader, found = FrameReader(), []
    for size in [*cuts, len(stream)]:
        found += reader.feed(stream[:size])
        stream = stream[size:]
    assert [frame.sequence for frame in found] == [0, 1, 2, 3]


def test_missing_frames_are_counted_over_the_wrap_of_the_sequence():
    reader = FrameReader()
    for sequence in (65534, 65535, 2, 3):
        reader.feed(frames.encode(FrameType.STATE, sequence, 0, STATE))
    assert (reader.bad, reader.lost) == (0, 2)


def test_a_state_that_is_cut_is_refused():
    for size in range(7):
        with pytest.raises(FrameError):
            frames.parse_state(STATE[:size])


def ready(library, motors, cells):
    """Return firmware that has taken leave to move."""
    board = Firmware(library, motors, cells)
    board.receive(
        frames.encode(FrameType.SET, 0, 0, frames.pack_targets((0,) * motors, enabled=False))
    )
    return board


def test_the_firmware_moves_nothing_after_a_restart_until_it_was_disabled(library):
    board = Firmware(library, motors=1, cells=1)
    board.receive(frames.encode(FrameType.HELLO, 0, 0, frames.pack_hello(0.03)))
    for enabled, (flags, power) in (
        (True, (BoardFlags.STOPPED, False)),
        (False, (BoardFlags(0), False)),
        (True, (BoardFlags.ENABLED, True)),
    ):
        board.receive(frames.encode(FrameType.SET, 1, 0, frames.pack_targets((70_000,), enabled)))
        found, _, powered = board.read_motors()
        assert (found, bool(powered[0])) == (flags, power)


def test_the_firmware_reads_targets_and_we_read_its_states(library):
    board = ready(library, motors=3, cells=2)
    board.receive(frames.encode(FrameType.HELLO, 0, 0, frames.pack_hello(0.03)))
    (info,) = FrameReader().feed(board.sent())
    assert frames.parse_info(info.body)[:4] == (30, 1000, 3, 2)
    targets = (0, -70_000, frames.MISSING)
    board.receive(frames.encode(FrameType.SET, 9, 0, frames.pack_targets(targets, enabled=True)))
    board.step(5000, True, positions=[1, -2, 2**31 - 1], cells=[-(2**31), 256])
    flags, taken, powered = board.read_motors()
    assert flags == BoardFlags.ENABLED
    assert taken[:2].tolist() == [0, -70_000]
    assert powered.tolist() == [True, True, False]  # the third is not used
    (frame,) = FrameReader().feed(board.sent())
    state = frames.parse_state(frame.body)
    assert (frame.time_us, state.answered) == (5000, 9)
    assert state.position == (1, -2, 2**31 - 1)
    assert state.cell == (frames.MISSING, 256)


def test_the_firmware_obeys_no_frame_with_a_wrong_byte(library):
    board = ready(library, motors=3, cells=1)
    whole = frames.encode(FrameType.SET, 1, 2, frames.pack_targets((0, 260, -5), enabled=True))
    for at in range(len(whole)):
        for wrong in range(256):
            if wrong == whole[at]:
                continue
            board.receive(whole[:at] + bytes([wrong]) + whole[at + 1 :] + b"\0")
            assert board.read_motors()[0] == 0, (at, wrong)
    board.receive(whole)
    assert board.read_motors()[0] == BoardFlags.ENABLED


def test_the_firmware_stops_its_motors_when_targets_cease(library):
    board = ready(library, motors=1, cells=1)
    enable = frames.pack_targets((10,), enabled=True)

    def after(now_us):
        board.step(now_us, False, [0], [0])
        flags, _, powered = board.read_motors()
        return flags, bool(powered[0])

    after(1000)
    board.receive(frames.encode(FrameType.SET, 1, 0, enable))
    assert after(41_000) == (BoardFlags.ENABLED, True)
    assert after(41_001) == (BoardFlags.WATCHDOG, False)
    board.receive(frames.encode(FrameType.SET, 2, 0, enable))
    assert after(42_000) == (BoardFlags.WATCHDOG, False)  # nothing moves because targets are back
    board.receive(frames.encode(FrameType.SET, 3, 0, frames.pack_targets((10,), enabled=False)))
    board.receive(frames.encode(FrameType.SET, 4, 0, enable))
    assert after(43_000) == (BoardFlags.ENABLED, True)
    board.receive(frames.encode(FrameType.STOP, 5, 0))
    board.receive(frames.encode(FrameType.SET, 6, 0, enable))
    assert after(44_000) == (BoardFlags.STOPPED, False)


def test_the_firmware_does_not_read_beyond_its_buffers(library):
    board = ready(library, motors=2, cells=2)
    random = np.random.default_rng(5)
    for _ in range(300):
        board.receive(random.integers(0, 256, random.integers(1, 900), np.uint8).tobytes())
        board.step(0, True, [0, 0], [0, 0])
        board.sent()
    assert board.read_motors()[0] == 0
