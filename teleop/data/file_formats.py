"""File formats of measured data: named columns, and the place of each row in the file."""

import contextlib
import csv
import gzip
import io
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from teleop.data import read_limits, time_text
from teleop.data.mapping_file import TableMapping
from teleop.data.raw_table import Column, RawTable
from teleop.data.table_parser import ROWS_PER_CHUNK, clean_name, read_text
from teleop.data.text_cells import WITH_UNIT, classify_word, to_number
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS
from teleop.messages.topics import TENDONS
from teleop.runtime.output_file import replace_file
from teleop.runtime.process import print_warning

TEXT_KINDS = ("csv", "tsv", "txt", "dat", "asc", "lvm", "prn", "log")
TEXT_SUFFIXES = tuple(f".{kind}{packed}" for kind in TEXT_KINDS for packed in ("", ".gz"))

FOOTER_MAX = 1 << 24  # [bytes] of a Parquet file: 1000 columns in 100 row groups
GZIP_LEVEL = 6  # of long tables; 9 takes three times as long for 1 % less

_READ_ERRORS = (OSError, EOFError, zlib.error, UnicodeError, csv.Error)


def read_columns(
    path: Path, mapping: TableMapping | None = None, names: Sequence[str] = ()
) -> RawTable:
    """Read all columns of a table, a recording or a bag; raises `UsageError` on failure.

    The `names` of columns tell which topic of a bag is meant.
    """
    mapping = mapping or TableMapping()
    if path.is_dir():
        from teleop.ros.bag_table import is_bag

        if is_bag(path):
            return _read_bag(path, names)
    reader = _READERS[_find_suffix(path)]
    if not path.is_file():
        raise UsageError(f"{path}: {'is not a file' if path.exists() else 'file not found'}")
    try:
        if path.stat().st_size == 0:
            raise UsageError(f"{path}: is empty")
        if reader is _read_recording:
            return _read_recording(path, mapping, names)
        return _split_cell_units(reader(path, mapping))
    except _READ_ERRORS as error:
        raise UsageError(f"{path}: cannot be read: {_format_reason(error)}") from None


def _split_cell_units(raw: RawTable) -> RawTable:
    """Return columns of which each cell has the same unit, as in `0.01 sec`, as numbers in it."""
    columns, units = dict(raw.columns), dict(raw.units)
    for name, column in raw.columns.items():
        if column.dtype != object or time_text.has_moments(column):
            continue
        cells = [str(cell or "").strip() for cell in column]
        known = [cell for cell in cells if not classify_word(cell)]
        match = WITH_UNIT.fullmatch(known[0]) if known else None
        if match is None or not all(cell.endswith(match[1]) for cell in known):
            continue
        numbers = [to_number(cell.removesuffix(match[1]), raw.decimal) for cell in cells]
        if None not in numbers:
            columns[name], units[name] = np.array(numbers, dtype=np.float64), match[1]
    return replace(raw, columns=columns, units=units) if units != raw.units else raw


def write_table(path: Path, columns: Mapping[str, Column]) -> None:
    """Write columns of equal length, e.g. `MeasuredTable.columns()`, atomically.

    The suffix decides the format: .csv, .csv.gz or .parquet. Floats are preserved exactly.
    """
    check_destination(path)
    try:
        with replace_file(path) as partial:
            _WRITERS[_find_suffix(path)](partial, columns)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {_format_reason(error)}") from error


def write_batches(path: Path, batches: Iterable[Any]) -> None:
    """Write the parts of a table, one after another, atomically, in the format of `write_table`.

    `batches` are of `pyarrow.RecordBatch`, of one schema, at least one. Raises `UsageError` if the
    file cannot be written.
    """
    check_destination(path)
    parts = iter(batches)
    first = next(parts)
    try:
        with replace_file(path) as partial, contextlib.ExitStack() as stack:
            write = _open_batch_writer(partial, _find_suffix(path), first.schema, stack)
            write(first)
            for batch in parts:
                write(batch)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {_format_reason(error)}") from error


def _open_batch_writer(
    path: Path, suffix: str, schema: Any, stack: contextlib.ExitStack
) -> Callable[[Any], None]:
    """Open a file; return what writes a part. In CSV categories are text."""
    import pyarrow as pa
    from pyarrow import csv as arrow
    from pyarrow import parquet

    if suffix == ".parquet":
        floats = [f.name for f in schema if pa.types.is_floating(f.type)]
        options = {  # of samples a dictionary makes nothing smaller, split bytes a third
            "compression": "zstd",
            "use_byte_stream_split": floats,
            "use_dictionary": [name for name in schema.names if name not in floats],
        }
        writer = stack.enter_context(parquet.ParquetWriter(path, schema, **options))
        return cast("Callable[[Any], None]", writer.write_batch)
    file: Any = stack.enter_context(path.open("wb"))
    if suffix == ".csv.gz":  # without name and date, so that equal data give equal bytes
        file = stack.enter_context(gzip.GzipFile("", "wb", GZIP_LEVEL, file, mtime=0))
    plain = pa.schema(
        [(f.name, pa.string() if pa.types.is_dictionary(f.type) else f.type) for f in schema]
    )
    lines = stack.enter_context(arrow.CSVWriter(file, plain))
    return lambda batch: lines.write_batch(batch.cast(plain))


