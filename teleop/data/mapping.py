"""A mapping file: how the tables of a lab are to be read, for a hundred files at once."""

from dataclasses import dataclass, fields
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedColumn:
    """The column of a channel."""

    column: str  # its name in the file
    unit: str = ""  # of its values; empty: as the name or a row of units states
    scale: float = 1.0  # units per unit of the values: 12.5 with unit N of a cell in volts; sign

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not self.column:
            raise ValueError("column: must not be empty")
        if not (abs(self.scale) > 0.0 and abs(self.scale) < 1e12):
            raise ValueError("scale: must be finite and not 0")

    def format_option(self) -> str:
        """Return it as in `--column NAME=COLUMN[SCALE UNIT]`."""
        scale = "" if self.scale == 1.0 else repr(self.scale).removesuffix(".0")
        stated = " ".join(part for part in (scale, self.unit) if part)
        return f"{self.column}[{stated}]" if stated else self.column


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedColumns:
    """The columns by channel; those that are not given have their standard names."""

    time: MappedColumn | None = None
    proximal_tension: MappedColumn | None = None
    proximal_force: MappedColumn | None = None
    proximal_torque: MappedColumn | None = None
    proximal_displacement: MappedColumn | None = None
    proximal_angle: MappedColumn | None = None
    distal_tension: MappedColumn | None = None
    distal_force: MappedColumn | None = None
    distal_torque: MappedColumn | None = None
    distal_displacement: MappedColumn | None = None
    distal_angle: MappedColumn | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableMapping:
    """How a table is to be read; what is not given is found in the file."""

    columns: MappedColumns = MappedColumns()
    separator: str = ""  # between columns: , ; | a space, or \t
    decimal: Literal["", "point", "comma"] = ""  # sign of decimals
    time_format: str = ""  # of times as text, such as %d.%m.%Y %H:%M:%S.%f
    rate_hz: float | None = None  # samples per second, where time is the number of the sample
    sheet: str = ""  # of a spreadsheet with several

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if self.separator not in ("", ",", ";", "|", " ", "\t", "\\t"):
            raise ValueError("separator: must be one of , ; | space \\t")
        if self.rate_hz is not None and not 0.0 < self.rate_hz < 1e9:
            raise ValueError("rate_hz: must be above 0")

    def options(self) -> tuple[str, ...]:
        """Return the columns as values of `--column`."""
        given = ((f.name, getattr(self.columns, f.name)) for f in fields(self.columns))
        return tuple(f"{name}={each.format_option()}" for name, each in given if each is not None)
