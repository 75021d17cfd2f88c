"""Stepwise search for causes, restarted from another first cause and on another base law."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from estimator.diagnosis.baseline import choose_loads, select_applicable_effects
from estimator.diagnosis.cause_selection import find_next_cause, rank_candidates
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    replace_records,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.file_causes import confine_effects, find_odd_file
from estimator.diagnosis.fit import fit_model, refit_baseline
from estimator.diagnosis.function_search import fit_functions
from estimator.diagnosis.hidden_motion import may_hide_motion, recover_motion_beside_effects
from estimator.diagnosis.intervals import estimate_intervals, is_significant
from estimator.diagnosis.outcome import CauseStep
from estimator.diagnosis.record import hold_out_aperiodically, shorten_blocks
from estimator.diagnosis.scoring import (
    ChannelErrors,
    Choice,
    compute_bic_penalty,
    compute_errors,
    compute_log_likelihood_ratio,
    compute_missed_share,
    compute_residual_fraction,
    has_localised_misfit,
    is_foreign_data,
    is_noise,
    is_within_tolerance,
)
from estimator.diagnosis.screening import Candidate, fit_candidates, score_candidate
from estimator.diagnosis.settings import (
    SETTINGS,
    ProgressCallback,
    TimeBudget,
    ignore_progress,
    scale_progress,
)
from estimator.effects import NAMES
from estimator.effects.effect import Effect, EffectContext
from estimator.effects.functions import build_functions

FINAL_ROUNDS = 12  # rounds of the fit to all samples
# shares of the time in which each cause of a stepwise search is looked for
SEARCH_ROUNDS = (0.1, 0.4), (0.4, 0.55), (0.55, 0.65)
FUNCTION_PROGRESS = SEARCH_ROUNDS[-1][1], 0.775  # the same of a free function
RESTART_PROGRESS = 0.9  # share of the time at which the search from another first cause ends
RESTART_ROUNDS = (0.0, 0.5), (0.5, 1.0)  # shares of that search in which further causes are
SAME_COST_TOLERANCE = 0.01  # relative: effects whose costs differ by less do the same
RESIDUAL_FRACTION_MAX = 0.5  # share of the error beyond noise that hidden motion may leave
FUNCTION_SEARCHES = 1  # that further causes leave time for: a function says more
RESTART_SEARCHES = 1  # the same of a search from another first cause: it may take twice as long

# --- causes that later causes make redundant, or whose size may be zero


def _prune_redundant_causes(
    dataset: Dataset, steps: list[CauseStep], fit: Fit
) -> tuple[list[CauseStep], Fit]:
    """Return the causes without those that later ones make redundant, and their fit."""
    for step in steps[:-1] if len(steps) > 1 else ():
        fit_without = refit_without_effect(dataset, fit, step.effect)
        if score_effect(dataset, fit, fit_without, step.effect) < SETTINGS.score_min:
            steps = [other_step for other_step in steps if other_step is not step]
            fit = fit_without
    return steps, fit


def _prune_insignificant_causes(
    dataset: Dataset, base_fit: Fit, steps: list[CauseStep], fit: Fit
) -> tuple[list[CauseStep], Fit]:
    """Return the causes without those whose size may be zero, and their fit."""
    contexts = build_contexts(dataset, base_fit)
    while steps:
        full_dataset = rescale_residuals(use_all_samples(dataset), fit)
        final_fit = fit_model(full_dataset, contexts, fit.model, FINAL_ROUNDS)
        insignificant = [
            step for step in steps if not _has_size(full_dataset, contexts, final_fit, step.effect)
        ]
        if not insignificant:
            break
        steps = [step for step in steps if step is not insignificant[-1]]
        fit = refit_without_effect(dataset, fit, insignificant[-1].effect)
    return steps, fit


def _has_size(
    full_dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit, effect: Effect
) -> bool:
    """Return whether the size of an effect of a model differs from zero significantly."""
    sizes = [p for p in effect.parameters if p.neutral is not None and not p.jumps]
    if len(sizes) > 1:
        return is_significant(full_dataset, fit, refit_without_effect(full_dataset, fit, effect))
    intervals = {
        interval.name: interval for interval in estimate_intervals(full_dataset, contexts, fit)
    }
    return all(intervals[f"{effect.name}.{p.name}"].excludes_neutral for p in sizes)


def refit_without_effect(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return the fit without one effect, started from the parameters of `fit`."""
    other_effects = tuple(pair for pair in fit.model.effects if pair[0].name != effect.name)
    model = fit.model._replace(effects=other_effects)
    return fit_model(
        rescale_residuals(dataset, fit), build_contexts(dataset, fit), model, FINAL_ROUNDS
    )


