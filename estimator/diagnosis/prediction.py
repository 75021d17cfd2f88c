"""Records that a model was not fitted to, predicted by it: validation, and leave-one-file-out."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    build_unsimulated_contexts,
    replace_records,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.driver_noise import propagate_driver_noise
from estimator.diagnosis.fit import fit_model, fit_record_parameters
from estimator.diagnosis.hidden_motion import recover_hidden_motion
from estimator.diagnosis.model import SimulatedRecord, simulate_record
from estimator.diagnosis.record import Record

ROUNDS = 12  # of a fit to the other files


class ErrorStatistics(NamedTuple):
    """How far a model is off in one channel, on one set of samples."""

    rmse: float  # in the channel's unit
    largest: float  # share of full scale
    mean: float  # share of full scale


class PredictedRecord(NamedTuple):
    """A record that was not fitted, as both models predict it."""

    record: Record
    before: SimulatedRecord  # by the base law
    after: SimulatedRecord  # by the extended law

    def fitness(self, simulated: SimulatedRecord) -> dict[str, ErrorStatistics]:
        """Return how far one of the two is off, by channel."""
        return {
            channel: compute_error_statistics(
                [self.residual(simulated, channel)], float(np.ptp(self.record.signals[channel]))
            )
            for channel in self.record.compared
        }

    def residual(self, simulated: SimulatedRecord, channel: str) -> Array:
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


def compute_error_statistics(residuals: Sequence[Array], full_scale: float) -> ErrorStatistics:
    """Return the errors of some residuals, in shares of a full scale [N] or [m]."""
    error = np.concatenate(residuals)
    share = np.abs(error) / max(full_scale, 1e-12)
    return ErrorStatistics(
        float(np.sqrt(np.mean(error**2))), float(share.max()), float(share.mean())
    )


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
    contexts = build_unsimulated_contexts(dataset, fit)

    def build_simulator(k: int) -> Callable[[Record], SimulatedRecord]:
        own = fit.model.own[k]
        return lambda driven: simulate_record(
            driven, contexts[k], dataset.base, fit.model.shared, own, ()
        )

    noisy_records = [
        propagate_driver_noise(record, build_simulator(k)) for k, record in enumerate(records)
    ]
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
            fit_model(rescale_residuals(remaining, model_fit), contexts, model_fit.model, ROUNDS)
            for model_fit in fits
        )
        predicted += predict_records(dataset, before, after, [record])
    return tuple(predicted)


def _drop_record(dataset: Dataset, k: int) -> Dataset:
    return dataset._replace(
        records=dataset.records[:k] + dataset.records[k + 1 :],
        scale=dataset.scale[:k] + dataset.scale[k + 1 :],
    )


def _drop_record_fit(fit: Fit, k: int) -> Fit:
    own = fit.model.own[:k] + fit.model.own[k + 1 :]
    return Fit(fit.model._replace(own=own), fit.simulated[:k] + fit.simulated[k + 1 :])