def check_destination(path: Path) -> None:
    """Raise `UsageError` if `write_table` could not write the file, before any work."""
    suffix = _find_suffix(path)
    if suffix not in _WRITERS:
        raise UsageError(f"{path}: tables are written as {', '.join(_WRITERS)}, not as {suffix}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: folder {path.parent} not found")


def _find_suffix(path: Path) -> str:
    for suffix in _READERS:
        if path.name.lower().endswith(suffix):
            return suffix
    if _is_text_file(path):
        return ".txt"
    allowed = ", ".join(suffix for suffix in _READERS if not suffix.endswith(".gz"))
    raise UsageError(f"{path}: unknown kind of file, allowed are {allowed}, and text as .gz")


def _is_text_file(path: Path) -> bool:
    """Return whether a file of an unknown kind is text, as what test machines write."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(4096)
    return bool(head) and not set(head) & {*range(9), 11, *range(14, 27), *range(28, 32), 127}


def _format_reason(error: Exception) -> str:
    if isinstance(error, UnicodeError):
        return "it is not UTF-8 text"
    if isinstance(error, EOFError | zlib.error | gzip.BadGzipFile):
        return "the compressed file is damaged or cut off"
    return getattr(error, "strerror", None) or " ".join(str(error).split())


def _read_lazily(name: str) -> Callable[[Path, TableMapping], RawTable]:
    """Return a reader of another format, whose module is imported when it reads."""

    def read(path: Path, mapping: TableMapping) -> RawTable:
        from teleop.data import array_files

        reader: Callable[[Path, TableMapping], RawTable] = getattr(array_files, name)
        return reader(path, mapping)

    return read


def _read_parquet(path: Path, _: TableMapping) -> RawTable:
    import pyarrow as pa
    from pyarrow import parquet

    _check_footer(path)
    try:
        schema = parquet.read_schema(path)
        texts = [f.name for f in schema if _is_text(f.type)]
        with parquet.ParquetFile(path, read_dictionary=texts) as file:
            _check_fields(path, schema)
            _check_parquet_size(path, len(schema), file.metadata)
            return _join_batches(path, schema, file.iter_batches(ROWS_PER_CHUNK, use_threads=False))
    except (pa.ArrowException, UnicodeError):
        raise UsageError(f"{path}: not a valid Parquet file") from None


def _read_feather(path: Path, _: TableMapping) -> RawTable:
    import pyarrow as pa

    try:
        with pa.memory_map(str(path)) as source, pa.ipc.open_file(source) as file:
            _check_fields(path, file.schema)
            batches = (file.get_batch(k) for k in range(file.num_record_batches))
            return _join_batches(path, file.schema, batches)
    except (pa.ArrowException, UnicodeError):
        raise UsageError(f"{path}: not a valid Feather file (version 2)") from None


def _join_batches(path: Path, schema: Any, batches: Iterable[Any]) -> RawTable:
    """Return the columns of batches of Arrow."""
    parts: list[list[Column]] = [[] for _ in schema]
    rows = 0
    for batch in batches:
        rows += len(batch)
        read_limits.check_size(path, len(schema), rows, "split the file")
        for name, part, column in zip(schema.names, parts, batch.columns, strict=True):
            part.append(_decode_parquet_values(path, name, column))
    columns = {
        clean_name(name): np.concatenate(part) if part else np.empty(0)
        for name, part in zip(schema.names, parts, strict=True)
    }
    return RawTable(path, columns, lambda row: f"row {row + 1}")


def _check_footer(path: Path) -> None:
    """Raise `UsageError` if the description of a Parquet file is too large to be read."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - 8, 0))
        length = int.from_bytes(file.read(4), "little")
    if length > FOOTER_MAX and path.stat().st_size > length:
        raise UsageError(
            f"{path}: its footer has {length} bytes, at most {FOOTER_MAX} are read; keep at most "
            f"{read_limits.COLUMNS_MAX} columns, and write fewer row groups"
        )


def _check_parquet_size(path: Path, columns: int, metadata: Any) -> None:
    """Raise `UsageError` for what is too large."""
    read_limits.check_size(path, columns, metadata.num_rows, "keep what is needed, or split it")
    size = sum(metadata.row_group(k).total_byte_size for k in range(metadata.num_row_groups))
    if size > read_limits.TEXT_MAX:
        raise UsageError(
            f"{path}: unpacks to {size >> 20} MB, at most {read_limits.TEXT_MAX >> 20} MB are "
            "read; keep the columns that are needed, or split it"
        )


def _check_fields(path: Path, schema: Any) -> None:
    """Raise `UsageError` for columns that are no numbers or text."""
    import pyarrow as pa

    for field in schema:
        name, kind = field.name, field.type
        if not name.isprintable():
            raise UsageError(f"{path}: the column name {name!r} is not text on one line")
        if schema.names.count(name) > 1:
            raise UsageError(f"{path}: column {name!r} occurs more than once")
        if pa.types.is_nested(kind) or not (_is_number_kind(kind) or _is_text_like(kind)):
            raise UsageError(
                f"{path}: column {name!r} is of type {kind}; numbers and text are read: convert or "
                "remove it"
            )


