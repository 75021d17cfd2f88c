"""Models of hysteresis without a sheath in them: what the law has to be better than.

Each gives a channel from the drive alone, by a least-squares fit of a few weights:

* one play operator with a gain, and a Prandtl-Ishlinskii model of five (Kuhnen, Eur. J. Control 9,
  2003): y = c + sum_j w_j p_j, where p_j is the drive after a play of half-width r_j, w_j >= 0; for
  a tension also with a half-width in proportion to it, from T e^-K to T e^K;
* LuGre (Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995): y = c + a u - s z - d v, with
  dz/dt = v - |v| z / (r g(v)), g(v) = 1 + b exp(-(v/w)^2).
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import Dataset
from estimator.diagnosis.record import Record
from estimator.diagnosis.score import (
    ChannelErrors,
    bootstrap_gain,
    compute_channel_errors,
    concatenate_errors,
)
from estimator.effects.effect import PROXIMAL_TENSION
from estimator.hysteresis import apply_proportional_play, compute_bristle_deflection
from estimator.signals import apply_play

PLAYS = 5
LUGRE = "LuGre"
_HALF_WIDTHS = np.geomspace(1e-3, 0.45, 24)  # of the drive's range, that one play is tried with
_FRICTIONS = np.linspace(0.05, 2.5, 50)  # K of plays in proportion to a tension
_REACHES = np.geomspace(1e-3, 0.3, 10)  # of it, of LuGre's bristles
_STRIBECK = ((0.0, 1.0), (0.5, 0.1), (0.5, 0.4), (1.0, 0.1), (1.0, 0.4))  # b, and w over rms speed


class SimpleFit(NamedTuple):
    """A model and how far it is off in each channel."""

    name: str
    held_out: dict[str, ChannelErrors]  # of both halves, each fitted to the other

    @property
    def rmse(self) -> dict[str, float]:
        """Root mean square by channel [N] or [m]."""
        return {channel: errors.rmse for channel, errors in self.held_out.items()}


class SimpleGain(NamedTuple):
    """By which share a law's held-out RMSE is below that of the best simple model."""

    model: str
    value: float  # negative where the simple model is better
    low: float  # of the 95 % interval, by the same bins of time of both
    high: float


def fit_simple_models(dataset: Dataset) -> tuple[SimpleFit, ...]:
    """Return the held-out errors of one play operator, of five, and of LuGre."""
    channels = dataset.records[0].compared
    return tuple(
        SimpleFit(
            name, {channel: _cross_validate_model(dataset, channel, name) for channel in channels}
        )
        for name in _MODELS
    )


def compute_simple_gains(
    law: Mapping[str, ChannelErrors], models: Sequence[SimpleFit]
) -> dict[str, SimpleGain]:
    """Return how much better a law is than the best of simple models on the same samples."""
    gains = {}
    for channel, errors in law.items():
        best = min(models, key=lambda model: model.held_out[channel].mean)
        gain = bootstrap_gain(errors, best.held_out[channel])
        gains[channel] = SimpleGain(best.name, *gain)
    return gains


def _cross_validate_model(dataset: Dataset, channel: str, name: str) -> ChannelErrors:
    """Return the errors of both halves, each fitted to the other; of all where all is fitted."""
    parts = []
    candidates = list(_MODELS[name](dataset))
    all_fitted = all(record.train.all() for record in dataset.records)
    for fitted_half in (True,) if all_fitted else (True, False):
        fits = (
            _fit_features(dataset, channel, features, fitted_half, name != LUGRE)
            for features in candidates
        )
        _, predicted = min(fits, key=lambda fit: fit[0])
        for record, signal in zip(dataset.records, predicted, strict=True):
            samples = record.train if all_fitted else record.train != fitted_half
            parts.append(compute_channel_errors(record, channel, signal, samples))
    return concatenate_errors(parts)


def _fit_features(
    dataset: Dataset, channel: str, features: list[Array], fitted_half: bool, positive: bool
) -> tuple[float, list[Array]]:
    """Return the squared error of the fitted half, and what is predicted of each record."""
    rows, values, fitted = [], [], []
    offsets = np.eye(len(dataset.records))
    for k, (record, columns) in enumerate(zip(dataset.records, features, strict=True)):
        own = np.repeat(offsets[k][None], len(columns), axis=0)  # each record its own zero
        rows.append(np.column_stack([columns, own]))
        values.append(record.signals[channel])
        fitted.append(record.good[channel] & (record.train == fitted_half))
    A, y, mask = np.concatenate(rows), np.concatenate(values), np.concatenate(fitted)
    weights = _solve_weights(A[mask], y[mask], A.shape[1] - len(offsets) if positive else 0)
    error = y[mask] - A[mask] @ weights
    return float(error @ error), [design @ weights for design in rows]


def _solve_weights(A: Array, y: Array, positive: int) -> Array:
    """Return the weights of least squares, the first `positive` of them not below zero."""
    from scipy.optimize import nnls

    size = np.maximum(np.abs(A).max(axis=0), 1e-30)
    Q, R = np.linalg.qr(A / size)
    unconstrained = R[:, positive:]
    solution, _ = nnls(np.column_stack([R, -unconstrained]), Q.T @ y)
    solution[positive : R.shape[1]] -= solution[R.shape[1] :]
    return np.asarray(solution[: R.shape[1]] / size)


def _generate_play_features(dataset: Dataset) -> Iterator[list[Array]]:
    for share in _HALF_WIDTHS:
        yield [
            apply_play(record.drive, share * span)[:, None]
            for record, span in _pair_records_with_span(dataset)
        ]
    if dataset.records[0].driver == PROXIMAL_TENSION:
        for K in _FRICTIONS:
            yield [apply_proportional_play(record.drive, K)[:, None] for record in dataset.records]


def _generate_prandtl_features(dataset: Dataset) -> Iterator[list[Array]]:
    shares = np.concatenate([[0.0], 0.45 * (np.arange(1, PLAYS) / (PLAYS - 1)) ** 2])
    yield [
        np.column_stack([apply_play(record.drive, share * span) for share in shares])
        for record, span in _pair_records_with_span(dataset)
    ]
    if dataset.records[0].driver == PROXIMAL_TENSION:
        for friction_max in _FRICTIONS:
            frictions = friction_max * np.arange(1, PLAYS + 1) / PLAYS
            yield [
                np.column_stack([apply_proportional_play(record.drive, K) for K in frictions])
                for record in dataset.records
            ]


def _generate_lugre_features(dataset: Dataset) -> Iterator[list[Array]]:
    for reach, (excess, speed) in itertools.product(_REACHES, _STRIBECK):
        columns = []
        for record, span in _pair_records_with_span(dataset):
            scale = speed * max(float(np.sqrt(np.mean(record.speed**2))), 1e-12)
            g = 1.0 + excess * np.exp(-((record.speed / scale) ** 2))
            z = compute_bristle_deflection(record.drive, reach * span * g)
            columns.append(np.column_stack([record.drive, z / (reach * span), record.speed]))
        yield columns


def _pair_records_with_span(dataset: Dataset) -> list[tuple[Record, float]]:
    """Return each record with the range of the drive over all of them."""
    span = max(float(np.ptp(record.drive)) for record in dataset.records)
    return [(record, span) for record in dataset.records]


_MODELS = {
    "play operator with gain": _generate_play_features,
    f"Prandtl-Ishlinskii, {PLAYS} plays": _generate_prandtl_features,
    LUGRE: _generate_lugre_features,
}
