"""How small an effect could have been and still been seen, on a bench that has none."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.diagnosis.bench import (
    NOISE,
    Bench,
    Fit,
    mean_noise,
    residual,
    scenes,
    simulated,
    tolerance,
)
from estimator.diagnosis.fit import slopes_of
from estimator.diagnosis.outcome import Visible
from estimator.effects.effect import Effect

Array = NDArray[np.float64]


def visible(bench: Bench, fit: Fit, effects: Sequence[Effect]) -> dict[str, Visible]:
    """Return for each effect the size at which it would have been seen; none where it could not.

    By a linear step from its starts: what the model's own parameters do not take up grows with the
    size, until some channel is off by more than noise and the simulation's own error make it.
    """
    about = scenes(bench, fit)
    r = residual(bench, fit)
    basis, _ = np.linalg.qr(slopes_of(bench, about, fit))
    found: dict[str, Visible] = {}
    for effect in effects:
        first = effect.parameters[0]
        if first.neutral is None:
            continue
        for values in effect.starts(about[0]):
            if values[0] == first.neutral:
                continue
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = residual(bench, simulated(bench, about, model)) - r
            change -= basis @ (basis.T @ change)
            share = _of_least(bench, change)
            size = abs(values[0] - first.neutral) / share if share > 0.0 else math.inf
            known = found.get(effect.name)
            most = max(abs(first.low - first.neutral), abs(first.high - first.neutral))
            if size < most and (known is None or size < known.size):
                found[effect.name] = Visible(first.name, size, first.unit)
    return found


def _of_least(bench: Bench, change: Array) -> float:
    """Return how many times the least that would be seen a change of the residual is."""
    noise, floor = mean_noise(bench), tolerance(bench)
    squares, counts, at = dict.fromkeys(noise, 0.0), dict.fromkeys(noise, 0), 0
    for record, scale in zip(bench.records, bench.scale, strict=True):
        for channel in record.compared:
            count = int((record.train & record.good[channel]).sum())
            squares[channel] += float(np.sum((scale[channel] * change[at : at + count]) ** 2))
            counts[channel] += count
            at += count
        at += record.starts_slack and len(bench.base.own) > 0
    shares = [
        math.sqrt(squares[c] / max(counts[c], 1) / ((NOISE * floor[c]) ** 2 - noise[c] ** 2))
        for c in noise
    ]
    return max(shares) if np.isfinite(shares).all() else 0.0
