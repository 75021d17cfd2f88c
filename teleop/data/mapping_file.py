"""A mapping file: how the tables of a lab are to be read, for a hundred files at once."""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal, NamedTuple

from estimator.units import Units
from teleop.config import strict_yaml
from teleop.config.loading import ConfigDocument
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.data import standard_columns
from teleop.data.standard_columns import Columns
from teleop.errors import UsageError


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedColumn:
    """The column of a channel."""

    column: str  # its name in the file
    unit: str = ""  # of its values; empty: as the name or a row of units states
    scale: float = 1.0  # units per unit of the values: 12.5 with unit N of a cell in volts; sign

    def __post_init__(self) -> None:
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
    # samples per second, where time is the number of the sample
    rate_hz: float | None = build_ranged_field(None, 0.0, 1e9, "Hz", above=True)
    sheet: str = ""  # of a spreadsheet with several
    # the one of a file of several runs, from 1; 0: all rows are one run
    run: int | None = build_ranged_field(None, 0, math.inf)
    run_column: str = ""  # that names the run, where it is not called so

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.separator not in ("", ",", ";", "|", " ", "\t", "\\t"):
            raise ValueError("separator: must be one of , ; | space \\t")

    def format_options(self) -> tuple[str, ...]:
        """Return the columns as values of `--column`."""
        given = ((f.name, getattr(self.columns, f.name)) for f in fields(self.columns))
        return tuple(f"{name}={each.format_option()}" for name, each in given if each is not None)


def load_mapping(args: argparse.Namespace) -> TableMapping:
    """Return how tables are to be read, by `--mapping`, `--rate`, `--decimal` and `--run`.

    Raises `UsageError` if the file or an option is invalid.
    """
    mapping = read_mapping(args.mapping)
    for option, key in {"rate": "rate_hz", "decimal": "decimal", "run": "run"}.items():
        if (value := getattr(args, option)) is not None:
            try:
                mapping = replace(mapping, **{key: value})
            except ValueError as error:
                raise UsageError(f"--{option} {value}: {error}") from error
    return mapping


def read_mapping(path: Path | None) -> TableMapping:
    """Return what a mapping file says, the defaults without one; `UsageError`."""
    if path is None:
        return TableMapping()
    return ConfigDocument(path, strict_yaml.read_text(path, "mapping file")).load(TableMapping)


def map_columns(tendons: Sequence[Columns], mapping: TableMapping) -> tuple[Columns, ...]:
    """Return the columns of tendons, named as by the mapping where they have standard names.

    Its time is that of all tendons, its other columns are those of the first one.
    """
    named = parse_column_names(mapping.format_options())
    own = {item: name for item, name in named.list_names().items() if not named.is_standard(item)}
    times = {item: name for item, name in own.items() if item == "time"}

    def rename(columns: Columns, names: Mapping[str, str]) -> Columns:
        standard = [item for item in columns.list_names() if columns.is_standard(item)]
        return replace(columns, **{k: name for k, name in names.items() if k in standard})

    return tuple(rename(c, times if k else own) for k, c in enumerate(tendons))


class NamedColumns(NamedTuple):
    """Column names, and the units that they were named in; None where none was told."""

    names: Columns
    units: Units | None


def parse_column_options(words: Sequence[str], tendon: int = 0) -> NamedColumns:
    """Return the columns of a tendon, from 0, with the overrides of `--column`.

    NAME may be that of a torque, an angle or a force, such as `proximal_torque`.

    Raises `UsageError` if an override is none, or they are linear in part and rotary in part.
    """
    pairs = [word.partition("=") for word in words]
    units = standard_columns.detect_option_units([name for name, _, _ in pairs])
    meant = [
        f"{standard_columns.to_channel(name)}{equals}{column}" for name, equals, column in pairs
    ]
    return NamedColumns(parse_column_names(meant, tendon), units)


def parse_column_names(words: Sequence[str], tendon: int = 0) -> Columns:
    """Return the column names of a tendon, from 0, with the overrides NAME=COLUMN."""
    field_names = [f.name for f in fields(Columns)]
    renamed = {}
    for word in words:
        name, equals, column = word.partition("=")
        if name not in field_names or not equals or not column:
            raise UsageError(
                f"--column {word}: expected NAME=COLUMN, NAME one of {', '.join(field_names)}"
            )
        renamed[name] = column
    return replace(Columns.from_tendon(tendon + 1), **renamed)
