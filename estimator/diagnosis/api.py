"""A diagnosis of measured data, in one call."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis import cause_selection, outcome
from estimator.diagnosis.baseline import (
    choose_law,
    fit_baseline,
    select_applicable_effects,
)
from estimator.diagnosis.bench_units import compute_bench_scale, to_bench_units, to_record_units
from estimator.diagnosis.cause_selection import CauseError, rank_candidates
from estimator.diagnosis.causes import (
    FINAL_ROUNDS,
    RESTART_PROGRESS,
    CauseSearch,
    CauseSearchResult,
    find_causes,
)
from estimator.diagnosis.curve import estimate_curve
from estimator.diagnosis.dataset import (
    BaseLaw,
    Dataset,
    Fit,
    build_contexts,
    build_dataset,
    compute_mean_noise,
    read_work_clock,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model, fit_robustly, refit_baseline
from estimator.diagnosis.hidden_motion import (
    may_hide_motion,
    propagate_driver_noise,
    recover_hidden_motion,
)
from estimator.diagnosis.intervals import estimate_intervals
from estimator.diagnosis.learned import compute_learned_gains, fit_learned_models
from estimator.diagnosis.outcome import (
    CauseStep,
    Diagnosis,
    FittedValue,
    RankedCandidate,
    Verdict,
    decide_verdict,
)
from estimator.diagnosis.record import (
    Record,
    RecordError,
    check_finite_values,
    is_loop,
    mark_all_as_train,
    prepare_record,
)
from estimator.diagnosis.residual_structure import find_residual_dependence
from estimator.diagnosis.scoring import (
    Choice,
    bootstrap_gain,
    compute_errors,
    compute_missed_share,
    compute_residual_fraction,
    is_noise,
    join_errors,
)
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, TimeBudget, ignore_progress
from estimator.diagnosis.simple_models import (
    compute_simple_gains,
    explain_foreign_data,
    fit_simple_models,
    is_plain_mechanism,
)
from estimator.diagnosis.validation import (
    compute_detection_limits,
    compute_file_force,
    compute_live_error,
    compute_model_errors,
    compute_rival_force,
    fit_folds,
    has_drifting_friction,
    predict_left_out,
    predict_records,
    prepare_validation_records,
    transfer_to_validation,
)
from estimator.effects import CATALOGUE, CHANNELS, Effect
from estimator.effects.functions import find_column, find_function
from estimator.measured_data import MeasuredData
from estimator.signals.sampling import mark_missing
from estimator.units import LINEAR, Units

__all__ = ["CauseError", "RecordError", "diagnose"]


def diagnose(
    data: MeasuredData | Record | Sequence[MeasuredData | Record],
    effects: Iterable[str | Effect] = CATALOGUE,
    *,
    validate: Sequence[MeasuredData | Record] = (),
    noise: Mapping[str, float] = MappingProxyType({}),
    cause: str = "",
    fit_all: bool = False,
    leave_one_file_out: bool = False,
    loop: bool | None = None,
    variables: Sequence[str] = (),
    time_limit: float = SETTINGS.search_time_max,
    progress: Callable[[str, float], None] = ignore_progress,
    workers: int = 1,
) -> Diagnosis:
    """Find what the law gets wrong on measured data, the cause, and what modelling it gains.

    Candidates are compared by held-out log-likelihood with a BIC penalty (docs/how-to/diagnose.md).

    Parameters
    ----------
    data : MeasuredData, Record, or a sequence of them
        Of one bench, with the same channels; they are fitted together. A `Record` is data that
        `estimator.diagnosis.record.prepare_record` has checked.
    effects : iterable of str or Effect
        Candidate causes, by name or from `CATALOGUE`.
    validate : sequence of MeasuredData or Record
        Further data of the bench, to be predicted and not fitted.
    noise : mapping
        Standard deviation of the noise of channels in the data's units, where it is known better
        than `MeasuredData` tell it.
    cause : str
        Name of the effect to be taken where several explain the data equally well.
    fit_all : bool
        Fit and judge all samples; none is held out.
    leave_one_file_out : bool
        Also predict each record by the fit of the others.
    loop : bool, optional
        Whether the data are of a closed loop of two cables; by default, whether effort changes its
        sign in one of them.
    variables : sequence of str
        Further columns of the data (`extra`), such as a temperature, that something may depend on;
        those that functions among `effects` name are added.
    time_limit : float
        [s] for each record, after which no further search for a cause begins; `Diagnosis.untried`
        says which. Counted by simulated samples (`dataset.read_work_clock`), not by a clock.
    progress : callable
        Called with what is being done and which share of it (0 to 1) is.
    workers : int
        Threads that fit side by side.

    Returns
    -------
    Diagnosis
        With `verdict`, `causes`, `parameters` and `gain`; `estimator.result_display` has it as text
        and figures.

    Raises
    ------
    RecordError
        If the data cannot be diagnosed; the message says why.
    CauseError
        If `cause` is not among the effects that explain the data equally well.
    ValueError
        If an effect is not in the catalogue.
    """
    is_single = isinstance(data, Record) or hasattr(data, "proximal_tension")
    data_sets: list[MeasuredData | Record] = [data] if is_single else list(data)  # type: ignore[list-item, arg-type]
    resolved = tuple(map(_resolve_effect, effects)) if effects is not CATALOGUE else CATALOGUE
    named = (find_column(effect.name) for effect in resolved if effect.function is not None)
    columns = tuple(dict.fromkeys([*variables, *filter(None, named)]))
    records = prepare_records([*data_sets, *validate], noise, loop=loop, variables=columns)
    diagnosis = diagnose_records(
        records[: len(data_sets)],
        resolved,
        validate=records[len(data_sets) :],
        cause=cause,
        fit_all=fit_all,
        leave_one_file_out=leave_one_file_out,
        time_limit=time_limit,
        report=progress,
        workers=workers,
    )
    progress("estimating the force", 1.0)
    return _add_forces(diagnosis, data_sets, validate)


def _add_forces(
    diagnosis: Diagnosis,
    data: Sequence[MeasuredData | Record],
    validate: Sequence[MeasuredData | Record],
) -> Diagnosis:
    """Return a diagnosis with the forces that its models would estimate in data that are given.

    The estimator runs the capstan law of one tendon only.
    """
    if diagnosis.units.rotary or diagnosis.dataset.records[0].loop:
        return diagnosis
    if diagnosis.dataset.base.law is not BaseLaw.CAPSTAN:
        return diagnosis
    base_model, model = diagnosis.baseline.model, diagnosis.live_model
    fitted_data = [item for item in data if not isinstance(item, Record)]
    forces = [
        compute_file_force(base_model, model, diagnosis.duration, item, validation=is_validation)
        for items, is_validation in ((data, False), (validate, True))
        for item in items
        if not isinstance(item, Record)
    ]
    rival_forces = [
        compute_rival_force(
            model, rival.fit.model, (rival.replaces, rival.effect.label), diagnosis.duration,
            fitted_data,
        )
        for rival in diagnosis.rivals
        if fitted_data
    ]  # fmt: skip
    return diagnosis._replace(
        forces=tuple(item for item in forces if item is not None), rival_forces=tuple(rival_forces)
    )


def prepare_records(
    data: Sequence[MeasuredData | Record],
    noise: Mapping[str, float] = MappingProxyType({}),
    *,
    loop: bool | None = None,
    variables: Sequence[str] = (),
) -> list[Record]:
    """Return records of one bench made ready: in common units, all of a loop or none.

    Parameters
    ----------
    data : sequence of MeasuredData or Record
        A `Record` is taken as it is.
    loop : bool, optional
        Whether they are of a closed loop of two cables; by default, whether effort changes its sign
        in one of them.
    variables : sequence of str
        Further columns of the data that something may depend on.

    Raises
    ------
    RecordError
        If one cannot be diagnosed or is in other units than the first.
    """
    raw_data = [item for item in data if not isinstance(item, Record)]
    signals = [mark_missing(collect_signals(item)) for item in raw_data]
    for channels in signals:
        check_finite_values(channels)
    if not raw_data:
        return [item for item in data if isinstance(item, Record)]
    units = get_units(raw_data[0])
    if any(get_units(item) != units for item in raw_data):
        raise RecordError("files mix rotary and linear units: give data of one bench")
    loop = is_loop(units, signals) if loop is None else loop
    records = []
    for item in data:
        if isinstance(item, Record):
            records.append(item)
            continue
        try:
            records.append(
                prepare_record(
                    item.time,
                    collect_signals(item),
                    noise=noise,
                    units=units,
                    loop=loop,
                    variables={name: _get_column(item, name) for name in variables},
                )
            )
        except RecordError as error:
            path = getattr(item, "path", None)
            raise RecordError(f"{path}: {error}" if path else str(error)) from error
    return records


def get_units(data: MeasuredData) -> Units:
    """Return the units of data; newtons and metres where they name none."""
    units: Units = getattr(data, "units", LINEAR)
    return units


def _get_column(data: MeasuredData, name: str) -> Array:
    """Return a further column of data."""
    columns = getattr(data, "extra", {})
    if name not in columns:
        raise RecordError(
            f"{name}: no such further column; there are {', '.join(columns) or 'none'}"
        )
    try:
        return np.asarray(columns[name], dtype=np.float64)
    except ValueError as error:
        raise RecordError(f"{name}: is a column of text; give one of numbers") from error


def collect_signals(data: MeasuredData) -> dict[str, Array]:
    """Return the channels that were measured, by name."""
    return {name: signal for name in CHANNELS if (signal := getattr(data, name)) is not None}


def _resolve_effect(effect: str | Effect) -> Effect:
    if isinstance(effect, Effect):
        return effect
    matches = [candidate for candidate in CATALOGUE if candidate.name == effect]
    if (function := find_function(effect)) is not None:
        return function
    if not matches:
        names = ", ".join(dict.fromkeys(candidate.name for candidate in CATALOGUE))
        raise ValueError(f"effect {effect!r}: not in the catalogue, which has {names}")
    return matches[0]


# --- the diagnosis: from records to a verdict, with its gain


# times that hidden motion is looked for, with better numbers the second time
HIDDEN_MOTION_PASSES = 2


def diagnose_records(
    records: Sequence[Record],
    effects: Sequence[Effect] = CATALOGUE,
    *,
    validate: Sequence[Record] = (),
    cause: str = "",
    fit_all: bool = False,
    leave_one_file_out: bool = False,
    time_limit: float = SETTINGS.search_time_max,
    report: ProgressCallback = ignore_progress,
    workers: int = 1,
) -> Diagnosis:
    """Say what a model of records that were made ready gets wrong; for the options see `diagnose`.

    The records are of one dataset and share its physics. Of those in `validate`, which are to be
    predicted, only where each starts is fitted.

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
    records = [
        replace(to_bench_units(record, scale), file=k) for k, record in enumerate(records, start=1)
    ]
    validate = [to_bench_units(record, scale) for record in validate]
    dataset = build_dataset(
        [mark_all_as_train(record) for record in records] if fit_all else records
    )
    report("fitting the base law", 0.0)
    base_fit = fit_baseline(dataset, workers)
    original_records = dataset.records
    noisy_records = propagate_driver_noise(original_records, dataset, base_fit)
    if any(new is not old for new, old in zip(noisy_records, original_records, strict=True)):
        dataset = build_dataset(noisy_records)
        dataset, base_fit = _recover_dataset_motion(dataset, refit_baseline(dataset, base_fit))
    law = Choice(dataset, base_fit, ())
    errors = compute_errors(dataset, base_fit)
    is_plain = is_plain_mechanism(dataset, errors)
    has_law = compute_missed_share(dataset, errors) < SETTINGS.foreign_share_law and not is_plain
    if has_law and (records[0].loop or not is_noise(dataset, errors)):
        report("choosing the base law", 0.0)
        law = choose_law(dataset, base_fit, workers)
    laws = [law]
    if law.dataset.base.law is not dataset.base.law and not records[0].loop:
        laws.append(law._replace(dataset=dataset, fit=base_fit))
    budget = TimeBudget(time_limit * len(records), read_work_clock)
    search = CauseSearch(effects, budget, report, workers)
    if is_plain:
        result = CauseSearchResult(law, dataset, base_fit, [], [], base_fit)
    else:
        result, law = find_causes(laws, search, fit_all=fit_all)
    report("fitting again and testing", RESTART_PROGRESS)
    dataset, base_fit, steps, fit = result.dataset, result.base_fit, result.steps, result.fit
    applicable = select_applicable_effects(effects, records[0], dataset.base)
    first_ranking = rank_candidates(dataset, base_fit, base_fit, result.first_candidates)
    if len(steps) == 1 and steps[0].effect.function is not None:  # after the first search
        functions = (*first_ranking, *steps[0].ranking)
        first_ranking = tuple(sorted(functions, key=lambda candidate: -candidate.score))
    if cause:
        steps, fit = cause_selection.choose_equivalent_cause(dataset, base_fit, steps, fit, cause)
    outcome = _build_diagnosis(dataset, base_fit, fit, steps, first_ranking, applicable, validate)
    if leave_one_file_out:
        report("leaving one file out", 1.0)
        left_out = predict_left_out(dataset, outcome.baseline, outcome.extended)
        outcome = outcome._replace(left_out=left_out)
    outcome = outcome._replace(laws=law, loads=result.loads, untried=tuple(budget.untried))
    return to_record_units(outcome, scale)


