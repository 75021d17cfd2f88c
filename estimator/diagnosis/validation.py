"""How an extended model holds on what it was not fitted to, and how it estimates the force."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    BaseLaw,
    Dataset,
    Fit,
    Model,
    build_contexts,
    build_unsimulated_contexts,
    compute_residual,
    compute_tolerance,
    estimate_taut_travel,
    replace_records,
    rescale_residuals,
    simulate_dataset,
    subsample,
    use_all_samples,
)
from estimator.diagnosis.fit import compute_jacobian, fit_model, fit_record_parameters, refit_subset
from estimator.diagnosis.hidden_motion import propagate_driver_noise, recover_hidden_motion
from estimator.diagnosis.outcome import (
    DetectionLimit,
    ErrorStatistics,
    FileForce,
    ForceError,
    LiveError,
    ModelErrors,
    PredictedRecord,
    RivalForce,
    compute_error_statistics,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.scoring import compute_errors, compute_residual_fraction
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_TENSION,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
    EffectContext,
    Values,
)
from estimator.effects.functions import (
    COEFFICIENTS,
    FRICTION_BY_TIME,
    compute_basis,
    penalise,
)
from estimator.lumped.lumped_model import Physics
from estimator.measured_data import MeasuredData, Samples
from estimator.online.estimator import Estimator
from estimator.online.extended_model import (
    FUNCTIONS_AT_END,
    apply_lasting_friction,
    build_extended_model,
    is_record_specific,
)
from estimator.online.force_error import Score
from estimator.online.tendon_model import TendonModel
from estimator.signals.spikes import remove_spikes

# --- records that a model was not fitted to, predicted by it: validation, and leave-one-file-out


LEFT_OUT_ROUNDS = 12  # of a fit to the other files


def predict_records(
    fitted: Dataset, base_fit: Fit, fit: Fit, records: Sequence[Record]
) -> tuple[PredictedRecord, ...]:
    """Return records as two models of a dataset predict them; only where each starts is fitted."""
    if not records:
        return ()
    dataset = use_all_samples(replace_records(fitted, records))
    before, after = fit_record_parameters(dataset, base_fit), fit_record_parameters(dataset, fit)
    return tuple(
        PredictedRecord(*row)
        for row in zip(dataset.records, before.simulated, after.simulated, strict=True)
    )


def prepare_validation_records(
    fitted: Dataset, records: Sequence[Record], base_fit: Fit
) -> tuple[Record, ...]:
    """Return records that were not fitted with what the noise of their drive does, as fitted ones.

    `base_fit` is the base law, fitted to a dataset of other records.
    """
    if not records:
        return ()
    dataset = use_all_samples(replace_records(fitted, records))
    fit = fit_record_parameters(dataset, base_fit)
    noisy_records = propagate_driver_noise(records, dataset, fit)
    if all(new is old for new, old in zip(noisy_records, records, strict=True)):
        return tuple(records)
    own = fit_record_parameters(
        use_all_samples(replace_records(fitted, noisy_records)), base_fit
    ).model.own
    return tuple(
        recover_hidden_motion(record, fitted.base, base_fit.model.shared, record_own)
        for record, record_own in zip(noisy_records, own, strict=True)
    )


def predict_left_out(dataset: Dataset, base_fit: Fit, fit: Fit) -> tuple[PredictedRecord, ...]:
    """Return each record as the models predict it whose numbers the other records gave.

    The causes are those of all records; their sizes and the law's parameters are fitted without the
    record.
    """
    predicted: list[PredictedRecord] = []
    for k, record in enumerate(dataset.records):
        remaining = use_all_samples(_drop_record(dataset, k))
        fits = [_drop_record_fit(model_fit, k) for model_fit in (base_fit, fit)]
        contexts = build_contexts(remaining, fits[0])
        before, after = (
            fit_model(
                rescale_residuals(remaining, model_fit), contexts, model_fit.model, LEFT_OUT_ROUNDS
            )
            for model_fit in fits
        )
        predicted += predict_records(dataset, before, after, [replace(record, file=0)])
    return tuple(predicted)


def _drop_record(dataset: Dataset, k: int) -> Dataset:
    return dataset._replace(
        records=dataset.records[:k] + dataset.records[k + 1 :],
        scale=dataset.scale[:k] + dataset.scale[k + 1 :],
    )


def _drop_record_fit(fit: Fit, k: int) -> Fit:
    own = fit.model.own[:k] + fit.model.own[k + 1 :]
    return Fit(fit.model._replace(own=own), fit.simulated[:k] + fit.simulated[k + 1 :])


# --- free friction over time, the reference for causes in time
# A step or a drift is the nearest of the catalogue to friction that wanders, and takes most of it
# up. It is not the cause if a course that is free to be anything does far better.

FRICTION_TIME_EFFECTS = frozenset({"friction_step", "friction_drift"})
FRICTION_ROUNDS = 25
COURSE_ROUGHNESS = 0.1  # residuals per step of a second difference


def has_drifting_friction(dataset: Dataset, fit: Fit) -> bool:
    """Return whether friction takes another course over time than a model's causes say.

    Both are fitted to all samples: a course that is free has no say about a time that is held out.
    """
    time_effects = [
        effect for effect, _ in fit.model.effects if effect.name in FRICTION_TIME_EFFECTS
    ]
    if not time_effects:
        return False
    full_dataset = use_all_samples(dataset)
    cause_fit = fit_model(
        rescale_residuals(full_dataset, fit),
        build_contexts(full_dataset, fit),
        fit.model,
        FRICTION_ROUNDS,
    )
    return any(
        _is_far_better(
            full_dataset, fit_time_varying_friction(full_dataset, cause_fit, time_effect), cause_fit
        )
        for time_effect in time_effects
    )


def _is_far_better(dataset: Dataset, free_fit: Fit, cause_fit: Fit) -> bool:
    free_errors, cause_errors = (
        compute_errors(dataset, fit, held_out=False) for fit in (free_fit, cause_fit)
    )
    return compute_residual_fraction(free_errors, cause_errors) < SETTINGS.free_function_fraction


def fit_time_varying_friction(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model in which friction takes any course instead of what `effect` says of it."""
    contexts = build_contexts(dataset, fit)
    others = tuple(pair for pair in fit.model.effects if pair[0].name != effect.name)
    course = penalise(FRICTION_BY_TIME, COURSE_ROUGHNESS, COURSE_ROUGHNESS, None)
    # begun at what the cause says, which the law has not taken up
    unit = Physics(np.ones_like(contexts[0].time), 1.0, np.ones(1))
    values = dict(fit.model.effects)[effect]
    change = effect.physics(unit, values, contexts[0]).friction - 1.0
    ends = (0.0, max(float(np.ptp(context.time)) for context in contexts))
    basis = compute_basis(course, (*ends, *(COEFFICIENTS * [0.0])), contexts[0].time)
    c = np.linalg.lstsq(basis, change, rcond=None)[0].clip(-0.9, 5.0).tolist()
    model = fit.model._replace(effects=(*others, (course, (*ends, *c))))
    return fit_model(rescale_residuals(dataset, fit), contexts, model, FRICTION_ROUNDS)


