"""Error of the estimated force against a bench's load cell at the tip, over a run or a record.

The estimate is put through the model of that cell (estimator.online.tip_reading) and compared with
what it reads.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online.tendon_model import TendonModel
from estimator.online.tip_reading import IDENTITY_TABLE, build_reading_table, compute_reading
from estimator.records import F64, I64, Struct, StructArray, view_struct

FULL_SCALE_SIGMAS = (
    200.0  # times the noise: with a smaller full scale a percentage shows only noise
)


class ErrorSums(Struct):
    """Sums over all samples."""

    samples: I64 = 0
    inside: I64 = 0  # samples inside the certified interval
    peak: F64 = 0.0  # [N] largest measured distal tension: the full scale
    square: F64 = 0.0  # [N^2]
    absolute: F64 = 0.0  # [N]
    worst: F64 = 0.0  # [N]


@jit_compile
def add_sample(
    sums: ErrorSums, table: Array, estimate: float, low: float, high: float, measured: float
) -> None:
    """Add one sample; a missing bench value (NaN) or estimate is ignored.

    `table` is what the bench's cell reads, of `tip_reading.reading_table`.
    """
    error = compute_reading(table, estimate) - measured
    if not math.isfinite(error):
        return
    sums.samples += 1
    sums.peak = max(sums.peak, measured)
    sums.inside += int(compute_reading(table, low) <= measured <= compute_reading(table, high))
    sums.square += error * error
    sums.absolute += abs(error)
    sums.worst = max(sums.worst, abs(error))


@jit_compile
def add_columns(
    all_sums: StructArray, tables: Array, estimate: Array, low: Array, high: Array, measured: Array
) -> None:
    """Add a whole record, arrays of shape (n,)."""
    for k in range(len(estimate)):
        add_sample(all_sums[0], tables[0], estimate[k], low[k], high[k], measured[k])


class Score:
    """Running error of the distal tension [N] against a bench sensor.

    Parameters
    ----------
    models : sequence of TendonModel
        Of the rig's tendons, for the noise of their load cells at the housing and for what the
        bench's cells read.
    """

    def __init__(self, models: Sequence[TendonModel] = ()) -> None:
        self._noise = max((model.tension_noise for model in models), default=0.0)
        tables = [build_reading_table(model.tip_effects) for model in models]
        self._tables = np.array(tables or [IDENTITY_TABLE])
        self._all_sums = ErrorSums.array()
        self._sums: ErrorSums = view_struct(self._all_sums)

    def add(self, estimate: float, low: float, high: float, measured: float) -> None:
        """Add one sample of the first tendon; a missing bench value (NaN) is ignored."""
        add_sample(self._sums, self._tables[0], estimate, low, high, measured)

    def add_columns(self, estimate: Array, low: Array, high: Array, measured: Array) -> None:
        """Add a whole record [N] of the first tendon, arrays of shape (n,); see `add_sample`."""
        columns = (estimate, low, high, measured)
        rows = (np.ascontiguousarray(column, dtype=np.float64) for column in columns)
        add_columns(self._all_sums, self._tables, *rows)

    def summary(self) -> dict[str, Any] | None:
        """Return RMSE, mean and maximum error [N] and in % of full scale, or None without bench."""
        sums = self._sums
        n = int(sums.samples)
        if not n:
            return None
        rmse, mean = math.sqrt(sums.square / n), float(sums.absolute) / n
        peak, worst = float(sums.peak), float(sums.worst)
        percent = 100.0 / peak if peak > 0.0 else math.nan
        return {
            "samples": n,
            "full_scale_N": peak,
            "pulled": peak >= FULL_SCALE_SIGMAS * self._noise,
            "rmse_N": rmse,
            "mean_N": mean,
            "max_N": worst,
            "rmse_percent": rmse * percent,
            "mean_percent": mean * percent,
            "max_percent": worst * percent,
            "inside_interval": int(sums.inside) / n,
        }
