"""A replayed rig: measured data, played as if they were being measured now."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from estimator.array_types import Array
from slave.rig import RigFinished, RigSample
from teleop.data.table import Columns, read_tables
from teleop.messages import MAX_JOINTS


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayedRigConfig:
    """A file of measured data (docs/data-format.md) to be played in real time."""

    type: Literal["replayed"] = "replayed"
    file: Path  # .csv, .csv.gz, .parquet or .mcap
    loop: bool = False  # start again behind the last row
    drop_nonfinite: bool = False  # leave out rows with values that are not finite
    tendons: tuple[Columns, ...] = (Columns(),)  # one for each tendon: its columns' names
    name: str = ""  # by which calibration files know the rig; empty = the file's name

    def __post_init__(self) -> None:
        """Refuse a rig that messages cannot carry."""
        if not 1 <= len(self.tendons) <= MAX_JOINTS:
            raise ValueError(f"tendons: must be 1 to {MAX_JOINTS}, one a joint")
        if len({columns.time for columns in self.tendons}) > 1:
            raise ValueError("tendons: all must have the same time column")


class ReplayedRig:
    """The rig of `slave.rig.Rig` that gives every row of a file once, unchanged and in order.

    A row is due when as much time has passed since the start as lies between the first row and it.
    Its sample carries the row's own time, so an estimator that steps from sample to sample does the
    same arithmetic on the same numbers as one that reads the file. The motors are not there; what
    is written to them has no effect.
    """

    starts_at_zero = True  # the motors are not there, so nowhere is a wrong place to start

    def __init__(self, config: ReplayedRigConfig) -> None:
        tables = read_tables(config.file, config.tendons, config.drop_nonfinite)
        self.name = config.name or config.file.name
        self.tendons = len(tables)
        self.joints: tuple[tuple[int, ...], ...] = tuple((k,) for k in range(self.tendons))
        self._loop = config.loop
        self._time = tables[0].time
        self._tension = np.column_stack([table.proximal_tension for table in tables])
        self._displacement = _beside([table.proximal_displacement for table in tables])
        self._bench_tension = _beside([table.distal_tension for table in tables])
        self._bench_displacement = _beside([table.distal_displacement for table in tables])
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
        """Do nothing: the motors of measured data have moved already."""

    def advance(self) -> None:
        """Do nothing: every row was there before."""

    def summary(self) -> dict[str, int | float | str]:
        """Return how much was played."""
        return {"rows": len(self._time), "played": self._played}

    def close(self) -> None:
        """Do nothing: the file was read when the rig was opened."""

    def _sample(self, row: int) -> RigSample:
        return RigSample(
            time_s=float(self._time[row]) + self._lap,
            proximal_tension=self._tension[row],
            proximal_displacement=_row(self._displacement, row),
            bench_distal_tension=_row(self._bench_tension, row),
            bench_distal_displacement=_row(self._bench_displacement, row),
        )


def _beside(columns: list[Array | None]) -> Array | None:
    """Return columns side by side, NaN where one is missing; None where all are."""
    rows = next((len(column) for column in columns if column is not None), None)
    if rows is None:
        return None
    missing = np.full(rows, np.nan)
    return np.column_stack([missing if column is None else column for column in columns])


def _row(columns: Array | None, row: int) -> Array | None:
    return None if columns is None else columns[row]
