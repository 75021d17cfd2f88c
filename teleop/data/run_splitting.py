"""Several runs in one file: where each begins, so that no two are ever taken for one.

A run begins where the names of the columns come again, where a column that names the run changes,
or where time starts again. A gap never begins one. Time that goes back otherwise is a fault of the
clock, which is refused: to another time than that of the first row, for a few rows, for a while
after which the clock is right again, or by the range of a counter.
"""

import itertools
import re
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.data.mapping_file import TableMapping
from teleop.data.raw_table import Column, RawTable
from teleop.errors import UsageError

RUN_ROWS = 20  # samples of a run, if time alone tells where it begins
START_PERIODS = 3.0  # by how much the times at which runs begin may differ, and ...
GAP_PERIODS = 10.0  # steps beyond this are gaps
_COUNTERS = [2.0**bits / scale for bits in (16, 24, 31, 32) for scale in (1.0, 1e3, 1e6)]
_RUN_NAME = re.compile(
    r"(run|trial|episode|rep|repetition|experiment|record|recording|session|test|file|filename"
    r"|versuch|messung|lauf)([\W_]?(id|no|nr|num|number|index|name))?"
)


def split_runs(
    raw: RawTable, time: Array, used: Collection[str], mapping: TableMapping
) -> dict[int, str]:
    """Return the first row of each run, and why it begins there.

    `time`, shape (samples,), is in any unit, NaN where it is missing; `used` are columns of
    channels, which name no run. `mapping` says which column names the run; run 0: all rows are one.

    Raises `UsageError` if a column seems to name runs, but their rows are mixed.
    """
    if mapping.run == 0:
        return {0: ""}
    column, starts = mapping.run_column, {0: ""} | dict.fromkeys(raw.breaks, "the names come again")
    if column and column not in raw.columns:
        raise UsageError(f"{raw.path}: has no column {column!r} (run_column)")
    names = [n for n in raw.columns if n not in used and _RUN_NAME.fullmatch(n.lower())]
    for name in [column] if column else names:
        rows = _find_changes(raw, name)
        starts |= {row: f"column {name!r} changes" for row in rows if row not in starts}
    if not raw.clocked:
        ends = [*sorted(starts)[1:], len(time)]
        for first, end in zip(sorted(starts), ends, strict=True):
            restarts = first + _find_restarts(time[first:end])
            starts |= dict.fromkeys(restarts.tolist(), "time starts again")
    return dict(sorted(starts.items()))


def list_runs(
    path: Path, starts: Collection[int], rows: int, mapping: TableMapping
) -> list[tuple[int, range]]:
    """Return number, 0 of an only one, and rows of each run, or of the one that is chosen."""
    chosen, several = mapping.run or 0, len(starts) > 1
    if chosen > len(starts):
        raise UsageError(f"{path}: --run {chosen}: the file has {len(starts)} run{'s' * several}")
    parts = [range(first, end) for first, end in itertools.pairwise([*starts, rows])]
    return [(k * several, part) for k, part in enumerate(parts, 1) if chosen in (0, k)]


def is_overflow(back: float, period: float) -> bool:
    """Return whether a step back is the range of a counter."""
    return any(abs(back - each) <= 2.0 * period for each in _COUNTERS)


def _find_changes(raw: RawTable, name: str) -> list[int]:
    """Return the rows at which a column has another value; a blank one is that above."""
    column: Column = raw.columns[name]
    is_text = column.dtype == object
    known = np.flatnonzero(
        [str(c or "").strip() != "" for c in column] if is_text else ~np.isnan(column)
    )
    values = column[known]
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    kinds = len(set(values.tolist()))
    if kinds == len(column) > 1:  # the number of the row
        return []
    if len(changes) >= max(kinds, 1):
        k = next(k for k in changes if values[k] in values[:k])
        raise UsageError(
            f"{raw.locate(name, int(known[k]))}: {values[k]} comes again after "
            f"other runs: sort the rows by {name!r}; if it names no run, --run 0"
        )
    return [int(row) for row in known[changes]]


def _find_restarts(time: Array) -> NDArray[np.intp]:
    """Return the rows at which time starts again; none if any step back is another one."""
    none, known = np.empty(0, dtype=np.intp), np.flatnonzero(np.isfinite(time))
    times = time[known]
    falls = np.flatnonzero(np.diff(times) < 0.0) + 1
    edges = [0, *falls.tolist(), len(times)]
    for first, row, end in zip(edges, edges[1:], edges[2:], strict=False):
        before, after = times[first:row], times[row:end]
        if min(len(before), len(after)) < RUN_ROWS:
            return none
        period = float(np.median(np.diff(before)))
        back = float(before[-1] - after[0]) + period
        wraps = is_overflow(back, period)
        passed = int(np.searchsorted(after, before[-1], "right"))
        returns = 0 < passed < len(after) and after[passed] - after[passed - 1] > (
            GAP_PERIODS * period
        )
        if wraps or returns or abs(after[0] - times[0]) > START_PERIODS * period:
            return none
    return known[falls]
