"""One checked pass through an MCAP file, complete or truncated.

The `mcap` package's readers raise at the end of a truncated file, build an object for every
message, and allocate whatever a compressed chunk unpacks to; this pass just ends at the end, yields
whole chunks, and unpacks no more than a chunk says and `CHUNK_MAX` allows.
"""

import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from teleop.errors import UsageError

# --- names in a recording, for writer and reader

if TYPE_CHECKING:
    from mcap.records import Channel  # not needed for the names alone

SESSION_METADATA = "recording"  # session, start, message layout, protection
VERSIONS_METADATA = "versions"  # of the writing software
GAPS_METADATA = "gaps"  # "<topic>/<sender>": lost messages; the last record of the name counts
DROPPED_METADATA = "dropped"  # "<topic>": came, but the recorder was too slow; the last one counts
END_METADATA = "end"  # how the recording ended: what is missing, largest lag, unfinished senders
CONFIG_ATTACHMENT = "config.yaml"
FILE_PREFIX = "file/"  # "file/<key>": what the file has that a key of the config names


def to_channel_name(topic: str) -> str:
    """Return the MCAP name of a topic, which as in ROS begins with a slash."""
    return f"/{topic}"


def to_topic_name(channel: "Channel") -> str:
    """Return the topic's name in `teleop.messages.topics`."""
    return channel.topic.removeprefix("/")


def describe_losses(lost: Mapping[str, int], unfinished: Collection[str]) -> list[str]:
    """Return what a recording lacks, in words: lost messages by topic, sides without an end."""
    out = []
    if lost := {topic: count for topic, count in lost.items() if count}:
        counts = ", ".join(f"{count} {topic}" for topic, count in lost.items())
        out.append(f"{sum(lost.values())} messages are missing ({counts})")
    if unfinished:
        out.append(f"the end of the {' and '.join(unfinished)} may be missing")
    return out


CHUNK_MAX = 1 << 26
"""Bytes of a chunk, unpacked; recorders write 1 MB."""

RECORD_MAX = 1 << 28
"""Bytes of a record of the file; the largest are attachments."""

MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FRAME = struct.Struct("<BQ")  # opcode, length of what follows
_CHANNEL = struct.Struct("<H")
_WINDOW_MAX = 1 << 27  # [bytes] that a zstd frame may refer back to


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
    loose: bool = False  # messages may be outside chunks, as bags may have them
    complete: bool = False  # the end of the file was read; False = truncated or damaged
    damage: str = ""  # where and what; nothing behind it was read
    share: float = 0.0  # of the file that was read
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # the last of each name
    attachments: dict[str, bytes] = field(default_factory=dict)

    def read_blocks(self) -> Iterator[Block]:
        """Yield the blocks in the order of the file, up to its end, truncation or damage."""
        if self.path.exists() and not self.path.is_file():
            raise RecordingError(f"{self.path}: is not a file")
        try:
            with self.path.open("rb") as file:
                yield from self._read_blocks(file, self.path.stat().st_size)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from None

    def describe_shortfall(self, read: str) -> str:
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

    def get_channel(self, number: int) -> records.Channel:
        """Return the channel of a message."""
        if number not in self.channels:
            raise RecordingError(f"{self.path}: is damaged: a message of no known channel")
        return self.channels[number]

    def _read_blocks(self, file: IO[bytes], size: int) -> Iterator[Block]:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{self.path}: is not an MCAP recording")
        at, checksum = len(MCAP0_MAGIC), zlib.crc32(MCAP0_MAGIC)
        while len(frame := file.read(_FRAME.size)) == _FRAME.size:
            opcode, length = _FRAME.unpack(frame)
            at += _FRAME.size + length
            if at > size:
                return
            if length > RECORD_MAX:
                self.damage = (
                    f"before byte {at}: a record of {length} bytes, at most {RECORD_MAX} are read"
                )
                return
            body = file.read(length)
            self.share = at / size
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
            except (EndOfFile, struct.error):
                self.damage = f"before byte {at}: a record is shorter than it says"
                return
            except Exception as error:  # each decompressor has its own exceptions
                self.damage = f"before byte {at}: {error or type(error).__name__}"
                return
            if block.messages:
                yield block

    def _take(self, opcode: int, body: bytes) -> Block:
        """Process one record of the file; return the messages in it, if any."""
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.CHUNK:
            return self._open_file(_unpack_chunk(records.Chunk.read(stream)))
        if opcode == Opcode.METADATA:
            metadata = records.Metadata.read(stream)
            self.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(stream)
            if attachment.name == CONFIG_ATTACHMENT or attachment.name.startswith(FILE_PREFIX):
                self.attachments[attachment.name] = attachment.data
        elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL) and self.loose:
            return self._open_file(_FRAME.pack(opcode, len(body)) + body)
        elif opcode == Opcode.MESSAGE:
            raise ValueError("a message outside a chunk")
        return Block(b"", [])

    def _open_file(self, content: bytes) -> Block:
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


def _unpack_chunk(chunk: records.Chunk) -> bytes:
    """Return the content of a chunk; `ValueError` if it is not what the chunk says."""
    size = chunk.uncompressed_size
    if size > CHUNK_MAX:
        raise ValueError(
            f"a chunk unpacks to {size} bytes, at most {CHUNK_MAX} are read; "
            "`mcap recover --chunk-size 1000000` makes smaller ones"
        )
    if chunk.compression == "zstd":
        packed = zstandard.ZstdDecompressor(max_window_size=_WINDOW_MAX)
        with packed.stream_reader(chunk.data) as reader:
            content = reader.read(size + 1)
    elif chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        content = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(content) != size:
        than = "more" if len(content) > size else "less"
        raise ValueError(f"a chunk unpacks to {than} than the {size} bytes that it says")
    if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
        raise ValueError("the checksum of a chunk is wrong")
    return bytes(content)
