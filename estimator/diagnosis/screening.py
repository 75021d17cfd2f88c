"""Which effect explains what a model leaves: every candidate fitted together with the model.

A regression on the residual would be wrong, since the model's own parameters have taken up part of
every effect. So each candidate is first tried by a linear step of all parameters together, from
each of its starts; the starts of lowest cost are then fitted by re-simulation.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    build_contexts,
    build_unsimulated_contexts,
    compute_cost,
    compute_residual,
    rescale_residuals,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.fit import (
    QUICK_ROUNDS,
    ParameterLayout,
    compute_jacobian,
    fit_model,
    fit_robustly,
    shift_parameters,
)
from estimator.diagnosis.scoring import (
    ChannelErrors,
    compute_bic_penalty,
    compute_errors,
    compute_log_likelihood_ratio,
    is_foreign_data,
    is_noise,
    is_within_tolerance,
)
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, scale_progress
from estimator.effects.effect import Effect, EffectContext, Parameter, Values

SUBSAMPLE_SIZE = 1200  # samples of a record in a first look
FOREIGN_STARTS = 12  # starts that are fitted where the law misses most, the cheapest
SECOND_STARTS_MAX, RAW_STARTS_MAX = 10, 12  # starts of all effects, besides the best of each
# shares of a search after which these are done
SCREENING_PROGRESS, FITTING_PROGRESS = 0.3, (0.6, 0.75)
HALVINGS = 3  # of a linear step that leads uphill
SLOPE_MIN = 1e-3  # of the steepest, of a direction that a linear step may go in
ROUNDS = (4, 6)  # of the first fits, on subsampled records
FINAL_ROUNDS = 25  # rounds of the last fit, on whole records
# which of the first fits are finished: of at most that share of the cost without the effect, and
FINISH_SHARE = 0.95
# of so many times the least cost at most, or so much of the best score
FINISH_COST_RATIO, FINISH_SCORE_SHARE = 2.0, 0.5
QUICK_RATIO = 3.0  # times the error of a finished fit that a quick one may leave
RESTART_COST_RATIO_MAX = 1.1  # of a quick fit on all samples to the best: it is followed
AMPLITUDE_RATIO_MAX = 6.0  # times a start's amplitude that a linear step may go

Task = TypeVar("Task")
Done = TypeVar("Done")


class Candidate(NamedTuple):
    """A model with one effect more, and its errors on held-out samples."""

    effect: Effect
    fit: Fit
    held_out: dict[str, ChannelErrors]
    cost: float  # that was minimised


class Start(NamedTuple):
    """A model to begin a fit from, and its cost."""

    model: Model
    cost: float


class Starts(NamedTuple):
    """Two ways to begin with an effect."""

    # of each: it and the model's own parameters where a linear step leads
    linearised_starts: list[list[Start]]
    raw_starts: list[Start]  # on top of the model as it is


def thin_dataset(
    dataset: Dataset, fit: Fit, size: int
) -> tuple[Dataset, Fit, tuple[EffectContext, ...]]:
    """Return a dataset of about `size` samples a record, with a fit's model and its contexts."""
    thin = subsample(dataset, size)
    thin_fit = simulate_dataset(thin, build_unsimulated_contexts(thin, fit), fit.model)
    return thin, thin_fit, build_contexts(thin, thin_fit)


