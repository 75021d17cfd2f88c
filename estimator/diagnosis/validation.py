"""Piecewise-linear friction over time, the reference for causes in time.

A step or a drift is the nearest of the catalogue to friction that wanders, and takes most of it up.
It is not the cause if a course that is free to be anything does far better.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    build_contexts,
    build_unsimulated_contexts,
    compute_residual,
    compute_tolerance,
    estimate_taut_travel,
    rescale_residuals,
    simulate_dataset,
    subsample,
    use_all_samples,
)
from estimator.diagnosis.fit import compute_jacobian, fit_model, refit_subset
from estimator.diagnosis.outcome import DetectionLimit, ModelErrors
from estimator.diagnosis.prediction import (
    ErrorStatistics,
    PredictedRecord,
    compute_error_statistics,
)
from estimator.diagnosis.score import compute_errors, compute_residual_fraction
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect, EffectContext, Parameter, Values
from estimator.lumped.lumped_model import Physics
from estimator.online.extension import is_record_specific

KNOTS = 20
FRICTION_TIME_EFFECTS = frozenset({"friction_step", "friction_drift"})
FRICTION_ROUNDS = 25


def _place_knots(context: EffectContext) -> Array:
    return np.linspace(context.time[0], context.time[-1], KNOTS)


def _apply_friction_course(physics: Physics, values: Values, context: EffectContext) -> Physics:
    share = 1.0 + np.interp(context.time, _place_knots(context), values)
    return physics._replace(friction=physics.friction * share)


FRICTION_COURSE = Effect(
    name="friction_course",
    cause="friction changes with time, neither at once nor steadily",
    equation="K(t) = K (1 + c(t)), c linear between its knots",
    parameters=tuple(Parameter(f"change_{k}", "", -0.9, 5.0, 0.05) for k in range(1, KNOTS + 1)),
    source="no law: what is free to follow the data",
    advice="Look for what comes and goes: a sheath that is moved, temperature, lubricant.",
    starts=lambda _: [(0.0,) * KNOTS],
    physics=_apply_friction_course,
)


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
    return compute_residual_fraction(free_errors, cause_errors) < SETTINGS.free_friction


def fit_time_varying_friction(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model in which friction takes any course instead of what `effect` says of it."""
    contexts = build_contexts(dataset, fit)
    other_effects: list[tuple[Effect, Values]] = []
    course: Values = (0.0,) * KNOTS
    for other_effect, values in fit.model.effects:
        if other_effect.name != effect.name:
            other_effects.append((other_effect, values))
            continue
        unit_physics = Physics(np.ones_like(contexts[0].time), 1.0, np.ones(1))
        change = other_effect.physics(unit_physics, values, contexts[0]).friction - 1.0
        course = tuple(np.interp(_place_knots(contexts[0]), contexts[0].time, change).tolist())
    model = fit.model._replace(effects=(*other_effects, (FRICTION_COURSE, course)))
    return fit_model(rescale_residuals(dataset, fit), contexts, model, FRICTION_ROUNDS)


# --- what of an extended model holds for records of another day, as it does in the loop


def transfer_to_validation(dataset: Dataset, model: Model) -> Model:
    """Return a model of a dataset for other records.

    What happened in a record is left out, and friction that changed in it stays as it was at the
    end of the longest.
    """
    end = max(float(record.time[-1]) for record in dataset.records)
    return model._replace(
        effects=tuple(
            (
                _freeze_friction(end, effect) if effect.name in FRICTION_TIME_EFFECTS else effect,
                values,
            )
            for effect, values in model.effects
            if not is_record_specific(effect)
        )
    )


def _freeze_friction(end: float, effect: Effect) -> Effect:
    """Return an effect on friction that stays as it is at a time [s]."""

    def physics(base_physics: Physics, values: Values, context: EffectContext) -> Physics:
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
    folds: tuple[Fold, ...], which: int, predicted: Sequence[PredictedRecord]
) -> ModelErrors:
    """Return the errors of the plain (0) or the extended (1) model on all sets of samples."""
    return ModelErrors(
        _compute_fold_errors(folds, which, fitted=True),
        _compute_fold_errors(folds, which, fitted=False),
        _compute_validation_errors(predicted, which),
    )


def _compute_fold_errors(
    folds: Sequence[Fold], which: int, *, fitted: bool
) -> dict[str, ErrorStatistics]:
    statistics = {}
    for channel in folds[0].dataset.records[0].compared:
        errors, full_scale = [], 0.0
        for fold in folds:
            for record, simulated in zip(
                fold.dataset.records, fold.fits[which].simulated, strict=True
            ):
                samples = record.train if record.train.all() else record.train == fitted
                rows = record.good[channel] & samples
                errors.append((record.signals[channel] - simulated.signals[channel])[rows])
                full_scale = max(full_scale, float(np.ptp(record.signals[channel])))
        statistics[channel] = compute_error_statistics(errors, full_scale)
    return statistics


def _compute_validation_errors(
    predicted: Sequence[PredictedRecord], which: int
) -> dict[str, ErrorStatistics]:
    """Return how far a model is off in all records that it predicts."""
    channels = predicted[0].record.compared if predicted else ()
    statistics = {}
    for channel in channels:
        errors = [
            record.residual((record.before, record.after)[which], channel) for record in predicted
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
            rows = record.train & record.good[channel]
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