def score_effect(dataset: Dataset, fit: Fit, fit_without: Fit, effect: Effect) -> float:
    """Return the log-likelihood ratio of `fit` to `fit_without`, less the effect's BIC penalty."""
    ratio = compute_log_likelihood_ratio(
        compute_errors(dataset, fit), compute_errors(dataset, fit_without)
    )
    return ratio - compute_bic_penalty(dataset, effect.degrees)


# --- the search


class CauseSearch(NamedTuple):
    """What a search for causes may try, and how."""

    effects: Sequence[Effect]
    budget: TimeBudget  # no stage begins that it has no time for
    report: ProgressCallback = ignore_progress
    workers: int = 1

    def report_between(self, begin: float, end: float) -> "CauseSearch":
        """Return the same search as a part of this one, from share `begin` of its time to `end`."""
        return self._replace(report=scale_progress(self.report, begin, end))


class CauseSearchResult(NamedTuple):
    """The causes, and the data and fits of the search."""

    loads: Choice
    dataset: Dataset
    base_fit: Fit  # the base law
    first_candidates: list[Candidate]  # of the first search
    steps: list[CauseStep]
    fit: Fit  # of the base law with the causes

    @property
    def errors(self) -> dict[str, ChannelErrors]:
        """Held-out errors of the base law with the causes."""
        return compute_errors(self.dataset, self.fit)

    @property
    def base_errors(self) -> dict[str, ChannelErrors]:
        """Held-out errors of the base law."""
        return compute_errors(self.dataset, self.base_fit)

    def add_step(self, step: CauseStep) -> "CauseSearchResult":
        """Return the result with one cause more."""
        return self._replace(steps=[*self.steps, step], fit=step.fit)


def find_causes(
    laws: Sequence[Choice], search: CauseSearch, *, fit_all: bool
) -> tuple[CauseSearchResult, Choice]:
    """Return the causes of the residual of a base law, and the base law.

    Each stage runs while a residual beyond noise remains, and returns what explains more; after
    the first, none if the data are of no tendon. What no named cause explains is searched for a
    free function, and unless that explains nearly all, from another first cause.
    """
    result, law = _search_on_each_law(laws, search, fit_all)
    if _is_foreign(result):
        return result, law
    result = _search_with_recovered_motion(result, search)
    result = _search_in_odd_file(result, search)
    if _is_explained(result):
        return result, law
    with_function = _find_function(result, search.report_between(*FUNCTION_PROGRESS))
    if with_function is None or _compute_fraction(with_function) > SETTINGS.uncertain_fraction_max:
        restart = search.report_between(FUNCTION_PROGRESS[1], RESTART_PROGRESS)
        result = _restart_from_other_cause(result, restart)
    if with_function is not None and _is_function_better(with_function, result):
        result = with_function
    return result, law


# --- on each law, with hidden motion, in one file


def _search_on_each_law(
    laws: Sequence[Choice], search: CauseSearch, fit_all: bool
) -> tuple[CauseSearchResult, Choice]:
    """Return the causes found on the law with which most is explained, and that law.

    The best law may have been chosen because it imitates a cause.
    """
    attempts: list[tuple[CauseSearchResult, Choice]] = []
    for law in laws:
        if attempts and not search.budget.has_time("another base law", FUNCTION_SEARCHES):
            break
        attempts.append((_search_on_law(law, search, fit_all), law))
        if _is_explained(attempts[-1][0]):
            break
    return max(attempts, key=lambda attempt: _compute_evidence(attempt[0], attempts[0][0]))


def _search_on_law(law: Choice, search: CauseSearch, fit_all: bool) -> CauseSearchResult:
    """Return the causes found on a law, with the loads at the tip that suit it best."""
    loads = choose_loads(law.dataset, law.fit)
    dataset, base_fit = loads.dataset, loads.fit
    if not fit_all and has_localised_misfit(dataset, base_fit):
        dataset = replace_records(dataset, [shorten_blocks(record) for record in dataset.records])
        base_fit = refit_baseline(dataset, base_fit)
    # with the weights that the candidates will have
    base_fit = refit_baseline(rescale_residuals(dataset, base_fit), base_fit)
    return _find_causes_stepwise(loads, dataset, base_fit, search)


