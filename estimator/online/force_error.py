"""Error of the estimated force against a bench's load cell at the tip, over a run or a record.

The estimate is put through the model of that cell (estimator.online.force_error) and compared with
what it reads.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.effects.effect import DISTAL_TENSION, Effect, EffectContext, Values
from estimator.online.tendon_model import TendonModel
from estimator.structs import F64, I64, Struct, StructArray, view_struct

# --- what a bench's load cell at the tip reads of a force: the scale on which estimates are
# scored
# A model of a bench may say that this cell has a wrong gain or zero. An estimate [N] is compared
# with a reading as it is, so that errors with and without such an effect are in the same unit; the
# estimate is therefore put through the cell's model. A table over the tension holds it, which the
# loop can use sample by sample, and which is exact for a gain and a bias.


TABLE_STEP = 1.0  # [N] from one entry of a table to the next
TABLE_SIZE = 1001  # entries, from 0 N on; beyond them the line goes on

IDENTITY_TABLE: Array = TABLE_STEP * np.arange(TABLE_SIZE, dtype=np.float64)
"""The table of a cell that reads the force."""


def build_reading_table(effects: Sequence[tuple[Effect, Values]]) -> Array:
    """Return what a cell with some effects reads at multiples of `TABLE_STEP` [N]."""
    zeros = np.zeros(TABLE_SIZE)
    context = EffectContext(zeros, "", zeros, zeros, {}, {}, zeros, 0.0)
    signals = {DISTAL_TENSION: IDENTITY_TABLE.copy()}
    for effect, values in effects:
        signals = effect.measure(signals, values, context)
    return np.ascontiguousarray(signals[DISTAL_TENSION], dtype=np.float64)


@jit_compile
def compute_reading(table: Array, tension: float) -> float:
    """Return what a cell reads of a tension [N]; NaN of NaN."""
    if not np.isfinite(tension):
        return tension
    i = min(max(int(tension / TABLE_STEP), 0), TABLE_SIZE - 2)
    slope = (table[i + 1] - table[i]) / TABLE_STEP
    return float(table[i] + slope * (tension - i * TABLE_STEP))


# times the noise: with a smaller full scale a percentage shows only noise
FULL_SCALE_SIGMAS = 200.0


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

    `table` is what the bench's cell reads, of `build_reading_table`.
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
        """Add a whole record [N] of the first tendon, arrays of shape (n,); see `add`."""
        columns = (estimate, low, high, measured)
        rows = (np.ascontiguousarray(column, dtype=np.float64) for column in columns)
        add_columns(self._all_sums, self._tables, *rows)

    def summarise(self) -> dict[str, Any] | None:
        """Return RMSE, mean and maximum error [N] and in % of full scale, or None without bench."""
        sums = self._sums
        n = int(sums.samples)
        if not n:
            return None
        rmse, mean = math.sqrt(sums.square / n), float(sums.absolute) / n
        peak, error_max = float(sums.peak), float(sums.worst)
        percent = 100.0 / peak if peak > 0.0 else math.nan
        return {
            "samples": n,
            "full_scale_N": peak,
            "pulled": peak >= FULL_SCALE_SIGMAS * self._noise,
            "rmse_N": rmse,
            "mean_N": mean,
            "max_N": error_max,
            "rmse_percent": rmse * percent,
            "mean_percent": mean * percent,
            "max_percent": error_max * percent,
            "inside_interval": int(sums.inside) / n,
        }