def _recover_dataset_motion(dataset: Dataset, base_fit: Fit) -> tuple[Dataset, Fit]:
    """Return a dataset with the motion that the noise of its travel hides, and its fit.

    A missing motion spoils the fit that is to recover it: so the first fit is robust.
    """
    noisy_records = dataset.records
    if not any(may_hide_motion(record) for record in noisy_records):
        return dataset, refit_baseline(dataset, base_fit)
    fit = base_fit
    if not is_noise(dataset, compute_errors(dataset, base_fit)):
        fit = fit_robustly(dataset, base_fit)
    for _ in range(HIDDEN_MOTION_PASSES):
        recovered = [
            recover_hidden_motion(record, dataset.base, fit.model.shared, own)
            for record, own in zip(noisy_records, fit.model.own, strict=True)
        ]
        dataset = build_dataset(recovered)
        base_fit = fit = refit_baseline(dataset, fit)
    return dataset, base_fit


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
    is_noise_after = is_noise(dataset, errors_after)
    has_function = bool(steps) and steps[-1].effect.function is not None
    is_drifting = not (is_noise_after or has_function) and has_drifting_friction(dataset, fit)
    verdict = decide_verdict(
        steps,
        residual_fraction,
        is_noise_before=is_noise(dataset, errors_before),
        is_noise_after=is_noise_after,
        is_drifting=is_drifting,
    )
    simple_models, learned_models = fit_simple_models(dataset), fit_learned_models(folds)
    foreign_reason = explain_foreign_data(
        dataset, final_fit, errors_after, simple_models, is_open=verdict is Verdict.UNEXPLAINED
    )
    if foreign_reason:
        verdict = Verdict.UNEXPLAINED
    free_names = {effect.name for effect, _ in final_fit.model.effects if effect.function}
    fitted_values = {
        item.name: FittedValue(item.value, item.low, item.high, item.parameter.unit, item.at_bound)
        for item in estimate_intervals(full_dataset, build_contexts(dataset, base_fit), final_fit)
        if item.name.partition(".")[0] not in free_names
    }
    validation_records = prepare_validation_records(dataset, validate, final_base_fit)
    transferred_fit = final_base_fit
    if steps:
        transferred_fit = final_fit._replace(model=transfer_to_validation(dataset, final_fit.model))
    predicted_records = predict_records(
        dataset, final_base_fit, transferred_fit, validation_records
    )
    equivalents = [(step.effect.name, *step.rivals) for step in steps if step.rivals]
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
            channel: bootstrap_gain(errors_after[channel], errors_before[channel])
            for channel in errors_before
        },
        noise=compute_mean_noise(dataset),
        residual_fraction=residual_fraction,
        has_drifting_friction=is_drifting,
        foreign_reason=foreign_reason,
        simple_models=simple_models,
        simple_gain=compute_simple_gains(errors_after, simple_models),
        learned_models=learned_models,
        learned_gain=compute_learned_gains(errors_after, learned_models),
        residual_dependences=find_residual_dependence(dataset, fit),
        detection_limits=compute_detection_limits(dataset, base_fit, applicable)
        if verdict is Verdict.CLEAN
        else {},
        laws=Choice(dataset, base_fit, ()),
        loads=Choice(dataset, base_fit, ()),
        experiments=outcome.suggest_experiments(equivalents, dataset.records[0].signals),
        issues=tuple(issue for record in dataset.records for issue in record.issues),
        fit_all=all(record.train.all() for record in dataset.records),
        rivals=cause_selection.fit_rivals(
            dataset, base_fit, final_fit, cause_selection.find_equivalent_causes(steps)
        ),
        validation=predicted_records,
        live_error=compute_live_error(folds, float(max(r.time[-1] for r in dataset.records)))
        if steps
        else None,
        curve=estimate_curve(full_dataset, build_contexts(dataset, base_fit), final_fit),
    )
