"""Records and their simulation by a model."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.model import (
    BaseLaw,
    BaseParameters,
    LoadModel,
    SimulatedRecord,
    build_base_parameters,
    build_context,
    simulate_record,
)
from estimator.diagnosis.record import (
    Record,
    mark_all_as_train,
    select_record_rows,
    select_subsample,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import PROXIMAL_TENSION, Effect, EffectContext, Values


class Dataset(NamedTuple):
    """Records of one dataset, which share its physics."""

    records: tuple[Record, ...]
    base: BaseParameters
    scale: tuple[dict[str, Array], ...]  # of the residuals, by record and channel


class Model(NamedTuple):
    """A model with its numbers."""

    shared: Values  # of the dataset
    own: tuple[Values, ...]  # of each record
    effects: tuple[tuple[Effect, Values], ...]


class Fit(NamedTuple):
    """A fitted model, and what it makes of each record."""

    model: Model
    simulated: tuple[SimulatedRecord, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect.name for effect, _ in self.model.effects)


class TautEstimate(NamedTuple):
    """Where a record that starts slack is expected to be taut [m], and how surely."""

    travel: float
    uncertainty: float


def build_dataset(
    records: Sequence[Record], law: BaseLaw = BaseLaw.CAPSTAN, loads: LoadModel = LoadModel.SHARED
) -> Dataset:
    """Return a dataset whose residuals are scaled by the noise, or a small share of the range.

    What is not fitted yet is wrong in all channels; one that is measured very finely must not
    decide alone then.
    """
    scale = tuple(
        {
            channel: np.maximum(sigma, SETTINGS.scale_min * float(np.ptp(record.signals[channel])))
            for channel, sigma in record.sigma.items()
        }
        for record in records
    )
    return Dataset(tuple(records), build_base_parameters(records[0], law, loads), scale)


def replace_records(dataset: Dataset, records: Sequence[Record]) -> Dataset:
    """Return a dataset of other records with the same base law and loads."""
    return build_dataset(records, dataset.base.law, dataset.base.loads)


def replace_base(dataset: Dataset, law: BaseLaw, loads: LoadModel = LoadModel.SHARED) -> Dataset:
    """Return the same records with another base law or other loads."""
    return build_dataset(dataset.records, law, loads)


def use_all_samples(dataset: Dataset) -> Dataset:
    """Return a dataset of which all samples are fitted."""
    return dataset._replace(records=tuple(map(mark_all_as_train, dataset.records)))


def subsample(dataset: Dataset, samples_max: int) -> Dataset:
    """Return a dataset of about `samples_max` samples a record, for a first look."""
    row_masks = [select_subsample(record, samples_max) for record in dataset.records]
    return dataset._replace(
        records=tuple(
            select_record_rows(*pair) for pair in zip(dataset.records, row_masks, strict=True)
        ),
        scale=tuple(
            {channel: values[rows] for channel, values in scale.items()}
            for scale, rows in zip(dataset.scale, row_masks, strict=True)
        ),
    )


def compute_mean_noise(dataset: Dataset) -> dict[str, float]:
    """Return the expected rms error of each channel by noise, in its unit."""
    return {
        channel: math.sqrt(float(np.mean(variance)))
        for channel, variance in _collect_variances(dataset).items()
    }


def compute_tolerance(dataset: Dataset) -> dict[str, float]:
    """Return the tolerated rms error of each channel, relative to `Record.sigma`.

    By noise, and by the `Settings.accuracy` of a simulation.
    """
    tolerances = {}
    for channel, variance in _collect_variances(dataset).items():
        range_max = max(float(np.ptp(record.signals[channel])) for record in dataset.records)
        error_bound = SETTINGS.accuracy * range_max
        tolerances[channel] = math.sqrt(1.0 + float(np.mean(error_bound**2 / variance)))
    return tolerances


def _collect_variances(dataset: Dataset) -> dict[str, Array]:
    return {
        channel: np.concatenate(
            [record.sigma[channel][record.good[channel]] ** 2 for record in dataset.records]
        )
        for channel in dataset.records[0].compared
    }


def rescale_residuals(dataset: Dataset, fit: Fit) -> Dataset:
    """Return a dataset whose residuals are scaled by noise and a share of the fit's residual."""
    scale = []
    for record, simulated in zip(dataset.records, fit.simulated, strict=True):
        record_scale = {}
        for channel in record.compared:
            error = (simulated.signals[channel] - record.signals[channel])[record.good[channel]]
            residual_part = SETTINGS.residual_share * float(error.std())
            record_scale[channel] = np.hypot(record.sigma[channel], residual_part)
        scale.append(record_scale)
    return dataset._replace(scale=tuple(scale))


def build_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of each record beside a model without them."""
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(
        build_context(record, simulated, compliance)
        for record, simulated in zip(dataset.records, fit.simulated, strict=True)
    )


def build_unsimulated_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of records that have not been simulated yet."""
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(build_context(record, None, compliance) for record in dataset.records)


def simulate_dataset(dataset: Dataset, contexts: Sequence[EffectContext], model: Model) -> Fit:
    """Return a model with what it makes of each record."""
    simulated = tuple(
        simulate_record(record, context, dataset.base, model.shared, own, model.effects)
        for record, context, own in zip(dataset.records, contexts, model.own, strict=True)
    )
    return Fit(model, simulated)


def compute_residual(dataset: Dataset, fit: Fit) -> Array:
    """Return what is fitted: simulated less measured where it counts, and what is expected."""
    parts = []
    for record, simulated, scale, own in zip(
        dataset.records, fit.simulated, dataset.scale, fit.model.own, strict=True
    ):
        for channel in record.compared:
            is_counted = record.train & record.good[channel]
            error = simulated.signals[channel] - record.signals[channel]
            parts.append((error / scale[channel])[is_counted])
        expected = estimate_taut_travel(record, dataset.base, fit.model)
        if expected is not None:
            parts.append(np.array([(own[0] - expected.travel) / expected.uncertainty]))
    return np.concatenate(parts)


def compute_cost(dataset: Dataset, fit: Fit) -> float:
    """Return what a fit makes as small as it can."""
    return float(np.sum(compute_residual(dataset, fit) ** 2))


def estimate_taut_travel(record: Record, base: BaseParameters, model: Model) -> TautEstimate | None:
    """Return where the motor must be for the first tension that was read, in a slack start."""
    compliance = base.compliance(model.shared)
    if compliance is None or not record.starts_slack:
        return None
    sigma = record.noise[PROXIMAL_TENSION]
    drive, tensions = record.first_tensions
    return TautEstimate(
        drive - compliance * max(0.0, float(tensions.mean())),
        max(SETTINGS.taut_sigma * compliance * sigma, SETTINGS.taut_sigma_min),
    )