# --- what of an extended model holds for records of another day, as it does in the loop


def transfer_to_validation(dataset: Dataset, model: Model) -> Model:
    """Return a model of a dataset for other records.

    What happened in a record is left out. Friction that changed in it stays as it was at the end of
    the longest, and over a cycle, whose phase nothing tells, at its mean.
    """
    end = max(float(record.time[-1]) for record in dataset.records)
    frozen = FRICTION_TIME_EFFECTS | FUNCTIONS_AT_END | {"friction_by_phase"}
    return model._replace(
        effects=tuple(
            (
                _freeze_friction(end, effect) if effect.name in frozen else effect,
                values,
            )
            for effect, values in model.effects
            if not is_record_specific(effect)
        )
    )


def _freeze_friction(end: float, effect: Effect) -> Effect:
    """Return an effect on friction that stays as it is at a time [s]."""

    def physics(base_physics: Physics, values: Values, context: EffectContext) -> Physics:
        if effect.function is not None:
            return apply_lasting_friction(base_physics, values, effect)
        unit_physics = base_physics._replace(friction=np.ones(2))
        end_physics = effect.physics(
            unit_physics, values, context._replace(time=np.array([0.0, end]))
        )
        return base_physics._replace(friction=base_physics.friction * end_physics.friction[-1])

    return replace(effect, physics=physics)


