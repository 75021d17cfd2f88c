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
from estimator.diagnosis.outcome import CauseStep, Rival
from estimator.effects.effect import Effect, Values

ROUNDS = 12  # of the fit to all samples


class CauseError(ValueError):
    """A cause that was asked for is not among those that explain the data equally well."""


class EquivalentCause(NamedTuple):
    """An effect that explains as much as one of the causes, with its first values."""

    replaces: str  # name of that cause
    effect: Effect
    values: Values


def fit_rivals(
    dataset: Dataset, base_fit: Fit, fit: Fit, equivalents: Sequence[EquivalentCause]
) -> tuple[Rival, ...]:
    """Return the models of all rivals."""
    full_dataset = rescale_residuals(use_all_samples(dataset), fit)
    contexts = build_contexts(dataset, base_fit)
    return tuple(
        Rival(
            equivalent.replaces,
            equivalent.effect,
            fit_model(full_dataset, contexts, replace_cause(fit.model, equivalent), ROUNDS),
        )
        for equivalent in equivalents
    )


def replace_cause(model: Model, equivalent: EquivalentCause) -> Model:
    """Return a model with a rival in the place of its cause."""
    effects = tuple(
        (equivalent.effect, equivalent.values)
        if effect.name == equivalent.replaces
        else (effect, values)
        for effect, values in model.effects
    )
    return model._replace(effects=effects)


# --- causes that explain the data equally well, and the choice among them


def choose_equivalent_cause(
    dataset: Dataset, base_fit: Fit, steps: list[CauseStep], fit: Fit, cause: str
) -> tuple[list[CauseStep], Fit]:
    """Return the causes with one of equally good ones in the place of the first of them."""
    if cause in [step.effect.name for step in steps]:
        return steps, fit
    equivalents = {
        equivalent.effect.name: equivalent for equivalent in find_equivalent_causes(steps)
    }
    if cause not in equivalents:
        raise _build_cause_error(cause, [*(step.effect.name for step in steps), *equivalents])
    chosen = equivalents[cause]
    fit = fit_model(
        rescale_residuals(dataset, fit),
        build_contexts(dataset, base_fit),
        replace_cause(fit.model, chosen),
        ROUNDS,
    )
    return [
        CauseStep(
            chosen.effect,
            (step.effect.name, *(name for name in step.rivals if name != cause)),
            step.ranking,
            fit,
        )
        if step.effect.name == chosen.replaces
        else step
        for step in steps
    ], fit


def _build_cause_error(cause: str, names: Sequence[str]) -> CauseError:
    if not names:
        return CauseError(f"{cause}: no cause was found in these data; leave it out")
    listed = ", ".join(dict.fromkeys(names))
    return CauseError(f"{cause}: does not explain these data equally well; choose from {listed}")


def find_equivalent_causes(steps: Sequence[CauseStep]) -> list[EquivalentCause]:
    """Return the effects that explain as much as the causes, each in its best variant."""
    causes = [step.effect.name for step in steps]
    equivalents = []
    for step in steps:
        for name in step.rivals:
            if name not in causes:
                ranked = next(candidate for candidate in step.ranking if candidate.name == name)
                equivalents.append(EquivalentCause(step.effect.name, ranked.effect, ranked.values))
    return equivalents
