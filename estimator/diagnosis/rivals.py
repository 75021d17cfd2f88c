"""Causes that explain the data as well as the one that was named: their models, and a choice."""

from collections.abc import Sequence
from typing import NamedTuple

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    build_contexts,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model
from estimator.effects.effect import Effect, Values

ROUNDS = 12  # of the fit to all samples


class CauseError(ValueError):
    """A cause that was asked for is not among those that explain the data equally well."""


class EquivalentCause(NamedTuple):
    """An effect that explains as much as one of the causes, with its first values."""

    replaces: str  # name of that cause
    effect: Effect
    values: Values


class Rival(NamedTuple):
    """A model with another effect in the place of a cause, fitted to all samples."""

    replaces: str  # name of that cause
    effect: Effect
    fit: Fit


def fit_rivals(
    dataset: Dataset, plain: Fit, fit: Fit, equals: Sequence[EquivalentCause]
) -> tuple[Rival, ...]:
    """Return the models of all rivals."""
    full = rescale_residuals(use_all_samples(dataset), fit)
    about = build_contexts(dataset, plain)
    return tuple(
        Rival(
            one.replaces,
            one.effect,
            fit_model(full, about, replace_cause(fit.model, one), ROUNDS),
        )
        for one in equals
    )


def replace_cause(model: Model, equal: EquivalentCause) -> Model:
    """Return a model with a rival in the place of its cause."""
    effects = tuple(
        (equal.effect, equal.values) if effect.name == equal.replaces else (effect, values)
        for effect, values in model.effects
    )
    return model._replace(effects=effects)
