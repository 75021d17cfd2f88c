"""The diagnosis: from records to a verdict, with its gain."""

from collections.abc import Callable, Sequence

from estimator.diagnosis import equal_causes, experiments, rivals
from estimator.diagnosis.baseline import again, baseline, by_most
from estimator.diagnosis.carried_over import carried_over
from estimator.diagnosis.causes import AGAIN, find_causes
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    contexts,
    contexts_without,
    dataset_of,
    mean_noise,
    rescaled,
    whole,
)
from estimator.diagnosis.detection_limit import detection_limits
from estimator.diagnosis.driver_noise import with_driver_noise
from estimator.diagnosis.fit import improved
from estimator.diagnosis.folds import fitnesses, two_folds
from estimator.diagnosis.free_friction import wanders
from estimator.diagnosis.hidden_motion import may_hide, with_hidden_motion
from estimator.diagnosis.intervals import parameters
from estimator.diagnosis.law_choice import Choice, applicable, choose_law
from estimator.diagnosis.model import Simulated, simulate
from estimator.diagnosis.needed_causes import LAST
from estimator.diagnosis.next_cause import ranking
from estimator.diagnosis.outcome import (
    Diagnosis,
    Gain,
    Number,
    Ranked,
    Step,
    Verdict,
)
from estimator.diagnosis.prediction import as_driven, left_out, predicted
from estimator.diagnosis.progress import Report, quiet
from estimator.diagnosis.record import Record, RecordError, in_full
from estimator.diagnosis.record_units import bench_scale, in_bench_units, in_record_units
from estimator.diagnosis.residual_dependence import structure
from estimator.diagnosis.score import (
    bootstrapped_gain,
    errors,
    is_noise,
    joined,
    left_of,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.simple_models import gains_over, simple_models
from estimator.effects import CATALOGUE
from estimator.effects.effect import Effect

HIDDEN = 2  # times that hidden motion is looked for, with better numbers the second time


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
        dataset, plain = _with_hidden_motion(dataset, again(dataset, plain))
    law = Choice(dataset, plain, ())
    if records[0].loop or not is_noise(dataset, errors(dataset, plain)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, plain)
    laws = [law]
    if law.dataset.base.law is not dataset.base.law and not records[0].loop:
        laws.append(law._replace(dataset=dataset, fit=plain))
    found, law = find_causes(laws, effects, fit_all=fit_all, report=report, workers=workers)
    report("fitting again and testing", AGAIN)
    dataset, plain, steps, fit = found.dataset, found.plain, found.steps, found.fit
    usable = applicable(effects, records[0], dataset.base)
    first = ranking(dataset, plain, plain, found.firsts)
    if cause:
        steps, fit = equal_causes.with_cause(dataset, plain, steps, fit, cause)
    outcome = _outcome(dataset, plain, fit, steps, first, usable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        others = left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=others)
    return in_record_units(outcome._replace(laws=law, loads=found.loads), scale)


def _with_hidden_motion(dataset: Dataset, plain: Fit) -> tuple[Dataset, Fit]:
    """Return a dataset with the motion that the noise of its travel hides, and its fit.

    A motion that is missing spoils the fit that is to find it: the first fit goes by most of a
    record.
    """
    noisy = dataset.records
    if not any(may_hide(record) for record in noisy):
        return dataset, again(dataset, plain)
    fit = plain if is_noise(dataset, errors(dataset, plain)) else by_most(dataset, plain)
    for _ in range(HIDDEN):
        moved = [
            with_hidden_motion(record, dataset.base, fit.model.shared, own)
            for record, own in zip(noisy, fit.model.own, strict=True)
        ]
        dataset = dataset_of(moved)
        plain = fit = again(dataset, fit)
    return dataset, plain


def simulated_by(fit: Fit, dataset: Dataset, record: Record) -> Callable[[Record], Simulated]:
    """Return a function that simulates a record of the dataset again with another drive."""
    k = next(i for i, other in enumerate(dataset.records) if other is record)
    about = contexts_without(dataset, fit)[k]

    def again_by(other: Record) -> Simulated:
        return simulate(other, about, dataset.base, fit.model.shared, fit.model.own[k], ())

    return again_by


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
