"""The columns of a file before they have a meaning, and how it is written."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from teleop.data import read_limits
from teleop.errors import UsageError

Column = NDArray[Any]  # float64, or object if some cell is text

SEPARATORS: Mapping[str, str] = MappingProxyType(
    {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
)

_MARKS = {
    b"PK\x03\x04": "a spreadsheet (.xlsx) or .npz",
    b"\xd0\xcf\x11\xe0": "a spreadsheet (.xls)",
}
_MARKS |= {b"\x1f\x8b": "packed (.csv.gz)", b"PAR1": ".parquet", b"ARROW1": ".feather"}
_MARKS |= {b"\x89HDF": "HDF5 (.h5)", b"MATLAB 5.0": ".mat", b"\x89MCAP": "a recording (.mcap)"}

_MARKUP = {b"<?xml": "XML", b"<": "HTML"} | dict.fromkeys((b'{"', b"[{", b"[["), "JSON (.json)")


@dataclass(frozen=True, slots=True)
class Layout:
    """How a table is written."""

    names: tuple[str, ...]
    names_line: int = 1
    data_line: int = 1  # line above the first row
    units: Mapping[str, str] = field(default_factory=dict)  # by column, of a row of units
    separator: str = ","
    decimal: str = "."  # "" if no number in the sample tells
    encoding: str = "utf-8-sig"
    width: int = 0  # cells of the line of names, of which the last may be blank

    def has_units(self, cells: Sequence[str]) -> bool:
        """Return whether a row has the units of that below the names."""
        row = [cell.strip(" []()") for cell in cells]
        return bool(self.units) and row == [self.units.get(name, "") for name in self.names]

    def describe(self) -> tuple[str, ...]:
        """Return what differs from a table as this project writes it."""
        parts = []
        if self.encoding != "utf-8-sig":
            parts.append(self.encoding)
        if self.separator not in ("", ","):
            parts.append(f"{SEPARATORS.get(self.separator, repr(self.separator))} between columns")
        if self.decimal == ",":
            parts.append("decimal commas")
        if self.names_line == 0:
            parts.append(f"no names, so its columns are column 1 to column {len(self.names)}")
        elif self.names_line != 1:
            parts.append(f"names in line {self.names_line}")
        if self.units:
            parts.append(f"units in line {self.data_line}")
        return tuple(parts)


@dataclass(frozen=True, slots=True)
class RawTable:
    """The raw columns of a file; `place(row)` is the place of row 0, 1, ... in messages."""

    path: Path
    columns: Mapping[str, Column]
    place: Callable[[int], str]
    lacks: str = ""  # why columns of a tendon are not there, one line
    clocked: bool = False  # the times are of a clock, so their unit is known
    units: Mapping[str, str] = field(default_factory=dict)  # by column, of a row of units
    decimal: str = "."  # sign of decimals in cells that are text
    words: Mapping[str, Counter[str]] = field(default_factory=dict)  # by column: no numbers
    remarks: tuple[str, ...] = ()  # how the file differs from one of this project
    breaks: tuple[int, ...] = ()  # rows above which the names come again

    def locate(self, name: str, row: int) -> str:
        """Return the place of a cell, for messages."""
        return f"{self.path}: column {name!r}, {self.place(row)}"

    def select(self, rows: range | NDArray[np.intp]) -> Self:
        """Return some rows of a file, which keep their places; of a range without a copy."""
        index = slice(rows.start, rows.stop) if isinstance(rows, range) else rows
        columns = {name: column[index] for name, column in self.columns.items()}
        return replace(self, columns=columns, place=lambda row: self.place(int(rows[row])))


def detect_encoding(path: Path, head: bytes) -> str:
    """Return the encoding that the first bytes of a file tell; UTF-8 where they tell none.

    Raises `UsageError` if they are those of another kind of file.
    """
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if kind := next((kind for mark, kind in _MARKUP.items() if text.startswith(mark)), ""):
        raise UsageError(f"{path}: is no table of text, but {kind}: save it as .csv")
    if kind := next((kind for mark, kind in _MARKS.items() if head.startswith(mark)), ""):
        raise UsageError(f"{path}: is no text, but {kind}: rename it")
    for mark, name in ((b"\xff\xfe\0\0", "utf-32"), (b"\0\0\xfe\xff", "utf-32")):
        if head.startswith(mark):
            return name
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in head and len(head) > 3:  # text of ASCII has its zeros at even or at odd places
        even, odd = head[0:400:2].count(0), head[1:400:2].count(0)
        if min(even, odd) == 0 and max(even, odd) > len(head[:400]) // 4:
            return "utf-16-be" if even else "utf-16-le"
    return "utf-8-sig"


def check_names(path: Path, line: int, names: Sequence[str]) -> None:
    """Raise `UsageError` for names of columns that cannot be."""
    if not "".join(names).strip():
        raise UsageError(f"{path}: line {line}: is blank, must contain the column names")
    if not all(name.isprintable() for name in names):
        raise UsageError(f"{path}: line {line}: is not text, must contain the column names")
    read_limits.check_size(path, len(names), 0, "keep those that are needed")
    for name in names:
        if name and names.count(name) > 1:
            raise UsageError(
                f"{path}: line {line}: column {name!r} occurs {names.count(name)} times; "
                "rename all but one"
            )
