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

SLOPE_MIN = 1e-3  # slope of all residuals below which they tell nothing of a number
SIGNIFICANCE_LEVEL = 0.05  # probability of numbers so far from none by chance
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
        above = self.low > max(neutral, p.low)
        below = self.high < min(neutral, p.high)
        return above or below

    @property
    def at_bound(self) -> bool:
        """Whether the value is at a bound of what the parameter may be."""
        p = self.parameter
        near = 1e-3 * (p.high - p.low)
        return self.value <= p.low + min(near, p.step) or self.value >= p.high - min(near, p.step)


def estimate_intervals(
    dataset: Dataset, about: Sequence[EffectContext], fit: Fit
) -> tuple[ParameterInterval, ...]:
    """Return all numbers of a model but where single records start, with their intervals.

    From the scatter of the residuals and their correlation from one sample to the next, and from
    the worst case of a simulation error of `Settings.accuracy`; for a time, a parameter without a
    gradient, from how far it can be moved until the residuals are as much larger.
    """
    layout = ParameterLayout(dataset, fit.model)
    J, r = compute_jacobian(dataset, about, fit), compute_residual(dataset, fit)
    inverse, spread = np.linalg.pinv(J), _estimate_residual_variance(r, J.shape[1])
    sigma = np.sqrt((inverse**2).sum(axis=1) * spread)
    most_off = _bound_simulation_error(dataset, fit.model, np.asarray(inverse))
    found, values = [], layout.values(fit.model)
    unseen = np.linalg.norm(J, axis=0) < SLOPE_MIN
    for i in (*range(layout.common), *layout.loads):
        p, value = layout.parameters[i], values[i]
        sampling = SETTINGS.cover * float(sigma[i]) * layout.step(i)
        reach = math.hypot(sampling, float(most_off[i]) * layout.step(i))
        low, high = value - reach, value + reach
        if p.jumps:
            most = compute_cost(dataset, fit) + SETTINGS.cover**2 * spread
            low = min(low, value + _find_reach(dataset, about, layout, fit, i, -1.0, most))
            high = max(high, value + _find_reach(dataset, about, layout, fit, i, 1.0, most))
        low, high = max(low, p.low), min(high, p.high)
        if unseen[i] and not p.jumps:
            low, high = p.low, p.high
        found.append(ParameterInterval(layout.names[i], p, value, low, high))
    return tuple(found)


def is_significant(dataset: Dataset, fit: Fit, without: Fit) -> bool:
    """Return whether data are surely less probable without numbers of a fit (likelihood ratio).

    The intervals of numbers that trade against each other, as the sine and cosine of a wave or the
    weights of two plays, may each include none; together they are something.
    """
    from scipy.special import chdtri  # here: the control processes import this module

    numbers, fewer = (len(ParameterLayout(dataset, one.model).names) for one in (fit, without))
    least = chdtri(numbers - fewer, SIGNIFICANCE_LEVEL) * _estimate_residual_variance(
        compute_residual(dataset, fit), numbers
    )
    return bool(compute_cost(dataset, without) - compute_cost(dataset, fit) > least)


def _estimate_residual_variance(r: Array, numbers: int) -> float:
    """Return the variance of a fit's residuals, larger as they correlate with the next sample."""
    correlation = float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-30)
    correlation = min(max(correlation, 0.0), 0.995)
    return float(r @ r) / max(len(r) - numbers, 1) * (1.0 + correlation) / (1.0 - correlation)


def _bound_simulation_error(dataset: Dataset, model: Model, inverse: Array) -> Array:
    """Return how far each number may be off because a simulation is, shape (numbers,).

    A simulation may be off by `Settings.accuracy`, at worst within a bin of time, and for an effect
    independently of it in the next; the law's own numbers are fitted to all samples, and may be off
    the same way in all of them.
    """
    parts, bins, first = [], [], 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        bin_of = ((record.time - record.time[0]) / SETTINGS.bin).astype(np.int64) + first
        first = int(bin_of[-1]) + 1
        for channel in record.compared:
            counts = record.train & record.good[channel]
            off = SETTINGS.accuracy * float(np.ptp(record.signals[channel]))
            parts.append(off / scale[channel][counts])
            bins.append(bin_of[counts])
        if estimate_taut_travel(record, dataset.base, model) is not None:
            parts.append(np.zeros(1))
            bins.append(bin_of[:1])
    worst = np.abs(inverse) * np.concatenate(parts)
    of_bins = np.concatenate(bins)
    of_law = len(dataset.base.shared)
    return np.array(
        [
            float(np.linalg.norm(np.bincount(of_bins, row), 1 if i < of_law else 2))
            for i, row in enumerate(worst)
        ]
    )


def _find_reach(
    dataset: Dataset,
    about: Sequence[EffectContext],
    layout: ParameterLayout,
    fit: Fit,
    i: int,
    way: float,
    most: float,
) -> float:
    """Return how far one number can go one way, in its unit, until the cost is more than `most`."""

    def bears(off: float) -> bool:
        x = layout.pack(fit.model)
        x[i] += off / layout.step(i)
        return compute_cost(dataset, simulate_dataset(dataset, about, layout.unpack(x))) <= most

    near, far = 0.0, way * SEARCH_REACHES[-1]
    while bears(far) and abs(far) < SETTINGS.onset_max:
        near, far = far, 2.0 * far
    for _ in range(BISECTIONS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if bears(middle) else (near, middle)
    return near
