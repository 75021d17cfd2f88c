"""The diagnosis: from records to a verdict, with its gain."""

from collections.abc import Callable, Sequence

from estimator.diagnosis import experiments, rivals
from estimator.diagnosis.baseline import (
    Choice,
    choose_law,
    fit_baseline,
    fit_robustly,
    refit_baseline,
    select_applicable_effects,
)
from estimator.diagnosis.causes import FINAL_ROUNDS, RESTART_PROGRESS, find_causes, rank_candidates
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    build_dataset,
    build_unsimulated_contexts,
    compute_mean_noise,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.driver_noise import propagate_driver_noise
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.hidden_motion import may_hide_motion, recover_hidden_motion
from estimator.diagnosis.intervals import estimate_intervals
from estimator.diagnosis.model import SimulatedRecord, simulate_record
from estimator.diagnosis.outcome import (
    CauseStep,
    Diagnosis,
    FittedValue,
    Gain,
    RankedCandidate,
    Verdict,
)
from estimator.diagnosis.prediction import (
    predict_left_out,
    predict_records,
    prepare_validation_records,
)
from estimator.diagnosis.record import Record, RecordError, mark_all_as_train
from estimator.diagnosis.record_units import compute_bench_scale, to_bench_units, to_record_units
from estimator.diagnosis.score import (
    bootstrap_gain,
    compute_errors,
    compute_residual_fraction,
    find_residual_dependence,
    is_noise,
    join_errors,
)
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, ignore_progress
from estimator.diagnosis.simple_models import compute_simple_gains, fit_simple_models
from estimator.diagnosis.validation import (
    compute_detection_limits,
    compute_model_errors,
    fit_folds,
    has_drifting_friction,
    transfer_to_validation,
)
from estimator.effects import CATALOGUE
from estimator.effects.effect import Effect

# times that hidden motion is looked for, with better numbers the second time
HIDDEN_MOTION_PASSES = 2


