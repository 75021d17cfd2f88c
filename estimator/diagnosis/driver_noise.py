"""What the noise of the driver does to records, as a fitted model has it.

Its travel is not exact: it adds to the noise of every channel, most behind reversals, and it hides
small motions. What it does there depends on friction and sensors, so both are found anew whenever
the model has another cause.
"""

from collections.abc import Callable, Sequence

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, simulated, with_records
from estimator.diagnosis.hidden_motion import Housing, with_hidden_motion
from estimator.diagnosis.model import TAUT, Simulated, plain_physics, simulate
from estimator.diagnosis.record import Record, with_driver_noise
from estimator.effects.effect import PROXIMAL_TENSION, EffectContext

Refit = Callable[[Dataset, Fit], Fit]


def as_driven(
    dataset: Dataset,
    about: Sequence[EffectContext],
    fit: Fit,
    refit: Refit,
    first: Refit | None = None,
) -> tuple[Dataset, Fit]:
    """Return a dataset with the noise and the hidden motion of its driver, and the model refitted.

    Parameters
    ----------
    dataset : Dataset
        Of records as they were prepared.
    about : sequence of EffectContext
        What effects may know of each record.
    fit : Fit
        The model.
    refit : callable
        Fits the model again, to a dataset of the same records.
    first : callable, optional
        The same while hidden motion is not in the records yet; `refit` by default.
    """
    noisy = [
        with_driver_noise(record, simulator)
        for record, simulator in zip(dataset.records, _simulators(dataset, about, fit), strict=True)
    ]
    if all(new is old for new, old in zip(noisy, dataset.records, strict=True)):
        return dataset, fit
    dataset = with_records(dataset, noisy)
    fit = (first or refit)(dataset, fit)
    fit = simulated(dataset, about, fit.model)
    moved = [
        with_hidden_motion(record, _housing(dataset, about[k], fit, k))
        for k, record in enumerate(noisy)
    ]
    dataset = with_records(dataset, moved)
    return dataset, refit(dataset, fit)


def _simulators(
    dataset: Dataset, about: Sequence[EffectContext], fit: Fit
) -> list[Callable[[Record], Simulated]]:
    """Return for each record a function that simulates it again, with another drive."""

    def of(k: int) -> Callable[[Record], Simulated]:
        model, own = fit.model, fit.model.own[k]
        return lambda other: simulate(
            other, about[k], dataset.base, model.shared, own, model.effects
        )

    return [of(k) for k in range(len(dataset.records))]


def _housing(dataset: Dataset, context: EffectContext, fit: Fit, k: int) -> Housing:
    """Return the tendon of one record and the errors of its sensors at the housing."""
    record, model, one = dataset.records[k], fit.model, fit.simulated[k]
    values = dataset.base.values(model.shared, model.own[k])
    physics, travel = plain_physics(record, dataset.base, values), record.drive
    for effect, numbers in model.effects:
        physics = effect.physics(physics, numbers, context)
    for effect, numbers in reversed(model.effects):
        travel = effect.invert(travel, numbers, context)
    return Housing(
        physics,
        record.drive - travel + values.get(TAUT.name, 0.0),
        np.asarray(one.signals[PROXIMAL_TENSION] - one.motion.proximal_tension)
        if PROXIMAL_TENSION in one.signals
        else np.zeros_like(record.time),
    )