# --- two-fold cross-validation: one half of the samples is fitted, the other judges

FOLD_ROUNDS = 12  # of a fit to one half


class Fold(NamedTuple):
    """A dataset of which one half is fitted, and the plain and the extended model fitted to it."""

    dataset: Dataset
    fits: tuple[Fit, Fit]


def fit_folds(dataset: Dataset, base_fit: Fit, fit: Fit) -> tuple[Fold, ...]:
    """Return both ways to fit one half of the samples and to be judged by the other.

    Where all samples are fitted, they are judged as well.
    """
    contexts = build_contexts(dataset, base_fit)
    full_dataset = use_all_samples(dataset)
    if all(record.train.all() for record in dataset.records):
        return (Fold(dataset, (base_fit, fit)),)

    def fold(half: Dataset) -> Fold:
        half_base_fit, half_fit = (
            refit_subset(
                rescale_residuals(half, model_fit),
                rescale_residuals(full_dataset, model_fit),
                contexts,
                model_fit,
                FOLD_ROUNDS,
            )
            for model_fit in (base_fit, fit)
        )
        return Fold(half, (half_base_fit, half_fit))

    swapped_records = tuple(replace(record, train=~record.train) for record in dataset.records)
    return fold(dataset), fold(dataset._replace(records=swapped_records))


def compute_model_errors(
    folds: tuple[Fold, ...], model_index: int, predicted: Sequence[PredictedRecord]
) -> ModelErrors:
    """Return the errors of the plain (0) or the extended (1) model on all sets of samples."""
    return ModelErrors(
        _compute_fold_errors(folds, model_index, fitted=True),
        _compute_fold_errors(folds, model_index, fitted=False),
        _compute_validation_errors(predicted, model_index),
    )


def _compute_fold_errors(
    folds: Sequence[Fold], model_index: int, *, fitted: bool
) -> dict[str, ErrorStatistics]:
    statistics = {}
    for channel in folds[0].dataset.records[0].compared:
        errors, full_scale = [], 0.0
        for fold in folds:
            for record, simulated in zip(
                fold.dataset.records, fold.fits[model_index].simulated, strict=True
            ):
                samples = record.train if record.train.all() else record.train == fitted
                rows = record.valid[channel] & samples
                errors.append((record.signals[channel] - simulated.signals[channel])[rows])
                full_scale = max(full_scale, float(np.ptp(record.signals[channel])))
        statistics[channel] = compute_error_statistics(errors, full_scale)
    return statistics


def _compute_validation_errors(
    predicted: Sequence[PredictedRecord], model_index: int
) -> dict[str, ErrorStatistics]:
    """Return how far a model is off in all records that it predicts."""
    channels = predicted[0].record.compared if predicted else ()
    statistics = {}
    for channel in channels:
        errors = [
            record.residual((record.before, record.after)[model_index], channel)
            for record in predicted
        ]
        full_scale = max(float(np.ptp(record.record.signals[channel])) for record in predicted)
        statistics[channel] = compute_error_statistics(errors, full_scale)
    return statistics


# --- smallest detectable effect size on a clean dataset

SUBSAMPLE_SIZE = 3000  # samples of a record, of which the rms of a change is taken


