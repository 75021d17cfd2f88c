"""The columns of a file before they have a meaning, and how it is written."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Column = NDArray[Any]  # float64, or object if some cell is text

SEPARATORS: Mapping[str, str] = MappingProxyType(
    {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
)


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
        if self.names_line != 1:
            parts.append(f"names in line {self.names_line}")
        if self.units:
            parts.append(f"units in line {self.data_line}")
        return tuple(parts)


@dataclass(frozen=True, slots=True)
class RawTable:
    """The raw columns of a file; `place(row)` is the place of row 0, 1, ... in messages."""

    columns: Mapping[str, Column]
    place: Callable[[int], str]
    lacks: str = ""  # why columns of a tendon are not there, one line
    clocked: bool = False  # the times are of a clock, so their unit is known
    units: Mapping[str, str] = field(default_factory=dict)  # by column, of a row of units
    decimal: str = "."  # sign of decimals in cells that are text
    words: Mapping[str, Counter[str]] = field(default_factory=dict)  # by column: no numbers
    remarks: tuple[str, ...] = ()  # how the file differs from one of this project
    breaks: tuple[int, ...] = ()  # rows above which the names come again

    def select(self, rows: range | NDArray[np.intp]) -> Self:
        """Return some rows of a file, which keep their places; of a range without a copy."""
        index = slice(rows.start, rows.stop) if isinstance(rows, range) else rows
        columns = {name: column[index] for name, column in self.columns.items()}
        return replace(self, columns=columns, place=lambda row: self.place(int(rows[row])))
