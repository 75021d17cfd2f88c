"""Write a recording: messages as sent on the link, in an MCAP file that survives a kill.

The file is self-contained: every channel has its ROS 2 message definition, and session, layout,
versions and config are at its head. See docs/how-to/record-and-view.md.
"""

import contextlib
import io
import json
import platform
import tempfile
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NoReturn, Self, cast

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex, MetadataIndex
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.config.strict_yaml import SIZE_MAX
from teleop.errors import TeleopError, UsageError
from teleop.link import ReceivedMessage
from teleop.messages.messages import LAYOUT, SCHEMA_PACKAGE
from teleop.messages.topics import Topic
from teleop.recording.scan import (
    CONFIG_ATTACHMENT,
    DROPPED_METADATA,
    END_METADATA,
    FILE_PREFIX,
    GAPS_METADATA,
    SESSION_METADATA,
    VERSIONS_METADATA,
    to_channel_name,
)
from teleop.runtime.process import is_supervised

# --- the `record:` section of a config file


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Folder of recordings, write intervals, scheduling."""

    directory: str = "recordings"  # created if missing; `--out` overrides it
    # messages are written to the file in chunks of this duration
    chunk_s: float = build_ranged_field(0.1, 0.01, 10.0, "s")
    drain_s: float = build_ranged_field(0.02, 0.001, 1.0, "s")  # between two reads from the link
    # SCHED_RR, below the loops (realtime.priority); 0: ordinary, after them
    priority: int = build_ranged_field(1, 0, 49)
    compression: Literal["zstd", "lz4", "none"] = "zstd"  # of the chunks

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.directory:
            raise ValueError("directory: is empty, give a path (recordings)")


# --- indices of a recording being written, in bounded memory

MEMORY_BYTES_MAX = 65_536  # longer ones are in a file


class ChunkIndices:
    """Replaces the list of `ChunkIndex` objects in `mcap.writer.Writer`.

    One is added for each chunk, ten a second by default, and written when the file is finished. As
    objects those of eight channels take 860 bytes each, 31 MB an hour; as in the file, 160. Beyond
    `MEMORY_BYTES_MAX` they are kept in a file without a name in the `folder` of the recording.
    """

    def __init__(self, folder: Path) -> None:
        self._encoded = tempfile.SpooledTemporaryFile(max_size=MEMORY_BYTES_MAX, dir=str(folder))  # noqa: SIM115 - `close`

    def append(self, index: ChunkIndex) -> None:
        """Add the index of a finished chunk."""
        builder = RecordBuilder()
        index.write(builder)
        self._encoded.write(builder.end())

    def __iter__(self) -> Iterator["ChunkIndices"]:
        """Iterate over the items to be written: this one."""
        yield self

    def write(self, stream: RecordBuilder) -> None:
        """Write all records."""
        self._encoded.seek(0)
        stream.write(self._encoded.read())

    def close(self) -> None:
        """Remove the file."""
        self._encoded.close()


class MetadataIndices:
    """Replaces the list of `MetadataIndex` objects: of each name it keeps the last, which counts.

    Losses are written whenever they change, ten times a second on a bad network.
    """

    def __init__(self) -> None:
        self._last: dict[str, MetadataIndex] = {}

    def append(self, index: MetadataIndex) -> None:
        """Add the index of a record of metadata."""
        self._last[index.name] = index

    def __iter__(self) -> Iterator[MetadataIndex]:
        """Iterate over the items to be written."""
        yield from self._last.values()


# --- messages that were sent but are not in a recording, counted from their sequence numbers

SENDERS = 64  # senders tracked per topic; beyond that the least recent one is dropped
DROPPED_SENDER = 0  # stands for dropped senders


class GapCounter:
    """Lost messages per topic and sender.

    Each sender numbers the messages of a topic 0, 1, 2, ..., and the link delivers them in rising
    order; a skipped number is a lost message. Messages before the first or after the last received
    one are not counted, unless `note_sent` says that there were some after it: these are counted by
    `finish`. A restarted process is a new sender, not a gap. Losses of dropped senders are summed
    under `DROPPED_SENDER`.
    """

    def __init__(self) -> None:
        self.lost: dict[tuple[str, int], int] = {}  # (topic, sender) -> messages
        self._sent: dict[tuple[str, int], int] = {}  # the sender's own count
        self._next: dict[str, OrderedDict[int, int]] = {}  # topic -> sender -> number, oldest first

    def note(self, topic: str, sender: int, sequence: int) -> None:
        """Add one message."""
        stream, senders = (topic, sender), self._next.setdefault(topic, OrderedDict())
        expected = senders.get(sender, sequence)
        self.lost[stream] = self.lost.get(stream, 0) + max(0, sequence - expected)
        senders[sender] = max(expected, sequence + 1)
        senders.move_to_end(sender)
        if len(senders) > SENDERS:
            oldest, _ = senders.popitem(last=False)
            forgotten = topic, DROPPED_SENDER
            lost = self.lost.pop((topic, oldest), 0)
            self._sent.pop((topic, oldest), None)
            self.lost[forgotten] = self.lost.get(forgotten, 0) + lost

    def note_sent(self, topic: str, sender: int, sequence: int) -> None:
        """Note that a sender says that `sequence` is its last message of a topic so far.

        Ignored while no message of them was received: the recording begins with the first.
        """
        if sender in self._next.get(topic, ()):
            self._sent[topic, sender] = max(sequence, self._sent.get((topic, sender), 0))

    def finish(self) -> None:
        """Count as lost what senders sent after the last message received; once, at the end."""
        for (topic, sender), sequence in self._sent.items():
            expected = self._next[topic][sender]
            self.lost[topic, sender] += max(0, sequence + 1 - expected)
        self._sent.clear()

    @property
    def total(self) -> int:
        """Lost messages of all topics and senders."""
        return sum(self.lost.values())

    def count_by_topic(self) -> dict[str, int]:
        """Return lost messages per topic, senders taken together."""
        topics: dict[str, int] = {}
        for (topic, _), count in self.lost.items():
            topics[topic] = topics.get(topic, 0) + count
        return topics


_VERSIONED_PACKAGES = ("tendon-teleop", "eclipse-zenoh", "mcap", "numpy", "numba")
_COMPRESSION = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}


class RecordingWriter:
    """A recording being written; a context manager that always closes the file.

    Messages are buffered and passed to the kernel as one closed chunk every `chunk_s`, so a killed
    process loses at most the last `chunk_s`. A power cut may also lose what the kernel has not
    written yet.

    The name of the file begins with that of the `session`, and has `started_ns`, the present stamp
    [ns since the Unix epoch]. Attachments are the session's config file and, in `files`, what those
    have that keys of the config name; metadata are the `overrides` of the command line, and whether
    the session was `insecure`. Raises `UsageError` if the file cannot be created, or the overrides
    are longer than a reader reads.
    """

    def __init__(
        self,
        config: RecordConfig,
        session: str,
        started_ns: int,
        config_text: str = "",
        overrides: Sequence[str] = (),
        insecure: bool = False,
        files: Mapping[str, bytes] = MappingProxyType({}),
    ) -> None:
        overrides_text = json.dumps(list(overrides))  # ASCII
        if len(overrides_text) > SIZE_MAX:
            raise UsageError(
                f"--set: the overrides have {len(overrides_text)} bytes, at most {SIZE_MAX} are "
                "recorded; state them in a config file"
            )
        self.messages: dict[str, int] = {}  # topic -> messages in the file
        self.gaps = GapCounter()
        self.lag_max_s = 0.0  # [s] the longest that a message waited to be written
        self.unfinished: tuple[str, ...] = ()  # roles that went without saying how much they sent
        self.dropped: dict[str, int] = {}  # topic -> messages dropped before reading
        self.first_ns = self.last_ns = 0  # when the first and the last of them were received
        self._taken: dict[str, int] = {}  # topic -> messages in the file or on the way there
        self._span_ns = (0, 0)
        self.path, file = _create_file(Path(config.directory), session, started_ns)
        self._file = _CommitBuffer(file)
        self._chunk_ns = round(config.chunk_s * 1e9)
        self._committed_ns = started_ns
        self._noted_loss, self._noted_drops = 0, dict[str, int]()
        self._channels: dict[str, int] = {}
        self._mcap = Writer(
            cast(io.BufferedWriter, self._file),
            compression=_COMPRESSION[config.compression],
            enable_data_crcs=True,
        )
        # private lists of mcap, without alternative; a test checks that they are used
        self._indices = ChunkIndices(self.path.parent)
        vars(self._mcap)["_Writer__chunk_indices"] = self._indices
        vars(self._mcap)["_Writer__metadata_indexes"] = MetadataIndices()
        self._mcap.start(
            profile=Profile.ROS2, library=f"tendon-teleop {_find_version('tendon-teleop')}"
        )
        started = datetime.fromtimestamp(started_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
        self._mcap.add_metadata(
            SESSION_METADATA,
            {
                "session": session,
                "started": started,
                "started_ns": str(started_ns),
                "layout": f"{LAYOUT:08x}",
                "overrides": overrides_text,
                "protection": "none" if insecure else "authenticated",
            },
        )
        self._mcap.add_metadata(
            VERSIONS_METADATA,
            {"python": platform.python_version()}
            | {name: _find_version(name) for name in _VERSIONED_PACKAGES},
        )
        if config_text:
            self._mcap.add_attachment(
                started_ns, started_ns, CONFIG_ATTACHMENT, "application/yaml", config_text.encode()
            )
        for key, data in files.items():
            self._mcap.add_attachment(
                started_ns, started_ns, FILE_PREFIX + key, "application/xml", data
            )
        self._commit()

    @property
    def bytes_written(self) -> int:
        """Length of the file [bytes] in the kernel."""
        return self._file.length

    def note_dropped(self, dropped: Mapping[str, int]) -> None:
        """Record how many messages of each topic were dropped because the recorder was too slow.

        They are also counted as gaps, unless no message of their sender was kept before or after.
        """
        self.dropped = {topic: count for topic, count in dropped.items() if count}

    def write(self, messages: Iterable[ReceivedMessage], now_ns: int) -> None:
        """Add messages; write a chunk if `chunk_s` has passed since the last one.

        Call it also without messages, to write the last ones when the session falls silent.
        """
        for item in messages:
            name = item.topic.name
            channel = self._channels.get(name) or self._register(item.topic)
            self._mcap.add_message(
                channel_id=channel,
                log_time=item.received_ns,
                publish_time=item.stamp_ns,
                sequence=item.sequence & 0xFFFFFFFF,
                data=item.data,
            )
            self._taken[name] += 1
            self.gaps.note(name, item.sender, item.sequence)
            self._span_ns = (self._span_ns[0] or item.received_ns, item.received_ns)
        if now_ns - self._committed_ns >= self._chunk_ns:
            self._committed_ns = now_ns
            self._flush()
            if self.gaps.total != self._noted_loss or self.dropped != self._noted_drops:
                self._note_gaps()
            self._commit()

    def close(self) -> None:
        """Write the buffer, the counts and the index, and close the file."""
        if self._file.closed:
            return
        try:
            self._flush()
            self.gaps.finish()
            self._note_gaps()
            self._mcap.add_metadata(
                END_METADATA,
                {
                    "missing": str(self.gaps.total),
                    "lag_max_s": f"{self.lag_max_s:.3f}",
                    "unfinished": " ".join(self.unfinished),
                },
            )
            self._commit()  # all that was received, before the index, which may be long
            self._mcap.finish()
            self._commit()
        finally:
            self._indices.close()
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _register(self, topic: Topic[Any]) -> int:
        schema = topic.message.schema
        schema_id = self._mcap.register_schema(
            f"{SCHEMA_PACKAGE}/msg/{schema.name}",
            SchemaEncoding.ROS2,
            schema.ros_definition.encode(),
        )
        channel = self._mcap.register_channel(
            to_channel_name(topic.name), MessageEncoding.CDR, schema_id
        )
        self._channels[topic.name] = channel
        self._taken[topic.name] = 0
        return channel

    def _note_gaps(self) -> None:
        counts = {f"{topic}/{sender:016x}": str(n) for (topic, sender), n in self.gaps.lost.items()}
        self._mcap.add_metadata(GAPS_METADATA, counts)
        self._noted_loss = self.gaps.total
        if self.dropped:
            self._mcap.add_metadata(DROPPED_METADATA, {t: str(n) for t, n in self.dropped.items()})
        self._noted_drops = self.dropped

    def _flush(self) -> None:
        try:
            self._mcap.flush()
        except OSError as error:  # of the file of indices
            self._give_up(error)

    def _commit(self) -> None:
        try:
            self._file.commit()
        except OSError as error:
            self._give_up(error)
        self.messages = dict(self._taken)
        self.first_ns, self.last_ns = self._span_ns

    def _give_up(self, error: OSError) -> NoReturn:
        self._indices.close()
        self._file.close()
        raise TeleopError(
            f"{self.path}: write failed: {error.strerror}; earlier data are kept; free some "
            f"space or choose another {find_folder_option()}"
        ) from error


class _CommitBuffer:
    """Output of mcap: buffered until `commit`, which writes it at once."""

    def __init__(self, file: io.FileIO) -> None:
        self.length = 0
        self._file = file
        self._held: list[bytes] = []
        self._held_bytes = 0

    def write(self, data: bytes) -> None:
        self._held.append(data)
        self._held_bytes += len(data)

    def tell(self) -> int:
        return self.length + self._held_bytes

    def flush(self) -> None:
        """Wait for `commit`."""

    def commit(self) -> None:
        remaining = memoryview(b"".join(self._held))
        self._held, self._held_bytes = [], 0
        end = self.length + len(remaining)
        try:
            while remaining:
                remaining = remaining[self._file.write(remaining) :]
        except OSError:
            with contextlib.suppress(OSError):  # a truncated last record is readable too
                self._file.truncate(self.length)
            raise
        self.length = end

    @property
    def closed(self) -> bool:
        return self._file.closed

    def close(self) -> None:
        self._file.close()


def _create_file(directory: Path, session: str, started_ns: int) -> tuple[Path, io.FileIO]:
    """Create a new file, `<session>-<UTC time>.mcap`; never overwrite one."""
    stem = f"{session}-{datetime.fromtimestamp(started_ns // 10**9, UTC):%Y%m%dT%H%M%SZ}"
    attempt = 1
    try:
        directory.mkdir(parents=True, exist_ok=True)
        while True:
            path = directory / (f"{stem}.mcap" if attempt == 1 else f"{stem}-{attempt}.mcap")
            try:
                return path, path.open("xb", buffering=0)
            except FileExistsError:
                attempt += 1
    except OSError as error:
        raise UsageError(
            f"{directory}: cannot create a recording: {error.strerror}; choose another "
            f"{find_folder_option()}"
        ) from error


def find_folder_option() -> str:
    """Return the name of the option for the folder in the user's command."""
    return "--record" if is_supervised() else "--out"


def _find_version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"
