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
        To be predicted by the fitted models; only where each record starts is fitted to them.
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
    base_fit = fit_baseline(dataset)
    original_records = dataset.records
    noisy_records = [
        propagate_driver_noise(record, build_drive_simulator(base_fit, dataset, record))
        for record in original_records
    ]
    if any(new is not old for new, old in zip(noisy_records, original_records, strict=True)):
        dataset = build_dataset(noisy_records)
        dataset, base_fit = _recover_dataset_motion(dataset, refit_baseline(dataset, base_fit))
    law = Choice(dataset, base_fit, ())
    if records[0].loop or not is_noise(dataset, compute_errors(dataset, base_fit)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, base_fit)
    laws = [law]
    if law.dataset.base.law is not dataset.base.law and not records[0].loop:
        laws.append(law._replace(dataset=dataset, fit=base_fit))
    result, law = find_causes(laws, effects, fit_all=fit_all, report=report, workers=workers)
    report("fitting again and testing", RESTART_PROGRESS)
    dataset, base_fit, steps, fit = result.dataset, result.plain, result.steps, result.fit
    applicable = select_applicable_effects(effects, records[0], dataset.base)
    first_ranking = rank_candidates(dataset, base_fit, base_fit, result.firsts)
    if cause:
        steps, fit = rivals.choose_equivalent_cause(dataset, base_fit, steps, fit, cause)
    outcome = _build_diagnosis(dataset, base_fit, fit, steps, first_ranking, applicable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        left_out = predict_left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=left_out)
    return to_record_units(outcome._replace(laws=law, loads=result.loads), scale)


def _recover_dataset_motion(dataset: Dataset, base_fit: Fit) -> tuple[Dataset, Fit]:
    """Return a dataset with the motion that the noise of its travel hides, and its fit.

    A missing motion spoils the fit that is to recover it: so the first fit is robust.
    """
    noisy_records = dataset.records
    if not any(may_hide_motion(record) for record in noisy_records):
        return dataset, refit_baseline(dataset, base_fit)
    fit = (
        base_fit
        if is_noise(dataset, compute_errors(dataset, base_fit))
        else fit_robustly(dataset, base_fit)
    )
    for _ in range(HIDDEN_MOTION_PASSES):
        recovered = [
            recover_hidden_motion(record, dataset.base, fit.model.shared, own)
            for record, own in zip(noisy_records, fit.model.own, strict=True)
        ]
        dataset = build_dataset(recovered)
        base_fit = fit = refit_baseline(dataset, fit)
    return dataset, base_fit


def build_drive_simulator(
    fit: Fit, dataset: Dataset, record: Record
) -> Callable[[Record], SimulatedRecord]:
    """Return a function that simulates a record of the dataset with another drive."""
    k = next(i for i, candidate in enumerate(dataset.records) if candidate is record)
    context = build_unsimulated_contexts(dataset, fit)[k]

    def simulate_with_drive(driven: Record) -> SimulatedRecord:
        return simulate_record(
            driven, context, dataset.base, fit.model.shared, fit.model.own[k], ()
        )

    return simulate_with_drive


def _build_diagnosis(
    dataset: Dataset,
    base_fit: Fit,
    fit: Fit,
    steps: list[CauseStep],
    first_ranking: tuple[RankedCandidate, ...],
    applicable: Sequence[Effect],
    validate: Sequence[Record],
) -> Diagnosis:
    full_dataset = rescale_residuals(use_all_samples(dataset), fit)
    final_fit = fit_model(full_dataset, build_contexts(dataset, base_fit), fit.model, FINAL_ROUNDS)
    final_base_fit = fit_model(
        rescale_residuals(use_all_samples(dataset), base_fit),
        build_contexts(dataset, base_fit),
        base_fit.model,
        FINAL_ROUNDS,
    )
    folds = fit_folds(dataset, base_fit, final_fit)
    errors_before, errors_after = (
        join_errors([compute_errors(item.dataset, item.fits[k]) for item in folds]) for k in (0, 1)
    )
    residual_fraction = compute_residual_fraction(errors_after, errors_before)
    is_drifting = not is_noise(dataset, errors_after) and has_drifting_friction(dataset, fit)
    if not steps:
        verdict = Verdict.CLEAN if is_noise(dataset, errors_before) else Verdict.UNEXPLAINED
    elif is_drifting or (
        residual_fraction > SETTINGS.explained and not is_noise(dataset, errors_after)
    ):
        verdict = Verdict.UNEXPLAINED
    elif any(step.rivals for step in steps):
        verdict = Verdict.AMBIGUOUS
    else:
        verdict = Verdict.NAMED
    fitted_values = {
        item.name: FittedValue(item.value, item.low, item.high, item.parameter.unit, item.at_bound)
        for item in estimate_intervals(full_dataset, build_contexts(dataset, base_fit), final_fit)
    }
    validation_records = prepare_validation_records(dataset, validate, final_base_fit)
    transferred_fit = (
        final_fit._replace(model=transfer_to_validation(dataset, final_fit.model))
        if steps
        else final_base_fit
    )
    predicted_records = predict_records(
        dataset, final_base_fit, transferred_fit, validation_records
    )
    equivalents = [(step.effect.name, *step.rivals) for step in steps if step.rivals]
    simple_models = fit_simple_models(dataset)
    return Diagnosis(
        verdict=verdict,
        steps=tuple(steps),
        ranking=first_ranking,
        parameters=fitted_values,
        dataset=dataset,
        baseline=final_base_fit,
        extended=final_fit if steps else final_base_fit,
        before=compute_model_errors(folds, 0, predicted_records),
        after=compute_model_errors(folds, 1, predicted_records),
        gain={
            channel: Gain(*bootstrap_gain(errors_after[channel], errors_before[channel]))
            for channel in errors_before
        },
        noise=compute_mean_noise(dataset),
        left=residual_fraction,
        wanders=is_drifting,
        simple_models=simple_models,
        simple_gain=compute_simple_gains(errors_after, simple_models),
        structure=find_residual_dependence(dataset, fit),
        detection_limits=compute_detection_limits(dataset, base_fit, applicable)
        if verdict is Verdict.CLEAN
        else {},
        laws=Choice(dataset, base_fit, ()),
        loads=Choice(dataset, base_fit, ()),
        experiments=experiments.suggest_experiments(equivalents, dataset.records[0].signals),
        troubles=tuple(trouble for record in dataset.records for trouble in record.troubles),
        fit_all=all(record.train.all() for record in dataset.records),
        rivals=rivals.fit_rivals(
            dataset, base_fit, final_fit, rivals.find_equivalent_causes(steps)
        ),
        validation=predicted_records,
    )
