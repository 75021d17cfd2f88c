"""Backward elimination: causes that a model does not need, once all are in it."""

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled, whole
from estimator.diagnosis.decision import score_beside
from estimator.diagnosis.fit import improved
from estimator.diagnosis.intervals import Named, parameters
from estimator.diagnosis.outcome import Step
from estimator.diagnosis.score import errors, left_of
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect

ROUNDS = 12  # of a fit without an effect, or to all samples


def explaining(dataset: Dataset, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without last ones that explain little of what those before them leave.

    Where a cause is modelled a little wrongly, another can imitate a part of what that leaves.
    """
    while len(steps) > 1:
        left = left_of(errors(dataset, steps[-1].fit), errors(dataset, steps[-2].fit))
        if left <= SETTINGS.further_left:
            break
        steps = steps[:-1]
        fit = steps[-1].fit
    return steps, fit


def needed(dataset: Dataset, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those that later ones have made needless, and the fit of them."""
    for step in steps[:-1] if len(steps) > 1 else ():
        other = fit_without(dataset, fit, step.effect)
        if score_beside(dataset, fit, other, step.effect) < SETTINGS.margin:
            steps = [one for one in steps if one is not step]
            fit = other
    return steps, fit


def distinct(dataset: Dataset, plain: Fit, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those whose size may be none, and the fit of them."""
    while steps:
        full = rescaled(whole(dataset), fit)
        last = improved(full, contexts(dataset, plain), fit.model, ROUNDS)
        found = {one.name: one for one in parameters(full, contexts(dataset, plain), last)}

        def is_distinct(step: Step, found: dict[str, Named] = found) -> bool:
            sizes = [p for p in step.effect.parameters if p.neutral is not None and not p.jumps]
            named = [found[f"{step.effect.name}.{p.name}"] for p in sizes]
            if len(named) > 1:  # which trade against each other, as a sine and a cosine
                return any(one.is_significant for one in named)
            return not named or named[0].excludes_neutral

        needless = [step for step in steps if not is_distinct(step)]
        if not needless:
            break
        steps = [step for step in steps if step is not needless[-1]]
        fit = fit_without(dataset, fit, needless[-1].effect)
    return steps, fit


def fit_without(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model without one of its effects, fitted from where it was with it."""
    rest = tuple(one for one in fit.model.effects if one[0].name != effect.name)
    model = fit.model._replace(effects=rest)
    return improved(rescaled(dataset, fit), contexts(dataset, fit), model, ROUNDS)