def diagnose(
    records: Sequence[Record],
    effects: Sequence[Effect] = CATALOGUE,
    *,
    validate: Sequence[Record] = (),
    cause: str = "",
    fit_all: bool = False,
    leave_one_file_out: bool = False,
    report: ProgressCallback = ignore_progress,
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
    scale = compute_bench_scale(records)
    records = [to_bench_units(record, scale) for record in records]
    validate = [to_bench_units(record, scale) for record in validate]
    dataset = build_dataset(
        [mark_all_as_train(record) for record in records] if fit_all else records
    )
    report("fitting the base law", 0.0)
    plain = fit_baseline(dataset)
    before = dataset.records
    noisy = [
        propagate_driver_noise(record, build_drive_simulator(plain, dataset, record))
        for record in before
    ]
    if any(new is not old for new, old in zip(noisy, before, strict=True)):
        dataset = build_dataset(noisy)
        dataset, plain = _recover_dataset_motion(dataset, refit_baseline(dataset, plain))
    law = Choice(dataset, plain, ())
    if records[0].loop or not is_noise(dataset, compute_errors(dataset, plain)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, plain)
    laws = [law]
    if law.dataset.base.law is not dataset.base.law and not records[0].loop:
        laws.append(law._replace(dataset=dataset, fit=plain))
    found, law = find_causes(laws, effects, fit_all=fit_all, report=report, workers=workers)
    report("fitting again and testing", RESTART_PROGRESS)
    dataset, plain, steps, fit = found.dataset, found.plain, found.steps, found.fit
    usable = select_applicable_effects(effects, records[0], dataset.base)
    first = rank_candidates(dataset, plain, plain, found.firsts)
    if cause:
        steps, fit = rivals.choose_equivalent_cause(dataset, plain, steps, fit, cause)
    outcome = _build_diagnosis(dataset, plain, fit, steps, first, usable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        others = predict_left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=others)
    return to_record_units(outcome._replace(laws=law, loads=found.loads), scale)


def _recover_dataset_motion(dataset: Dataset, plain: Fit) -> tuple[Dataset, Fit]:
    """Return a dataset with the motion that the noise of its travel hides, and its fit.

    A motion that is missing spoils the fit that is to find it: the first fit goes by most of a
    record.
    """
    noisy = dataset.records
    if not any(may_hide_motion(record) for record in noisy):
        return dataset, refit_baseline(dataset, plain)
    fit = (
        plain if is_noise(dataset, compute_errors(dataset, plain)) else fit_robustly(dataset, plain)
    )
    for _ in range(HIDDEN_MOTION_PASSES):
        moved = [
            recover_hidden_motion(record, dataset.base, fit.model.shared, own)
            for record, own in zip(noisy, fit.model.own, strict=True)
        ]
        dataset = build_dataset(moved)
        plain = fit = refit_baseline(dataset, fit)
    return dataset, plain


def build_drive_simulator(
    fit: Fit, dataset: Dataset, record: Record
) -> Callable[[Record], SimulatedRecord]:
    """Return a function that simulates a record of the dataset again with another drive."""
    k = next(i for i, other in enumerate(dataset.records) if other is record)
    about = build_unsimulated_contexts(dataset, fit)[k]

    def again_by(other: Record) -> SimulatedRecord:
        return simulate_record(other, about, dataset.base, fit.model.shared, fit.model.own[k], ())

    return again_by


def _build_diagnosis(
    dataset: Dataset,
    plain: Fit,
    fit: Fit,
    steps: list[CauseStep],
    first: tuple[RankedCandidate, ...],
    usable: Sequence[Effect],
    validate: Sequence[Record],
) -> Diagnosis:
    full = rescale_residuals(use_all_samples(dataset), fit)
    last = fit_model(full, build_contexts(dataset, plain), fit.model, FINAL_ROUNDS)
    first_law = fit_model(
        rescale_residuals(use_all_samples(dataset), plain),
        build_contexts(dataset, plain),
        plain.model,
        FINAL_ROUNDS,
    )
    folds = fit_folds(dataset, plain, last)
    before, after = (
        join_errors([compute_errors(one.dataset, one.fits[k]) for one in folds]) for k in (0, 1)
    )
    left = compute_residual_fraction(after, before)
    astray = not is_noise(dataset, after) and has_drifting_friction(dataset, fit)
    if not steps:
        verdict = Verdict.CLEAN if is_noise(dataset, before) else Verdict.UNEXPLAINED
    elif astray or (left > SETTINGS.explained and not is_noise(dataset, after)):
        verdict = Verdict.UNEXPLAINED
    elif any(step.rivals for step in steps):
        verdict = Verdict.AMBIGUOUS
    else:
        verdict = Verdict.NAMED
    numbers = {
        one.name: FittedValue(one.value, one.low, one.high, one.parameter.unit, one.at_bound)
        for one in estimate_intervals(full, build_contexts(dataset, plain), last)
    }
    known = prepare_validation_records(dataset, validate, first_law)
    other = last._replace(model=transfer_to_validation(dataset, last.model)) if steps else first_law
    further = predict_records(dataset, first_law, other, known)
    alike = [(step.effect.name, *step.rivals) for step in steps if step.rivals]
    simple = fit_simple_models(dataset)
    return Diagnosis(
        verdict=verdict,
        steps=tuple(steps),
        ranking=first,
        parameters=numbers,
        dataset=dataset,
        baseline=first_law,
        extended=last if steps else first_law,
        before=compute_model_errors(folds, 0, further),
        after=compute_model_errors(folds, 1, further),
        gain={
            channel: Gain(*bootstrap_gain(after[channel], before[channel])) for channel in before
        },
        noise=compute_mean_noise(dataset),
        left=left,
        wanders=astray,
        simple_models=simple,
        simple_gain=compute_simple_gains(after, simple),
        structure=find_residual_dependence(dataset, fit),
        detection_limits=compute_detection_limits(dataset, plain, usable)
        if verdict is Verdict.CLEAN
        else {},
        laws=Choice(dataset, plain, ()),
        loads=Choice(dataset, plain, ()),
        experiments=experiments.suggest_experiments(alike, dataset.records[0].signals),
        troubles=tuple(trouble for record in dataset.records for trouble in record.troubles),
        fit_all=all(record.train.all() for record in dataset.records),
        rivals=rivals.fit_rivals(dataset, plain, last, rivals.find_equivalent_causes(steps)),
        validation=further,
    )
