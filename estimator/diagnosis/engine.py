"""The diagnosis: from records to a verdict, with its gain."""

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from estimator.diagnosis import equal_causes, experiments, rivals
from estimator.diagnosis.baseline import again, baseline
from estimator.diagnosis.carried_over import carried_over
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    contexts,
    contexts_without,
    dataset_of,
    mean_noise,
    rescaled,
    tolerance,
    whole,
    with_records,
)
from estimator.diagnosis.detection_limit import detection_limits
from estimator.diagnosis.fit import improved
from estimator.diagnosis.folds import fitnesses, two_folds
from estimator.diagnosis.free_friction import wanders
from estimator.diagnosis.hidden_motion import with_hidden_motion
from estimator.diagnosis.intervals import Named, parameters
from estimator.diagnosis.law_choice import Choice, applicable, choose_law, choose_loads
from estimator.diagnosis.model import Simulated, simulate
from estimator.diagnosis.outcome import (
    Diagnosis,
    Gain,
    Number,
    Ranked,
    Step,
    Verdict,
)
from estimator.diagnosis.prediction import as_driven, left_out, predicted
from estimator.diagnosis.progress import Report, part, quiet
from estimator.diagnosis.record import (
    Record,
    RecordError,
    in_full,
    in_short_blocks,
    with_driver_noise,
)
from estimator.diagnosis.record_units import bench_scale, in_bench_units, in_record_units
from estimator.diagnosis.residual_dependence import structure
from estimator.diagnosis.score import (
    Errors,
    bootstrapped_gain,
    errors,
    gain_of,
    joined,
    left_of,
    log_likelihood_ratio,
    surely_better,
)
from estimator.diagnosis.search import Candidate, candidates
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.simple_models import gains_over, simple_models
from estimator.effects import CATALOGUE
from estimator.effects.effect import Effect

LAST = 12  # rounds of the fit to all samples
SEARCHES = (0.1, 0.5, 0.75, 0.9)  # shares of the time between which each search for a cause runs


def diagnose(
    records: Sequence[Record],
    effects: Sequence[Effect] = CATALOGUE,
    *,
    validate: Sequence[Record] = (),
    cause: str = "",
    fit_all: bool = False,
    leave_one_file_out: bool = False,
    report: Report = quiet,
    workers: int = 1,
) -> Diagnosis:
    """Say what a model of a dataset gets wrong.

    Parameters
    ----------
    records : sequence of Record
        From one dataset, with the same channels; they share its physics.
    effects : sequence of Effect
        That may be the cause.
    validate : sequence of Record
        To be predicted with what was found; only where each record starts is fitted to them.
    cause : str
        Name of the effect to be taken where several explain the data equally well.
    fit_all : bool
        Fit and judge all samples; none is held out.
    leave_one_file_out : bool
        Also predict each record by what the others give.
    report : callable
        Told what is being done and which share of it is.
    workers : int
        Fits side by side.

    Raises
    ------
    RecordError
        If the records have different channels, or one is to be left out of one.
    CauseError
        If `cause` is not among the effects that explain the data equally well.
    """
    if leave_one_file_out and len(records) < 2:
        raise RecordError("one file: to leave one out, at least two are needed")
    if len({tuple(sorted(record.signals)) for record in [*records, *validate]}) > 1:
        raise RecordError("the records have different channels: give those of one dataset")
    if len({(record.units, record.loop) for record in [*records, *validate]}) > 1:
        raise RecordError("the records have different units: give those of one dataset")
    scale = bench_scale(records)
    records = [in_bench_units(record, scale) for record in records]
    validate = [in_bench_units(record, scale) for record in validate]
    dataset = dataset_of([in_full(record) for record in records] if fit_all else records)
    report("fitting the base law", 0.0)
    plain = baseline(dataset)
    before = dataset.records
    noisy = [with_driver_noise(record, simulated_by(plain, dataset, record)) for record in before]
    if any(new is not old for new, old in zip(noisy, before, strict=True)):
        dataset = dataset_of(noisy)
        plain = again(dataset, plain)
        moved = [
            with_hidden_motion(record, dataset.base, plain.model.shared, own)
            for record, own in zip(noisy, plain.model.own, strict=True)
        ]
        dataset = dataset_of(moved)
        plain = again(dataset, plain)
    law = Choice(dataset, plain, ())
    if records[0].loop or not _is_noise(dataset, errors(dataset, plain)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, plain)
    loads = choose_loads(law.dataset, law.fit)
    dataset, plain = loads.dataset, loads.fit
    if not fit_all and _brief(dataset, plain):
        dataset = with_records(dataset, [in_short_blocks(one) for one in dataset.records])
        plain = again(dataset, plain)
    plain = again(rescaled(dataset, plain), plain)  # weighed as its rivals will be
    usable = applicable(effects, records[0], dataset.base)
    fit, steps = plain, list[Step]()
    first: tuple[Ranked, ...] = ()
    for begin, end in itertools.pairwise(SEARCHES):
        if _is_noise(dataset, errors(dataset, fit)) or (steps and _is_all(dataset, fit, plain)):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        searching = part(report, begin, end)
        found = candidates(dataset, fit, rest, searching, workers)
        step = _step(dataset, plain, fit, found)
        if step is not None and not steps:
            without = _without(dataset, step.fit, step.effect)
            if (
                _matters(dataset, step.fit, without, step.effect) < SETTINGS.margin
            ):  # the previous fit was a local minimum
                plain = fit = without
                continue
        first = first or _ranking(dataset, plain, fit, found)
        if step is None:
            two = _by_two(
                dataset, plain, fit, found, rest, part(report, end, SEARCHES[-1]), workers
            )
            steps, fit = [*steps, *two], two[-1].fit if two else fit
            break
        steps.append(step)
        fit = step.fit
    report("fitting again and testing", SEARCHES[-1])
    steps, fit = _needed(dataset, steps, fit)
    steps, fit = _distinct(dataset, plain, steps, fit)
    if cause:
        steps, fit = equal_causes.with_cause(dataset, plain, steps, fit, cause)
    outcome = _outcome(dataset, plain, fit, steps, first, usable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        others = left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=others)
    return in_record_units(outcome._replace(laws=law, loads=loads), scale)