def compute_detection_limits(
    dataset: Dataset, fit: Fit, effects: Sequence[Effect]
) -> dict[str, DetectionLimit]:
    """Return for each effect the size at which it would have been seen; none where it could not.

    By a linear step from its starts: what the model's own parameters do not take up grows with the
    size, until some channel is off by more than noise and the simulation's own error make it.
    """
    dataset = subsample(dataset, SUBSAMPLE_SIZE)
    fit = simulate_dataset(dataset, build_unsimulated_contexts(dataset, fit), fit.model)
    contexts = build_contexts(dataset, fit)
    residual = compute_residual(dataset, fit)
    basis, _ = np.linalg.qr(compute_jacobian(dataset, contexts, fit))
    limits: dict[str, DetectionLimit] = {}
    for effect in effects:
        amplitude = effect.parameters[0]
        if amplitude.neutral is None:
            continue
        for values in effect.starts(contexts[0]):
            if values[0] == amplitude.neutral:
                continue
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = (
                compute_residual(dataset, simulate_dataset(dataset, contexts, model)) - residual
            )
            change -= basis @ (basis.T @ change)
            ratio = _compute_detection_ratio(dataset, fit, change)
            size = abs(values[0] - amplitude.neutral) / ratio if ratio > 0.0 else math.inf
            smallest = limits.get(effect.name)
            size_max = max(
                abs(amplitude.low - amplitude.neutral), abs(amplitude.high - amplitude.neutral)
            )
            if size < size_max and (smallest is None or size < smallest.size):
                limits[effect.name] = DetectionLimit(amplitude.name, size, amplitude.unit)
    return limits


def _compute_detection_ratio(dataset: Dataset, fit: Fit, change: Array) -> float:
    """Return how many times the least that would be seen a change of the residual is."""
    tolerance = compute_tolerance(dataset)
    squares, counts, offset = dict.fromkeys(tolerance, 0.0), dict.fromkeys(tolerance, 0), 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        for channel in record.compared:
            rows = record.train & record.valid[channel]
            count = int(rows.sum())
            noises = (scale[channel] / record.sigma[channel])[rows]
            squares[channel] += float(np.sum((noises * change[offset : offset + count]) ** 2))
            counts[channel] += count
            offset += count
        offset += estimate_taut_travel(record, dataset.base, fit.model) is not None
    shares = [
        math.sqrt(
            squares[c] / max(counts[c], 1) / ((SETTINGS.noise_ratio * tolerance[c]) ** 2 - 1.0)
        )
        for c in tolerance
    ]
    return max(shares) if np.isfinite(shares).all() else 0.0


# --- the force at the tip that a loop would estimate with a model, and how far off it is
# The numbers are those of `teleop estimate` and `teleop run --replay` with the model's file: the
# same estimator (estimator.online), the same noise, the same spikes excluded, and the same
# comparison with what the load cell at the tip reads (estimator.online.force_error).

SHEATH_LENGTH = 1.0  # [m] of the sheath: elongation and force go by L/EA
END_SHARE = 0.1  # of a record, in which friction that changes is taken as it ended


def build_tendon_model(model: Model, duration: float, data: MeasuredData) -> TendonModel:
    """Return the estimator's model of a diagnosis's, with the noise of a record.

    Parameters
    ----------
    model : Model
    duration : float
        Of the longest fitted record [s]; friction is taken as at its end.
    """
    stiffness = SHEATH_LENGTH / SETTINGS.assumed_compliance
    extended = build_extended_model(model.shared, model.effects, duration, SHEATH_LENGTH, stiffness)
    travel = data.proximal_displacement
    return TendonModel(
        extended.sheath,
        tension_noise=noise_treatment.estimate_noise_sigma(data.proximal_tension),
        displacement_noise=0.0 if travel is None else noise_treatment.estimate_noise_sigma(travel),
        extension=extended.extension,
        tip_effects=extended.tip_effects,
    )


def estimate_force(model: Model, duration: float, data: MeasuredData) -> Array:
    """Return the estimated force [N] of rows that have all that it is estimated from."""
    data = _select_complete_rows(data)
    return Estimator(build_tendon_model(model, duration, data)).run(remove_spikes(data)).tension


