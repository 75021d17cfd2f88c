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
    in_time = [effect for effect, _ in fit.model.effects if effect.name in FRICTION_TIME_EFFECTS]
    if not in_time:
        return False
    full = use_all_samples(dataset)
    described = fit_model(
        rescale_residuals(full, fit), build_contexts(full, fit), fit.model, FRICTION_ROUNDS
    )
    return any(
        _is_far_better(full, fit_time_varying_friction(full, described, one), described)
        for one in in_time
    )


def _is_far_better(dataset: Dataset, free: Fit, described: Fit) -> bool:
    a, b = (compute_errors(dataset, one, held_out=False) for one in (free, described))
    return compute_residual_fraction(a, b) < SETTINGS.free_friction


def fit_time_varying_friction(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model in which friction takes any course instead of what `effect` says of it."""
    about = build_contexts(dataset, fit)
    rest: list[tuple[Effect, Values]] = []
    course: Values = (0.0,) * KNOTS
    for one, values in fit.model.effects:
        if one.name != effect.name:
            rest.append((one, values))
            continue
        plain = Physics(np.ones_like(about[0].time), 1.0, np.ones(1))
        change = one.physics(plain, values, about[0]).friction - 1.0
        course = tuple(np.interp(_place_knots(about[0]), about[0].time, change).tolist())
    model = fit.model._replace(effects=(*rest, (FRICTION_COURSE, course)))
    return fit_model(rescale_residuals(dataset, fit), about, model, FRICTION_ROUNDS)


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

    def physics(before: Physics, values: Values, context: EffectContext) -> Physics:
        unit = before._replace(friction=np.ones(2))
        late = effect.physics(unit, values, context._replace(time=np.array([0.0, end])))
        return before._replace(friction=before.friction * late.friction[-1])

    return replace(effect, physics=physics)


# --- two-fold cross-validation: one half of the samples is fitted, the other judges

FOLD_ROUNDS = 12  # of a fit to one half


class Fold(NamedTuple):
    """A dataset of which one half is fitted, and the plain and the extended model fitted to it."""

    dataset: Dataset
    fits: tuple[Fit, Fit]


def fit_folds(dataset: Dataset, plain: Fit, fit: Fit) -> tuple[Fold, ...]:
    """Return both ways to fit one half of the samples and to be judged by the other.

    Where all samples are fitted, they are judged as well.
    """
    about = build_contexts(dataset, plain)
    full = use_all_samples(dataset)
    if all(record.train.all() for record in dataset.records):
        return (Fold(dataset, (plain, fit)),)

    def fold(half: Dataset) -> Fold:
        before, after = (
            refit_subset(
                rescale_residuals(half, one), rescale_residuals(full, one), about, one, FOLD_ROUNDS
            )
            for one in (plain, fit)
        )
        return Fold(half, (before, after))

    swapped = tuple(replace(record, train=~record.train) for record in dataset.records)
    return fold(dataset), fold(dataset._replace(records=swapped))


def compute_model_errors(
    folds: tuple[Fold, ...], which: int, further: Sequence[PredictedRecord]
) -> ModelErrors:
    """Return the errors of the plain (0) or the extended (1) model on all sets of samples."""
    return ModelErrors(
        _compute_fold_errors(folds, which, fitted=True),
        _compute_fold_errors(folds, which, fitted=False),
        _compute_validation_errors(further, which),
    )


def _compute_fold_errors(
    folds: Sequence[Fold], which: int, *, fitted: bool
) -> dict[str, ErrorStatistics]:
    found = {}
    for channel in folds[0].dataset.records[0].compared:
        off, full = [], 0.0
        for fold in folds:
            for record, one in zip(fold.dataset.records, fold.fits[which].simulated, strict=True):
                judged = record.train if record.train.all() else record.train == fitted
                rows = record.good[channel] & judged
                off.append((record.signals[channel] - one.signals[channel])[rows])
                full = max(full, float(np.ptp(record.signals[channel])))
        found[channel] = compute_error_statistics(off, full)
    return found


def _compute_validation_errors(
    further: Sequence[PredictedRecord], which: int
) -> dict[str, ErrorStatistics]:
    """Return how far a model is off in all records that it predicts."""
    channels = further[0].record.compared if further else ()
    found = {}
    for channel in channels:
        off = [one.residual((one.before, one.after)[which], channel) for one in further]
        full = max(float(np.ptp(one.record.signals[channel])) for one in further)
        found[channel] = compute_error_statistics(off, full)
    return found


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
    about = build_contexts(dataset, fit)
    r = compute_residual(dataset, fit)
    basis, _ = np.linalg.qr(compute_jacobian(dataset, about, fit))
    found: dict[str, DetectionLimit] = {}
    for effect in effects:
        first = effect.parameters[0]
        if first.neutral is None:
            continue
        for values in effect.starts(about[0]):
            if values[0] == first.neutral:
                continue
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = compute_residual(dataset, simulate_dataset(dataset, about, model)) - r
            change -= basis @ (basis.T @ change)
            share = _compute_detection_ratio(dataset, fit, change)
            size = abs(values[0] - first.neutral) / share if share > 0.0 else math.inf
            known = found.get(effect.name)
            most = max(abs(first.low - first.neutral), abs(first.high - first.neutral))
            if size < most and (known is None or size < known.size):
                found[effect.name] = DetectionLimit(first.name, size, first.unit)
    return found


def _compute_detection_ratio(dataset: Dataset, fit: Fit, change: Array) -> float:
    """Return how many times the least that would be seen a change of the residual is."""
    floor = compute_tolerance(dataset)
    squares, counts, at = dict.fromkeys(floor, 0.0), dict.fromkeys(floor, 0), 0
    for record, scale in zip(dataset.records, dataset.scale, strict=True):
        for channel in record.compared:
            rows = record.train & record.good[channel]
            count = int(rows.sum())
            noises = (scale[channel] / record.sigma[channel])[rows]
            squares[channel] += float(np.sum((noises * change[at : at + count]) ** 2))
            counts[channel] += count
            at += count
        at += estimate_taut_travel(record, dataset.base, fit.model) is not None
    shares = [
        math.sqrt(squares[c] / max(counts[c], 1) / ((SETTINGS.noise_ratio * floor[c]) ** 2 - 1.0))
        for c in floor
    ]
    return max(shares) if np.isfinite(shares).all() else 0.0
