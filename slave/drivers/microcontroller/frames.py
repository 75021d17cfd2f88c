"""The line protocol of the microcontroller: frames as bytes, and nothing else.

A frame is COBS(payload, CRC-32) and a zero byte. COBS (Cheshire, Baker 1999) leaves no other zero
byte, so after any damage the next zero is the end of a frame. The payload is

    version u8, kind u8, sequence u16, time_us u32, body

little-endian; the CRC is that of zlib and Ethernet, over the payload, u32. `sequence` counts the
frames of each direction; `time_us` is the sender's clock, of a state the time when it was sampled.

To the board:

    HELLO 1    watchdog_ms u16
    SET 2      flags u8 (1: motors enabled), count u8, target i32 each (MISSING: not used)
    STOP 3     motors off, until a SET that disables and then one that enables

From the board:

    INFO 129   watchdog_ms u16, rate_hz u16, motors u8, cells u8, name (ASCII)
    STATE 130  flags u8, bad_frames u16, answered u16, motors u8, cells u8,
               position i32 each, cell i32 each
"""

import binascii
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

VERSION = 1
FRAME_SIZE_MAX = 256  # [B] of a frame with its zero
_HEAD = struct.Struct("<BBHI")
_CRC = struct.Struct("<I")
_INFO = struct.Struct("<HHBB")
_STATE = struct.Struct("<BHHBB")
MISSING = -(1 << 31)  # count of a position or a cell that was not read


class FrameType(IntEnum):
    """Kinds of frames."""

    HELLO, SET, STOP = 1, 2, 3
    INFO, STATE = 129, 130


class BoardFlags(IntFlag):
    """State of the board."""

    ENABLED = 1  # motors have power and follow
    WATCHDOG = 2  # motors stopped: no target for too long
    STOPPED = 4  # motors stopped: emergency stop
    MOTOR_FAULT = 8
    CELL_FAULT = 16  # the converter does not answer


class FrameError(ValueError):
    """Bytes that are no frame of this protocol."""


class Frame(NamedTuple):
    """A frame whose checksum is right."""

    kind: int
    sequence: int
    time_us: int
    body: bytes


class BoardInfo(NamedTuple):
    """What a board is."""

    watchdog_ms: int
    rate_hz: int
    motors: int
    cells: int
    name: str


class BoardState(NamedTuple):
    """One sample of a board, in counts."""

    flags: BoardFlags
    bad_frames: int  # that the board refused since its start, modulo 65536
    answered: int  # sequence of the newest SET
    position: tuple[int, ...]
    cell: tuple[int, ...]


def encode_cobs(data: bytes) -> bytes:
    """Return `data` without zero bytes, 1 byte longer per 254."""
    out = bytearray()
    groups = data.split(b"\0")
    for k, group in enumerate(groups, 1):
        for begin in range(0, len(group) + 1, 254):
            part = group[begin : begin + 254]
            if begin and not part and k == len(groups):  # a full block ends the data
                break
            out.append(len(part) + 1)
            out += part
    return bytes(out)


def decode_cobs(data: bytes) -> bytes:
    """Return the bytes that `encode_cobs` was given; `FrameError` if it was not."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            raise FrameError("COBS block beyond the end")
        out += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def encode(kind: int, sequence: int, time_us: int, body: bytes = b"") -> bytes:
    """Return a frame with its zero byte."""
    payload = _HEAD.pack(VERSION, kind, sequence & 0xFFFF, time_us & 0xFFFFFFFF) + body
    return encode_cobs(payload + _CRC.pack(binascii.crc32(payload))) + b"\0"


def decode(data: bytes) -> Frame:
    """Return the frame in `data`, without its zero byte; `FrameError` if there is none."""
    whole = decode_cobs(data)
    if len(whole) < _HEAD.size + _CRC.size:
        raise FrameError("too short")
    payload = whole[: -_CRC.size]
    if _CRC.unpack(whole[-_CRC.size :])[0] != binascii.crc32(payload):
        raise FrameError("wrong checksum")
    version, kind, sequence, time_us = _HEAD.unpack_from(payload)
    if version != VERSION:
        raise FrameError(f"protocol version {version}, {VERSION} is needed: update the firmware")
    return Frame(kind, sequence, time_us, payload[_HEAD.size :])


def pack_hello(watchdog_s: float) -> bytes:
    """Return the body of a HELLO."""
    return struct.pack("<H", round(watchdog_s * 1e3))


def pack_targets(targets: tuple[int, ...], enabled: bool) -> bytes:
    """Return the body of a SET."""
    return struct.pack(f"<BB{len(targets)}i", enabled, len(targets), *targets)


def parse_info(body: bytes) -> BoardInfo:
    """Return the body of an INFO; `FrameError` if it is none."""
    if len(body) < _INFO.size:
        raise FrameError("INFO too short")
    watchdog_ms, rate_hz, motors, cells = _INFO.unpack_from(body)
    name = body[_INFO.size :].decode("ascii", "replace")
    return BoardInfo(watchdog_ms, rate_hz, motors, cells, name)


def parse_state(body: bytes) -> BoardState:
    """Return the body of a STATE; `FrameError` if it is none."""
    if len(body) < _STATE.size:
        raise FrameError("STATE too short")
    flags, errors, answered, motors, cells = _STATE.unpack_from(body)
    if len(body) != _STATE.size + 4 * (motors + cells):
        raise FrameError("STATE of the wrong length")
    values = struct.unpack_from(f"<{motors + cells}i", body, _STATE.size)
    return BoardState(BoardFlags(flags), errors, answered, values[:motors], values[motors:])


class FrameReader:
    """Cuts received bytes into frames.

    So far `bad` ones were damaged, and `lost` ones are missing between valid ones, by their
    sequence.
    """

    def __init__(self) -> None:
        self.bad = self.lost = 0
        self._rest = b""
        self._sequence: int | None = None

    def feed(self, data: bytes) -> list[Frame]:
        """Return the valid frames that end in `data`."""
        *ended, self._rest = (self._rest + data).split(b"\0")
        frames = []
        for part in ended:
            if not part:
                continue
            try:
                frame = decode(part)
            except FrameError:
                self.bad += 1
                continue
            if self._sequence is not None:
                self.lost += (frame.sequence - self._sequence - 1) & 0xFFFF
            self._sequence = frame.sequence
            frames.append(frame)
        if len(self._rest) > FRAME_SIZE_MAX:
            self._rest = b""
            self.bad += 1
        return frames
