"""Models of hysteresis without a sheath in them: what the law has to be better than.

Each gives a channel from the drive alone, by a least-squares fit of a few weights:

* one play operator with a gain, and a Prandtl-Ishlinskii model of five (Kuhnen, Eur. J. Control
  9, 2003): y = c + sum_j w_j p_j, where p_j is the drive after a play of half-width r_j and
  w_j >= 0; for a tension also with a half-width in proportion to it, from T e^-K to T e^K;
* LuGre (Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995): y = c + a u - s z - d v,
  with dz/dt = v - |v| z / (r g(v)), g(v) = 1 + b exp(-(v/w)^2);
* a mechanism: a spring that hardens or softens, a damper, a mass, and dry friction of any load,
  y = c + a1 u + a2 u^2 + a3 u^3 + d v + m dv/dt + F p_r / r.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import FRICTION, FRICTION_FORCE, Dataset, Fit
from estimator.diagnosis.record import Record
from estimator.diagnosis.scoring import (
    ChannelErrors,
    SimpleFit,
    SimpleGain,
    bootstrap_gain,
    bootstrap_superiority,
    compute_channel_errors,
    compute_log_likelihood_ratio,
    compute_missed_share,
    concatenate_errors,
    is_noise,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import DISTAL_TENSION, PROXIMAL_TENSION
from estimator.hysteresis_operators import apply_proportional_play, compute_bristle_deflection
from estimator.noise_treatment import apply_play
from estimator.signals.driving_signal import compute_rate

PLAYS = 5
LUGRE = "LuGre"
MECHANISM = "spring, damper, mass and dry friction"
PLAIN_MECHANISMS = MECHANISM, LUGRE  # none of whose friction grows with the tension
_HALF_WIDTHS = np.geomspace(1e-3, 0.45, 24)  # of the drive's range, that one play is tried with
_FRICTIONS = np.linspace(0.05, 2.5, 50)  # K of plays in proportion to a tension
_REACHES = np.geomspace(1e-3, 0.3, 10)  # of it, of LuGre's bristles
_STRIBECK = ((0.0, 1.0), (0.5, 0.1), (0.5, 0.4), (1.0, 0.1), (1.0, 0.4))  # b, and w over rms speed


def fit_simple_models(dataset: Dataset, names: Sequence[str] = ()) -> tuple[SimpleFit, ...]:
    """Return the held-out errors of the models of some names, or of all."""
    channels = dataset.records[0].compared
    return tuple(
        SimpleFit(
            name, {channel: _cross_validate_model(dataset, channel, name) for channel in channels}
        )
        for name in names or _MODELS
    )


def compute_simple_gains(
    law: Mapping[str, ChannelErrors], models: Sequence[SimpleFit]
) -> dict[str, SimpleGain]:
    """Return how much better a law is than the best of simple models on the same samples."""
    gains = {}
    for channel, errors in law.items():
        best = min(models, key=lambda model: model.held_out[channel].mean_square)
        gain = bootstrap_gain(errors, best.held_out[channel])
        gains[channel] = SimpleGain(best.name, *gain)
    return gains


def is_plain_mechanism(dataset: Dataset, errors: Mapping[str, ChannelErrors]) -> bool:
    """Return whether a mechanism of any load leaves only noise of what a model's errors are."""
    models = fit_simple_models(dataset, PLAIN_MECHANISMS)
    return not is_noise(dataset, errors) and any(
        is_noise(dataset, held_out)
        for _, held_out in find_plain_mechanisms(dataset, errors, models)
    )


def find_plain_mechanisms(
    dataset: Dataset, errors: Mapping[str, ChannelErrors], models: Sequence[SimpleFit]
) -> list[SimpleFit]:
    """Return the mechanisms of any load that predict the tensions better than a model does.

    None of a closed loop: two cables that rub, each in proportion to its tension, take about the
    same force to turn at any load, since their tensions add up to the same.
    """
    tensions = {c: e for c, e in errors.items() if c in (PROXIMAL_TENSION, DISTAL_TENSION)}
    mechanisms = (
        SimpleFit(model.name, {channel: model.held_out[channel] for channel in tensions})
        for model in models
        if model.name in PLAIN_MECHANISMS and not dataset.records[0].loop
    )
    return [
        mechanism
        for mechanism in mechanisms
        if compute_log_likelihood_ratio(mechanism.held_out, tensions) > SETTINGS.score_min
    ]


def has_sheath_friction(dataset: Dataset, fit: Fit) -> bool:
    """Return whether friction grows with the tension, or of a loop whether there is any."""
    values = dataset.base.values(fit.model.shared, fit.model.own[0])
    share = values.get(FRICTION.name, 0.0)
    if dataset.records[0].loop:
        peak = max(float(np.abs(r.signals[PROXIMAL_TENSION]).max()) for r in dataset.records)
        share = max(share, values.get(FRICTION_FORCE.name, 0.0) / peak)
    return share >= SETTINGS.friction_share_min


def explain_foreign_data(
    dataset: Dataset,
    fit: Fit,
    errors: Mapping[str, ChannelErrors],
    models: Sequence[SimpleFit],
    *,
    is_open: bool,
) -> str:
    """Return why data are of no tendon in a sheath, by a model of one; empty if they may be.

    Where it is open what a tendon's model misses, one of a mechanism that misses less says nothing
    unless it leaves only noise.
    """
    missed_share = compute_missed_share(dataset, errors)
    if missed_share > SETTINGS.foreign_share_max:
        return f"the best model of one misses {missed_share:.0%} of a tension's changes"
    if not has_sheath_friction(dataset, fit):
        return "no friction grows with the tension, as of a plain spring or a straight sheath"
    for name, held_out in find_plain_mechanisms(dataset, errors, models):
        tensions = {channel: errors[channel] for channel in held_out}
        is_sure = bootstrap_superiority(held_out, tensions) > SETTINGS.confidence
        if is_noise(dataset, held_out) if is_open else is_sure:
            return f"a model without friction that grows with it ({name}) predicts a tension better"
    return ""


def _cross_validate_model(dataset: Dataset, channel: str, name: str) -> ChannelErrors:
    """Return the errors of both halves, each fitted to the other; of all where all is fitted."""
    parts = []
    candidates = list(_MODELS[name](dataset))
    all_fitted = all(record.train.all() for record in dataset.records)
    for fitted_half in (True,) if all_fitted else (True, False):
        fits = (
            _fit_features(dataset, channel, features, fitted_half, name not in PLAIN_MECHANISMS)
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
        fitted.append(record.valid[channel] & (record.train == fitted_half))
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


def _generate_mechanism_features(dataset: Dataset) -> Iterator[list[Array]]:
    for reach in _REACHES:
        columns = []
        for record, span in _pair_records_with_span(dataset):
            u, rate = record.drive / span, compute_rate(record.time, record.speed)
            slip = u - apply_play(u, reach)  # between its half-widths
            columns.append(np.column_stack([u, u**2, u**3, slip / reach, record.speed, rate]))
        yield columns


def _pair_records_with_span(dataset: Dataset) -> list[tuple[Record, float]]:
    """Return each record with the range of the drive over all of them."""
    span = max(float(np.ptp(record.drive)) for record in dataset.records)
    return [(record, span) for record in dataset.records]


_MODELS = {
    "play operator with gain": _generate_play_features,
    f"Prandtl-Ishlinskii, {PLAYS} plays": _generate_prandtl_features,
    LUGRE: _generate_lugre_features,
    MECHANISM: _generate_mechanism_features,
}
