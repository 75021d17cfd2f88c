"""Smallest detectable effect size on a clean dataset."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    contexts,
    contexts_without,
    residual,
    simulated,
    thin,
    tolerance,
)
from estimator.diagnosis.fit import slopes_of
from estimator.diagnosis.outcome import DetectionLimit
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect

FIRST_LOOK = 3000  # samples of a record, of which the rms of a change is taken


def detection_limits(
    dataset: Dataset, fit: Fit, effects: Sequence[Effect]
) -> dict[str, DetectionLimit]:
    """Return for each effect the size at which it would have been seen; none where it could not.

    By a linear step from its starts: what the model's own parameters do not take up grows with the
    size, until some channel is off by more than noise and the simulation's own error make it.
    """
    dataset = thin(dataset, FIRST_LOOK)
    fit = simulated(dataset, contexts_without(dataset, fit), fit.model)
    about = contexts(dataset, fit)
    r = residual(dataset, fit)
    basis, _ = np.linalg.qr(slopes_of(dataset, about, fit))
    found: dict[str, DetectionLimit] = {}
    for effect in effects:
        first = effect.parameters[0]
        if first.neutral is None:
            continue
        for values in effect.starts(about[0]):
            if values[0] == first.neutral:
                continue
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = residual(dataset, simulated(dataset, about, model)) - r
            change -= basis @ (basis.T @ change)
            share = _of_least(dataset, change)
            size = abs(values[0] - first.neutral) / share if share > 0.0 else math.inf
            known = found.get(effect.name)
            most = max(abs(first.low - first.neutral), abs(first.high - first.neutral))
            if size < most and (known is None or size < known.size):
                found[effect.name] = DetectionLimit(first.name, size, first.unit)
    return found


def _of_least(dataset: Dataset, change: Array) -> float:
    """Return how many times the least that would be seen a change of the residual is."""
    floor = tolerance(dataset)
    squares, counts, at = dict.fromkeys(floor, 0.0), dict.fromkeys(floor, 0), 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        for channel in record.compared:
            rows = record.train & record.good[channel]
            count = int(rows.sum())
            noises = (scale[channel] / record.sigma[channel])[rows]
            squares[channel] += float(np.sum((noises * change[at : at + count]) ** 2))
            counts[channel] += count
            at += count
        at += record.starts_slack and len(dataset.base.own) > 0
    shares = [
        math.sqrt(squares[c] / max(counts[c], 1) / ((SETTINGS.noise_ratio * floor[c]) ** 2 - 1.0))
        for c in floor
    ]
    return max(shares) if np.isfinite(shares).all() else 0.0
