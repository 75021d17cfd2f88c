"""Smallest detectable effect size on a clean dataset."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    build_unsimulated_contexts,
    compute_residual,
    compute_tolerance,
    estimate_taut_travel,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.fit import compute_jacobian
from estimator.diagnosis.outcome import DetectionLimit
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect

SUBSAMPLE_SIZE = 3000  # samples of a record, of which the rms of a change is taken


def compute_detection_limits(
    dataset: Dataset, fit: Fit, effects: Sequence[Effect]
) -> dict[str, DetectionLimit]:
    """Return for each effect the size at which it would have been seen; none where it could not.

    By a linear step from its starts: what the model's own parameters do not take up grows with the
    size, until some channel is off by more than noise and the simulation's own error make it.
    """
    dataset = subsample(dataset, SUBSAMPLE_SIZE)
    fit = simulate_dataset(dataset, build_unsimulated_contexts(dataset, fit), fit.model)
    about = build_contexts(dataset, fit)
    r = compute_residual(dataset, fit)
    basis, _ = np.linalg.qr(compute_jacobian(dataset, about, fit))
    found: dict[str, DetectionLimit] = {}
    for effect in effects:
        first = effect.parameters[0]
        if first.neutral is None:
            continue
        for values in effect.starts(about[0]):
            if values[0] == first.neutral:
                continue
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = compute_residual(dataset, simulate_dataset(dataset, about, model)) - r
            change -= basis @ (basis.T @ change)
            share = _compute_detection_ratio(dataset, fit, change)
            size = abs(values[0] - first.neutral) / share if share > 0.0 else math.inf
            known = found.get(effect.name)
            most = max(abs(first.low - first.neutral), abs(first.high - first.neutral))
            if size < most and (known is None or size < known.size):
                found[effect.name] = DetectionLimit(first.name, size, first.unit)
    return found


def _compute_detection_ratio(dataset: Dataset, fit: Fit, change: Array) -> float:
    """Return how many times the least that would be seen a change of the residual is."""
    floor = compute_tolerance(dataset)
    squares, counts, at = dict.fromkeys(floor, 0.0), dict.fromkeys(floor, 0), 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        for channel in record.compared:
            rows = record.train & record.good[channel]
            count = int(rows.sum())
            noises = (scale[channel] / record.sigma[channel])[rows]
            squares[channel] += float(np.sum((noises * change[at : at + count]) ** 2))
            counts[channel] += count
            at += count
        at += estimate_taut_travel(record, dataset.base, fit.model) is not None
    shares = [
        math.sqrt(squares[c] / max(counts[c], 1) / ((SETTINGS.noise_ratio * floor[c]) ** 2 - 1.0))
        for c in floor
    ]
    return max(shares) if np.isfinite(shares).all() else 0.0
