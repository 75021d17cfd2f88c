"""How surely the numbers of a model are known."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    compute_cost,
    compute_residual,
    estimate_taut_travel,
    simulate_dataset,
)
from estimator.diagnosis.fit import SEARCH_REACHES, ParameterLayout, compute_jacobian
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import EffectContext, Parameter
from estimator.fitting import COVERAGE_FACTOR, compute_residual_variance, estimate_correlation

SLOPE_MIN = 1e-3  # slope of all residuals below which they tell nothing of a number
SIGNIFICANCE_LEVEL = 0.05  # probability of numbers so far from none by chance
CORRELATION_MAX = 0.995  # of a residual: a row of all channels may be one error that lasts
BISECTIONS = 5  # times, the step that is one too far


class ParameterInterval(NamedTuple):
    """One number of a model with its 95 % interval."""

    name: str
    parameter: Parameter
    value: float
    low: float
    high: float

    @property
    def excludes_neutral(self) -> bool:
        """Whether the interval leaves out the value at which an effect does nothing.

        Where a bound of the parameter keeps that value away, the interval must keep off the bound.
        """
        p, neutral = self.parameter, self.parameter.neutral
        if neutral is None:
            return True
        is_above = self.low > max(neutral, p.low)
        is_below = self.high < min(neutral, p.high)
        return is_above or is_below

    @property
    def at_bound(self) -> bool:
        """Whether the value is at a bound of what the parameter may be."""
        p = self.parameter
        margin = 1e-3 * (p.high - p.low)
        return self.value <= p.low + min(margin, p.step) or self.value >= p.high - min(
            margin, p.step
        )


def estimate_intervals(
    dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit
) -> tuple[ParameterInterval, ...]:
    """Return all numbers of a model but where single records start, with their intervals.

    From the scatter of the residuals and their correlation from one sample to the next, and from
    the worst case of a simulation error of `Settings.accuracy`; for a time, a parameter without a
    gradient, from how far it can be moved until the residuals are as much larger.
    """
    layout = ParameterLayout(dataset, fit.model)
    J, residual = compute_jacobian(dataset, contexts, fit), compute_residual(dataset, fit)
    inverse, variance = np.linalg.pinv(J), estimate_residual_variance(residual, J.shape[1])
    sigma = np.sqrt((inverse**2).sum(axis=1) * variance)
    simulation_error = _bound_simulation_error(dataset, fit.model, np.asarray(inverse))
    intervals, values = [], layout.values(fit.model)
    is_unseen = np.linalg.norm(J, axis=0) < SLOPE_MIN
    for i in (*range(layout.common), *layout.load_indices):
        p, value = layout.parameters[i], values[i]
        sampling_error = COVERAGE_FACTOR * float(sigma[i]) * layout.step(i)
        reach = math.hypot(sampling_error, float(simulation_error[i]) * layout.step(i))
        low, high = value - reach, value + reach
        if p.jumps:
            cost_max = compute_cost(dataset, fit) + COVERAGE_FACTOR**2 * variance
            low = min(low, value + _find_reach(dataset, contexts, layout, fit, i, -1.0, cost_max))
            high = max(high, value + _find_reach(dataset, contexts, layout, fit, i, 1.0, cost_max))
        low, high = max(low, p.low), min(high, p.high)
        if is_unseen[i] and not p.jumps:
            low, high = p.low, p.high
        intervals.append(ParameterInterval(layout.names[i], p, value, low, high))
    return tuple(intervals)


def is_significant(dataset: Dataset, fit: Fit, fit_without: Fit) -> bool:
    """Return whether data are surely less probable without numbers of a fit (likelihood ratio).

    The intervals of numbers that trade against each other, as the sine and cosine of a wave or the
    weights of two plays, may each include none; together they are something.
    """
    from scipy.special import chdtri  # here: the control processes import this module

    numbers, numbers_without = (
        len(ParameterLayout(dataset, trial.model).names) for trial in (fit, fit_without)
    )
    increase_min = chdtri(
        numbers - numbers_without, SIGNIFICANCE_LEVEL
    ) * estimate_residual_variance(compute_residual(dataset, fit), numbers)
    return bool(compute_cost(dataset, fit_without) - compute_cost(dataset, fit) > increase_min)


def estimate_residual_variance(residual: Array, numbers: int) -> float:
    """Return the variance of a fit's residuals, larger as they correlate with the next sample."""
    correlation = estimate_correlation(residual, centred=False, correlation_max=CORRELATION_MAX)
    return compute_residual_variance(residual, len(residual) - numbers, correlation)


def _bound_simulation_error(dataset: Dataset, model: Model, inverse: Array) -> Array:
    """Return how far each number may be off because a simulation is, shape (numbers,).

    A simulation may be off by `Settings.accuracy`, at worst within a bin of time, and for an effect
    independently of it in the next; the law's own numbers are fitted to all samples, and may be off
    the same way in all of them.
    """
    parts, bins, next_bin = [], [], 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        bin_of = ((record.time - record.time[0]) / SETTINGS.bin_width).astype(np.int64) + next_bin
        next_bin = int(bin_of[-1]) + 1
        for channel in record.compared:
            counts = record.train & record.valid[channel]
            error = SETTINGS.accuracy * float(np.ptp(record.signals[channel]))
            parts.append(error / scale[channel][counts])
            bins.append(bin_of[counts])
        if estimate_taut_travel(record, dataset.base, model) is not None:
            parts.append(np.zeros(1))
            bins.append(bin_of[:1])
    parts += [np.zeros(len(effect.penalty(values))) for effect, values in model.effects]
    bins += [np.zeros(len(rows), dtype=np.int64) for rows in parts[len(bins) :]]
    error_max = np.abs(inverse) * np.concatenate(parts)
    all_bins = np.concatenate(bins)
    law_count = len(dataset.base.shared)
    return np.array(
        [
            float(np.linalg.norm(np.bincount(all_bins, row), 1 if i < law_count else 2))
            for i, row in enumerate(error_max)
        ]
    )


def _find_reach(
    dataset: Dataset,
    contexts: Sequence[EffectContext],
    layout: ParameterLayout,
    fit: Fit,
    i: int,
    direction: float,
    cost_max: float,
) -> float:
    """Return how far one number can go one way, in its unit, at a cost of at most `cost_max`."""

    def is_tolerated(offset: float) -> bool:
        x = layout.pack(fit.model)
        x[i] += offset / layout.step(i)
        return (
            compute_cost(dataset, simulate_dataset(dataset, contexts, layout.unpack(x))) <= cost_max
        )

    inner, outer = 0.0, direction * SEARCH_REACHES[-1]
    while is_tolerated(outer) and abs(outer) < SETTINGS.onset_max:
        inner, outer = outer, 2.0 * outer
    for _ in range(BISECTIONS):
        middle = 0.5 * (inner + outer)
        inner, outer = (middle, outer) if is_tolerated(middle) else (inner, middle)
    return inner
