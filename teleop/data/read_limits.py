"""How much of a file of measured data is read: what is beyond is refused before it is allocated."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from teleop.errors import UsageError

CELLS_MAX = 100_000_000
"""Values of a table, 800 MB: five channels at 1 kHz for five hours."""

COLUMNS_MAX = 1000
"""Columns of a table; 16 tendons have 65."""

CELL_MAX = 131_072
"""Characters of a cell: the limit of `csv`."""

LINE_MAX = 1 << 20
"""Characters of a line of text."""

BLANK_MAX = 10_000
"""Blank lines one after another."""

TEXT_MAX = 1 << 31
"""Bytes of a text file, unpacked: 20 for each of so many values."""


def check_size(path: Path, columns: int, rows: int, remedy: str) -> None:
    """Raise `UsageError` if a table is too wide or too large to be read."""
    if columns > COLUMNS_MAX:
        raise UsageError(f"{path}: has {columns} columns, at most {COLUMNS_MAX} are read; {remedy}")
    if columns * rows > CELLS_MAX:
        raise UsageError(
            f"{path}: {columns} columns have more than {CELLS_MAX // columns} rows, at most "
            f"{CELLS_MAX} values are read; {remedy}"
        )


def read_bounded_lines(path: Path, text: IO[str]) -> Iterator[str]:
    """Yield the lines of a text file; `UsageError` if one is too long, or too many are blank."""
    number = blank = 0
    while line := text.readline(LINE_MAX + 1):
        number += 1
        blank = 0 if line.strip() else blank + 1
        if blank > BLANK_MAX:
            raise UsageError(
                f"{path}: line {number}: more than {BLANK_MAX} blank lines; remove them"
            )
        if len(line) > LINE_MAX:
            raise UsageError(
                f"{path}: line {number}: is longer than {LINE_MAX} characters; a row of a table "
                "with at most 1000 columns is shorter"
            )
        yield line


class BoundedReader(io.RawIOBase):
    """A binary file of which at most `TEXT_MAX` bytes are read, then `UsageError` is raised."""

    def __init__(self, path: Path, file: io.BufferedIOBase) -> None:
        self._path, self._file, self._read = path, file, 0

    def readable(self) -> bool:
        """Return that it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Read into a buffer; return the number of bytes."""
        data = self._file.read(len(buffer))
        buffer[: len(data)] = data
        self._read += len(data)
        if self._read > TEXT_MAX:
            raise UsageError(
                f"{self._path}: unpacks to more than {TEXT_MAX >> 20} MB of text; split it, or "
                "save it as .parquet"
            )
        return len(data)

    def seekable(self) -> bool:
        """Return that it can go back to its start."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Seek in what is unpacked; from the start on it counts anew."""
        at = self._file.seek(offset, whence)
        self._read = min(self._read, at)
        return at
