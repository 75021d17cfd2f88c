"""Tables in spreadsheets and in files of arrays: .xlsx and its kin, .mat, .npz, JSON, HDF5.

A sheet is rows of text and goes the way of a text table. Of arrays those of the most frequent
length are the columns; what else is in the file is left out, and said. Extra `files`.
"""

import datetime
import importlib
import itertools
import json
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from teleop.data import read_limits
from teleop.data.mapping_file import TableMapping
from teleop.data.raw_table import Column, RawTable
from teleop.data.table_parser import (
    SAMPLE_LINES,
    Row,
    clean_name,
    locate_table,
    read_rows,
    read_text,
)
from teleop.errors import UsageError

ARRAYS_MAX = 10_000
"""Arrays in a file that are looked at."""

JSON_MAX = 1 << 28
"""Bytes of JSON, which is read at once: an hour of five channels at 1 kHz."""


def _import(path: Path, module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise UsageError(
            f"{path}: needs {module.replace('_', '-')}: pip install 'tendon-teleop[files]', or "
            "save it as .csv"
        ) from None


def read_spreadsheet(path: Path, mapping: TableMapping) -> RawTable:
    """Read the table of a spreadsheet: its only sheet that is not empty, or the one mapped."""
    with path.open("rb") as file:
        if file.read(4) not in (b"PK\x03\x04", b"\xd0\xcf\x11\xe0"):
            return read_text(path, mapping)  # text that is named .xls so that Excel opens it
    calamine = _import(path, "python_calamine")
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as packed:
            if sum(item.file_size for item in packed.infolist()) > read_limits.TEXT_MAX:
                raise UsageError(f"{path}: unpacks to more than {read_limits.TEXT_MAX >> 20} MB")
    try:
        book = calamine.CalamineWorkbook.from_path(str(path))
        wanted = [mapping.sheet] if mapping.sheet else book.sheet_names
        if mapping.sheet and mapping.sheet not in book.sheet_names:
            raise UsageError(f"{path}: no sheet {mapping.sheet!r}, but {book.sheet_names}")
        sheets = {name: book.get_sheet_by_name(name) for name in wanted}
        filled = {name: sheet for name, sheet in sheets.items() if sheet.total_height > 1}
    except (calamine.CalamineError, OSError) as error:
        raise UsageError(f"{path}: is no spreadsheet: {error}") from None
    if len(filled) != 1:
        listed = ", ".join(map(repr, filled)) or "no rows"
        raise UsageError(f"{path}: has {listed}; name one: `sheet: NAME` in --mapping FILE")
    (sheet,) = filled.values()
    read_limits.check_size(path, sheet.total_width, sheet.total_height, "split the sheet")
    rows: list[Row] = [
        (line, [_format_cell(cell) for cell in cells])
        for line, cells in enumerate(sheet.to_python(skip_empty_area=False), 1)
    ]
    full = (row for row in rows if any(map(str.strip, row[1])))
    sample = list(itertools.islice(full, SAMPLE_LINES))
    layout = locate_table(path, sample, "", mapping, decimal=".")
    return read_rows(path, layout, (row for row in rows if row[0] > layout.data_line), "row")


def _format_cell(value: object) -> str:
    if isinstance(value, datetime.timedelta):
        return str(datetime.datetime.min + value).partition(" ")[2]
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value)


