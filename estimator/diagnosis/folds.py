"""Two-fold cross-validation: one half of the samples is fitted, the other judges."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import refit_subset
from estimator.diagnosis.outcome import ModelErrors
from estimator.diagnosis.prediction import (
    ErrorStatistics,
    PredictedRecord,
    compute_error_statistics,
)

FOLD_ROUNDS = 12  # of a fit to one half


class Fold(NamedTuple):
    """A dataset of which one half is fitted, and the plain and the extended model fitted to it."""

    dataset: Dataset
    fits: tuple[Fit, Fit]


def fit_folds(dataset: Dataset, plain: Fit, fit: Fit) -> tuple[Fold, ...]:
    """Return both ways to fit one half of the samples and to be judged by the other.

    Where all samples are fitted, they are judged as well.
    """
    about = build_contexts(dataset, plain)
    full = use_all_samples(dataset)
    if all(record.train.all() for record in dataset.records):
        return (Fold(dataset, (plain, fit)),)

    def fold(half: Dataset) -> Fold:
        before, after = (
            refit_subset(
                rescale_residuals(half, one), rescale_residuals(full, one), about, one, FOLD_ROUNDS
            )
            for one in (plain, fit)
        )
        return Fold(half, (before, after))

    swapped = tuple(replace(record, train=~record.train) for record in dataset.records)
    return fold(dataset), fold(dataset._replace(records=swapped))


def compute_model_errors(
    folds: tuple[Fold, ...], which: int, further: Sequence[PredictedRecord]
) -> ModelErrors:
    """Return the errors of the plain (0) or the extended (1) model on all sets of samples."""
    return ModelErrors(
        _compute_fold_errors(folds, which, fitted=True),
        _compute_fold_errors(folds, which, fitted=False),
        _compute_validation_errors(further, which),
    )


def _compute_fold_errors(
    folds: Sequence[Fold], which: int, *, fitted: bool
) -> dict[str, ErrorStatistics]:
    found = {}
    for channel in folds[0].dataset.records[0].compared:
        off, full = [], 0.0
        for fold in folds:
            for record, one in zip(fold.dataset.records, fold.fits[which].simulated, strict=True):
                judged = record.train if record.train.all() else record.train == fitted
                rows = record.good[channel] & judged
                off.append((record.signals[channel] - one.signals[channel])[rows])
                full = max(full, float(np.ptp(record.signals[channel])))
        found[channel] = compute_error_statistics(off, full)
    return found


def _compute_validation_errors(
    further: Sequence[PredictedRecord], which: int
) -> dict[str, ErrorStatistics]:
    """Return how far a model is off in all records that it predicts."""
    channels = further[0].record.compared if further else ()
    found = {}
    for channel in channels:
        off = [one.residual((one.before, one.after)[which], channel) for one in further]
        full = max(float(np.ptp(one.record.signals[channel])) for one in further)
        found[channel] = compute_error_statistics(off, full)
    return found