def fit_candidates(
    dataset: Dataset,
    current_fit: Fit,
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int = 1,
    *,
    tolerance_ratio_max: float = math.inf,
) -> list[Candidate]:
    """Return the fitted candidates, the lowest cost first.

    Of those that explain too little after quick fits on few samples, that is all.

    Parameters
    ----------
    current_fit : Fit
        The model without the effects.
    effects : sequence of Effect
        To try on top of it.
    report : callable
        Called with the current task and the share that is done.
    workers : int
        Threads that fit in parallel.
    tolerance_ratio_max : float
        Rms residual over tolerance up to which an effect is wanted.
    """
    dataset = rescale_residuals(dataset, current_fit)
    contexts = build_contexts(dataset, current_fit)
    subsampled, subsampled_fit, subsampled_contexts = thin_dataset(
        dataset, current_fit, SUBSAMPLE_SIZE
    )
    sudden = [effect for effect in effects if any(p.jumps for p in effect.parameters)]
    gradual = [effect for effect in effects if effect not in sudden]
    screening_report = scale_progress(
        report, 0.0, SCREENING_PROGRESS if not sudden else 0.5 * SCREENING_PROGRESS
    )
    linearised_starts, raw_starts = screen_candidates(
        subsampled, subsampled_fit, subsampled_contexts, gradual, screening_report, workers
    )
    if sudden:
        robust_fit = fit_robustly(subsampled, subsampled_fit)
        screening_report = scale_progress(report, 0.5 * SCREENING_PROGRESS, SCREENING_PROGRESS)
        sudden_starts = screen_candidates(
            subsampled, robust_fit, subsampled_contexts, sudden, screening_report, workers
        )
        linearised_starts = linearised_starts + sudden_starts.linearised_starts
        raw_starts = raw_starts + sudden_starts.raw_starts
    best_starts = [pair[0] for pair in linearised_starts]
    second_starts = [pair[1] for pair in linearised_starts if len(pair) > 1]
    selected_starts = [
        *best_starts,
        *_select_cheapest(second_starts, SECOND_STARTS_MAX),
        *_select_cheapest(raw_starts, RAW_STARTS_MAX),
    ]
    models = [
        candidate.model
        for candidate in sorted(selected_starts, key=lambda candidate: candidate.cost)
    ]
    law_errors = compute_errors(subsampled, subsampled_fit)
    if is_foreign_data(subsampled, [law_errors]):
        # what happened at one time makes a law of all samples wrong: its starts do not tell
        later_starts = models[FOREIGN_STARTS:]
        models = models[:FOREIGN_STARTS]
        models += [model for model in later_starts if model.effects[-1][0] in sudden]
    best: list[Candidate] = []
    progress_begin = SCREENING_PROGRESS
    for rounds, kept_count, cost_ratio_max, progress_end in zip(
        ROUNDS, SETTINGS.candidates_kept, SETTINGS.cost_ratio_max, FITTING_PROGRESS, strict=True
    ):
        fitting_report = scale_progress(report, progress_begin, progress_end)
        progress_begin = progress_end

        def fit_subsampled(model: Model, rounds: int = rounds) -> Candidate:
            return _fit_candidate(subsampled, subsampled_contexts, model, rounds)

        best = _select_best_by_label(
            map_parallel(fit_subsampled, models, fitting_report, "fitting candidates", workers)
        )[:kept_count]
        models = [
            candidate.fit.model
            for candidate in best
            if candidate.cost < cost_ratio_max * best[0].cost
        ]
    cost_max = FINISH_SHARE * compute_cost(subsampled, subsampled_fit)
    scores = [score_candidate(subsampled, law_errors, candidate) for candidate in best]
    score_min = FINISH_SCORE_SHARE * max(scores, default=0.0)
    finished = [
        candidate
        for candidate, score in zip(best, scores, strict=True)
        if candidate.cost < min(cost_max, cost_ratio_max * best[0].cost)
        and (score > score_min or candidate.cost < FINISH_COST_RATIO * best[0].cost)
        and is_within_tolerance(subsampled, candidate.held_out, QUICK_RATIO * tolerance_ratio_max)
    ]
    # by the last of these fits: the first ones still fall
    if is_foreign_data(subsampled, (law_errors, *(candidate.held_out for candidate in best))):
        finished = []
    models = [candidate.fit.model for candidate in finished]

    def fit_cheapest(starts: Iterable[Model]) -> Candidate:
        return min(
            (_fit_candidate(dataset, contexts, candidate, FINAL_ROUNDS) for candidate in starts),
            key=lambda candidate: candidate.cost,
        )

    def refine_candidate(model: Model) -> Candidate:
        models = (
            [model]
            if (reset_model := _reset_shapes_at_bound(model, contexts)) is None
            else [model, reset_model]
        )
        best = fit_cheapest(models)
        if best.effect.is_transient and not is_noise(dataset, best.held_out):
            quick_fits = _refine_starts(dataset, contexts, current_fit.model, best.effect)
            promising = [
                fit.model
                for fit in quick_fits
                if compute_cost(dataset, fit) < RESTART_COST_RATIO_MAX * best.cost
            ]
            if promising:
                best = min(best, fit_cheapest(promising), key=lambda candidate: candidate.cost)
        return best

    finishing_report = scale_progress(report, FITTING_PROGRESS[-1], 1.0)
    refined = list(
        map_parallel(refine_candidate, models, finishing_report, "finishing the best", workers)
    )
    unrefined = [
        build_candidate(dataset, simulate_dataset(dataset, contexts, candidate.fit.model))
        for candidate in best
        if not any(candidate is other for other in finished)
    ]
    return sorted(refined + unrefined, key=lambda candidate: candidate.cost)


