"""Running error statistics of the estimate against the bench sensor."""

import math
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import F64, I64, Record, Records, one

PULLED = 200.0  # times the noise: with a smaller full scale a percentage shows only noise


class Sums(Record):
    """Sums over all samples."""

    samples: I64 = 0
    inside: I64 = 0  # samples inside the certified interval
    peak: F64 = 0.0  # [N] largest measured distal tension: the full scale
    square: F64 = 0.0  # [N^2]
    absolute: F64 = 0.0  # [N]
    worst: F64 = 0.0  # [N]


@compiled
def add(sums: Sums, estimate: float, low: float, high: float, measured: float) -> None:
    """Add one sample; a missing bench value (NaN) or estimate is ignored."""
    error = estimate - measured
    if not math.isfinite(error):
        return
    sums.samples += 1
    sums.peak = max(sums.peak, measured)
    sums.inside += int(low <= measured <= high)
    sums.square += error * error
    sums.absolute += abs(error)
    sums.worst = max(sums.worst, abs(error))


@compiled
def add_rows(all_sums: Records, layouts: Records, rows: Records, samples: int) -> None:
    """Add all tendons of the first `samples` of a tick's rows."""
    for k in range(samples):
        row = rows[k]
        for i in range(layouts[0].tendons):
            e = row.tendons[i].estimate
            add(all_sums[0], e.distal_tension, e.low, e.high, row.bench_tension[i])


@compiled
def add_columns(
    all_sums: Records, estimate: Array, low: Array, high: Array, measured: Array
) -> None:
    """Add a whole record, arrays of shape (n,)."""
    for k in range(len(estimate)):
        add(all_sums[0], estimate[k], low[k], high[k], measured[k])


class Score:
    """Running error of the distal tension [N] against a bench sensor.

    Parameters
    ----------
    noise : float
        Standard deviation [N] of the housing's load cells, 0 if unknown.
    """

    def __init__(self, noise: float = 0.0) -> None:
        self._noise = noise
        self._all_sums = Sums.array()
        self._sums: Sums = one(self._all_sums)

    def add(self, estimate: float, low: float, high: float, measured: float) -> None:
        """Add one sample; a missing bench value (NaN) or estimate is ignored."""
        add(self._sums, estimate, low, high, measured)

    def add_columns(self, estimate: Array, low: Array, high: Array, measured: Array) -> None:
        """Add a whole record [N], arrays of shape (n,); see `add`."""
        columns = (estimate, low, high, measured)
        add_columns(self._all_sums, *(np.ascontiguousarray(c, dtype=np.float64) for c in columns))

    def add_rows(self, layouts: Records, rows: Records, samples: int) -> None:
        """Add all tendons of the first `samples` of a tick's rows."""
        add_rows(self._all_sums, layouts, rows, samples)

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
            "pulled": peak >= PULLED * self._noise,
            "rmse_N": rmse,
            "mean_N": mean,
            "max_N": worst,
            "rmse_percent": rmse * percent,
            "mean_percent": mean * percent,
            "max_percent": worst * percent,
            "inside_interval": int(sums.inside) / n,
        }