def _search_with_recovered_motion(
    result: CauseSearchResult, search: CauseSearch
) -> CauseSearchResult:
    """Return the causes found with hidden motion that a cause had masked, if they are better."""
    if _is_explained(result) or (recovered := _recover_motion_beside_cause(result)) is None:
        return result
    if not search.budget.has_time("motion that a cause hides"):
        return result
    moved = _find_causes_stepwise(result.loads, *recovered, search)
    return moved if _compute_evidence(moved, result) > 0.0 else result


def _search_in_odd_file(result: CauseSearchResult, search: CauseSearch) -> CauseSearchResult:
    """Return the causes found in the one file that differs from the others, if there is one."""
    if _is_explained(result):
        return result
    file = find_odd_file(result.dataset, result.base_fit, result.fit)
    if not file or not search.budget.has_time("a cause in one file"):
        return result
    effects = [*confine_effects(search.effects, file), *(search.effects if result.steps else ())]
    in_file = _find_causes_stepwise(
        result.loads, result.dataset, result.base_fit, search._replace(effects=effects)
    )
    return in_file if _compute_evidence(in_file, result) >= 0.0 else result


def _recover_motion_beside_cause(result: CauseSearchResult) -> tuple[Dataset, Fit] | None:
    """Return the dataset with the hidden motion that a cause had masked, and the base law's fit.

    None if this motion does not explain more.
    """
    dataset = result.dataset
    if not any(map(may_hide_motion, dataset.records)):
        return None
    best = min(result.first_candidates, key=lambda candidate: candidate.cost, default=None)
    fit = result.fit if result.steps or best is None else best.fit
    contexts = build_contexts(dataset, result.base_fit)
    robust_model = fit_model(dataset, contexts, fit.model, FINAL_ROUNDS, robust=True).model
    records = [
        recover_motion_beside_effects(
            record, context, dataset.base, robust_model.shared, own, robust_model.effects
        )
        for record, context, own in zip(dataset.records, contexts, robust_model.own, strict=True)
    ]
    if all(new is old for new, old in zip(records, dataset.records, strict=True)):
        return None
    moved_dataset = replace_records(dataset, records)
    base_fit = refit_baseline(moved_dataset, result.base_fit)
    refit = fit_model(
        rescale_residuals(moved_dataset, fit),
        build_contexts(moved_dataset, base_fit),
        robust_model,
        FINAL_ROUNDS,
    )
    fraction = compute_residual_fraction(
        compute_errors(moved_dataset, refit), compute_errors(dataset, fit)
    )
    if fraction > RESIDUAL_FRACTION_MAX:
        return None
    return rescale_residuals(moved_dataset, base_fit), base_fit


# --- causes one after the other, or two at once


def _find_causes_stepwise(
    loads: Choice, dataset: Dataset, base_fit: Fit, search: CauseSearch
) -> CauseSearchResult:
    """Return the causes of the residual of the base law, searched one after the other."""
    result = CauseSearchResult(loads, dataset, base_fit, [], [], base_fit)
    for begin, end in SEARCH_ROUNDS:
        if _is_explained(result) or (result.steps and _is_within_model_error(result)):
            break
        if result.first_candidates and not search.budget.has_time(
            "further causes", FUNCTION_SEARCHES
        ):
            break
        candidates = _fit_next_candidates(result, search.report_between(begin, end))
        with_candidates = result._replace(first_candidates=result.first_candidates or candidates)
        if is_foreign_data(dataset, (result.base_errors, *_get_errors(candidates))):
            result = with_candidates
            break
        step = find_next_cause(dataset, result.base_fit, result.fit, candidates)
        if step is not None and not result.steps:
            fit_without = refit_without_effect(dataset, step.fit, step.effect)
            if score_effect(dataset, step.fit, fit_without, step.effect) < SETTINGS.score_min:
                # the previous fit was a local minimum
                result = result._replace(base_fit=fit_without, fit=fit_without)
                continue
        result = with_candidates
        if step is None:
            if search.budget.has_time("pairs of causes", FUNCTION_SEARCHES):
                pair_search = search.report_between(end, SEARCH_ROUNDS[-1][1])
                for step in _find_cause_pair(result, candidates, pair_search):
                    result = result.add_step(step)
            break
        result = result.add_step(step)
    return _prune_result(result)


def _fit_next_candidates(
    result: CauseSearchResult, search: CauseSearch, tolerance_ratio_max: float = math.inf
) -> list[Candidate]:
    """Return the models with one cause more, fitted, the lowest cost first."""
    dataset, fit = result.dataset, result.fit
    applicable = select_applicable_effects(search.effects, dataset.records[0], dataset.base)
    untried = [effect for effect in applicable if effect.name not in fit.names]
    return fit_candidates(
        dataset, fit, untried, search.report, search.workers,
        tolerance_ratio_max=tolerance_ratio_max,
    )  # fmt: skip


