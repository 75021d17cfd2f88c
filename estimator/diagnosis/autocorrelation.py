"""Autocorrelation of a residual: of white noise it is zero at every lag but 0."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.sampling import GAP_PERIODS
from estimator.fitting import COVERAGE_FACTOR

LAG_MAX = 5.0  # [s]
LENGTH_DIVISOR = 4  # of a record's length, at most


class Autocorrelation(NamedTuple):
    """Of the residual of one channel."""

    lag: Array  # [s], shape (m,), from 0
    value: Array  # shape (m,), 1 at lag 0
    band: float  # 95 % of white noise lie between -band and band


def compute_autocorrelation(residuals: Sequence[Array], period: float) -> Autocorrelation:
    """Return the autocorrelation of residuals of one or several records.

    Parameters
    ----------
    residuals : sequence of ndarray
        Of each record, shape (n,), on even times (`resample_residual`); NaN where none counts.
    period : float
        [s] from one sample to the next.
    """
    shortest = min(len(residual) for residual in residuals)
    count = max(2, min(round(LAG_MAX / period), shortest // LENGTH_DIVISOR))
    mean = float(np.nanmean(np.concatenate(list(residuals))))
    products, pairs, samples = np.zeros(count), np.zeros(count), 0
    for residual in residuals:
        is_known: NDArray[np.bool_] = np.isfinite(residual)
        centred = np.where(is_known, residual - mean, 0.0)
        for lag in range(count):
            products[lag] += float(centred[lag:] @ centred[: len(residual) - lag])
            pairs[lag] += int((is_known[lag:] & is_known[: len(residual) - lag]).sum())
        samples += int(is_known.sum())
    value = products / np.maximum(pairs, 1.0)
    scale = value[0] if value[0] > 0.0 else 1.0
    return Autocorrelation(
        period * np.arange(count, dtype=np.float64),
        value / scale,
        COVERAGE_FACTOR / math.sqrt(max(samples, 1)),
    )


def resample_residual(time: Array, residual: Array, period: float) -> Array:
    """Return a residual at multiples of `period`: each sample at the nearest, NaN where none is."""
    rows = np.rint((time - time[0]) / period).astype(np.int64)
    is_known = np.isfinite(residual)
    resampled = np.full(int(rows[-1]) + 1, np.nan)
    resampled[rows[is_known]] = residual[is_known]
    return resampled


def autocorrelate_channel(diagnosis: Diagnosis, channel: str) -> Autocorrelation:
    """Return that of the extended model's residual in a channel, of all fitted records."""
    records = diagnosis.dataset.records
    period = float(np.median([_compute_period(record.time[record.measured]) for record in records]))
    residuals = []
    for record, simulated in zip(records, diagnosis.extended.simulated, strict=True):
        residual = np.where(
            record.good[channel], record.signals[channel] - simulated.signals[channel], np.nan
        )
        residuals.append(
            resample_residual(record.time[record.measured], residual[record.measured], period)
        )
    return compute_autocorrelation(residuals, period)


def _compute_period(time: Array) -> float:
    """Return the mean time from one sample to the next, gaps left out."""
    steps = np.diff(time)
    return float(steps[steps < GAP_PERIODS * float(np.median(steps))].mean())
