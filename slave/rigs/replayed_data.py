"""A replayed rig: measured data played in real time."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from estimator.array_types import Array
from estimator.effects.effect import CHANNELS
from estimator.plausibility import find_channel_faults
from estimator.signals.spikes import remove_spikes
from slave.rig import RigFinished, RigSample
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.data.mapping_file import map_columns, read_mapping
from teleop.data.measured_table import get_loop_tension, read_tables
from teleop.data.read_summary import ReadSummary, format_read_summary
from teleop.data.standard_columns import Columns
from teleop.messages.messages import MAX_JOINTS
from teleop.runtime.process import print_warning


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayedRigConfig:
    """A file of measured data (docs/reference/data-format.md) to be played in real time."""

    type: Literal["replayed"] = "replayed"
    file: Path  # .csv, .csv.gz, .parquet or .mcap
    loop: bool = False  # start again after the last row
    drop_nonfinite: bool = False  # leave out rows without a finite reading at the housing
    tendons: tuple[Columns, ...] = (Columns(),)  # one for each tendon: its columns' names
    mapping: Path | None = None  # how the file is to be read, of `teleop data show --write-mapping`
    # the one of a file of several, from 1; 0: all rows are one run
    run: int | None = build_ranged_field(None, 0, math.inf)
    name: str = ""  # name of the rig in calibration files; empty = the file's name

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 1 <= len(self.tendons) <= MAX_JOINTS:
            raise ValueError(f"tendons: must be 1 to {MAX_JOINTS}, one a joint")
        if len({columns.time for columns in self.tendons}) > 1:
            raise ValueError("tendons: must all have the same time column")


class ReplayedRig:
    """A `slave.rig.Rig` that returns every row of a file once, in order.

    A row is due when its time since the first row has passed since the start. A sample has the time
    of its row, so the live estimator computes exactly what one that reads the file does. There are
    no motors; writes have no effect. Rows are unchanged, but for single-sample spikes, which are
    missing (NaN) as in `teleop estimate` and `teleop diagnose`, so that all three give one error.
    """

    starts_at_zero = True  # there are no motors, so any start is correct

    def __init__(self, config: ReplayedRigConfig) -> None:
        mapping = read_mapping(config.mapping)
        if config.run is not None:
            mapping = replace(mapping, run=config.run)
        tables = read_tables(
            config.file,
            map_columns(config.tendons, mapping),
            config.drop_nonfinite,
            zero_errors=("distal_tension",),
            mapping=mapping,
        )
        self.name = config.name or config.file.name
        self.tendons = len(tables)
        self.joints: tuple[tuple[int, ...], ...] = tuple((k,) for k in range(self.tendons))
        self._loop = config.loop
        self._read_as = " / ".join(
            format_read_summary(ReadSummary.from_table(table).to_json()) for table in tables
        )
        self._time = tables[0].time
        clean = [remove_spikes(table) for table in tables]
        for text in dict.fromkeys(text for data in clean for text in find_channel_faults(data)):
            print_warning(f"{config.file}: {text}")
        self.housing = tuple((data.proximal_tension, data.proximal_displacement) for data in tables)
        self._tension = np.column_stack([data.proximal_tension for data in clean])
        self._displacement = _stack_columns([data.proximal_displacement for data in clean])
        self._bench_tension = _stack_columns([data.distal_tension for data in clean])
        self._bench_displacement = _stack_columns([data.distal_displacement for data in clean])
        loops = [get_loop_tension(table, number) for number, table in enumerate(tables, 1)]
        self._loops = [
            _stack_columns([None if loop is None else loop[:, end] for loop in loops])
            for end in (0, 1)
        ]
        self._spikes = sum(
            int(np.isnan(signal).sum() - np.isnan(getattr(table, name)).sum())
            for data, table in zip(clean, tables, strict=True)
            for name in CHANNELS
            if (signal := getattr(data, name)) is not None
        )
        self._next = self._played = 0
        self._lap = 0.0  # [s] added to the rows' times, in a loop
        gaps = np.diff(self._time)
        self._seam = float(np.median(gaps)) if gaps.size else 1.0  # [s] from last row to first

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return all rows that have become due by `time_s` [s], oldest first."""
        rows = []
        while True:
            if self._next == len(self._time):
                if not self._loop:
                    break
                self._next = 0
                self._lap += float(self._time[-1] - self._time[0]) + self._seam
            due = float(self._time[self._next] - self._time[0]) + self._lap
            if due > time_s:
                break
            rows.append(self._sample(self._next))
            self._next += 1
        self._played += len(rows)
        if not rows and self._next == len(self._time):
            raise RigFinished("the last row has been played")
        return tuple(rows)

    def write(self, proximal_displacement: Array) -> None:
        """Do nothing: the data are already recorded."""

    def advance(self) -> None:
        """Do nothing: all rows are loaded."""

    def summarise(self) -> dict[str, int | float | str]:
        """Return the amount of data played, and how they were read."""
        counts = {"rows": len(self._time), "played": self._played, "spikes": self._spikes}
        return {**counts, "read_as": self._read_as}

    def close(self) -> None:
        """Do nothing: the file was read when the rig was opened."""

    def _sample(self, row: int) -> RigSample:
        return RigSample(
            time_s=float(self._time[row]) + self._lap,
            proximal_tension=self._tension[row],
            proximal_displacement=_get_row(self._displacement, row),
            bench_distal_tension=_get_row(self._bench_tension, row),
            bench_distal_displacement=_get_row(self._bench_displacement, row),
            loop_moved_tension=_get_row(self._loops[0], row),
            loop_held_tension=_get_row(self._loops[1], row),
        )


def _stack_columns(columns: list[Array | None]) -> Array | None:
    """Return columns as an array, NaN for a missing one; None if all are missing."""
    rows = next((len(column) for column in columns if column is not None), None)
    if rows is None:
        return None
    missing = np.full(rows, np.nan)
    return np.column_stack([missing if column is None else column for column in columns])


def _get_row(columns: Array | None, row: int) -> Array | None:
    return None if columns is None else columns[row]
