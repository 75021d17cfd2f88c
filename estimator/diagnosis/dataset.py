"""Records and their simulation by a model."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.model import Base, Loads, Simulated, base_of, scene_of, simulate
from estimator.diagnosis.record import Record, at_rows, first_look, in_full
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.transmission_law import Law
from estimator.effects.effect import PROXIMAL_TENSION, Effect, EffectContext, Values


class Dataset(NamedTuple):
    """Records of one dataset, which share its physics."""

    records: tuple[Record, ...]
    base: Base
    scale: tuple[dict[str, Array], ...]  # of the residuals, by record and channel


class Model(NamedTuple):
    """A model with its numbers."""

    shared: Values  # of the dataset
    own: tuple[Values, ...]  # of each record
    effects: tuple[tuple[Effect, Values], ...]


class Fit(NamedTuple):
    """A fitted model, and what it makes of each record."""

    model: Model
    simulated: tuple[Simulated, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect.name for effect, _ in self.model.effects)


class Expected(NamedTuple):
    """Where a record that starts slack is expected to be taut [m], and how surely."""

    travel: float
    uncertainty: float


def dataset_of(
    records: Sequence[Record], law: Law = Law.CAPSTAN, loads: Loads = Loads.SHARED
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
    return Dataset(tuple(records), base_of(records[0], law, loads), scale)


def with_records(dataset: Dataset, records: Sequence[Record]) -> Dataset:
    """Return a dataset of other records with the same base law and loads."""
    return dataset_of(records, dataset.base.law, dataset.base.loads)


def with_base(dataset: Dataset, law: Law, loads: Loads = Loads.SHARED) -> Dataset:
    """Return the same records with another base law or other loads."""
    return dataset_of(dataset.records, law, loads)


def whole(dataset: Dataset) -> Dataset:
    """Return a dataset of which all samples are fitted."""
    return dataset._replace(records=tuple(map(in_full, dataset.records)))


def thin(dataset: Dataset, most: int) -> Dataset:
    """Return a dataset of about `most` samples a record, for a first look."""
    kept = [first_look(record, most) for record in dataset.records]
    return dataset._replace(
        records=tuple(at_rows(*one) for one in zip(dataset.records, kept, strict=True)),
        scale=tuple(
            {channel: each[rows] for channel, each in scale.items()}
            for scale, rows in zip(dataset.scale, kept, strict=True)
        ),
    )


def mean_noise(dataset: Dataset) -> dict[str, float]:
    """Return the expected rms error of each channel by noise, in its unit."""
    return {
        channel: math.sqrt(float(np.mean(variance)))
        for channel, variance in _variances(dataset).items()
    }


def tolerance(dataset: Dataset) -> dict[str, float]:
    """Return the tolerated rms error of each channel, relative to `Record.sigma`.

    By noise, and by the `Settings.accuracy` of a simulation.
    """
    tolerances = {}
    for channel, variance in _variances(dataset).items():
        most = max(float(np.ptp(one.signals[channel])) for one in dataset.records)
        off = SETTINGS.accuracy * most
        tolerances[channel] = math.sqrt(1.0 + float(np.mean(off**2 / variance)))
    return tolerances


def _variances(dataset: Dataset) -> dict[str, Array]:
    return {
        channel: np.concatenate(
            [one.sigma[channel][one.good[channel]] ** 2 for one in dataset.records]
        )
        for channel in dataset.records[0].compared
    }


def rescaled(dataset: Dataset, fit: Fit) -> Dataset:
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


def contexts(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of each record beside a model without them."""
    elastic = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(
        scene_of(record, simulated, elastic)
        for record, simulated in zip(dataset.records, fit.simulated, strict=True)
    )


def contexts_without(dataset: Dataset, fit: Fit) -> tuple[EffectContext, ...]:
    """Return what effects may know of records that have not been simulated yet."""
    elastic = dataset.base.compliance(fit.model.shared) or 0.0
    return tuple(scene_of(record, None, elastic) for record in dataset.records)


def simulated(dataset: Dataset, about: Sequence[EffectContext], model: Model) -> Fit:
    """Return a model with what it makes of each record."""
    done = tuple(
        simulate(record, context, dataset.base, model.shared, own, model.effects)
        for record, context, own in zip(dataset.records, about, model.own, strict=True)
    )
    return Fit(model, done)


def residual(dataset: Dataset, fit: Fit) -> Array:
    """Return what is fitted: simulated less measured where it counts, and what is expected."""
    parts = []
    for record, one, scale, own in zip(
        dataset.records, fit.simulated, dataset.scale, fit.model.own, strict=True
    ):
        for channel in record.compared:
            counts = record.train & record.good[channel]
            off = one.signals[channel] - record.signals[channel]
            parts.append((off / scale[channel])[counts])
        expected = expected_taut(record, dataset.base, fit.model)
        if expected is not None:
            parts.append(np.array([(own[0] - expected.travel) / expected.uncertainty]))
    return np.concatenate(parts)


def cost(dataset: Dataset, fit: Fit) -> float:
    """Return what a fit makes as small as it can."""
    return float(np.sum(residual(dataset, fit) ** 2))


def expected_taut(record: Record, base: Base, model: Model) -> Expected | None:
    """Return where the motor must be for the first tension that was read, in a slack start."""
    compliance = base.compliance(model.shared)
    if compliance is None or not record.starts_slack:
        return None
    sigma = record.noise[PROXIMAL_TENSION]
    drive, tensions = record.first_tensions
    return Expected(
        drive - compliance * max(0.0, float(tensions.mean())),
        max(SETTINGS.taut_sigma * compliance * sigma, SETTINGS.taut_sigma_min),
    )