def _refine_starts(
    dataset: Dataset, contexts: Sequence[EffectContext], model: Model, effect: Effect
) -> list[Fit]:
    """Return the best two fits of a few rounds on all samples, from each start of an effect."""
    starts = [
        _add_effect(model, effect, values)
        for values in effect.starts(_select_context(contexts, effect))
    ]
    fits = [fit_model(dataset, contexts, trial, QUICK_ROUNDS) for trial in starts]
    return sorted(fits, key=lambda trial: compute_cost(dataset, trial))[:2]


def screen_candidates(
    dataset: Dataset,
    current_fit: Fit,
    contexts: Sequence[EffectContext],
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int,
) -> Starts:
    """Return models to start fits from: of each effect the starts of lowest predicted cost.

    Each start is taken as far as a linear step of all parameters would go along it, the model's own
    parameters with it, or a part of that way where the whole leads uphill; and the best as it is,
    since the first samples of a record, for example, are not linear in the parameters.
    """
    residual = compute_residual(dataset, current_fit)
    J = compute_jacobian(dataset, contexts, current_fit)
    J[:, ~ParameterLayout(dataset, current_fit.model).is_smooth] = 0.0  # times have no gradient
    solve = np.linalg.pinv(J, rcond=SLOPE_MIN)  # the stiff cables of a loop may have none
    current_cost = compute_cost(dataset, current_fit)
    effect_starts = [
        (effect, values)
        for effect in effects
        for values in effect.starts(_select_context(contexts, effect))
    ]

    def evaluate_start(model: Model) -> Start:
        return Start(model, compute_cost(dataset, simulate_dataset(dataset, contexts, model)))

    def screen_start(pair: tuple[Effect, Values]) -> tuple[Start, Start] | None:
        effect, values = pair
        raw_fit = simulate_dataset(
            dataset, contexts, _add_effect(current_fit.model, effect, values)
        )
        change = compute_residual(dataset, raw_fit) - residual
        if not np.isfinite(change).all():
            return None
        projected = change - J @ (solve @ change)
        power = float(projected @ projected)
        if power < 1e-12:
            return None

        def linearise(share: float) -> tuple[float, Model]:
            scaled, applied_share = _scale_start(effect, values, share)
            target = residual + applied_share * change
            parameter_step = -(solve @ target)
            predicted_cost = float(np.sum((target + J @ parameter_step) ** 2))
            return predicted_cost, _add_effect(
                shift_parameters(dataset, current_fit.model, parameter_step), effect, scaled
            )

        share = min(
            (1.0, -(float(projected @ residual)) / power), key=lambda share: linearise(share)[0]
        )
        start = evaluate_start(linearise(share)[1])
        for _ in range(HALVINGS):
            if start.cost < current_cost:
                break
            share *= 0.5
            start = min(
                start,
                evaluate_start(linearise(share)[1]),
                key=lambda candidate_start: candidate_start.cost,
            )
        return start, Start(raw_fit.model, float(np.sum((residual + change) ** 2)))

    pairs_by_effect: dict[str, list[tuple[Start, Start]]] = {}
    for pair in map_parallel(screen_start, effect_starts, report, "trying effects", workers):
        if pair is not None:
            pairs_by_effect.setdefault(pair[0].model.effects[-1][0].label, []).append(pair)
    linearised_starts = [
        _select_cheapest([start for start, _ in pairs], 2) for pairs in pairs_by_effect.values()
    ]
    raw_starts = [
        _select_cheapest([start for _, start in pairs], 1)[0] for pairs in pairs_by_effect.values()
    ]
    return Starts(linearised_starts, raw_starts)