def _by_two(
    dataset: Dataset,
    plain: Fit,
    fit: Fit,
    found: Sequence[Candidate],
    rest: Sequence[Effect],
    report: Report,
    workers: int,
) -> list[Step]:
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
    more = candidates(dataset, lead.fit, rest, report, workers)
    second = _step(dataset, plain, lead.fit, more)
    if second is None or not _within(dataset, errors(dataset, second.fit), SETTINGS.further):
        return []
    return [Step(lead.effect, (), _ranking(dataset, plain, fit, list(found)), lead.fit), second]


def _needed(dataset: Dataset, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those that later ones have made needless, and the fit of them."""
    for step in steps[:-1] if len(steps) > 1 else ():
        without = _without(dataset, fit, step.effect)
        if _matters(dataset, fit, without, step.effect) < SETTINGS.margin:
            steps = [one for one in steps if one is not step]
            fit = without
    return steps, fit


def _distinct(dataset: Dataset, plain: Fit, steps: list[Step], fit: Fit) -> tuple[list[Step], Fit]:
    """Return the causes without those whose size may be none, and the fit of them."""
    while steps:
        full = rescaled(whole(dataset), fit)
        last = improved(full, contexts(dataset, plain), fit.model, LAST)
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
        fit = _without(dataset, fit, needless[-1].effect)
    return steps, fit


def _without(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model without one of its effects, fitted from where it was with it."""
    rest = tuple(one for one in fit.model.effects if one[0].name != effect.name)
    model = fit.model._replace(effects=rest)
    return improved(rescaled(dataset, fit), contexts(dataset, fit), model, LAST)


def _matters(dataset: Dataset, fit: Fit, without: Fit, effect: Effect) -> float:
    """Return ln of how much more probable held-out data are with an effect, parameters paid for."""
    return log_likelihood_ratio(errors(dataset, fit), errors(dataset, without)) - _bic_penalty(
        dataset, effect
    )


def _bic_penalty(dataset: Dataset, effect: Effect) -> float:
    samples = sum(len(record.time) for record in dataset.records)
    return 0.5 * len(effect.parameters) * math.log(samples)


def simulated_by(fit: Fit, dataset: Dataset, record: Record) -> Callable[[Record], Simulated]:
    """Return a function that simulates a record of the dataset again with another drive."""
    k = next(i for i, other in enumerate(dataset.records) if other is record)
    about = contexts_without(dataset, fit)[k]

    def again_by(other: Record) -> Simulated:
        return simulate(other, about, dataset.base, fit.model.shared, fit.model.own[k], ())

    return again_by


def _brief(dataset: Dataset, plain: Fit) -> bool:
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


def _is_all(dataset: Dataset, fit: Fit, plain: Fit) -> bool:
    """Return whether too little is left for another cause to be told from model error."""
    found = errors(dataset, fit)
    if left_of(found, errors(dataset, plain)) < SETTINGS.left_min:
        return True
    return _within(dataset, found, SETTINGS.further)


def _is_noise(dataset: Dataset, found: dict[str, Errors]) -> bool:
    """Return whether errors are what noise makes, and a simulation's own error."""
    return _within(dataset, found, SETTINGS.noise_ratio)


def _within(dataset: Dataset, found: dict[str, Errors], times: float) -> bool:
    floor = tolerance(dataset)
    return all(math.sqrt(one.mean) < times * floor[c] for c, one in found.items())


def _score(dataset: Dataset, base: dict[str, Errors], one: Candidate) -> float:
    """Return ln of how much more probable held-out data are, parameters paid for."""
    return log_likelihood_ratio(one.held_out, base) - _bic_penalty(dataset, one.effect)


def _step(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> Step | None:
    """Return the cause that explains most, with those that cannot be told from it, if any does."""
    base = errors(dataset, fit)
    order = sorted(found, key=lambda one: -_score(dataset, base, one))
    if not order:
        return None
    best = _simplest(dataset, plain, base, order)
    if (
        _score(dataset, base, best) < SETTINGS.margin
        or gain_of(best.held_out, base) < SETTINGS.gain_min
        or surely_better(best.held_out, base) < SETTINGS.confidence
    ):
        return None
    most = left_of(best.held_out, errors(dataset, plain))
    rivals: list[str] = []
    for other in order:
        if other.effect.name in (best.effect.name, *rivals) or len(rivals) == SETTINGS.rivals_max:
            continue
        behind = _score(dataset, base, best) - _score(dataset, base, other)
        more = left_of(other.held_out, errors(dataset, plain)) - most
        unsure = (
            surely_better(best.held_out, other.held_out) < SETTINGS.confidence
            and more < SETTINGS.unsure_left
        )
        if behind < SETTINGS.alike or more < SETTINGS.alike_left or unsure:
            rivals.append(other.effect.name)
    return Step(best.effect, tuple(rivals), _ranking(dataset, plain, fit, found), best.fit)


def _simplest(
    dataset: Dataset, plain: Fit, base: dict[str, Errors], order: list[Candidate]
) -> Candidate:
    """Return of the best causes, which are as good as each other, that of the fewest parameters.

    One with more can imitate another: an antagonist of hardly any friction is joint friction.
    """
    best, at_first = order[0], errors(dataset, plain)
    most = left_of(best.held_out, at_first) + SETTINGS.alike_left
    least = _score(dataset, base, best) - SETTINGS.alike
    alike = [
        one
        for one in order
        if _score(dataset, base, one) > least and left_of(one.held_out, at_first) < most
    ]
    return min(alike, key=lambda one: len(one.effect.parameters))


def _ranking(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> tuple[Ranked, ...]:
    base, at_first = errors(dataset, fit), errors(dataset, plain)
    ranked = [
        Ranked(
            one.effect,
            _score(dataset, base, one),
            {c: e.rmse for c, e in one.held_out.items()},
            left_of(one.held_out, at_first),
            one.fit.model.effects[-1][1],
        )
        for one in found
    ]
    return tuple(sorted(ranked, key=lambda one: -one.score))


def _outcome(
    dataset: Dataset,
    plain: Fit,
    fit: Fit,
    steps: list[Step],
    first: tuple[Ranked, ...],
    usable: Sequence[Effect],
    validate: Sequence[Record],
) -> Diagnosis:
    full = rescaled(whole(dataset), fit)
    last = improved(full, contexts(dataset, plain), fit.model, LAST)
    first_law = improved(
        rescaled(whole(dataset), plain), contexts(dataset, plain), plain.model, LAST
    )
    folds = two_folds(dataset, plain, last)
    before, after = (joined([errors(one.dataset, one.fits[k]) for one in folds]) for k in (0, 1))
    left = left_of(after, before)
    astray = not _is_noise(dataset, after) and wanders(dataset, fit)
    if not steps:
        verdict = Verdict.CLEAN if _is_noise(dataset, before) else Verdict.UNEXPLAINED
    elif astray or (left > SETTINGS.explained and not _is_noise(dataset, after)):
        verdict = Verdict.UNEXPLAINED
    elif any(step.rivals for step in steps):
        verdict = Verdict.AMBIGUOUS
    else:
        verdict = Verdict.NAMED
    numbers = {
        one.name: Number(one.value, one.low, one.high, one.parameter.unit, one.at_bound)
        for one in parameters(full, contexts(dataset, plain), last)
    }
    known = as_driven(dataset, validate, first_law)
    other = last._replace(model=carried_over(dataset, last.model)) if steps else first_law
    further = predicted(dataset, first_law, other, known)
    alike = [(step.effect.name, *step.rivals) for step in steps if step.rivals]
    simple = simple_models(dataset)
    return Diagnosis(
        verdict=verdict,
        steps=tuple(steps),
        ranking=first,
        parameters=numbers,
        dataset=dataset,
        baseline=first_law,
        extended=last if steps else first_law,
        before=fitnesses(folds, 0, further),
        after=fitnesses(folds, 1, further),
        gain={
            channel: Gain(*bootstrapped_gain(after[channel], before[channel])) for channel in before
        },
        noise=mean_noise(dataset),
        left=left,
        wanders=astray,
        simple_models=simple,
        simple_gain=gains_over(after, simple),
        structure=structure(dataset, fit),
        detection_limits=detection_limits(dataset, plain, usable)
        if verdict is Verdict.CLEAN
        else {},
        laws=Choice(dataset, plain, ()),
        loads=Choice(dataset, plain, ()),
        experiments=experiments.settling(alike, dataset.records[0].signals),
        troubles=tuple(trouble for record in dataset.records for trouble in record.troubles),
        fit_all=all(record.train.all() for record in dataset.records),
        rivals=rivals.fitted(dataset, plain, last, equal_causes.equals(steps)),
        validation=further,
    )
