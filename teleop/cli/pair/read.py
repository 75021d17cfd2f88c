"""Reading the records of a pair."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from estimator.array_types import Array
from estimator.pair.pair import PairRecord
from teleop.cli.pair.config import PairColumns, PairConfig
from teleop.data.table import check_effort, check_time
from teleop.data.table_files import RawTable, read_columns
from teleop.errors import UsageError

ANGLE_SPAN = 7.0  # [rad] of a joint: above a full turn the unit is wrong
SAMPLES_MIN = 20  # in which a sensor that works changes


def read_records(paths: Sequence[Path], config: PairConfig) -> tuple[PairRecord, ...]:
    """Return the records of some files, in the order of their bends.

    Raises
    ------
    UsageError
        A file cannot be read, lacks a column or its bend, or has invalid values.
    """
    return tuple(sorted((_read_record(path, config) for path in paths), key=lambda one: one.bend))


def _read_record(path: Path, config: PairConfig) -> PairRecord:
    bend = config.bend_of(path)
    raw = read_columns(path)
    columns = {f.name: _parse_column(path, raw, config, f.name) for f in fields(PairColumns)}
    time = columns["time"]
    if not len(time):
        raise UsageError(f"{path}: has a header but no rows")
    check_time(path, raw, config.columns.time, time, "convert it to seconds")
    for item in ("tension_a", "tension_b"):
        check_effort(path, raw, getattr(config.columns, item), columns[item], may_err=True)
    _check_columns(path, columns, config)
    return PairRecord(
        bend,
        time,
        config.radians * columns["command"],
        config.radians * columns["angle"],
        columns["tension_a"],
        columns["tension_b"],
    )


def _check_columns(path: Path, columns: Mapping[str, Array], config: PairConfig) -> None:
    """Refuse a sensor that never changes, and angles that are plainly in degrees."""
    for item, column in columns.items():
        span = float(np.ptp(column))
        name = getattr(config.columns, item)
        if len(column) >= SAMPLES_MIN and span == 0.0:
            raise UsageError(
                f"{path}: column {name!r} never changes ({column[0]:g}): the sensor is stuck or "
                "not connected, or nothing moved; check it, and move the joint while you record"
            )
        if item in ("command", "angle") and config.radians * span > ANGLE_SPAN:
            raise UsageError(
                f"{path}: column {name!r} spans {config.radians * span:.4g} rad; if it is in "
                "degrees, set unit: deg in --columns FILE"
            )


def _parse_column(path: Path, raw: RawTable, config: PairConfig, item: str) -> Array:
    name = getattr(config.columns, item)
    if name not in raw.columns:
        raise UsageError(
            f"{path}: there is no column {name!r} (it has {', '.join(raw.columns)}); "
            f"--columns FILE says what {item} is called"
        )
    try:
        column = np.asarray(raw.columns[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{path}: column {name!r} is not numbers throughout") from None
    if (bad := np.flatnonzero(~np.isfinite(column))).size:
        place = raw.place(int(bad[0]))
        raise UsageError(f"{path}: column {name!r}, {place}: is blank or not finite")
    return column