def _prune_result(result: CauseSearchResult) -> CauseSearchResult:
    """Return a result with the causes that are neither redundant nor insignificant."""
    needed = _prune_redundant_causes(result.dataset, result.steps, result.fit)
    steps, fit = _prune_insignificant_causes(result.dataset, result.base_fit, *needed)
    return result._replace(steps=steps, fit=fit)


def _find_cause_pair(
    result: CauseSearchResult, candidates: list[Candidate], search: CauseSearch
) -> list[CauseStep]:
    """Return two causes, neither significant alone, if together they leave only noise.

    The first of the two may increase the error of a channel of little noise while it removes most
    of another's. It must fit far better than any other, as this is the only evidence for it yet.
    """
    dataset, base_fit = result.dataset, result.base_fit
    if not candidates:
        return []
    lead = min(candidates, key=lambda candidate: candidate.cost)
    other_costs = [
        candidate.cost for candidate in candidates if candidate.effect.name != lead.effect.name
    ]
    if not other_costs or lead.cost * SETTINGS.lead_cost_ratio > min(other_costs):
        return []
    ranking = rank_candidates(dataset, base_fit, result.fit, candidates)
    lead_step = CauseStep(lead.effect, (), ranking, lead.fit)
    second_candidates = _fit_next_candidates(
        result.add_step(lead_step), search, SETTINGS.tolerance_ratio_max
    )
    second_step = find_next_cause(dataset, base_fit, lead.fit, second_candidates)
    if second_step is None or not is_within_tolerance(
        dataset, compute_errors(dataset, second_step.fit), SETTINGS.tolerance_ratio_max
    ):
        return []
    return [lead_step, second_step]


# --- from another first cause


def _restart_from_other_cause(result: CauseSearchResult, search: CauseSearch) -> CauseSearchResult:
    """Return the result of a search from another first cause if it is better, else `result`."""
    dataset, base_fit = result.dataset, result.base_fit
    if (other := _choose_other_first_cause(result)) is None:
        return result
    ranking = rank_candidates(dataset, base_fit, base_fit, result.first_candidates)
    first_step = CauseStep(other.effect, (), ranking, other.fit)
    restarted = result._replace(steps=[]).add_step(first_step)
    for begin, end in RESTART_ROUNDS:
        if _is_explained(restarted) or _is_within_model_error(restarted):
            break
        if not search.budget.has_time("other first causes", RESTART_SEARCHES):
            break
        candidates = _fit_next_candidates(restarted, search.report_between(begin, end))
        step = find_next_cause(dataset, base_fit, restarted.fit, candidates)
        if step is None:
            break
        restarted = restarted.add_step(step)
    restarted = _prune_result(restarted)
    # see `_find_cause_pair`
    is_accepted = result.steps or is_within_tolerance(
        dataset, restarted.errors, SETTINGS.tolerance_ratio_max
    )
    is_better = (len(restarted.steps) > 1 or _is_explained(restarted)) and is_accepted
    return restarted if is_better and _compute_evidence(restarted, result) > 0.0 else result


def _choose_other_first_cause(result: CauseSearchResult) -> Candidate | None:
    """Return the candidate that explains most beside the first cause; None if there is no other.

    The effect that explains most by itself need not be among those that together explain all:
    plays of many thresholds imitate the gain of a load cell, badly.
    """
    candidates = result.first_candidates
    if result.steps:
        cause = result.steps[0].effect.name
        candidates = [candidate for candidate in candidates if candidate.effect.name == cause]
    if not candidates:
        return None
    first = min(candidates, key=lambda candidate: candidate.cost)
    alternatives = [
        candidate
        for candidate in result.first_candidates
        if candidate.effect.name != first.effect.name
        and abs(candidate.cost / first.cost - 1.0) > SAME_COST_TOLERANCE
    ]
    base_errors = result.base_errors
    return max(
        alternatives,
        key=lambda candidate: score_candidate(result.dataset, base_errors, candidate),
        default=None,
    )


# --- a free function


