"""Two-fold cross-validation: one half of the samples is fitted, the other judges."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled, whole
from estimator.diagnosis.fit import refitted
from estimator.diagnosis.outcome import Fitnesses
from estimator.diagnosis.prediction import Fitness, Predicted, fitness_of

ROUNDS = 12  # of a fit to one half


class Fold(NamedTuple):
    """A dataset of which one half is fitted, and the plain and the extended model fitted to it."""

    dataset: Dataset
    fits: tuple[Fit, Fit]


def two_folds(dataset: Dataset, plain: Fit, fit: Fit) -> tuple[Fold, ...]:
    """Return both ways to fit one half of the samples and to be judged by the other.

    Where all samples are fitted, they are judged as well.
    """
    about = contexts(dataset, plain)
    full = whole(dataset)
    if all(record.train.all() for record in dataset.records):
        return (Fold(dataset, (plain, fit)),)

    def fold(half: Dataset) -> Fold:
        before, after = (
            refitted(rescaled(half, one), rescaled(full, one), about, one, ROUNDS)
            for one in (plain, fit)
        )
        return Fold(half, (before, after))

    swapped = tuple(replace(record, train=~record.train) for record in dataset.records)
    return fold(dataset), fold(dataset._replace(records=swapped))


def fitnesses(folds: tuple[Fold, ...], which: int, further: Sequence[Predicted]) -> Fitnesses:
    """Return the errors of the plain (0) or the extended (1) model on all sets of samples."""
    return Fitnesses(
        _fitness(folds, which, fitted=True),
        _fitness(folds, which, fitted=False),
        _validated(further, which),
    )


def _fitness(folds: Sequence[Fold], which: int, *, fitted: bool) -> dict[str, Fitness]:
    found = {}
    for channel in folds[0].dataset.records[0].compared:
        off, full = [], 0.0
        for fold in folds:
            for record, one in zip(fold.dataset.records, fold.fits[which].simulated, strict=True):
                judged = record.train if record.train.all() else record.train == fitted
                rows = record.good[channel] & judged
                off.append((record.signals[channel] - one.signals[channel])[rows])
                full = max(full, float(np.ptp(record.signals[channel])))
        found[channel] = fitness_of(off, full)
    return found


def _validated(further: Sequence[Predicted], which: int) -> dict[str, Fitness]:
    """Return how far a model is off in all records that it predicts."""
    channels = further[0].record.compared if further else ()
    found = {}
    for channel in channels:
        off = [one.residual((one.before, one.after)[which], channel) for one in further]
        full = max(float(np.ptp(one.record.signals[channel])) for one in further)
        found[channel] = fitness_of(off, full)
    return found