def read_npz(path: Path, _: TableMapping) -> RawTable:
    """Read the arrays that `numpy.savez` or `save` wrote; nothing in it is run."""
    try:
        if not zipfile.is_zipfile(path):
            matrix = np.lib.format.open_memmap(path, mode="r")
            _check_shape(path, "its array", matrix.shape)
            return _assemble(path, [("column", matrix)])
        with zipfile.ZipFile(path) as packed:
            if sum(item.file_size for item in packed.infolist()) > 8 * read_limits.CELLS_MAX:
                raise UsageError(f"{path}: has more than {read_limits.CELLS_MAX} values")
        with np.load(path, allow_pickle=False) as arrays:
            return _assemble(path, ((name, arrays[name]) for name in arrays.files))
    except (ValueError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from None


def read_mat(path: Path, _: TableMapping) -> RawTable:
    """Read the variables of MATLAB, also those of structs."""
    from scipy import io
    from scipy.io.matlab import MatReadError

    try:
        for name, shape, _kind in io.whosmat(path):
            _check_shape(path, name, shape)
        variables = io.loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3 is HDF5
        return read_hdf5(path, TableMapping())
    except (MatReadError, ValueError, TypeError) as error:
        raise UsageError(f"{path}: is not a file of MATLAB: {error}") from None
    shown = {name: value for name, value in variables.items() if not name.startswith("__")}
    return _assemble(path, _flatten("", shown))


def read_json(path: Path, _: TableMapping) -> RawTable:
    """Read samples as objects, in one list or each in a line, or an object of the columns."""
    if path.stat().st_size > JSON_MAX:
        raise UsageError(f"{path}: more than {JSON_MAX >> 20} MB of JSON: save it as .parquet")
    text = path.read_text("utf-8-sig")
    try:
        try:
            data = json.loads(text)
        except json.JSONDecodeError:
            data = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is not JSON: {error}") from None
    if isinstance(data, list) and all(isinstance(row, dict) for row in data):
        rows = [dict(_flatten("", row)) for row in data]
        names = list(dict.fromkeys(name for row in rows for name in row))
        missing = np.array(np.nan)
        data = {name: [row.get(name, missing).tolist() for row in rows] for name in names}
    elif isinstance(data, list):
        data = {"column": data}
    if not isinstance(data, dict):
        raise UsageError(f"{path}: is no table: a list of samples, or an object of the columns")
    return _assemble(path, [(name, _to_array(values)) for name, values in _flatten("", data)])


def _to_array(values: Column) -> Column:
    """Return values of JSON as numbers, NaN for null, if all are numbers."""
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError):
        return values


def _flatten(stem: str, variables: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in variables.items():
        if isinstance(value, dict):
            yield from _flatten(f"{stem}{name}.", value)
        else:
            yield f"{stem}{name}", np.asarray(value)


def read_hdf5(path: Path, _: TableMapping) -> RawTable:
    """Read the datasets of HDF5, with the units that they have as an attribute."""
    h5py = _import(path, "h5py")
    arrays: dict[str, Column] = {}
    units: dict[str, str] = {}

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or len(arrays) > ARRAYS_MAX:
            return
        _check_shape(path, name, item.shape)
        arrays[name] = item[()]
        for key in ("unit", "units", "Unit", "Units"):
            if isinstance(text := item.attrs.get(key), str | bytes):
                units[clean_name(name)] = text.decode() if isinstance(text, bytes) else text

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise UsageError(f"{path}: is not HDF5: {error}") from None
    return _assemble(path, arrays.items(), units)


def _check_shape(path: Path, name: str, shape: Iterable[int]) -> None:
    if (cells := int(np.prod([int(n) for n in shape]))) > read_limits.CELLS_MAX:
        raise UsageError(
            f"{path}: {name} has {cells} values, at most {read_limits.CELLS_MAX} are read"
        )


def _assemble(
    path: Path, arrays: Iterable[tuple[str, Any]], units: Mapping[str, str] | None = None
) -> RawTable:
    """Return the arrays of the most frequent length as columns; the fields and columns of each."""
    columns: dict[str, Column] = {}
    for name, array in arrays:
        if array.dtype.names:
            columns |= {clean_name(f): np.asarray(array[f]).ravel() for f in array.dtype.names}
        elif array.dtype.kind in "iuf" and array.size > 1:
            columns[clean_name(name)] = np.squeeze(array)
    lengths = Counter(max(column.shape) for column in columns.values())
    if not lengths:
        raise UsageError(f"{path}: has no arrays of numbers")
    rows = max(lengths, key=lambda n: (lengths[n], n))
    table: dict[str, Column] = {}
    for name, column in columns.items():
        if column.shape == (rows,):
            table[name] = column.astype(np.float64) if column.dtype.kind in "iuf" else column
        elif column.ndim == 2 and rows in column.shape:
            wide = column if column.shape[0] == rows else column.T
            table |= {f"{name}:{k + 1}": np.array(wide[:, k], float) for k in range(wide.shape[1])}
    read_limits.check_size(path, len(table), rows, "keep what is needed")
    left_out = [name for name in columns if not any(t.partition(":")[0] == name for t in table)]
    remarks = (f"{', '.join(left_out)} left out, not of {rows} values",) if left_out else ()
    return RawTable(path, table, lambda row: f"row {row + 1}", units=units or {}, remarks=remarks)
