"""Which of the causes found one after the other are needed beside the later ones."""

from collections.abc import Sequence

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled, whole
from estimator.diagnosis.fit import improved
from estimator.diagnosis.intervals import are_less_probable, parameters
from estimator.diagnosis.outcome import Step
from estimator.diagnosis.score import bic_penalty, errors, log_likelihood_ratio
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect, EffectContext

LAST = 12  # rounds of the fit to all samples


def needed(dataset: Dataset, plain: Fit, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes that are needed and have a size, and the fit of them."""
    return _distinct(dataset, plain, *_without_needless(dataset, steps, fit))


def _without_needless(dataset: Dataset, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those that later ones have made needless, and the fit of them."""
    for step in steps[:-1] if len(steps) > 1 else ():
        less = without(dataset, fit, step.effect)
        if matters(dataset, fit, less, step.effect) < SETTINGS.margin:
            steps = [one for one in steps if one is not step]
            fit = less
    return steps, fit


def _distinct(dataset: Dataset, plain: Fit, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those whose size may be none, and the fit of them."""
    about = contexts(dataset, plain)
    while steps:
        full = rescaled(whole(dataset), fit)
        last = improved(full, about, fit.model, LAST)
        needless = [step for step in steps if not _has_size(full, about, last, step.effect)]
        if not needless:
            break
        steps = [step for step in steps if step is not needless[-1]]
        fit = without(dataset, fit, needless[-1].effect)
    return steps, fit


def _has_size(full: Dataset, about: Sequence[EffectContext], fit: Fit, effect: Effect) -> bool:
    """Return whether an effect of a model has a size other than none."""
    sizes = [p for p in effect.parameters if p.neutral is not None and not p.jumps]
    if len(sizes) > 1:
        return are_less_probable(full, fit, without(full, fit, effect))
    named = {one.name: one for one in parameters(full, about, fit)}
    return all(named[f"{effect.name}.{p.name}"].excludes_neutral for p in sizes)


def without(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model without one of its effects, fitted from where it was with it."""
    rest = tuple(one for one in fit.model.effects if one[0].name != effect.name)
    model = fit.model._replace(effects=rest)
    return improved(rescaled(dataset, fit), contexts(dataset, fit), model, LAST)


def matters(dataset: Dataset, fit: Fit, less: Fit, effect: Effect) -> float:
    """Return ln of how much more probable held-out data are with an effect, parameters paid for."""
    ratio = log_likelihood_ratio(errors(dataset, fit), errors(dataset, less))
    return ratio - bic_penalty(dataset, len(effect.parameters))
