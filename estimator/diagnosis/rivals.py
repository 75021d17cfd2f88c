"""Causes that explain the data as well as the one that was named: their models, and a choice."""

from collections.abc import Sequence
from typing import NamedTuple

from estimator.diagnosis.dataset import Dataset, Fit, Model, contexts, rescaled, whole
from estimator.diagnosis.fit import improved
from estimator.effects.effect import Effect, Values

ROUNDS = 12  # of the fit to all samples


class CauseError(ValueError):
    """A cause that was asked for is not among those that explain the data equally well."""


class Equal(NamedTuple):
    """An effect that explains as much as one of the causes, with its first values."""

    replaces: str  # name of that cause
    effect: Effect
    values: Values


class Rival(NamedTuple):
    """A model with another effect in the place of a cause, fitted to all samples."""

    replaces: str  # name of that cause
    effect: Effect
    fit: Fit


def fitted(dataset: Dataset, plain: Fit, fit: Fit, equals: Sequence[Equal]) -> tuple[Rival, ...]:
    """Return the models of all rivals."""
    full = rescaled(whole(dataset), fit)
    about = contexts(dataset, plain)
    return tuple(
        Rival(
            one.replaces,
            one.effect,
            improved(full, about, replaced(fit.model, one), ROUNDS),
        )
        for one in equals
    )


def replaced(model: Model, equal: Equal) -> Model:
    """Return a model with a rival in the place of its cause."""
    effects = tuple(
        (equal.effect, equal.values) if effect.name == equal.replaces else (effect, values)
        for effect, values in model.effects
    )
    return model._replace(effects=effects)
