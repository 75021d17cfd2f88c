"""Indices of a recording being written, in bounded memory."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex, MetadataIndex

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