def _is_number_kind(kind: Any) -> bool:
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        return _is_number_kind(kind.value_type)
    kinds = pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null
    return any(is_kind(kind) for is_kind in kinds)


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_text_like(kind: Any) -> bool:
    """Return whether a type of column is text, or may be kept as text."""
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        return _is_text_like(kind.value_type)
    moment = pa.types.is_temporal(kind) and not pa.types.is_duration(kind)  # that is as a number
    return bool(_is_text(kind) or pa.types.is_boolean(kind) or moment)


def _decode_parquet_values(path: Path, name: str, column: Any) -> Column:
    """Return a batch of a column: numbers, or text as objects that equal cells share."""
    import pyarrow as pa

    if _is_number_kind(column.type):
        values = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
        return np.asarray(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
    if not pa.types.is_dictionary(column.type):
        column = column.cast(pa.string()).dictionary_encode()
    texts = [*column.dictionary.cast(pa.string()).to_pylist(), None]
    if any(text is not None and len(text) > read_limits.CELL_MAX for text in texts):
        raise UsageError(
            f"{path}: column {name!r} has a cell of more than {read_limits.CELL_MAX} characters"
        )
    cells: Column = np.array(texts, dtype=object)[column.indices.fill_null(-1).to_numpy()]
    return cells


def _read_recording(path: Path, _: TableMapping, names: Sequence[str] = ()) -> RawTable:
    """Read the tendons topic of a recording into table columns; or a bag of ROS."""
    from teleop.recording import reader
    from teleop.ros.bag_table import is_bag

    if is_bag(path):
        return _read_bag(path, names)

    fields = {
        "proximal_tension": "proximal_tension{}_N",
        "proximal_displacement": "proximal_displacement{}_m",
        "bench_distal_tension": "distal_tension{}_N",
        "bench_distal_displacement": "distal_displacement{}_m",
    }
    rows = reader.read_columns(path, TENDONS.name, ("tendons", "time_s", *fields), print_warning)
    columns: dict[str, Column] = {"time_s": np.array(rows["time_s"])}
    tendons = int(rows["tendons"].max())
    if tendons > MAX_TENDONS:
        row = int(rows["tendons"].argmax())
        raise UsageError(
            f"{path}: message {row + 1} has {tendons} tendons, at most {MAX_TENDONS} are possible: "
            "it is no recording of a session"
        )
    for tendon in range(tendons):
        number = "" if tendon == 0 else f"_{tendon + 1}"
        for field, name in fields.items():
            column = np.array(rows[field][:, tendon])
            if not np.isnan(column).all():  # all NaN means that there is no such sensor
                columns[name.format(number)] = column
    return RawTable(path, columns, lambda row: f"message {row + 1}", clocked=True)


def _read_bag(path: Path, names: Sequence[str]) -> RawTable:
    """Read JointState and WrenchStamped messages of a rosbag2 into table columns."""
    from teleop.ros.bag_table import read_bag

    columns, lacks = read_bag(path, names)
    return RawTable(path, columns, lambda row: f"message {row + 1}", lacks, clocked=True)


def _write_csv(path: Path, columns: Mapping[str, Column]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        _write_rows(file, columns)


def _write_csv_gz(path: Path, columns: Mapping[str, Column]) -> None:
    with (  # without name and date, so that equal data give equal bytes
        path.open("wb") as raw_file,
        gzip.GzipFile("", "wb", fileobj=raw_file, mtime=0) as packed,
        io.TextIOWrapper(packed, encoding="utf-8", newline="") as file,
    ):
        _write_rows(file, columns)


def _write_rows(file: IO[str], columns: Mapping[str, Column]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def _write_parquet(path: Path, columns: Mapping[str, Column]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    arrays = {
        name: pa.array([None if v is None else str(v) for v in c] if c.dtype == object else c)
        for name, c in columns.items()
    }
    parquet.write_table(pa.table(arrays), path)


_READERS: dict[str, Callable[[Path, TableMapping], RawTable]] = {
    **dict.fromkeys(TEXT_SUFFIXES, read_text),
    ".parquet": _read_parquet,
    **dict.fromkeys((".feather", ".arrow"), _read_feather),
    ".mcap": _read_recording,
    **dict.fromkeys((".xlsx", ".xls", ".ods"), _read_lazily("read_spreadsheet")),
    ".mat": _read_lazily("read_mat"),
    **dict.fromkeys((".npz", ".npy"), _read_lazily("read_npz")),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), _read_lazily("read_json")),
    **dict.fromkeys((".h5", ".hdf5"), _read_lazily("read_hdf5")),
}
_WRITERS: dict[str, Callable[[Path, Mapping[str, Column]], None]] = {
    ".csv": _write_csv,
    ".csv.gz": _write_csv_gz,
    ".parquet": _write_parquet,
}
