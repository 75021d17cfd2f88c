"""One checked pass through an MCAP file, complete or truncated.

The `mcap` package's readers raise at the end of a truncated file and build an object for every
message; this pass just ends there and yields whole chunks.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from teleop.errors import UsageError

MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FRAME = struct.Struct("<BQ")  # opcode, length of what follows
_CHANNEL = struct.Struct("<H")


class RecordingError(UsageError):
    """The file is not a recording, is damaged, or lacks the requested data."""


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive messages: their bytes and the (channel id, start, end) of each.

    `MESSAGE_HEAD` is at `start`, followed by the message up to `end`.
    """

    content: bytes
    messages: list[tuple[int, int, int]]


@dataclass(slots=True)
class Scan:
    """The pass; records other than messages are collected in its fields."""

    path: Path
    complete: bool = False  # the end of the file was read; False = truncated or damaged
    damage: str = ""  # where and what; nothing behind it was read
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # the last of each name
    attachments: dict[str, bytes] = field(default_factory=dict)

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks in the order of the file, up to its end, truncation or damage."""
        try:
            with self.path.open("rb") as file:
                yield from self._blocks(file, self.path.stat().st_size)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from error

    def shortfall(self, read: str) -> str:
        """Return what is wrong with a file of which `read` was read, in one line; empty if nothing.

        Known once `blocks` has ended.
        """
        if self.complete:
            return ""
        if self.damage:
            return f"{self.path}: is damaged {self.damage}; up to there {read} could be read"
        return (
            f"{self.path}: is truncated, its recorder was killed or still writes; {read} could "
            "be read"
        )

    def channel(self, number: int) -> records.Channel:
        """Return the channel of a message."""
        if number not in self.channels:
            raise RecordingError(f"{self.path}: is damaged: a message of no known channel")
        return self.channels[number]

    def _blocks(self, file: IO[bytes], size: int) -> Iterator[Block]:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{self.path}: is not an MCAP recording")
        at, checksum = len(MCAP0_MAGIC), zlib.crc32(MCAP0_MAGIC)
        while len(frame := file.read(_FRAME.size)) == _FRAME.size:
            opcode, length = _FRAME.unpack(frame)
            at += _FRAME.size + length
            if at > size:
                return
            body = file.read(length)
            if opcode == Opcode.DATA_END:
                stated = int.from_bytes(body[:4], "little")
                if stated not in (0, checksum):
                    raise RecordingError(
                        f"{self.path}: is damaged: the checksum of the file is wrong, and each "
                        "part's own does not say where; nothing was read"
                    )
            elif opcode == Opcode.FOOTER:
                self.complete = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
                return
            checksum = zlib.crc32(body, zlib.crc32(frame, checksum))
            try:
                block = self._take(opcode, body)
            except Exception as error:  # each decompressor has its own exceptions
                self.damage = f"before byte {at}: {error}"
                return
            if block.messages:
                yield block

    def _take(self, opcode: int, body: bytes) -> Block:
        """Process one record of the file; return the messages in it, if any."""
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            stream, length = get_chunk_data_stream(records.Chunk.read(stream), validate_crc=True)
            return self._opened(stream.read(length))
        if opcode == Opcode.METADATA:
            metadata = records.Metadata.read(stream)
            self.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(stream)
            self.attachments[attachment.name] = attachment.data
        elif opcode == Opcode.MESSAGE:
            raise ValueError("a message outside a chunk")
        return Block(b"", [])

    def _opened(self, content: bytes) -> Block:
        messages = []
        at, message = 0, Opcode.MESSAGE.value
        frame, frame_size, channel_of = _FRAME.unpack_from, _FRAME.size, _CHANNEL.unpack_from
        while at < len(content):
            opcode, length = frame(content, at)
            start = at + frame_size
            at = start + length
            if opcode == message:
                messages.append((channel_of(content, start)[0], start, at))
            elif opcode == Opcode.SCHEMA:
                schema = records.Schema.read(ReadDataStream(BytesIO(content[start:at])))
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = records.Channel.read(ReadDataStream(BytesIO(content[start:at])))
                self.channels[channel.id] = channel
        if at > len(content):
            raise ValueError("a chunk ends inside a record")
        return Block(content, messages)
