"""Which of the causes found one after the other are needed beside the later ones."""

from collections.abc import Sequence

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.intervals import estimate_intervals, is_significant
from estimator.diagnosis.outcome import CauseStep
from estimator.diagnosis.score import (
    compute_bic_penalty,
    compute_errors,
    compute_log_likelihood_ratio,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect, EffectContext

FINAL_ROUNDS = 12  # rounds of the fit to all samples


def prune_causes(
    dataset: Dataset, plain: Fit, steps: list[CauseStep], fit: Fit
) -> tuple[list[CauseStep], Fit]:
    """Return the causes that are needed and have a size, and the fit of them."""
    return _prune_insignificant_causes(
        dataset, plain, *_prune_redundant_causes(dataset, steps, fit)
    )


def _prune_redundant_causes(
    dataset: Dataset, steps: list[CauseStep], fit: Fit
) -> tuple[list[CauseStep], Fit]:
    """Return the causes without those that later ones have made needless, and the fit of them."""
    for step in steps[:-1] if len(steps) > 1 else ():
        less = refit_without_effect(dataset, fit, step.effect)
        if score_effect(dataset, fit, less, step.effect) < SETTINGS.margin:
            steps = [one for one in steps if one is not step]
            fit = less
    return steps, fit


def _prune_insignificant_causes(
    dataset: Dataset, plain: Fit, steps: list[CauseStep], fit: Fit
) -> tuple[list[CauseStep], Fit]:
    """Return the causes without those whose size may be none, and the fit of them."""
    about = build_contexts(dataset, plain)
    while steps:
        full = rescale_residuals(use_all_samples(dataset), fit)
        last = fit_model(full, about, fit.model, FINAL_ROUNDS)
        needless = [step for step in steps if not _has_size(full, about, last, step.effect)]
        if not needless:
            break
        steps = [step for step in steps if step is not needless[-1]]
        fit = refit_without_effect(dataset, fit, needless[-1].effect)
    return steps, fit


def _has_size(full: Dataset, about: Sequence[EffectContext], fit: Fit, effect: Effect) -> bool:
    """Return whether an effect of a model has a size other than none."""
    sizes = [p for p in effect.parameters if p.neutral is not None and not p.jumps]
    if len(sizes) > 1:
        return is_significant(full, fit, refit_without_effect(full, fit, effect))
    named = {one.name: one for one in estimate_intervals(full, about, fit)}
    return all(named[f"{effect.name}.{p.name}"].excludes_neutral for p in sizes)


def refit_without_effect(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model without one of its effects, fitted from where it was with it."""
    rest = tuple(one for one in fit.model.effects if one[0].name != effect.name)
    model = fit.model._replace(effects=rest)
    return fit_model(
        rescale_residuals(dataset, fit), build_contexts(dataset, fit), model, FINAL_ROUNDS
    )


def score_effect(dataset: Dataset, fit: Fit, less: Fit, effect: Effect) -> float:
    """Return ln of how much more probable held-out data are with an effect, parameters paid for."""
    ratio = compute_log_likelihood_ratio(
        compute_errors(dataset, fit), compute_errors(dataset, less)
    )
    return ratio - compute_bic_penalty(dataset, len(effect.parameters))
