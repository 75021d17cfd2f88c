"""The diagnosis: from records to a verdict, with its gain."""

import itertools
from collections.abc import Sequence

import numpy as np

from estimator.diagnosis import equal_causes, experiments, rivals
from estimator.diagnosis.baseline import again, baseline
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    contexts,
    contexts_without,
    dataset_of,
    mean_noise,
    rescaled,
    simulated,
    whole,
    with_records,
)
from estimator.diagnosis.decision import (
    is_all,
    is_noise,
    is_within,
    next_step,
    ranking,
    score_beside,
)
from estimator.diagnosis.detection_limit import detection_limits
from estimator.diagnosis.driver_noise import as_driven
from estimator.diagnosis.elimination import distinct, explaining, fit_without, needed
from estimator.diagnosis.fit import improved
from estimator.diagnosis.folds import fitnesses, two_folds
from estimator.diagnosis.free_friction import wanders
from estimator.diagnosis.intervals import parameters
from estimator.diagnosis.law_choice import Choice, applicable, choose_law, choose_loads
from estimator.diagnosis.outcome import (
    Diagnosis,
    Gain,
    Number,
    Ranked,
    Step,
    Verdict,
)
from estimator.diagnosis.prediction import as_fitted, left_out, predicted
from estimator.diagnosis.progress import Report, part, quiet
from estimator.diagnosis.record import (
    Record,
    RecordError,
    in_full,
    in_short_blocks,
)
from estimator.diagnosis.record_units import in_record_units
from estimator.diagnosis.residual_dependence import structure
from estimator.diagnosis.score import (
    bootstrapped_gain,
    errors,
    joined,
    left_of,
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
    prepared = [in_full(record) for record in records] if fit_all else list(records)
    dataset = dataset_of(prepared)
    report("fitting the base law", 0.0)
    plain = baseline(dataset)
    dataset, plain = as_driven(dataset, contexts_without(dataset, plain), plain, again)
    law = Choice(dataset, plain, ())
    if records[0].loop or not is_noise(dataset, errors(dataset, plain)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, plain)
    loads = choose_loads(law.dataset, law.fit)
    dataset, plain = loads.dataset, loads.fit
    if not fit_all and _brief(dataset, plain):
        prepared = [in_short_blocks(one) for one in prepared]
        dataset = with_records(dataset, [in_short_blocks(one) for one in dataset.records])
        plain = again(dataset, plain)
    plain = again(rescaled(dataset, plain), plain)  # weighed as its rivals will be
    usable = applicable(effects, records[0], dataset.base)
    fit, steps = plain, list[Step]()
    first: tuple[Ranked, ...] = ()
    for begin, end in itertools.pairwise(SEARCHES):
        if is_noise(dataset, errors(dataset, fit)) or (steps and is_all(dataset, fit, plain)):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        searching = part(report, begin, end)
        found = candidates(dataset, fit, rest, searching, workers)
        step = next_step(dataset, plain, fit, found)
        if step is not None and not steps:
            alone = fit_without(dataset, step.fit, step.effect)
            if score_beside(dataset, step.fit, alone, step.effect) < SETTINGS.margin:
                plain = fit = alone  # the previous fit was a local minimum
                continue
        first = first or ranking(dataset, plain, fit, found)
        if step is None:
            two = _by_two(
                dataset, plain, fit, found, rest, part(report, end, SEARCHES[-1]), workers
            )
            steps, fit = [*steps, *two], two[-1].fit if two else fit
            break
        dataset, plain, fit = _driven_anew(dataset, prepared, plain, step.fit)
        steps.append(step._replace(fit=fit))
    report("fitting again and testing", SEARCHES[-1])
    steps, fit = explaining(dataset, steps, fit)
    steps, fit = needed(dataset, steps, fit)
    steps, fit = distinct(dataset, plain, steps, fit)
    if cause:
        steps, fit = equal_causes.with_cause(dataset, plain, steps, fit, usable, cause)
    outcome = _outcome(dataset, plain, fit, steps, first, usable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        others = left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=others)
    return in_record_units(outcome._replace(laws=law, loads=loads))


def _driven_anew(
    dataset: Dataset, prepared: Sequence[Record], plain: Fit, fit: Fit
) -> tuple[Dataset, Fit, Fit]:
    """Return a dataset with what a model with another cause makes of its driver's noise.

    And the plain law and the model, fitted to it.
    """
    about = contexts(dataset, plain)

    def refitted(other: Dataset, model: Fit) -> Fit:
        return improved(rescaled(other, model), about, model.model, LAST)

    def by_most(other: Dataset, model: Fit) -> Fit:
        """Return the fit without what a motion that is still hidden would draw it to."""
        return improved(rescaled(other, model), about, model.model, LAST, robust=True)

    as_measured = with_records(dataset, prepared)
    begun = simulated(as_measured, about, fit.model)
    driven, fit_anew = as_driven(as_measured, about, begun, refitted, by_most)
    if driven is as_measured:
        return dataset, plain, fit
    plain = again(driven, plain)
    return driven, again(rescaled(driven, plain), plain), fit_anew


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
    second = next_step(dataset, plain, lead.fit, more)
    if second is None or not is_within(dataset, errors(dataset, second.fit), SETTINGS.further):
        return []
    return [Step(lead.effect, (), ranking(dataset, plain, fit, list(found)), lead.fit), second]


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
    astray = not is_noise(dataset, after) and wanders(dataset, fit)
    if not steps:
        verdict = Verdict.CLEAN if is_noise(dataset, before) else Verdict.UNEXPLAINED
    elif astray or (left > SETTINGS.explained and not is_noise(dataset, after)):
        verdict = Verdict.UNEXPLAINED
    elif any(step.rivals for step in steps):
        verdict = Verdict.AMBIGUOUS
    else:
        verdict = Verdict.NAMED
    numbers = {
        one.name: Number(one.value, one.low, one.high, one.parameter.unit, one.at_bound)
        for one in parameters(full, contexts(dataset, plain), last)
    }
    extended = last if steps else first_law
    further = predicted(dataset, first_law, extended, as_fitted(dataset, validate, extended))
    alike = [(step.effect.name, *step.rivals) for step in steps if step.rivals]
    simple = simple_models(dataset)
    return Diagnosis(
        verdict=verdict,
        steps=tuple(steps),
        ranking=first,
        parameters=numbers,
        dataset=dataset,
        baseline=first_law,
        extended=extended,
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
        rivals=rivals.fitted(dataset, plain, last, equal_causes.equals(dataset, steps, usable)),
        validation=further,
    )
