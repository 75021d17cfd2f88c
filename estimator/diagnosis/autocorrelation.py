"""Autocorrelation of a residual: of white noise it is zero at every lag but 0."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.outcome import Diagnosis

LONGEST = 5.0  # [s]
SHARE = 4  # of a record's length, at most


class Autocorrelation(NamedTuple):
    """Of the residual of one channel."""

    lag: Array  # [s], shape (m,), from 0
    value: Array  # shape (m,), 1 at lag 0
    band: float  # 95 % of white noise lie between -band and band


def autocorrelation(residuals: Sequence[Array], period: float) -> Autocorrelation:
    """Return the autocorrelation of residuals of one or several records.

    Parameters
    ----------
    residuals : sequence of ndarray
        Of each record, shape (n,), evenly sampled; NaN where a sample does not count.
    period : float
        [s] from one sample to the next.
    """
    shortest = min(len(one) for one in residuals)
    count = max(2, min(round(LONGEST / period), shortest // SHARE))
    mean = float(np.nanmean(np.concatenate(list(residuals))))
    products, pairs, samples = np.zeros(count), np.zeros(count), 0
    for one in residuals:
        known: NDArray[np.bool_] = np.isfinite(one)
        centred = np.where(known, one - mean, 0.0)
        for lag in range(count):
            products[lag] += float(centred[lag:] @ centred[: len(one) - lag])
            pairs[lag] += int((known[lag:] & known[: len(one) - lag]).sum())
        samples += int(known.sum())
    value = products / np.maximum(pairs, 1.0)
    scale = value[0] if value[0] > 0.0 else 1.0
    return Autocorrelation(
        period * np.arange(count, dtype=np.float64),
        value / scale,
        1.96 / math.sqrt(max(samples, 1)),
    )


def of_channel(found: Diagnosis, channel: str) -> Autocorrelation:
    """Return that of the extended model's residual in a channel, of all fitted records."""
    residuals, periods = [], []
    for record, one in zip(found.dataset.records, found.extended.simulated, strict=True):
        off = record.signals[channel] - one.signals[channel]
        residuals.append(np.where(record.good[channel], off, np.nan)[record.measured])
        periods.append(float(np.median(np.diff(record.time[record.measured]))))
    return autocorrelation(residuals, float(np.median(periods)))
