"""What a learned model could do: a bound that says whether a law leaves something to be found.

Boosted trees (scikit-learn, extra `learned`) predict each channel from what drives the simulation
and its history, once by themselves and once what the law leaves, on the halves that judge the law.
They are for comparison only: nothing is driven by them.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.record import Record
from estimator.diagnosis.scoring import (
    ChannelErrors,
    SimpleFit,
    SimpleGain,
    bootstrap_gain,
    compute_channel_errors,
    concatenate_errors,
)
from estimator.diagnosis.validation import Fold
from estimator.effects.effect import PROXIMAL_TENSION
from estimator.hysteresis_operators import apply_proportional_play
from estimator.noise_treatment import apply_play
from estimator.signals.driving_signal import find_turning_points

LEARNED, CORRECTED = "learned from the drive", "the law, corrected by learning"
_HALF_WIDTHS = (0.002, 0.007, 0.02, 0.05, 0.1, 0.2, 0.35)  # of plays, of the drive's range
_FRICTIONS = (0.1, 0.3, 0.6, 1.0, 1.6)  # K of plays in proportion to a tension
_DELAYS = (0.05, 0.2, 1.0, 4.0)  # [s] since which the drive's change is a feature
_REVERSAL = 0.003  # of the drive's range, that counts as a reversal
_TREES, _LEARNING_RATE = 40, 0.2
_SAMPLES_MAX = 5000  # that trees are fitted to
_INNER_PART = 3  # one block in so many of a fitted half says how many trees to keep


def fit_learned_models(folds: Sequence[Fold]) -> tuple[SimpleFit, ...]:
    """Return the held-out errors of both uses of a learned model.

    Empty without scikit-learn, and where no sample is held out.
    """
    try:
        from sklearn.ensemble import HistGradientBoostingRegressor
        from threadpoolctl import threadpool_limits
    except ImportError:
        return ()
    if folds[0].dataset.records[0].train.all():
        return ()

    def build_trees(count: int) -> Any:
        return HistGradientBoostingRegressor(
            learning_rate=_LEARNING_RATE, max_iter=count, max_leaf_nodes=12, early_stopping=False
        )

    with threadpool_limits(1, "openmp"):  # for few samples threads cost more than they share
        return _judge_learned_models(folds, build_trees)


def _judge_learned_models(
    folds: Sequence[Fold], build_trees: Callable[[int], Any]
) -> tuple[SimpleFit, ...]:
    parts: dict[str, dict[str, list[ChannelErrors]]] = {LEARNED: {}, CORRECTED: {}}
    for fold in folds:
        records, simulated = fold.dataset.records, fold.fits[1].simulated
        own = [_build_features(record, len(records)) for record in records]
        with_law = [
            np.column_stack([X, *s.signals.values()]) for X, s in zip(own, simulated, strict=True)
        ]
        for channel in records[0].compared:
            laws = [s.signals[channel] for s in simulated]
            lines = _fit_line(records, channel, own)
            for name, features, starts in ((LEARNED, own, lines), (CORRECTED, with_law, laws)):
                predicted = _boost(records, channel, features, starts, build_trees)
                parts[name].setdefault(channel, []).extend(
                    compute_channel_errors(record, channel, signal, ~record.train)
                    for record, signal in zip(records, predicted, strict=True)
                )
    return tuple(
        SimpleFit(name, {channel: concatenate_errors(errors) for channel, errors in of.items()})
        for name, of in parts.items()
    )


def compute_learned_gains(
    law: Mapping[str, ChannelErrors], models: Sequence[SimpleFit]
) -> dict[str, SimpleGain]:
    """Return by which share the better learned model's RMSE is below a law's, by channel."""
    gains = {}
    for channel, errors in law.items() if models else ():
        best = min(models, key=lambda model: model.held_out[channel].mean_square)
        gains[channel] = SimpleGain(best.name, *bootstrap_gain(best.held_out[channel], errors))
    return gains


def _build_features(record: Record, records: int) -> Array:
    """Return what may be learned from: the drive, its plays and its history, shape (n, m)."""
    u, t, v = record.drive, record.time, record.speed
    span = float(np.ptp(u))
    turns = np.array(find_turning_points(u, _REVERSAL * span))
    latest = np.maximum(np.searchsorted(turns, np.arange(len(u)), side="right") - 1, 0)
    columns = [u, v, np.sign(v), np.cumsum(np.abs(np.diff(u, prepend=u[0])))]
    columns += [t - t[turns[latest]], u - u[turns[latest]], u[turns[np.maximum(latest - 1, 0)]]]
    columns += [u - np.interp(t - delay, t, u) for delay in _DELAYS]
    columns += [apply_play(u, share * span) for share in _HALF_WIDTHS]
    if record.driver == PROXIMAL_TENSION:
        columns += [apply_proportional_play(u, K) for K in _FRICTIONS]
    columns += [*record.variables.values()] + [np.full(len(u), record.file)] * (records > 1)
    return np.column_stack(columns)


def _select_fitted(record: Record, channel: str) -> NDArray[np.bool_]:
    return record.measured & record.valid[channel] & record.train


def _fit_line(records: Sequence[Record], channel: str, features: Sequence[Array]) -> list[Array]:
    """Return each record as a linear function of the features, fitted to the samples of a half."""
    designs = [np.column_stack([X, np.ones(len(X))]) for X in features]
    fitted = [_select_fitted(record, channel) for record in records]
    A = np.concatenate([design[rows] for design, rows in zip(designs, fitted, strict=True)])
    y = np.concatenate([r.signals[channel][rows] for r, rows in zip(records, fitted, strict=True)])
    size = np.maximum(np.abs(A).max(axis=0), 1e-30)
    weights = np.linalg.lstsq(A / size, y, rcond=1e-6)[0] / size
    return [design @ weights for design in designs]


def _boost(
    records: Sequence[Record],
    channel: str,
    features: Sequence[Array],
    starts: Sequence[Array],
    build_trees: Callable[[int], Any],
) -> list[Array]:
    """Return predictions of a channel: a start, and what trees learn of its error in a half.

    As many trees as suit blocks of that half that they were not fitted to, perhaps none.
    """
    X, y, is_inner = [], [], []
    for record, columns, start in zip(records, features, starts, strict=True):
        rows = np.flatnonzero(_select_fitted(record, channel))
        _, number = np.unique(record.block[rows], return_inverse=True)
        X.append(columns[rows])
        y.append((record.signals[channel] - start)[rows])
        is_inner.append(number % _INNER_PART == 1)
    A, b, inner = np.concatenate(X), np.concatenate(y), np.concatenate(is_inner)
    step = -(-len(b) // _SAMPLES_MAX)
    A, b, inner = A[::step], b[::step], inner[::step]
    if not inner.any() or inner.all():
        return list(starts)
    stages = build_trees(_TREES).fit(A[~inner], b[~inner]).staged_predict(A[inner])
    errors = [float(np.mean((b[inner] - c) ** 2)) for c in (0.0 * b[inner], *stages)]
    count = int(np.argmin(errors))
    if count == 0:
        return list(starts)
    trees = build_trees(count).fit(A, b)
    return [s + trees.predict(columns) for s, columns in zip(starts, features, strict=True)]
