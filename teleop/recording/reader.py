"""Read recordings: contents, messages, and topics as numpy columns.

A recording is read with its own message definitions, so other message layouts are readable too.
From a truncated file all finished chunks are read, from a damaged one those before the damage.
"""

import json
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from teleop.config.strict_yaml import SIZE_MAX
from teleop.messages.messages import ENCAPSULATION
from teleop.recording.scan import (
    CONFIG_ATTACHMENT,
    DROPPED_METADATA,
    END_METADATA,
    FILE_PREFIX,
    GAPS_METADATA,
    MESSAGE_HEAD,
    SESSION_METADATA,
    VERSIONS_METADATA,
    RecordingError,
    Scan,
    describe_losses,
    to_topic_name,
)

# --- parse ROS 2 message definitions of recorded messages

_NUMPY = {
    "bool": "?", "byte": "u1", "char": "u1",
    "int8": "i1", "int16": "<i2", "int32": "<i4", "int64": "<i8",
    "uint8": "u1", "uint16": "<u2", "uint32": "<u4", "uint64": "<u8",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
_FIELD = re.compile(r"(?P<type>\w+)(?:\[(?P<count>\d+)\])?\s+(?P<name>[a-zA-Z]\w*)(?P<rest>.*)")


def to_dtype(definition: str) -> np.dtype[np.void]:
    """Return the dtype of CDR messages with a given `ros2msg` definition.

    The dtype covers the whole message, its four-byte encapsulation header included, so
    `numpy.frombuffer(data, dtype)` reads one as recorded. It knows fields of fixed size, which are
    all that this project's messages have.

    Raises `ValueError` if the definition has a field of variable size or of another message type.
    """
    names, formats, offsets = [], [], []
    end = 0
    for line in definition.splitlines():
        text = line.partition("#")[0].strip()
        if not text:
            continue
        field = _FIELD.fullmatch(text)
        if field is None or field["type"] not in _NUMPY:
            raise ValueError(f"{text!r} is not a field of fixed size")
        if field["rest"].lstrip().startswith("="):
            continue  # constants take no bytes
        scalar = np.dtype(_NUMPY[field["type"]])
        count = 1 if field["count"] is None else int(field["count"])
        start = end + -end % scalar.itemsize
        end = start + count * scalar.itemsize
        names.append(field["name"])
        formats.append(scalar if field["count"] is None else (scalar, (count,)))
        offsets.append(len(ENCAPSULATION) + start)
    return np.dtype(
        {
            "names": names,
            "formats": formats,
            "offsets": offsets,
            "itemsize": len(ENCAPSULATION) + end,
        }
    )


FILES_SIZE_MAX = 20_000_000
"""[bytes] of the files that a config names."""

ROWS_MAX = 1 << 32
"""Bytes of the columns of a topic, in memory."""

_TIMES_OFFSET = 6  # where the two times begin in a MESSAGE_HEAD; a row of columns begins there


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message of a recording."""

    topic: str
    data: bytes  # as sent on the link
    log_time_ns: int  # when the recorder received it
    publish_time_ns: int  # when it was sent, on its sender's clock


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Contents of a recording."""

    path: Path
    complete: bool  # closed properly; False = truncated or damaged, `describe_shortfall` says so
    shortfall: str  # what is wrong with the file and what could be read, one line; "" = nothing
    session: str  # "" = unknown
    layout: int | None  # CRC-32 of the message declarations it was made with, None = unknown
    versions: dict[str, str]
    config_text: str  # the session's config file, "" = ran on defaults
    overrides: tuple[str, ...]  # overrides of the command line
    messages: dict[str, int]  # per topic
    lost: dict[str, int]  # per topic: sent, but not recorded
    dropped: dict[str, int]  # per topic: received, but the recorder was too slow to write them
    unfinished: tuple[str, ...]  # sides that went without saying how much they sent
    first_ns: int  # log time of the first message, 0 = there is none
    last_ns: int

    @property
    def seconds(self) -> float:
        """Time [s] from the first message to the last."""
        return (self.last_ns - self.first_ns) * 1e-9

    @property
    def doubts(self) -> list[str]:
        """What the file lacks, in lines of text; none if it is whole."""
        out = [self.shortfall] if self.shortfall else []
        losses = describe_losses(self.lost, self.unfinished)
        return out + [f"{self.path}: {line}" for line in losses]


def open_recording(path: str | Path) -> RecordingInfo:
    """Return the contents of a recording; `RecordingError` if nothing of it can be read."""
    scan = Scan(Path(path))
    counts: dict[int, int] = {}
    first, last = 0, 0
    for block in scan.read_blocks():
        for channel, start, _ in block.messages:
            counts[channel] = counts.get(channel, 0) + 1
            log_time = MESSAGE_HEAD.unpack_from(block.content, start)[2]
            first = min(first or log_time, log_time)
            last = max(last, log_time)
    messages: dict[str, int] = {}
    for channel, count in counts.items():
        topic = to_topic_name(scan.get_channel(channel))
        messages[topic] = messages.get(topic, 0) + count
    if scan.damage and not messages:
        raise RecordingError(f"{path}: is damaged {scan.damage}; nothing could be read")
    head = scan.metadata.get(SESSION_METADATA, {})
    try:
        lost = dict.fromkeys(messages, 0) | _count_losses(scan)
        drops = scan.metadata.get(DROPPED_METADATA, {})
        dropped = dict.fromkeys(messages, 0) | {topic: int(text) for topic, text in drops.items()}
        layout = int(head["layout"], 16) if "layout" in head else None
    except ValueError as error:
        raise RecordingError(f"{path}: is damaged: invalid number in metadata: {error}") from error
    config_text, overrides, _ = _decode_config(scan, head)
    return RecordingInfo(
        path=scan.path,
        complete=scan.complete,
        shortfall=scan.describe_shortfall(
            f"{sum(messages.values())} messages, {(last - first) * 1e-9:.1f} s"
        ),
        session=head.get("session", ""),
        layout=layout,
        versions=scan.metadata.get(VERSIONS_METADATA, {}),
        config_text=config_text,
        overrides=overrides,
        messages=messages,
        lost=lost,
        dropped=dropped,
        unfinished=_list_unfinished(scan),
        first_ns=first,
        last_ns=last,
    )


def list_doubts(scan: Scan, read: str | None) -> list[str]:
    """Return what a file lacks, in lines of text; as in `RecordingInfo`.

    The pass `scan` has ended; `read` is what was read of the file, None if no more was wanted
    before its end.
    """
    shortfall = "" if read is None else scan.describe_shortfall(read)
    try:
        lost = _count_losses(scan)
    except ValueError as error:
        raise RecordingError(
            f"{scan.path}: is damaged: invalid number of losses: {error}"
        ) from error
    losses = [f"{scan.path}: {line}" for line in describe_losses(lost, _list_unfinished(scan))]
    return [shortfall, *losses] if shortfall else losses


def _count_losses(scan: Scan) -> dict[str, int]:
    lost: dict[str, int] = {}
    for stream, count_text in scan.metadata.get(GAPS_METADATA, {}).items():
        topic = stream.partition("/")[0]
        lost[topic] = lost.get(topic, 0) + int(count_text)
    return lost


def _list_unfinished(scan: Scan) -> tuple[str, ...]:
    return tuple(scan.metadata.get(END_METADATA, {}).get("unfinished", "").split())


class RecordedConfig(NamedTuple):
    """The config of a recorded session."""

    text: str  # of its file
    overrides: tuple[str, ...]
    files: dict[str, bytes]  # by the keys that name them: the descriptions of arms


def read_recorded_config(path: str | Path) -> RecordedConfig:
    """Return the config of a recorded session.

    Only the head of the recording is read. `RecordingError` if it is no recording of a session.
    """
    scan = Scan(Path(path))
    next(scan.read_blocks(), None)  # all of it comes before the first messages
    head = scan.metadata.get(SESSION_METADATA)
    if head is None:
        raise RecordingError(f"{path}: is no recording of a session, which would have its config")
    return _decode_config(scan, head)


def _decode_config(scan: Scan, head: Mapping[str, str]) -> RecordedConfig:
    """Return the config; `RecordingError` if a part is longer than any session's."""
    config, overrides = scan.attachments.get(CONFIG_ATTACHMENT, b""), head.get("overrides", "")
    files = {
        name.removeprefix(FILE_PREFIX): data
        for name, data in scan.attachments.items()
        if name.startswith(FILE_PREFIX)
    }
    for part, size, size_max in (
        ("config", len(config), SIZE_MAX),
        ("overrides", len(overrides.encode()), SIZE_MAX),
        ("files", sum(map(len, files.values())), FILES_SIZE_MAX),
    ):
        if size > size_max:
            raise RecordingError(
                f"{scan.path}: its {part}: {size} bytes, at most {size_max} are read; no session "
                "has so many"
            )
    text = config.decode(errors="replace")
    return RecordedConfig(text, _parse_overrides(scan.path, overrides), files)


def _parse_overrides(path: Path, text: str) -> tuple[str, ...]:
    """Return the overrides of a JSON list; of older files, of lines."""
    if not text.startswith("["):
        return tuple(text.splitlines())
    try:
        overrides = json.loads(text)
    except (ValueError, RecursionError):
        overrides = None
    if not isinstance(overrides, list) or not all(isinstance(item, str) for item in overrides):
        raise RecordingError(f"{path}: is damaged: its overrides are not a JSON list of texts")
    return tuple(overrides)


def read_messages(
    path: str | Path, topics: Collection[str] | None = None
) -> Iterator[RecordedMessage]:
    """Yield the messages of a recording in the order of the file (None = of all topics)."""
    scan = Scan(Path(path))
    for block in scan.read_blocks():
        for channel, start, end in block.messages:
            topic = to_topic_name(scan.get_channel(channel))
            if topics is None or topic in topics:
                _, _, log_time, publish_time = MESSAGE_HEAD.unpack_from(block.content, start)
                data = block.content[start + MESSAGE_HEAD.size : end]
                yield RecordedMessage(topic, data, log_time, publish_time)


def read_columns(
    path: str | Path,
    topic: str,
    names: Sequence[str] | None = None,
    doubt: Callable[[str], None] | None = None,
) -> NDArray[np.void]:
    """Return all messages of one topic as a structured array, one row per message.

    Of a truncated or damaged file those that can be read.

    Its fields are `log_time_ns` (received) and `publish_time_ns` (sent), then those of the message;
    rows are in the order of the file. The `topic` is named as in `teleop.messages.topics`; `names`
    are the fields to read, all by default: fewer take less memory. `doubt` is called with one line
    if the file is truncated or damaged.

    Raises `RecordingError` if the file is not a recording, or has no such topic or field.
    """
    scan = Scan(Path(path))
    parts: list[NDArray[np.void]] = []
    size = 0
    for part in read_row_parts(scan, {topic: names}):
        parts.append(part[topic].rows)
        size += parts[-1].nbytes
        if size > ROWS_MAX:
            raise RecordingError(
                f"{path}: has more than {ROWS_MAX >> 30} GB of {topic} messages in "
                "memory; take a part of the recording by `mcap filter`"
            )
    if not parts:
        raise build_missing_topic_error(scan, topic)
    rows = np.concatenate(parts)
    if doubt is not None and (
        shortfall := scan.describe_shortfall(f"{len(rows)} {topic} messages")
    ):
        doubt(shortfall)
    return rows


def build_missing_topic_error(scan: Scan, topic: str) -> RecordingError:
    """Return the error of a recording without messages of a topic, after the whole pass."""
    present = ", ".join(sorted(map(to_topic_name, scan.channels.values()))) or "none at all"
    damage = f"; it is damaged {scan.damage}" if scan.damage else ""
    return RecordingError(f"{scan.path}: no messages of topic {topic!r}; it has {present}{damage}")


class TopicRows(NamedTuple):
    """Messages of one topic in a part of a recording."""

    places: NDArray[np.int64]  # in the order of the file, over all topics; shape (messages,)
    rows: NDArray[np.void]  # as of `read_columns`


def read_row_parts(
    scan: Scan, topics: Mapping[str, Sequence[str] | None], size: int = 1
) -> Iterator[dict[str, TopicRows]]:
    """Yield the messages of some topics in parts of `size` or somewhat more, in bounded memory.

    `scan` can be asked what the file lacks when it has ended; `topics` has the fields to read, None
    = all. Yields the messages of the topics that have some in a part. Raises `RecordingError` if
    the file is not a recording, or a topic lacks a field.
    """
    taken: dict[str, tuple[list[int], list[bytes]]] = {}
    ids: dict[str, set[int]] = {}
    first = count = 0

    def parse_taken() -> dict[str, TopicRows]:
        parts = {}
        for topic, (places, pieces) in taken.items():
            dtype = _build_row_dtype(scan, ids[topic], topic)
            if any(len(piece) != dtype.itemsize for piece in pieces):
                raise RecordingError(
                    f"{scan.path}: a {topic} message does not have the size of its definition"
                )
            rows = np.frombuffer(b"".join(pieces), dtype)
            names = topics[topic]
            if names is not None:
                rows = _select_columns(rows, names, scan.path, topic)
            parts[topic] = TopicRows(np.array(places, dtype=np.int64), rows)
        return parts

    for block in scan.read_blocks():
        topic_of = {n: to_topic_name(channel) for n, channel in scan.channels.items()}
        for place, (channel, start, end) in enumerate(block.messages, first):
            topic = topic_of.get(channel)
            if topic is not None and topic in topics:
                places, pieces = taken.setdefault(topic, ([], []))
                places.append(place)
                pieces.append(block.content[start + _TIMES_OFFSET : end])
                ids.setdefault(topic, set()).add(channel)
                count += 1
        first += len(block.messages)
        if count >= size:
            yield parse_taken()
            taken, count = {}, 0
    if taken:
        yield parse_taken()


def _build_row_dtype(scan: Scan, ids: set[int], topic: str) -> np.dtype[np.void]:
    """Return the dtype of a row: the two times of the message record, and the message."""
    dtypes = []
    for channel in (scan.channels[n] for n in ids):
        schema = scan.schemas.get(channel.schema_id)
        if (
            schema is None
            or schema.encoding != SchemaEncoding.ROS2
            or channel.message_encoding != MessageEncoding.CDR
        ):
            raise RecordingError(f"{scan.path}: topic {topic!r} is not in the ROS 2 encoding")
        try:
            dtypes.append(to_dtype(schema.data.decode()))
        except ValueError as error:
            raise RecordingError(f"{scan.path}: topic {topic!r}: {error}") from error
    message = dtypes[0]
    if any(dtype != message for dtype in dtypes):
        raise RecordingError(
            f"{scan.path}: topic {topic!r} has messages with different definitions"
        )
    fields: Mapping[str, Any] = message.fields or {}
    return np.dtype(
        {
            "names": ["log_time_ns", "publish_time_ns", *fields],
            "formats": ["<i8", "<i8", *(entry[0] for entry in fields.values())],
            "offsets": [0, 8, *(16 + entry[1] for entry in fields.values())],
            "itemsize": 16 + message.itemsize,
        }
    )


def _select_columns(
    rows: NDArray[np.void], names: Sequence[str], path: Path, topic: str
) -> NDArray[np.void]:
    present = rows.dtype.names or ()
    for name in names:
        if name not in present:
            raise RecordingError(
                f"{path}: {topic} messages have no field {name!r} (another message layout?); "
                f"they have {', '.join(present)}"
            )
    selected: NDArray[np.void] = repack_fields(rows[list(names)])
    return selected
