"""A cause that is in one of several files only: which file differs, and what may be wrong in it.

The files share the physics of a bench, so a fault of one spoils the fit of all. Without that file
a model fits the others as well as their noise allows. That needs three files at least: of two that
differ, nothing says which is right. It is looked for only where no effect in all files explains
them: an effect of the bench may show in one more than in the others.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from estimator.diagnosis.dataset import Dataset, Fit, build_contexts, replace_records
from estimator.diagnosis.fit import BASELINE_ROUNDS, fit_model
from estimator.diagnosis.scoring import compute_errors, is_noise
from estimator.effects.effect import Effect

FILES_MIN = 3

T = TypeVar("T")


def find_odd_file(dataset: Dataset, base_fit: Fit, fit: Fit) -> int:
    """Return the file without which a model explains the others best, from 1; 0 if it never does.

    `fit` is that of the base law and the causes found in all files.
    """
    if len(dataset.records) < FILES_MIN:
        return 0
    explained, contexts = {}, build_contexts(dataset, base_fit)
    for k, record in enumerate(dataset.records):
        rest = replace_records(dataset, _drop(dataset.records, k))
        model = fit.model._replace(own=_drop(fit.model.own, k))
        errors = compute_errors(rest, fit_model(rest, _drop(contexts, k), model, BASELINE_ROUNDS))
        if is_noise(rest, errors):
            explained[record.file] = sum(channel.mean_square for channel in errors.values())
    return min(explained, key=explained.__getitem__, default=0)


def confine_effects(effects: Sequence[Effect], file: int) -> list[Effect]:
    """Return effects that act in one file only."""
    return [replace(effect, file=file) for effect in effects]


def _drop(items: tuple[T, ...], k: int) -> tuple[T, ...]:
    return items[:k] + items[k + 1 :]
