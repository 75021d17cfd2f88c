"""Errors of models on held-out samples, and how significantly one model beats another."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.diagnosis.dataset import Dataset, Fit, compute_tolerance
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import DISTAL_TENSION, PROXIMAL_TENSION
from estimator.fitting import (
    IntervalEstimate,
    compute_independent_share,
    estimate_correlation,
)

BOOTSTRAP_DRAWS = 400
BLOCKS_MIN = 6  # of a bootstrapped record


class ChannelErrors(NamedTuple):
    """Squared errors of one channel on held-out samples."""

    normalised_squares: Array  # sums over bins, (bins,), in squares of the noise
    sum_of_squares: float  # of all samples, in squares of the channel's unit
    counts: Array  # samples of each bin
    independent_share: float  # share of the samples that are statistically independent

    @property
    def rmse(self) -> float:
        """Root mean square, in the channel's unit."""
        return math.sqrt(self.sum_of_squares / max(float(self.counts.sum()), 1.0))

    @property
    def mean_square(self) -> float:
        """Mean square, in squares of the noise."""
        return float(self.normalised_squares.sum() / max(self.counts.sum(), 1.0))


def compute_errors(
    dataset: Dataset, fit: Fit, *, held_out: bool = True
) -> dict[str, ChannelErrors]:
    """Return the errors of a model by channel, all records together.

    Where no sample is held out, those of the fitted ones.
    """
    parts: dict[str, list[ChannelErrors]] = {}
    for record, simulated in zip(dataset.records, fit.simulated, strict=True):
        samples = record.train if record.train.all() else record.train != held_out
        for channel in record.compared:
            errors = compute_channel_errors(record, channel, simulated.signals[channel], samples)
            parts.setdefault(channel, []).append(errors)
    return {channel: concatenate_errors(errors) for channel, errors in parts.items()}


def compute_channel_errors(
    record: Record, channel: str, predicted: Array, samples: Mask
) -> ChannelErrors:
    """Return the errors of a predicted channel of a record on some of its samples, shape (n,)."""
    # no bin goes beyond its block: both numbers rise with time
    bins = ((record.time - record.time[0]) / SETTINGS.bin_width).astype(np.int64) + record.block
    rows = record.valid[channel] & samples
    error = (record.signals[channel] - predicted)[rows]
    scaled_error = error / record.sigma[channel][rows]
    squares = np.bincount(bins[rows], scaled_error**2, bins[-1] + 1).astype(np.float64)
    counts = np.bincount(bins[rows], minlength=bins[-1] + 1).astype(np.float64)
    has_samples = counts > 0
    return ChannelErrors(
        squares[has_samples],
        float(error @ error),
        counts[has_samples],
        _estimate_independent_share(scaled_error),
    )


def join_errors(parts: Sequence[dict[str, ChannelErrors]]) -> dict[str, ChannelErrors]:
    """Return the errors of several parts by channel, concatenated."""
    return {channel: concatenate_errors([part[channel] for part in parts]) for channel in parts[0]}


def concatenate_errors(parts: Sequence[ChannelErrors]) -> ChannelErrors:
    """Return the errors of several parts of one channel, concatenated."""
    return ChannelErrors(
        np.concatenate([part.normalised_squares for part in parts]),
        sum(part.sum_of_squares for part in parts),
        np.concatenate([part.counts for part in parts]),
        min(part.independent_share for part in parts),
    )


def compute_log_likelihood_ratio(
    a: Mapping[str, ChannelErrors], b: Mapping[str, ChannelErrors]
) -> float:
    """Return the log-likelihood ratio of held-out data under `a` to that under `b`.

    Each channel's own mean square stands for its variance, so that neither its unit nor an error of
    its estimated noise matters. As many samples are independent as on the geometric mean of both
    models: where one leaves noise of another's slow error, that itself is evidence.
    """
    total = 0.0
    for channel, errors in a.items():
        share = math.sqrt(errors.independent_share * b[channel].independent_share)
        total += (
            0.5
            * share
            * float(errors.counts.sum())
            * math.log(_floor_variance(b[channel]) / _floor_variance(errors))
        )
    return total


