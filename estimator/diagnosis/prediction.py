"""Records that a model was not fitted to, predicted by it: validation, and leave-one-file-out."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    contexts,
    contexts_without,
    rescaled,
    whole,
    with_records,
)
from estimator.diagnosis.driver_noise import with_driver_noise
from estimator.diagnosis.fit import improved, own_only
from estimator.diagnosis.hidden_motion import with_hidden_motion
from estimator.diagnosis.model import Simulated, simulate
from estimator.diagnosis.record import Record

ROUNDS = 12  # of a fit to the other files


class Fitness(NamedTuple):
    """How far a model is off in one channel, on one set of samples."""

    rmse: float  # in the channel's unit
    largest: float  # share of full scale
    mean: float  # share of full scale


class Predicted(NamedTuple):
    """A record that was not fitted, as both models predict it."""

    record: Record
    before: Simulated  # by the plain law
    after: Simulated  # by the extended law

    def fitness(self, simulated: Simulated) -> dict[str, Fitness]:
        """Return how far one of the two is off, by channel."""
        return {
            channel: fitness_of(
                [self.residual(simulated, channel)], float(np.ptp(self.record.signals[channel]))
            )
            for channel in self.record.compared
        }

    def residual(self, simulated: Simulated, channel: str) -> Array:
        """Return measured less simulated of the samples that count [N] or [m]."""
        good = self.record.good[channel]
        return (self.record.signals[channel] - simulated.signals[channel])[good]

    @property
    def spikes(self) -> dict[str, int]:
        """Single-sample spikes that were excluded, by channel."""
        excluded = dict.fromkeys(self.record.signals, 0)
        for trouble in self.record.troubles:
            if trouble.what == SPIKES:
                excluded[trouble.channel] = trouble.samples
        return excluded


SPIKES = "single-sample spikes"


def fitness_of(residuals: Sequence[Array], full_scale: float) -> Fitness:
    """Return the errors of some residuals, in shares of a full scale [N] or [m]."""
    error = np.concatenate(residuals)
    share = np.abs(error) / max(full_scale, 1e-12)
    return Fitness(float(np.sqrt(np.mean(error**2))), float(share.max()), float(share.mean()))


def predicted(
    fitted: Dataset, plain: Fit, fit: Fit, records: Sequence[Record]
) -> tuple[Predicted, ...]:
    """Return records as two models of a dataset predict them; only where each starts is fitted."""
    if not records:
        return ()
    dataset = whole(with_records(fitted, records))
    before, after = own_only(dataset, plain), own_only(dataset, fit)
    return tuple(
        Predicted(*row)
        for row in zip(dataset.records, before.simulated, after.simulated, strict=True)
    )


def as_driven(fitted: Dataset, records: Sequence[Record], plain: Fit) -> tuple[Record, ...]:
    """Return records that were not fitted with what the noise of their drive does, as fitted ones.

    `plain` is the plain law, fitted to a dataset of other records.
    """
    if not records:
        return ()
    dataset = whole(with_records(fitted, records))
    fit = own_only(dataset, plain)
    about = contexts_without(dataset, fit)

    def again(k: int) -> Callable[[Record], Simulated]:
        own = fit.model.own[k]
        return lambda other: simulate(other, about[k], dataset.base, fit.model.shared, own, ())

    noisy = [with_driver_noise(record, again(k)) for k, record in enumerate(records)]
    if all(new is old for new, old in zip(noisy, records, strict=True)):
        return tuple(records)
    own = own_only(whole(with_records(fitted, noisy)), plain).model.own
    return tuple(
        with_hidden_motion(record, fitted.base, plain.model.shared, one)
        for record, one in zip(noisy, own, strict=True)
    )


def left_out(dataset: Dataset, plain: Fit, fit: Fit) -> tuple[Predicted, ...]:
    """Return each record as the models predict it whose numbers the other records gave.

    The causes are those of all records; their sizes and the law's parameters are fitted without the
    record.
    """
    found: list[Predicted] = []
    for k, record in enumerate(dataset.records):
        rest = whole(_without(dataset, k))
        models = [_of_others(one, k) for one in (plain, fit)]
        about = contexts(rest, models[0])
        before, after = (improved(rescaled(rest, one), about, one.model, ROUNDS) for one in models)
        found += predicted(dataset, before, after, [record])
    return tuple(found)


def _without(dataset: Dataset, k: int) -> Dataset:
    return dataset._replace(
        records=dataset.records[:k] + dataset.records[k + 1 :],
        scale=dataset.scale[:k] + dataset.scale[k + 1 :],
    )


def _of_others(fit: Fit, k: int) -> Fit:
    own = fit.model.own[:k] + fit.model.own[k + 1 :]
    return Fit(fit.model._replace(own=own), fit.simulated[:k] + fit.simulated[k + 1 :])
