"""The search for causes: one after the other, from another first one, on another base law."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.baseline import (
    Choice,
    choose_loads,
    refit_baseline,
    select_applicable_effects,
)
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    replace_records,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import ParameterLayout, fit_model
from estimator.diagnosis.hidden_motion import recover_motion_beside_effects
from estimator.diagnosis.intervals import estimate_intervals, is_significant
from estimator.diagnosis.outcome import CauseStep, RankedCandidate
from estimator.diagnosis.record import shorten_blocks
from estimator.diagnosis.score import (
    ChannelErrors,
    bootstrap_superiority,
    compute_bic_penalty,
    compute_errors,
    compute_gain,
    compute_log_likelihood_ratio,
    compute_residual_fraction,
    is_noise,
    is_within_tolerance,
)
from estimator.diagnosis.search import Candidate, fit_candidates
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, scale_progress
from estimator.effects.effect import Effect, EffectContext

# --- which candidate is the next cause, and which others the data do not distinguish from it


def find_next_cause(
    dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]
) -> CauseStep | None:
    """Return the cause that explains most, with those that cannot be told from it, if any does."""
    base = compute_errors(dataset, fit)
    order = sorted(found, key=lambda one: -score_candidate(dataset, base, one))
    if not order:
        return None
    best = select_simplest_cause(dataset, plain, base, order)
    if (
        score_candidate(dataset, base, best) < SETTINGS.margin
        or compute_gain(best.held_out, base) < SETTINGS.gain_min
        or bootstrap_superiority(best.held_out, base) < SETTINGS.confidence
    ):
        return None
    most = compute_residual_fraction(best.held_out, compute_errors(dataset, plain))
    rivals: list[str] = []
    for other in order:
        if other.effect.name in (best.effect.name, *rivals) or len(rivals) == SETTINGS.rivals_max:
            continue
        behind = score_candidate(dataset, base, best) - score_candidate(dataset, base, other)
        more = compute_residual_fraction(other.held_out, compute_errors(dataset, plain)) - most
        unsure = (
            bootstrap_superiority(best.held_out, other.held_out) < SETTINGS.confidence
            and more < SETTINGS.unsure_left
        )
        if behind < SETTINGS.alike or more < SETTINGS.alike_left or unsure:
            rivals.append(other.effect.name)
    return CauseStep(
        best.effect, tuple(rivals), rank_candidates(dataset, plain, fit, found), best.fit
    )


def select_simplest_cause(
    dataset: Dataset, plain: Fit, base: dict[str, ChannelErrors], order: list[Candidate]
) -> Candidate:
    """Return of the best causes, which are as good as each other, that of the fewest parameters.

    One with more can imitate another: an antagonist of hardly any friction is joint friction.
    """
    best, at_first = order[0], compute_errors(dataset, plain)
    most = compute_residual_fraction(best.held_out, at_first) + SETTINGS.alike_left
    least = score_candidate(dataset, base, best) - SETTINGS.alike
    alike = [
        one
        for one in order
        if score_candidate(dataset, base, one) > least
        and compute_residual_fraction(one.held_out, at_first) < most
    ]
    return min(alike, key=lambda one: len(one.effect.parameters))


def score_candidate(dataset: Dataset, base: dict[str, ChannelErrors], one: Candidate) -> float:
    """Return ln of how much more probable held-out data are, parameters paid for."""
    return compute_log_likelihood_ratio(one.held_out, base) - compute_bic_penalty(
        dataset, len(one.effect.parameters)
    )


def rank_candidates(
    dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]
) -> tuple[RankedCandidate, ...]:
    """Return the candidates of a search on top of a fit, the most probable first."""
    base, at_first = compute_errors(dataset, fit), compute_errors(dataset, plain)
    ranked = [
        RankedCandidate(
            one.effect,
            score_candidate(dataset, base, one),
            {c: e.rmse for c, e in one.held_out.items()},
            compute_residual_fraction(one.held_out, at_first),
            one.fit.model.effects[-1][1],
        )
        for one in found
    ]
    return tuple(sorted(ranked, key=lambda one: -one.score))


# --- which of the causes found one after the other are needed beside the later ones

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


# shares of the time between which each search for a cause runs
SEARCH_PROGRESS = 0.1, 0.4, 0.55, 0.65
SAME_COST_TOLERANCE = 0.01  # of a cost: an effect that does the same leads nowhere else
RESIDUAL_FRACTION_MAX = 0.5  # of the error beyond noise, to which hidden motion must lower it
RESTART_PROGRESS = 0.9  # share at which a search that begins with another cause is done


class CauseSearchResult(NamedTuple):
    """Causes, and what they were found from."""

    loads: Choice
    dataset: Dataset
    plain: Fit  # the base law
    firsts: list[Candidate]  # of the first search
    steps: list[CauseStep]
    fit: Fit  # of the base law with the causes


def find_causes(
    laws: Sequence[Choice],
    effects: Sequence[Effect],
    *,
    fit_all: bool,
    report: ProgressCallback,
    workers: int,
) -> tuple[CauseSearchResult, Choice]:
    """Return the causes of what a base law leaves, and which of the base laws that is.

    A law may have been chosen because it imitates a cause. So those after the first are tried while
    more than noise is left, and the one stays with which most is explained.
    """
    tried: list[tuple[CauseSearchResult, Choice]] = []
    for law in laws:
        loads = choose_loads(law.dataset, law.fit)
        dataset, plain = loads.dataset, loads.fit
        if not fit_all and _is_brief(dataset, plain):
            dataset = replace_records(dataset, [shorten_blocks(one) for one in dataset.records])
            plain = refit_baseline(dataset, plain)
        plain = refit_baseline(
            rescale_residuals(dataset, plain), plain
        )  # weighed as its rivals will be
        tried.append((_find_causes_stepwise(loads, dataset, plain, effects, report, workers), law))
        if _is_explained(tried[-1][0]):
            break
    found, law = max(tried, key=lambda one: _compute_evidence(one[0], tried[0][0]))
    if not _is_explained(found) and (moved := _recover_motion_beside_cause(found)) is not None:
        found = _find_causes_stepwise(found.loads, *moved, effects, report, workers)
    if not _is_explained(found):
        found = _restart_from_other_cause(
            found, effects, scale_progress(report, SEARCH_PROGRESS[-1], RESTART_PROGRESS), workers
        )
    return found, law


def _recover_motion_beside_cause(found: CauseSearchResult) -> tuple[Dataset, Fit] | None:
    """Return records with the hidden motion that shows beside a cause, and the base law's fit.

    A cause hides it from the base law. None where with it no more is explained.
    """
    dataset = found.dataset
    best = min(found.firsts, key=lambda one: one.cost, default=None)
    fit = found.fit if found.steps or best is None else best.fit
    about = build_contexts(dataset, found.plain)
    most = fit_model(dataset, about, fit.model, FINAL_ROUNDS, robust=True).model
    records = [
        recover_motion_beside_effects(record, context, dataset.base, most.shared, own, most.effects)
        for record, context, own in zip(dataset.records, about, most.own, strict=True)
    ]
    if all(new is old for new, old in zip(records, dataset.records, strict=True)):
        return None
    moved = replace_records(dataset, records)
    plain = refit_baseline(moved, found.plain)
    then = fit_model(
        rescale_residuals(moved, fit), build_contexts(moved, plain), most, FINAL_ROUNDS
    )
    if (
        compute_residual_fraction(compute_errors(moved, then), compute_errors(dataset, fit))
        > RESIDUAL_FRACTION_MAX
    ):
        return None
    return rescale_residuals(moved, plain), plain


def _is_explained(found: CauseSearchResult) -> bool:
    return is_noise(found.dataset, compute_errors(found.dataset, found.fit))


def _compute_evidence(a: CauseSearchResult, b: CauseSearchResult) -> float:
    """Return ln of how much more probable held-out data are by `a` than by `b`, numbers paid for.

    What is needed to choose `a` before `b` is taken off.
    """
    if a is b:
        return 0.0
    ratio = compute_log_likelihood_ratio(
        compute_errors(a.dataset, a.fit), compute_errors(b.dataset, b.fit)
    )
    more = len(ParameterLayout(a.dataset, a.fit.model).names) - len(
        ParameterLayout(b.dataset, b.fit.model).names
    )
    return ratio - compute_bic_penalty(a.dataset, more) - SETTINGS.alike


def _find_causes_stepwise(
    loads: Choice,
    dataset: Dataset,
    plain: Fit,
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int,
) -> CauseSearchResult:
    """Return the causes of what the base law leaves, searched one after the other."""
    usable = select_applicable_effects(effects, dataset.records[0], dataset.base)
    fit, steps, firsts = plain, list[CauseStep](), list[Candidate]()
    for begin, end in itertools.pairwise(SEARCH_PROGRESS):
        if is_noise(dataset, compute_errors(dataset, fit)) or (
            steps and _is_exhausted(dataset, fit, plain)
        ):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        found = fit_candidates(dataset, fit, rest, scale_progress(report, begin, end), workers)
        step = find_next_cause(dataset, plain, fit, found)
        if step is not None and not steps:
            less = refit_without_effect(dataset, step.fit, step.effect)
            if score_effect(dataset, step.fit, less, step.effect) < SETTINGS.margin:
                plain = fit = less  # the previous fit was a local minimum
                continue
        firsts = firsts or found
        if step is None:
            two = _find_cause_pair(
                dataset,
                plain,
                fit,
                found,
                rest,
                scale_progress(report, end, SEARCH_PROGRESS[-1]),
                workers,
            )
            steps, fit = [*steps, *two], two[-1].fit if two else fit
            break
        steps.append(step)
        fit = step.fit
    return CauseSearchResult(
        loads, dataset, plain, firsts, *prune_causes(dataset, plain, steps, fit)
    )


def _restart_from_other_cause(
    found: CauseSearchResult, effects: Sequence[Effect], report: ProgressCallback, workers: int
) -> CauseSearchResult:
    """Return better causes of which another is the first, if there are any.

    The effect that explains most alone is not always one of those that together explain all: plays
    of many thresholds imitate the gain of a load cell, badly.
    """
    dataset, plain = found.dataset, found.plain
    usable = select_applicable_effects(effects, dataset.records[0], dataset.base)
    names = {step.effect.name for step in found.steps[:1]}
    first = min(
        (one for one in found.firsts if one.effect.name in names or not names),
        key=lambda one: one.cost,
        default=None,
    )
    others = [
        one
        for one in found.firsts
        if first is not None
        and one.effect.name != first.effect.name
        and abs(one.cost / first.cost - 1.0) > SAME_COST_TOLERANCE
    ]
    if not others:
        return found
    base = compute_errors(dataset, plain)
    lead = max(others, key=lambda one: score_candidate(dataset, base, one))
    order = rank_candidates(dataset, plain, plain, found.firsts)
    steps, fit = [CauseStep(lead.effect, (), order, lead.fit)], lead.fit
    for share in (0.0, 0.5):
        if is_noise(dataset, compute_errors(dataset, fit)) or _is_exhausted(dataset, fit, plain):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        more = fit_candidates(
            dataset, fit, rest, scale_progress(report, share, share + 0.5), workers
        )
        step = find_next_cause(dataset, plain, fit, more)
        if step is None:
            break
        steps.append(step)
        fit = step.fit
    steps, fit = prune_causes(dataset, plain, steps, fit)
    other = found._replace(steps=steps, fit=fit)
    sure = found.steps or is_within_tolerance(
        dataset, compute_errors(dataset, fit), SETTINGS.further
    )  # see `_find_cause_pair`
    return other if len(steps) > 1 and sure and _compute_evidence(other, found) > 0.0 else found


def _find_cause_pair(
    dataset: Dataset,
    plain: Fit,
    fit: Fit,
    found: Sequence[Candidate],
    rest: Sequence[Effect],
    report: ProgressCallback,
    workers: int,
) -> list[CauseStep]:
    """Return two causes, none of which is worth it alone, if together they leave only noise.

    One of two can make a quiet channel worse while it takes most away from a loud one. It must fit
    far better than any other, since nothing else speaks for it yet.
    """
    ahead = sorted(found, key=lambda one: one.cost)
    others = [one.cost for one in ahead if one.effect.name != ahead[0].effect.name] if ahead else []
    if not others or ahead[0].cost * SETTINGS.ahead > min(others):
        return []
    lead = ahead[0]
    rest = [effect for effect in rest if effect.name != lead.effect.name]
    more = fit_candidates(dataset, lead.fit, rest, report, workers)
    second = find_next_cause(dataset, plain, lead.fit, more)
    if second is None or not is_within_tolerance(
        dataset, compute_errors(dataset, second.fit), SETTINGS.further
    ):
        return []
    return [
        CauseStep(lead.effect, (), rank_candidates(dataset, plain, fit, list(found)), lead.fit),
        second,
    ]


def _is_exhausted(dataset: Dataset, fit: Fit, plain: Fit) -> bool:
    """Return whether too little is left for another cause to be told from model error."""
    found = compute_errors(dataset, fit)
    if compute_residual_fraction(found, compute_errors(dataset, plain)) < SETTINGS.left_min:
        return True
    return is_within_tolerance(dataset, found, SETTINGS.further)


def _is_brief(dataset: Dataset, plain: Fit) -> bool:
    """Return whether what is wrong is nearly all in one block, or in two side by side."""
    most = total = 0.0
    for record, one in zip(dataset.records, plain.simulated, strict=True):
        excess = np.zeros(record.block[-1] + 1)
        for channel in record.compared:
            good = record.good[channel]
            off = (one.signals[channel] - record.signals[channel])[good] / record.sigma[channel][
                good
            ]
            excess += np.bincount(record.block[good], off**2 - 1.0, len(excess))
        excess = np.maximum(excess, 0.0)
        most = max(most, float(np.convolve(excess, np.ones(2)).max()))
        total += float(excess.sum())
    return most > SETTINGS.brief * total
