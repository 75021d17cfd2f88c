"""Measured data of one tendon: read, check, write.

The format is described in docs/reference/data-format.md. Nothing is repaired silently: invalid data
raise a `UsageError` of one line with file, column and row.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.units import LINEAR, Units
from teleop.data import standard_columns, time_text
from teleop.data.column_search import (
    NAMES_SHOWN,
    detect_file_units,
    find_columns,
    is_travel_pair,
    match_name,
    replace_aliases,
)
from teleop.data.column_units import (
    UNIT_FACTORS,
    convert_to_si,
    find_aliases,
    propose_time_unit,
    split_unit,
)
from teleop.data.file_formats import check_destination, read_columns, write_table
from teleop.data.mapping_file import TableMapping
from teleop.data.raw_table import Column, RawTable
from teleop.data.run_splitting import list_runs, split_runs
from teleop.data.sample_checks import check_samples, estimate_rate
from teleop.data.standard_columns import Columns
from teleop.data.text_cells import THOUSANDS, classify_word, to_number
from teleop.errors import UsageError
from teleop.runtime.process import print_warning

__all__ = [
    "Columns",
    "MeasuredTable",
    "check_destination",
    "read_runs",
    "read_table",
    "read_tables",
    "write_table",
]


# what a force is estimated from
HOUSING_CHANNELS = ("time", "proximal_tension", "proximal_displacement")
RATE_ERROR = 0.1  # of --rate beside the ticks of a coarse clock


class Source(NamedTuple):
    """The column of a channel in the file."""

    column: str
    unit: str  # as stated; "" if nothing states it
    factor: float  # by which it was multiplied


@dataclass(frozen=True, slots=True)
class MeasuredTable:
    """The samples of one tendon; arrays of shape (samples,), None without a sensor.

    Read for a diagnosis or with `drop_nonfinite`, channels are NaN where a value is missing.
    In `units`: of a rotary record tensions are torques [N m], displacements angles [rad].
    """

    time: Array  # [s] strictly increasing
    proximal_tension: Array  # [N]
    proximal_displacement: Array | None  # [m]
    distal_tension: Array | None  # [N]
    distal_displacement: Array | None  # [m]
    path: Path
    extra: Mapping[str, Column] = field(default_factory=dict)  # further columns, as they are
    dropped: int = 0  # number of rows omitted because of non-finite values
    units: Units = LINEAR
    run: int = 0  # which one of a file of several, from 1
    first: str = ""  # place of its first row in the file
    remarks: tuple[str, ...] = ()  # how the file was understood, where it is not as usual
    sources: Mapping[str, Source] = field(default_factory=dict)  # of the fields above

    @property
    def name(self) -> str:
        """The file, and which of its runs."""
        return f"{self.path}, run {self.run}" if self.run else str(self.path)

    def columns(self, number: int = 1) -> dict[str, Column]:
        """Return all columns by standard names of tendon 1, 2, ..., then the further ones."""
        standard = {
            name: column
            for item, name in Columns.from_tendon(number, self.units).list_names().items()
            if (column := getattr(self, item)) is not None
        }
        return standard | {k: v for k, v in self.extra.items() if k not in standard}


def get_loop_tension(table: MeasuredTable, number: int = 1) -> Array | None:
    """Return the tensions of the sensing loop of tendon 1, 2, ... [N], shape (n, 2), if any."""
    names = [
        standard_columns.format_numbered_name(n, number) for n in standard_columns.LOOP_TENSIONS
    ]
    if not any(name in table.extra for name in names):
        return None
    for name in names:
        if name not in table.extra or table.extra[name].dtype == object:
            raise UsageError(f"{table.path}: column {name!r}: a sensing loop needs numbers in both")
    return np.column_stack([np.asarray(table.extra[name], np.float64) for name in names])


class ReadOptions(TypedDict, total=False):
    """Options of `read_table`, by name."""

    zero_errors: Collection[str]
    diagnosed: bool
    units: Units | None
    mapping: TableMapping | None


def read_table(
    path: Path | str,
    columns: Columns | None = None,
    drop_nonfinite: bool = False,
    *,
    zero_errors: Collection[str] = (),
    diagnosed: bool = False,
    units: Units | None = None,
    mapping: TableMapping | None = None,
) -> MeasuredTable:
    """Read and check the samples of one tendon.

    Parameters
    ----------
    path : Path or str
        Text (.csv, .tsv, .txt, packed or not), .parquet, or a recording (.mcap) of the project.
    columns : Columns, optional
        The columns' names; the standard ones by default.
    drop_nonfinite : bool
        Omit rows without a finite time or reading at the housing instead of raising; other values
        that are not finite are missing (NaN).
    zero_errors : collection of str
        Tensions that may be below zero by more than noise, as far as a load cell's wrong zero
        takes them, and single samples by any amount: "proximal_tension", "distal_tension".
    diagnosed : bool
        For a diagnosis: the record may be of torques and angles, or of forces of either sign, and
        unless `drop_nonfinite`, values other than times may be missing (NaN).
    units : Units, optional
        Of the columns that are named; by default as the file's column names tell.
    mapping : TableMapping, optional
        How the file is written, where it does not tell; its columns are for `--column`.

    Raises
    ------
    UsageError
        The file or its content is invalid.
    """
    options = ReadOptions(
        zero_errors=zero_errors, diagnosed=diagnosed, units=units, mapping=mapping
    )
    return read_tables(Path(path), (columns or Columns(),), drop_nonfinite, **options)[0]


def read_tables(
    path: Path,
    tendons: Sequence[Columns],
    drop_nonfinite: bool = False,
    **options: Unpack[ReadOptions],
) -> tuple[MeasuredTable, ...]:
    """Read and check the samples of several tendons of one file; see `read_table`.

    A row omitted for one tendon is omitted for all. Of several runs the mapping says which one.
    """
    runs = read_runs(path, tendons, drop_nonfinite, **options)
    if len(runs) > 1:
        raise UsageError(f"{path}: has {len(runs)} runs, one is read here: --run N (slave.rig.run)")
    return runs[0]


def read_runs(
    path: Path,
    tendons: Sequence[Columns],
    drop_nonfinite: bool = False,
    **options: Unpack[ReadOptions],
) -> list[tuple[MeasuredTable, ...]]:
    """Read and check all runs of a file, or the one that the mapping says; see `read_tables`."""
    mapping, units = options.get("mapping") or TableMapping(), options.get("units")
    diagnosed, zero_errors = options.get("diagnosed", False), options.get("zero_errors", ())
    named = [name for columns in tendons for name in columns.list_names().values()]
    raw = read_columns(path, mapping, named)
    aliases = find_aliases(raw)
    clocks = ("time_s", tendons[0].time)
    has_clock = "time_s" in aliases.stated or any(name in raw.columns for name in clocks)
    if mapping.rate_hz and not has_clock:
        rows = len(next(iter(raw.columns.values())))
        raw = replace(raw, columns={"time_s": np.arange(float(rows)), **raw.columns})
    notes = [
        {item: split_unit(name, raw.columns) for item, name in columns.list_names().items()}
        for columns in tendons
    ]
    tendons = [
        replace(c, **{k: match_name(raw, name) for k, (name, _) in t.items()})
        for c, t in zip(tendons, notes, strict=True)
    ]
    if units is None:
        units = detect_file_units(raw, aliases.stated, tendons, diagnosed)
    tendons = [replace_aliases(columns.to_units(units), aliases.stated) for columns in tendons]
    claimed = {name for columns in tendons for name in columns.list_names().values()}
    is_pair = diagnosed and len(tendons) == 1 and is_travel_pair(raw, tendons[0])
    required_items = ["time"] if is_pair else ["time", "proximal_tension"]
    tables_columns = [
        find_columns(raw, columns, claimed, aliases.unstated, required_items) for columns in tendons
    ]
    clock = tables_columns[0]["time"]
    numbers = {
        name: parse_column(raw, name, mapping, is_time=name == clock)
        for names in tables_columns
        for name in names.values()
    }
    is_clocked = raw.clocked or time_text.has_moments(raw.columns[clock])
    if mapping.rate_hz:
        if number_samples(raw, clock, numbers, mapping.rate_hz):
            told_of = f"times of {clock!r} are coarse, --rate counts"
            raw = replace(raw, remarks=(*raw.remarks, told_of))
        for note in notes:
            note["time"] = (clock, f"{1.0 / mapping.rate_hz!r} s")
    elif is_clocked:
        for note in notes:
            note["time"] = (clock, note["time"][1] or "s")
    factors = convert_to_si(path, numbers, tables_columns, notes, raw.units, units)
    remarks = [*raw.remarks]
    remarks += [_describe_words(name, raw.words[name]) for name in numbers if name in raw.words]
    if not len(numbers[clock]):
        raise UsageError(f"{path}: has a header but no rows")
    starts = split_runs(raw, numbers[clock], numbers, mapping)
    if len(starts) > 1:
        begins = [f"{raw.place(row)} ({why})" for row, why in starts.items() if why]
        more = ", ..." * (len(begins) > NAMES_SHOWN)
        remarks.append(
            f"{len(starts)} runs; a new one from {', '.join(begins[:NAMES_SHOWN])}{more}"
        )
    converted = [
        f"column {name!r} is in {unit}, converted to SI units"
        for name, (unit, factor) in factors.items()
        if factor != 1.0
    ]
    if converted or remarks:
        print_warning(f"{path}: {'; '.join([*converted, *remarks])}")
    required = set(numbers)
    if diagnosed or drop_nonfinite:
        items = HOUSING_CHANNELS if drop_nonfinite else ("time",)
        required = {names[item] for names in tables_columns for item in items if item in names}
    runs = []
    for number, span in list_runs(path, starts, len(numbers[clock]), mapping):
        part, values, dropped = _clean_rows(
            raw.select(span),
            {name: column[span.start : span.stop] for name, column in numbers.items()},
            required,
            drop_nonfinite,
        )
        common: dict[str, Any] = {"path": path, "units": units, "remarks": tuple(remarks)}
        common |= {"dropped": dropped, "run": number, "first": raw.place(span.start)}
        common["extra"] = {name: c for name, c in part.columns.items() if name not in values}
        tables = []
        for names, noted in zip(tables_columns, notes, strict=True):
            stated = {item for item, (_, unit) in noted.items() if unit}
            check_samples(part, names, values, zero_errors, diagnosed, units, stated, factors)
            samples: dict[str, Any] = dict.fromkeys(Columns().list_names())
            samples |= {item: values[name] for item, name in names.items()}
            if "proximal_tension" not in names:
                samples["proximal_tension"] = np.full(len(samples["time"]), np.nan)
            sources = {item: Source(name, *factors[name]) for item, name in names.items()}
            tables.append(MeasuredTable(**samples, **common, sources=sources))
        runs.append(tuple(tables))
    return runs


def _clean_rows(
    raw: RawTable, numbers: dict[str, Array], required: Collection[str], drop: bool
) -> tuple[RawTable, dict[str, Array], int]:
    """Return a run without the rows that are dropped, and their number; NaN where not required."""
    numbers = {n: c if n in required else _mark_missing(raw.path, n, c) for n, c in numbers.items()}
    keep = _find_finite_rows(raw, {name: numbers[name] for name in required}, drop)
    if dropped := len(keep) - int(keep.sum()):
        raw = raw.select(np.flatnonzero(keep))
        numbers = {name: column[keep] for name, column in numbers.items()}
    return raw, numbers, dropped


def number_samples(raw: RawTable, name: str, numbers: dict[str, Array], rate_hz: float) -> bool:
    """Put the numbers of samples in place of times of a coarse clock; return whether it is one.

    Raises `UsageError` if a time is no number of a sample, and the clock of another rate.
    """
    time = numbers[name]
    step = float(np.nanmedian(np.diff(time))) if len(time) > 1 else 1.0
    if step == 0.0 and (np.diff(time) >= 0.0).all():
        found = [estimate_rate(time) / size for size in UNIT_FACTORS["time"].values()]
        if all(np.isnan(found)) or min(abs(each / rate_hz - 1.0) for each in found) < RATE_ERROR:
            numbers[name] = np.arange(float(len(time)))
            return True
        raise UsageError(
            f"{raw.path}: column {name!r}: --rate {rate_hz:g}, but by its whole ticks "
            f"{found[0]:.4g} Hz"
        )
    if step != 1.0:
        unit = propose_time_unit(step)
        raise UsageError(
            f"{raw.locate(name, 1)}: its steps are {step:.6g}, so it does not "
            f"number samples; without --rate, name its unit: --column 'time={name}[{unit}]'"
        )
    return False


def _describe_words(name: str, words: Mapping[str, int]) -> str:
    """Return which cells of a column are no numbers."""
    kinds = {"missing": "missing", "overload": "an overload: out of the range", "error": "an error"}
    examples = [f"{n} {w} ({kinds[classify_word(w)]})" for w, n in words.items() if w != THOUSANDS]
    if n := words.get(THOUSANDS, 0):
        examples.append(f"{THOUSANDS} in {n} cells")
    return f"column {name!r} has {', '.join(examples)}"


def parse_column(raw: RawTable, name: str, mapping: TableMapping, *, is_time: bool) -> Array:
    """Return a column as numbers; `UsageError` names the first cell that is not one."""
    column = raw.columns[name]
    if column.dtype != object:
        return np.asarray(column, dtype=np.float64)
    if is_time and (mapping.time_format or time_text.has_moments(column)):
        dates = [k for k in raw.columns if k.lower() in ("date", "datum") and k != name]
        try:
            return time_text.to_seconds(
                column, raw.place, mapping.time_format, raw.columns[dates[0]] if dates else None
            )
        except ValueError as error:
            raise UsageError(f"{raw.path}: column {name!r}, {error}") from None
    numbers = np.empty(len(column))
    for row, cell in enumerate(column):
        number = to_number(cell, raw.decimal) if isinstance(cell, str) else cell
        if number is None and cell is not None:
            place = raw.locate(name, row)
            raise UsageError(f"{place}: {cell[:40]!r} is not a number{_explain_text(cell)}")
        numbers[row] = np.nan if number is None else number
    return numbers


def _explain_text(cell: str) -> str:
    """Return how a cell that is no number can become one."""
    if "," in cell and any(map(str.isdigit, cell)):
        return "; write decimals with a point, or say --decimal comma"
    if time_text.is_moment(cell):
        return ", but a time"
    if re.fullmatch(r"[+-]?[\d.]+\s*[^\W\d]{1,4}", cell.strip()):
        return "; write its unit into the column's name, as in 'q [mm]', not into the cells"
    return "; leave a missing value blank"


def _find_finite_rows(raw: RawTable, numbers: Mapping[str, Array], drop: bool) -> NDArray[np.bool_]:
    """Return the mask of finite rows; raise if there are others that must not be dropped."""
    keep = np.ones(len(next(iter(numbers.values()))), dtype=np.bool_)
    for name, column in numbers.items():
        is_finite = np.isfinite(column)
        if not drop:
            _mark_missing(raw.path, name, column)
        if not drop and not is_finite.all():
            bad = np.flatnonzero(~is_finite)
            raise UsageError(
                f"{raw.path}: column {name!r}: {len(bad)} of {len(column)} values are missing or "
                f"not finite, the first in {raw.place(int(bad[0]))}; use --drop-nonfinite to omit "
                "these rows"
            )
        keep &= is_finite
    if not keep.any():
        raise UsageError(f"{raw.path}: no row has a time and all readings at the housing")
    return keep


def _mark_missing(path: Path, name: str, column: Array) -> Array:
    """Return a column with NaN for what is not finite; `UsageError` if nothing is left."""
    is_finite = np.isfinite(column)
    if not is_finite.any():
        raise UsageError(f"{path}: column {name!r} has no finite value: remove the column")
    return np.where(is_finite, column, np.nan)