def _find_function(result: CauseSearchResult, search: CauseSearch) -> CauseSearchResult | None:
    """Return the free function that explains most, on the base law or beside the named causes.

    None where it could only follow what the model itself is off: beside causes that leave no more
    than that, or on a law that makes hardly anything of the data, as of any periodic record.
    """
    if (result.steps and _is_within_model_error(result)) or not _has_law(result):
        return None
    columns = result.dataset.records[0].variables
    is_complete = set(NAMES) <= {effect.name for effect in search.effects}
    functions = [effect for effect in search.effects if effect.function is not None]
    functions = list(build_functions(columns)) if is_complete else functions
    cycles = [effect for effect in functions if effect.function and effect.function.is_periodic]
    others = [effect for effect in functions if effect not in cycles]
    best: CauseSearchResult | None = None
    base = result._replace(steps=[], fit=result.base_fit)
    for start in (base, *([result] if result.steps else [])) if functions else ():
        begin = _hold_out_aperiodically(start)
        for group, what in ((others, "free functions"), (cycles, "cycles")):
            # beside a named cause, or a function, it could only follow what the model itself is off
            if best is not None and _is_within_model_error(best):
                return best
            place = f" beside {start.steps[0].effect.name}" if start.steps else ""
            if not group or not search.budget.has_time(f"{what}{place}"):
                continue
            candidates = fit_functions(
                begin.dataset, begin.fit, group, search.report, search.workers
            )
            step = find_next_cause(begin.dataset, begin.base_fit, begin.fit, candidates)
            if step is None:
                continue
            extended = begin.add_step(step)
            if best is None or _compute_evidence(extended, best) > SETTINGS.score_min:
                best = extended
    return best


def _hold_out_aperiodically(result: CauseSearchResult) -> CauseSearchResult:
    """Return a result with other halves of its records, and refitted to them."""
    records = tuple(map(hold_out_aperiodically, result.dataset.records))
    dataset = result.dataset._replace(records=records)
    base_fit = refit_baseline(rescale_residuals(dataset, result.base_fit), result.base_fit)
    if not result.steps:
        return result._replace(dataset=dataset, base_fit=base_fit, fit=base_fit)
    contexts, weighted = build_contexts(dataset, base_fit), rescale_residuals(dataset, result.fit)
    fit = fit_model(weighted, contexts, result.fit.model, FINAL_ROUNDS)
    return result._replace(dataset=dataset, base_fit=base_fit, fit=fit)


def _is_function_better(with_function: CauseSearchResult, named: CauseSearchResult) -> bool:
    """Return whether a free function explains what named causes do not; as good, they are named."""
    if _is_explained(named):
        return False
    fraction = compute_residual_fraction(with_function.errors, named.errors)
    if fraction < SETTINGS.free_function_fraction:
        return True
    is_unexplained = not named.steps or _compute_fraction(named) > SETTINGS.unexplained_fraction_max
    return is_unexplained and _compute_evidence(with_function, named) > 0.0


# --- what a result explains


def _is_explained(result: CauseSearchResult) -> bool:
    return is_noise(result.dataset, result.errors)


def _is_foreign(result: CauseSearchResult) -> bool:
    """Return whether neither the base law nor any first candidate makes a tendon of the data."""
    return is_foreign_data(result.dataset, (result.errors, *_get_errors(result.first_candidates)))


def _has_law(result: CauseSearchResult) -> bool:
    """Return whether the base law makes some of the data, so that a function can correct it."""
    return compute_missed_share(result.dataset, result.base_errors) < SETTINGS.foreign_share_law


def _get_errors(candidates: Sequence[Candidate]) -> Iterator[dict[str, ChannelErrors]]:
    return (candidate.held_out for candidate in candidates)


def _compute_fraction(result: CauseSearchResult) -> float:
    """Return the share of the base law's error beyond noise that is left."""
    return compute_residual_fraction(result.errors, result.base_errors)


def _compute_evidence(a: CauseSearchResult, b: CauseSearchResult) -> float:
    """Return the log-likelihood ratio of `a` to `b`, less the BIC penalty of extra parameters.

    The margin needed to prefer `a` is subtracted.
    """
    if a is b:
        return 0.0
    ratio = compute_log_likelihood_ratio(a.errors, b.errors)
    extra_degrees = _count_degrees(a) - _count_degrees(b)
    return ratio - compute_bic_penalty(a.dataset, extra_degrees) - SETTINGS.equivalent_score_max


def _count_degrees(result: CauseSearchResult) -> float:
    """Return the degrees of freedom of a model."""
    base, model = result.dataset.base, result.fit.model
    own = len(base.own) * len(result.dataset.records)
    return len(base.shared) + own + sum(effect.degrees for effect, _ in model.effects)


def _is_within_model_error(result: CauseSearchResult) -> bool:
    """Return whether the residual is too small to tell another cause from model error."""
    return _compute_fraction(result) < SETTINGS.residual_fraction_min or is_within_tolerance(
        result.dataset, result.errors, SETTINGS.tolerance_ratio_max
    )