def compute_force_error(model: Model, duration: float, data: MeasuredData) -> ForceError | None:
    """Return how far the estimated force is off in a record; None without a cell at the tip."""
    data = _select_complete_rows(data)
    clean = remove_spikes(data)
    reading = clean.distal_tension
    if reading is None or data.distal_tension is None:
        return None
    tendon_model = build_tendon_model(model, duration, data)
    estimates = Estimator(tendon_model).run(clean)
    score = Score([tendon_model])
    score.add_columns(estimates.distal_tension, estimates.low, estimates.high, reading)
    summary = score.summarise()
    if summary is None:
        return None
    return ForceError(
        summary["rmse_N"],
        summary["mean_N"],
        summary["max_N"],
        summary["full_scale_N"],
        summary["samples"],
        int(np.isnan(reading).sum() - np.isnan(data.distal_tension).sum()),
    )


def compute_live_error(folds: Sequence[Fold], duration: float) -> LiveError | None:
    """Return how far the force is off in samples that were not fitted, live, with both models.

    None where the loop runs no such model, nothing tells the force, or something happened in one
    record only. Friction that is taken as it ended is judged by the end of the longest record.
    """
    dataset = folds[0].dataset
    first = dataset.records[0]
    if first.loop or first.units.rotary or dataset.base.law is not BaseLaw.CAPSTAN:
        return None
    as_ended = FRICTION_TIME_EFFECTS | FUNCTIONS_AT_END
    effects = [effect for effect, _ in folds[0].fits[1].model.effects]
    if any(map(is_record_specific, effects)):
        return None
    has_changed = any(effect.name in as_ended for effect in effects)
    begin = (1.0 - END_SHARE) * duration if has_changed else 0.0
    squares, samples = np.zeros(2), 0
    for fold in folds:
        for record in fold.dataset.records:
            is_judged = record.measured & (~record.train | record.train.all())
            is_judged = is_judged & (record.time >= begin)
            tip = record.signals.get(DISTAL_TENSION)
            if tip is not None:
                tip = np.where(is_judged & record.valid[DISTAL_TENSION], tip, np.nan)
            travel = record.signals.get(PROXIMAL_DISPLACEMENT)
            data = Samples(record.time, record.signals[PROXIMAL_TENSION], travel, tip)
            errors = [compute_force_error(fit.model, duration, data) for fit in fold.fits]
            if errors[0] is None or errors[1] is None:
                continue
            squares += [error.samples * error.rmse**2 for error in errors if error is not None]
            samples += errors[0].samples
    return LiveError(*np.sqrt(squares / samples).tolist()) if samples else None


def _select_complete_rows(data: MeasuredData) -> Samples:
    """Return the rows of a record in which nothing is missing that the force is estimated from."""
    travel, tip = data.proximal_displacement, data.distal_tension
    rows = np.isfinite(data.proximal_tension)
    if travel is not None:
        rows &= np.isfinite(travel)
        travel = travel[rows]
    tip = None if tip is None else np.where(np.isfinite(tip), tip, np.nan)[rows]
    return Samples(data.time[rows], data.proximal_tension[rows], travel, tip)


def compute_file_force(
    base_model: Model, model: Model, duration: float, data: MeasuredData, *, validation: bool
) -> FileForce | None:
    """Return the errors of the force in a record; None without a cell at the tip."""
    before, after = (
        compute_force_error(trial_model, duration, data) for trial_model in (base_model, model)
    )
    return None if before is None or after is None else FileForce(validation, before, after)


def compute_rival_force(
    model: Model,
    rival: Model,
    names: tuple[str, str],
    duration: float,
    records: Sequence[MeasuredData],
) -> RivalForce:
    """Return what a rival would do to the force; `names` are the cause it replaces and its own."""
    forces = [estimate_force(model, duration, data) for data in records]
    rival_forces = [estimate_force(rival, duration, data) for data in records]
    change = np.abs(np.concatenate(rival_forces) - np.concatenate(forces))
    full_scale = max(float(force.max()) for force in forces)
    return RivalForce(*names, float(change.mean()), float(change.max()), full_scale)
