"""Structure that a residual still has, for a person to look at; no part of the verdict."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array, Mask
from estimator.diagnosis.dataset import Dataset, Fit
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_TENSION
from estimator.fitting import COVERAGE_FACTOR
from estimator.signals.sampling import GAP_PERIODS

# --- what it depends on


class ResidualDependence(NamedTuple):
    """What a residual depends on, strongest first."""

    what: str
    channel: str
    share: float  # of the residual's variance


def find_residual_dependence(dataset: Dataset, fit: Fit) -> tuple[ResidualDependence, ...]:
    """Return the dependences of each channel's residual on other variables, strongest first.

    The share of its variance between bins of tension, speed, direction, travel or time, less the
    share that bins of noise would have.
    """
    dependences = []
    for channel in dataset.records[0].compared:
        residual, signals = [], dict[str, list[Array]]()
        for record, simulated in zip(dataset.records, fit.simulated, strict=True):
            rows = record.valid[channel]
            residual.append((record.signals[channel] - simulated.signals[channel])[rows])
            T = record.signals[PROXIMAL_TENSION]
            for variable, signal in (
                ("tension", T),
                ("speed", record.speed),
                ("direction", np.sign(record.speed)),
                ("travel" if record.driver != PROXIMAL_TENSION else "drive", record.drive),
                ("time", record.time - record.time[0]),
            ):
                signals.setdefault(variable, []).append(signal[rows])
        r = np.concatenate(residual)
        for variable, parts in signals.items():
            share = compute_explained_variance(r, np.concatenate(parts))
            if share > SETTINGS.dependence_min:
                dependences.append(ResidualDependence(variable, channel, share))
    return tuple(sorted(dependences, key=lambda dependence: -dependence.share))


def compute_explained_variance(residual: Array, signal: Array) -> float:
    """Return the share of a residual's variance that is between bins of a signal."""
    edges = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, SETTINGS.dependence_bins + 1)))
    if len(edges) < 2 or not residual.var() > 0.0:
        return 0.0
    bin_of = np.clip(np.searchsorted(edges, signal, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bin_of, minlength=len(edges) - 1)
    mean = np.bincount(bin_of, residual, len(edges) - 1) / np.maximum(count, 1)
    explained = float(np.sum(count * (mean - residual.mean()) ** 2)) / len(residual)
    return max(0.0, explained / float(residual.var()) - (len(edges) - 1) / len(residual))


# --- autocorrelation of a residual: of white noise it is zero at every lag but 0


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
        is_known: Mask = np.isfinite(residual)
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


def autocorrelate_channel(dataset: Dataset, fit: Fit, channel: str) -> Autocorrelation:
    """Return the autocorrelation of a fit's residual in a channel, of all fitted records."""
    records = dataset.records
    period = float(np.median([_compute_period(record.time[record.measured]) for record in records]))
    residuals = []
    for record, simulated in zip(records, fit.simulated, strict=True):
        residual = np.where(
            record.valid[channel], record.signals[channel] - simulated.signals[channel], np.nan
        )
        residuals.append(
            resample_residual(record.time[record.measured], residual[record.measured], period)
        )
    return compute_autocorrelation(residuals, period)


def _compute_period(time: Array) -> float:
    """Return the mean time from one sample to the next, gaps left out."""
    steps = np.diff(time)
    return float(steps[steps < GAP_PERIODS * float(np.median(steps))].mean())
