"""Read large CSV files in blocks, at seven times the speed of a reader of rows.

5 million rows of 5 columns (240 MB) take 5.5 s in place of 39 s, and 600 MB of memory: three
times the 200 MB of the numbers. A bar shows how far it is. It knows nothing of lines: what it does
not understand is left to the reader of rows, which names the line.
"""

import gzip
import io
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from teleop.data import read_limits
from teleop.data.raw_table import Layout
from teleop.runtime.status_line import Progress

BLOCK_BYTES = 1 << 24  # [bytes] of text at once
PROGRESS_DELAY_S = 0.5


def read(path: Path, layout: Layout, first: Sequence[str]) -> dict[str, NDArray[Any]] | None:
    """Return the columns of a CSV file in UTF-8, or None if the reader of rows has to read it.

    Numbers become float64, blank cells NaN; a column that begins with text, by the cells of the
    `first` row, is of text.
    """
    names = layout.names
    if len(first) != len(names) or not all(names):
        return None
    import pyarrow as pa
    from pyarrow import csv as arrow

    with path.open("rb") as raw_file:
        file = unpack_text(path, raw_file)
        kinds = {
            name: pa.float64() if _is_number(cell, layout.decimal) else pa.string()
            for name, cell in zip(names, first, strict=True)
        }
        parts: list[list[Any]] = [[] for _ in names]
        size, begin_s, progress = path.stat().st_size, time.monotonic(), Progress()
        try:
            blocks = arrow.open_csv(
                pa.PythonFile(file, mode="r"),
                arrow.ReadOptions(
                    use_threads=False,
                    block_size=BLOCK_BYTES,
                    column_names=names,
                    skip_rows=layout.data_line,
                ),
                arrow.ParseOptions(delimiter=layout.separator, newlines_in_values=False),
                arrow.ConvertOptions(
                    column_types=kinds, null_values=[""], decimal_point=layout.decimal or "."
                ),
            )
            rows = 0
            for block in blocks:
                rows += len(block)
                read_limits.check_size(path, len(names), rows, "split the file")
                for part, column in zip(parts, block.columns, strict=True):
                    if not _has_readable_cells(column):
                        return None
                    part.append(_to_array(column))
                if time.monotonic() - begin_s > PROGRESS_DELAY_S:
                    progress(f"reading {path}", min(raw_file.tell() / size, 1.0))
        except (pa.ArrowException, OSError, EOFError):
            return None  # the reader of rows says what is wrong, and where
        finally:
            progress.end()
    columns = {}
    for name in names:
        columns[name] = np.concatenate(parts[0]) if parts[0] else np.empty(0)
        del parts[0]  # or two copies of all would be in memory
    return columns


def _is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number, or blank."""
    try:
        float(cell.replace(",", ".") if decimal == "," else cell or "0")
    except ValueError:
        return not cell.strip()
    return True


def _has_readable_cells(column: Any) -> bool:
    """Return whether no cell of a block of text is longer than `csv` reads."""
    import pyarrow as pa
    from pyarrow import compute

    if pa.types.is_floating(column.type):
        return True
    longest = compute.max(compute.utf8_length(column)).as_py()
    return longest is None or longest <= read_limits.CELL_MAX


def _to_array(column: Any) -> NDArray[Any]:
    """Return a block of a column: numbers, or text as objects that equal cells share."""
    import pyarrow as pa

    if pa.types.is_floating(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    encoded = column.fill_null("").dictionary_encode()
    texts = np.array(encoded.dictionary.to_pylist(), dtype=object)
    return np.asarray(texts[encoded.indices.to_numpy()])


def unpack_text(path: Path, file: io.BufferedIOBase) -> io.BufferedReader:
    """Return the text of an open .csv or .csv.gz file, as bytes, of which so much is read."""
    packed = path.name.lower().endswith(".gz")
    text = gzip.GzipFile(fileobj=file) if packed else file
    return io.BufferedReader(read_limits.BoundedReader(path, text), 1 << 16)