def bootstrap_superiority(a: Mapping[str, ChannelErrors], b: Mapping[str, ChannelErrors]) -> float:
    """Return the share of bootstrapped records in which `a` is better than `b`.

    Bins are paired, and drawn in blocks as long as the difference remembers.
    """
    difference = []
    for channel, errors in a.items():
        scale = _floor_variance(errors)
        difference.append((b[channel].normalised_squares - errors.normalised_squares) / scale)
    total = (  # channels with the same bins are drawn together: their errors are correlated in time
        np.sum(difference, axis=0)
        if len({len(d) for d in difference}) == 1
        else np.concatenate(difference)
    )
    draws = _draw_bootstrap_rows(total)
    return float(np.mean(total[draws].sum(axis=1) > 0.0))


def compute_likelihood_gain(a: dict[str, ChannelErrors], b: dict[str, ChannelErrors]) -> float:
    """Return 1 - prod(rmse_a / rmse_b) over channels of as many independent samples each."""
    samples = sum(errors.independent_share * float(errors.counts.sum()) for errors in a.values())
    return -math.expm1(-compute_log_likelihood_ratio(a, b) / max(samples / len(a), 1.0))


def compute_residual_fraction(a: dict[str, ChannelErrors], b: dict[str, ChannelErrors]) -> float:
    """Return the residual of `a` over that of `b`, both beyond noise; worse channels weigh more.

    0 if only noise remains, 1 if `a` is no better.
    """
    remaining = total = 0.0
    for channel, errors in b.items():
        excess = max(errors.mean_square - 1.0, 0.0)
        if excess < SETTINGS.excess_min:
            continue
        weight = math.sqrt(excess)
        remaining += weight * min(
            max(a[channel].mean_square - 1.0, 0.0) / excess, SETTINGS.excess_ratio_max
        )
        total += weight
    return remaining / total if total else 0.0


