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


def subsample(dataset: Dataset, most: int) -> Dataset:
    """Return a dataset of about `most` samples a record, for a first look."""
    kept = [select_subsample(record, most) for record in dataset.records]
    return dataset._replace(
        records=tuple(select_record_rows(*one) for one in zip(dataset.records, kept, strict=True)),
        scale=tuple(
            {channel: each[rows] for channel, each in scale.items()}
            for scale, rows in zip(dataset.scale, kept, strict=True)
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
        most = max(float(np.ptp(one.signals[channel])) for one in dataset.records)
        off = SETTINGS.accuracy * most
        tolerances[channel] = math.sqrt(1.0 + float(np.mean(off**2 / variance)))
    return tolerances


def _collect_variances(dataset: Dataset) -> dict[str, Array]:
    return {
        channel: np.concatenate(
            [one.sigma[channel][one.good[channel]] ** 2 for one in dataset.records]
        )
        for channel in dataset.records[0].compared
    }


def rescale_residuals(dataset: Dataset, fit: Fit) -> Dataset:
    """Return a dataset whose residuals are scaled by noise and a share of the fit's residual."""
    scale = []
    for record, one in zip(dataset.records, fit.simulated, strict=True):
        each = {}
        for channel in record.compared:
            off = (one.signals[channel] - record.signals[channel])[record.good[channel]]
            left = SETTINGS.residual_share * float(off.std())
            each[channel] = np.hypot(record.sigma[channel], left)
        scale.append(each)
    return dataset._replace(scale=tuple(scale))


def build_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of each record beside a model without them."""
    elastic = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(
        build_context(record, simulated, elastic)
        for record, simulated in zip(dataset.records, fit.simulated, strict=True)
    )


def build_unsimulated_contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of records that have not been simulated yet."""
    elastic = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(build_context(record, None, elastic) for record in dataset.records)


def simulate_dataset(dataset: Dataset, about: Sequence[EffectContext], model: Model) -> Fit:
    """Return a model with what it makes of each record."""
    done = tuple(
        simulate_record(record, context, dataset.base, model.shared, own, model.effects)
        for record, context, own in zip(dataset.records, about, model.own, strict=True)
    )
    return Fit(model, done)


def compute_residual(dataset: Dataset, fit: Fit) -> Array:
    """Return what is fitted: simulated less measured where it counts, and what is expected."""
    parts = []
    for record, one, scale, own in zip(
        dataset.records, fit.simulated, dataset.scale, fit.model.own, strict=True
    ):
        for channel in record.compared:
            counts = record.train & record.good[channel]
            off = one.signals[channel] - record.signals[channel]
            parts.append((off / scale[channel])[counts])
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
