"""What a residual depends on: hints for a person, no verdict."""

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import Dataset, Fit
from estimator.diagnosis.outcome import ResidualDependence
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_TENSION


def find_residual_dependence(dataset: Dataset, fit: Fit) -> tuple[ResidualDependence, ...]:
    """Return how much of each channel's residual is a function of what, strongest first.

    The share of its variance between bins of the tension, its rate, the speed, the direction, the
    travel and the time, less what bins of noise would have.
    """
    found = []
    for channel in dataset.records[0].compared:
        residual, along = [], dict[str, list[Array]]()
        for record, one in zip(dataset.records, fit.simulated, strict=True):
            rows = record.good[channel]
            residual.append((record.signals[channel] - one.signals[channel])[rows])
            T = record.signals[PROXIMAL_TENSION]
            for what, signal in (
                ("tension", T),
                ("speed", record.speed),
                ("direction", np.sign(record.speed)),
                ("travel" if record.driver != PROXIMAL_TENSION else "drive", record.drive),
                ("time", record.time - record.time[0]),
            ):
                along.setdefault(what, []).append(signal[rows])
        r = np.concatenate(residual)
        for what, parts in along.items():
            share = compute_explained_variance(r, np.concatenate(parts))
            if share > SETTINGS.dependence_min:
                found.append(ResidualDependence(what, channel, share))
    return tuple(sorted(found, key=lambda one: -one.share))


def compute_explained_variance(residual: Array, signal: Array) -> float:
    """Return the share of a residual's variance that is between bins of a signal."""
    edges = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, SETTINGS.dependence_bins + 1)))
    if len(edges) < 2 or not residual.var() > 0.0:
        return 0.0
    bin_of = np.clip(np.searchsorted(edges, signal, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bin_of, minlength=len(edges) - 1)
    mean = np.bincount(bin_of, residual, len(edges) - 1) / np.maximum(count, 1)
    between = float(np.sum(count * (mean - residual.mean()) ** 2)) / len(residual)
    return max(0.0, between / float(residual.var()) - (len(edges) - 1) / len(residual))
