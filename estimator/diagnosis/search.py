"""Which effect explains what a model leaves: every candidate fitted together with the model.

A regression on the residual would be wrong, since the model's own parameters have taken up part of
every effect. So each candidate is first tried by a linear step of all parameters together, from
each of its starts, and those that promise most are then fitted by re-simulation.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np

from estimator.diagnosis.baseline import fit_robustly
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
    shift_parameters,
)
from estimator.diagnosis.score import ChannelErrors, compute_errors, is_noise
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, scale_progress
from estimator.effects.effect import Effect, EffectContext, Parameter, Values

SUBSAMPLE_SIZE = 1200  # samples of a record in a first look
SECOND_STARTS_MAX, RAW_STARTS_MAX = 10, 12  # starts of all effects, besides the best of each
# shares of a search after which these are done
SCREENING_PROGRESS, FITTING_PROGRESS = 0.3, (0.6, 0.75)
HALVINGS = 3  # of a linear step that leads uphill
ROUNDS = (4, 6)  # of the first fits, on thin records
FINAL_ROUNDS = 25  # rounds of the last fit, on whole records
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

    led: list[list[Start]]  # of each: it and the model's own parameters where a linear step leads
    bare: list[Start]  # on top of the model as it is


def fit_candidates(
    dataset: Dataset,
    fit: Fit,
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int = 1,
) -> list[Candidate]:
    """Return what came of each effect that promised something, the best first.

    Parameters
    ----------
    dataset : Dataset
        What was measured.
    fit : Fit
        The model without.
    effects : sequence of Effect
        To try on top of it.
    report : callable
        Told what is done, and which share of it is.
    workers : int
        Fits side by side.
    """
    dataset = rescale_residuals(dataset, fit)
    about = build_contexts(dataset, fit)
    thin_bench = subsample(dataset, SUBSAMPLE_SIZE)
    there = simulate_dataset(thin_bench, build_unsimulated_contexts(thin_bench, fit), fit.model)
    around = build_contexts(thin_bench, there)
    sudden = [effect for effect in effects if any(p.jumps for p in effect.parameters)]
    gradual = [effect for effect in effects if effect not in sudden]
    trying = scale_progress(
        report, 0.0, SCREENING_PROGRESS if not sudden else 0.5 * SCREENING_PROGRESS
    )
    led, bare = screen_candidates(thin_bench, there, around, gradual, trying, workers)
    if sudden:
        by_part = fit_robustly(thin_bench, there)
        trying = scale_progress(report, 0.5 * SCREENING_PROGRESS, SCREENING_PROGRESS)
        more = screen_candidates(thin_bench, by_part, around, sudden, trying, workers)
        led, bare = led + more.led, bare + more.bare
    firsts = [pair[0] for pair in led]
    seconds = [pair[1] for pair in led if len(pair) > 1]
    begin = [
        *firsts,
        *_select_cheapest(seconds, SECOND_STARTS_MAX),
        *_select_cheapest(bare, RAW_STARTS_MAX),
    ]
    models = [one.model for one in sorted(begin, key=lambda one: one.cost)]
    best: list[Candidate] = []
    begun = SCREENING_PROGRESS
    for rounds, kept, hopeless, done in zip(
        ROUNDS, SETTINGS.kept, SETTINGS.hopeless, FITTING_PROGRESS, strict=True
    ):
        fitting, begun = scale_progress(report, begun, done), done

        def fitted(model: Model, rounds: int = rounds) -> Candidate:
            return _fit_candidate(thin_bench, around, model, rounds)

        best = _select_best_by_label(
            _map_parallel(fitted, models, fitting, "fitting candidates", workers)
        )[:kept]
        models = [one.fit.model for one in best if one.cost < hopeless * best[0].cost]

    def fit_cheapest(starts: Iterable[Model]) -> Candidate:
        return min(
            (_fit_candidate(dataset, about, one, FINAL_ROUNDS) for one in starts),
            key=lambda one: one.cost,
        )

    def finished(model: Model) -> Candidate:
        begun = (
            [model]
            if (inside := _reset_shapes_at_bound(model, about[0])) is None
            else [model, inside]
        )
        best = fit_cheapest(begun)
        if best.effect.brief and not is_noise(dataset, best.held_out):
            restarted = fit_cheapest(_refine_starts(dataset, about, fit.model, best.effect))
            best = min(best, restarted, key=lambda one: one.cost)
        return best

    finishing = scale_progress(report, FITTING_PROGRESS[-1], 1.0)
    refined = list(_map_parallel(finished, models, finishing, "finishing the best", workers))
    rest = [
        _build_candidate(dataset, simulate_dataset(dataset, about, one.fit.model))
        for one in best[len(models) :]
    ]
    return sorted(refined + rest, key=lambda one: one.cost)


def _refine_starts(
    dataset: Dataset, about: Sequence[EffectContext], model: Model, effect: Effect
) -> list[Model]:
    """Return where a few rounds on all samples lead from the starts of an effect: the best two."""
    starts = [_add_effect(model, effect, values) for values in effect.starts(about[0])]
    fits = [fit_model(dataset, about, one, QUICK_ROUNDS) for one in starts]
    return [one.model for one in sorted(fits, key=lambda one: compute_cost(dataset, one))[:2]]


def screen_candidates(
    dataset: Dataset,
    fit: Fit,
    about: Sequence[EffectContext],
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int,
) -> Starts:
    """Return models to begin fits from: for each effect those of its starts that promise most.

    Each start is taken as far as a linear step of all parameters would go along it, the model's own
    parameters with it, or a part of that way where the whole leads uphill; and the best as it is,
    since where a record starts, for one, nothing is linear.
    """
    r = compute_residual(dataset, fit)
    J = compute_jacobian(dataset, about, fit)
    J[:, ~ParameterLayout(dataset, fit.model).smooth] = 0.0  # times have no gradient
    solve = np.linalg.pinv(J)
    without = compute_cost(dataset, fit)
    begin = [(effect, values) for effect in effects for values in effect.starts(about[0])]

    def start(model: Model) -> Start:
        return Start(model, compute_cost(dataset, simulate_dataset(dataset, about, model)))

    def promise(one: tuple[Effect, Values]) -> tuple[Start, Start] | None:
        effect, values = one
        begun = simulate_dataset(dataset, about, _add_effect(fit.model, effect, values))
        change = compute_residual(dataset, begun) - r
        if not np.isfinite(change).all():
            return None
        alone = change - J @ (solve @ change)
        power = float(alone @ alone)
        if power < 1e-12:
            return None

        def led(share: float) -> tuple[float, Model]:
            scaled, step = _scale_start(effect, values, share)
            wanted = r + step * change
            base = -(solve @ wanted)
            foreseen = float(np.sum((wanted + J @ base) ** 2))
            return foreseen, _add_effect(shift_parameters(dataset, fit.model, base), effect, scaled)

        share = min((1.0, -(float(alone @ r)) / power), key=lambda share: led(share)[0])
        best = start(led(share)[1])
        for _ in range(HALVINGS):
            if best.cost < without:
                break
            share *= 0.5
            best = min(best, start(led(share)[1]), key=lambda one: one.cost)
        return best, Start(begun.model, float(np.sum((r + change) ** 2)))

    of_effect: dict[str, list[tuple[Start, Start]]] = {}
    for one in _map_parallel(promise, begin, report, "trying effects", workers):
        if one is not None:
            of_effect.setdefault(one[0].model.effects[-1][0].label, []).append(one)
    led = [_select_cheapest([of_two for of_two, _ in pairs], 2) for pairs in of_effect.values()]
    bare = [_select_cheapest([of_two for _, of_two in pairs], 1)[0] for pairs in of_effect.values()]
    return Starts(led, bare)


def _select_cheapest(starts: Sequence[Start], most: int) -> list[Start]:
    return sorted(starts, key=lambda one: one.cost)[:most]


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
        most = room / (value - p.neutral)
        share = min(share, most) if share > 0.0 else max(share, most)
    scaled = tuple(
        value if p.neutral is None else p.neutral + share * (value - p.neutral)
        for value, p in zip(values, effect.parameters, strict=True)
    )
    return scaled, share


def _add_effect(model: Model, effect: Effect, values: Values) -> Model:
    return model._replace(effects=(*model.effects, (effect, values)))


def _reset_shapes_at_bound(model: Model, context: EffectContext) -> Model | None:
    """Return a model with its last effect reset to its default shape parameters where at a bound.

    A thin record does not have what is short, such as a memory: there it may end at a bound that
    whole records would not have led it to, and would not lead it away from. None if there is none.
    """
    *rest, (effect, values) = model.effects
    allowed = effect.within(effect.parameters, float(np.ptp(context.drive)), values)
    stopped = [
        p.neutral is None and not p.jumps and _is_at_bound(value, p)
        for value, p in zip(values, allowed, strict=True)
    ]
    starts = list(effect.starts(context)) if any(stopped) else []
    if not starts:
        return None
    usual = np.median(np.array(starts), axis=0).tolist()
    shape = tuple(
        start if at_bound else value
        for value, start, at_bound in zip(values, usual, stopped, strict=True)
    )
    return model._replace(effects=(*rest, (effect, shape)))


def _is_at_bound(value: float, parameter: Parameter) -> bool:
    return any(
        abs(value - bound) <= SETTINGS.at_bound * abs(bound)
        for bound in (parameter.low, parameter.high)
    )


def _fit_candidate(
    dataset: Dataset, about: Sequence[EffectContext], start: Model, rounds: int
) -> Candidate:
    return _build_candidate(dataset, fit_model(dataset, about, start, rounds))


def _build_candidate(dataset: Dataset, fit: Fit) -> Candidate:
    return Candidate(
        fit.model.effects[-1][0], fit, compute_errors(dataset, fit), compute_cost(dataset, fit)
    )


def _select_best_by_label(found: Iterable[Candidate]) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for one in sorted(found, key=lambda one: one.cost):
        best.setdefault(one.effect.label, one)
    return list(best.values())


def _map_parallel(
    work: Callable[[Task], Done],
    tasks: Sequence[Task],
    report: ProgressCallback,
    what: str,
    workers: int,
) -> Iterator[Done]:
    """Yield what `work` makes of each task, in their order; compiled code runs side by side."""
    with ThreadPoolExecutor(workers) as pool:
        for i, done in enumerate(pool.map(work, tasks), start=1):
            report(what, i / max(len(tasks), 1))
            yield done