def _select_cheapest(starts: Sequence[Start], count: int) -> list[Start]:
    return sorted(starts, key=lambda start: start.cost)[:count]


def _scale_start(effect: Effect, values: Values, share: float) -> tuple[Values, float]:
    """Return a start whose amplitudes are `share` times as large, as far as they may be."""
    amplitudes = [p.neutral is not None for p in effect.parameters]
    if not any(amplitudes):
        return values, 1.0
    share = min(max(share, -AMPLITUDE_RATIO_MAX), AMPLITUDE_RATIO_MAX)
    for value, p in zip(values, effect.parameters, strict=True):
        if p.neutral is None or value == p.neutral:
            continue
        room = (p.high if share * (value - p.neutral) > 0.0 else p.low) - p.neutral
        limit = room / (value - p.neutral)
        share = min(share, limit) if share > 0.0 else max(share, limit)
    scaled = tuple(
        value if p.neutral is None else p.neutral + share * (value - p.neutral)
        for value, p in zip(values, effect.parameters, strict=True)
    )
    return scaled, share


def _add_effect(model: Model, effect: Effect, values: Values) -> Model:
    return model._replace(effects=(*model.effects, (effect, values)))


def _reset_shapes_at_bound(model: Model, contexts: Sequence[EffectContext]) -> Model | None:
    """Return a model with its last effect reset to its default shape parameters where at a bound.

    A subsampled record lacks what is short, such as a memory: a fit may end there at a bound that
    whole records would not have led it to, and would not lead it away from. None if there is none.
    """
    *other_effects, (effect, values) = model.effects
    context = _select_context(contexts, effect)
    allowed = effect.limit_parameters(effect.parameters, float(np.ptp(context.drive)), values)
    are_at_bound = [
        p.neutral is None and not p.jumps and _is_at_bound(value, p)
        for value, p in zip(values, allowed, strict=True)
    ]
    starts = list(effect.starts(context)) if any(are_at_bound) else []
    if not starts:
        return None
    median_start = np.median(np.array(starts), axis=0).tolist()
    shape = tuple(
        start if at_bound else value
        for value, start, at_bound in zip(values, median_start, are_at_bound, strict=True)
    )
    return model._replace(effects=(*other_effects, (effect, shape)))


def _select_context(contexts: Sequence[EffectContext], effect: Effect) -> EffectContext:
    """Return what is known of the first record that an effect acts in."""
    return next(context for context in contexts if effect.is_active_in(context))


def _is_at_bound(value: float, parameter: Parameter) -> bool:
    return any(
        abs(value - bound) <= SETTINGS.bound_tolerance * abs(bound)
        for bound in (parameter.low, parameter.high)
    )


def _fit_candidate(
    dataset: Dataset, contexts: Sequence[EffectContext], start: Model, rounds: int
) -> Candidate:
    return build_candidate(dataset, fit_model(dataset, contexts, start, rounds))


def build_candidate(dataset: Dataset, fit: Fit) -> Candidate:
    """Return the candidate of a fit, whose last effect it is."""
    return Candidate(
        fit.model.effects[-1][0], fit, compute_errors(dataset, fit), compute_cost(dataset, fit)
    )


def score_candidate(
    dataset: Dataset, current_errors: dict[str, ChannelErrors], candidate: Candidate
) -> float:
    """Return the log-likelihood ratio of held-out data to the current fit, less the BIC penalty."""
    return compute_log_likelihood_ratio(candidate.held_out, current_errors) - compute_bic_penalty(
        dataset, candidate.effect.degrees
    )


def _select_best_by_label(candidates: Iterable[Candidate]) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for candidate in sorted(candidates, key=lambda candidate: candidate.cost):
        best.setdefault(candidate.effect.label, candidate)
    return list(best.values())


def map_parallel(
    work: Callable[[Task], Done],
    tasks: Sequence[Task],
    report: ProgressCallback,
    task_name: str,
    workers: int,
) -> Iterator[Done]:
    """Yield what `work` makes of each task, in their order; compiled code runs side by side."""
    with ThreadPoolExecutor(workers) as pool:
        for i, result in enumerate(pool.map(work, tasks), start=1):
            report(task_name, i / max(len(tasks), 1))
            yield result