def _draw_bootstrap_rows(series: Array) -> NDArray[np.intp]:
    """Return rows of bootstrapped records, (BOOTSTRAP_DRAWS, n): moving blocks of the series.

    A block is as long as two independent bins are apart, by the correlation of neighbours; a fixed
    length of one bin takes an error that lasts for several (Kuensch, Ann. Stat. 17, 1989).
    """
    n = len(series)
    share = compute_independent_share(estimate_correlation(series))
    length = min(max(round(1.0 / share), 1), max(n // BLOCKS_MIN, 1))
    starts = np.random.default_rng(0).integers(0, n, (BOOTSTRAP_DRAWS, -(-n // length)))
    rows = (starts[:, :, None] + np.arange(length)).reshape(BOOTSTRAP_DRAWS, -1)
    return np.asarray(rows[:, :n] % n)


def bootstrap_gain(a: ChannelErrors, b: ChannelErrors) -> IntervalEstimate:
    """Return by which share the RMSE is smaller under `a` than under `b`, and its 95 % interval."""
    value = 1.0 - math.sqrt(a.mean_square / max(b.mean_square, 1e-12))
    draws = _draw_bootstrap_rows(b.normalised_squares - a.normalised_squares)
    ratio = a.normalised_squares[draws].sum(axis=1) / np.maximum(
        b.normalised_squares[draws].sum(axis=1), 1e-12
    )
    low, high = np.quantile(1.0 - np.sqrt(ratio), [0.025, 0.975])
    return IntervalEstimate(value, float(low), float(high))


def compute_missed_share(dataset: Dataset, errors: Mapping[str, ChannelErrors]) -> float:
    """Return the rms error beyond noise over the channel's rms about its mean, at worst.

    Of the tensions, which any transmission must pass on; a tip that is held hardly moves.
    """
    shares = [0.0]
    for channel, channel_errors in errors.items():
        if channel not in (PROXIMAL_TENSION, DISTAL_TENSION):
            continue
        excess = max(1.0 - 1.0 / max(channel_errors.mean_square, 1e-12), 0.0)
        spread = max(float(r.signals[channel].std()) for r in dataset.records)
        shares.append(channel_errors.rmse * math.sqrt(excess) / max(spread, 1e-12))
    return max(shares)


def is_foreign_data(dataset: Dataset, errors: Iterable[dict[str, ChannelErrors]]) -> bool:
    """Return whether each of several models misses so much that data are surely of no tendon."""
    return all(
        compute_missed_share(dataset, model_errors) > SETTINGS.foreign_share_stop
        for model_errors in errors
    )


def has_localised_misfit(dataset: Dataset, base_fit: Fit) -> bool:
    """Return whether nearly all of the misfit lies in one block, or in two neighbouring ones."""
    peak = total = 0.0
    for record, simulated in zip(dataset.records, base_fit.simulated, strict=True):
        excess = np.zeros(record.block[-1] + 1)
        for channel in record.compared:
            rows = record.valid[channel]
            error = (simulated.signals[channel] - record.signals[channel])[rows]
            scaled_error = error / record.sigma[channel][rows]
            excess += np.bincount(record.block[rows], scaled_error**2 - 1.0, len(excess))
        excess = np.maximum(excess, 0.0)
        peak = max(peak, float(np.convolve(excess, np.ones(2)).max()))
        total += float(excess.sum())
    return peak > SETTINGS.localised_share * total


def is_noise(dataset: Dataset, errors: Mapping[str, ChannelErrors]) -> bool:
    """Return whether errors are no larger than noise and the simulation's own error."""
    return is_within_tolerance(dataset, errors, SETTINGS.noise_ratio)


def is_within_tolerance(
    dataset: Dataset, errors: Mapping[str, ChannelErrors], ratio_max: float
) -> bool:
    """Return whether errors are below `ratio_max` times those of noise and of a simulation."""
    tolerance = compute_tolerance(dataset)
    return all(
        math.sqrt(channel_errors.mean_square) < ratio_max * tolerance[channel]
        for channel, channel_errors in errors.items()
    )


def compute_bic_penalty(dataset: Dataset, parameters: float) -> float:
    """Return the log-likelihood penalty of a count of parameters (BIC, Schwarz 1978)."""
    samples = sum(len(record.time) for record in dataset.records)
    return 0.5 * parameters * math.log(samples)


def _floor_variance(errors: ChannelErrors) -> float:
    return max(errors.mean_square, SETTINGS.variance_min)


def _estimate_independent_share(error: Array) -> float:
    return max(compute_independent_share(estimate_correlation(error)), SETTINGS.independent_min)


# --- scores of base laws and of models without a sheath, by held-out samples


class ChoiceScore(NamedTuple):
    """The result of a base law or of a choice of loads."""

    name: str
    score: float  # log-likelihood ratio of held-out data to the first choice, less BIC penalty
    rmse: dict[str, float]  # held out, by channel, in the channel's unit


class Choice(NamedTuple):
    """A chosen law or model of the loads: its dataset, its fit, and the scores of all."""

    dataset: Dataset
    fit: Fit
    scores: tuple[ChoiceScore, ...]  # of all that were tried; empty where nothing was to be chosen

    @property
    def equivalents(self) -> tuple[str, ...]:
        """Names of the choices that the data do not distinguish from the best."""
        best_score = max((choice.score for choice in self.scores), default=0.0)
        return tuple(
            choice.name
            for choice in self.scores
            if best_score - choice.score < SETTINGS.equivalent_score_max
        )


class SimpleFit(NamedTuple):
    """A model without a sheath, and its held-out errors."""

    name: str
    held_out: dict[str, ChannelErrors]  # of both halves, each fitted to the other

    @property
    def rmse(self) -> dict[str, float]:
        """Root mean square by channel [N] or [m]."""
        return {channel: errors.rmse for channel, errors in self.held_out.items()}


class SimpleGain(NamedTuple):
    """By which share a law's held-out RMSE is below that of the best simple model."""

    model: str
    value: float  # negative where the simple model is better
    low: float  # of the 95 % interval, by the same bins of time of both
    high: float
