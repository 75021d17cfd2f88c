"""Models of a pair that know no tendon: the angle as a hysteresis of the command.

What the model of the pair has to be better than. Their numbers are linear in the bend b:

* one play operator with a gain: angle = (g0 + g1 b) play(command; r0 + r1 b) + c0 + c1 b;
* a Prandtl-Ishlinskii model of five (Kuhnen, Eur. J. Control 9, 2003), with weights w0 + w1 b;
* LuGre without a dependence on speed, which is Dahl's (Canudas de Wit et al., IEEE Trans. Autom.
  Control 40, 1995): angle = (a0 + a1 b) command - (s0 + s1 b) z + c0 + c1 b.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy.optimize import least_squares

from estimator.array_types import Array
from estimator.hysteresis import compute_bristle_deflection
from estimator.pair.pair import PairRecord
from estimator.signals import apply_play

ONE_PLAY = "one play, linear in the bend"
PLAYS = 5
PLAY_WIDTHS = 0.45 * (np.arange(PLAYS) / (PLAYS - 1)) ** 2  # of the command's span: half-widths
BRISTLE_REACHES = np.geomspace(0.01, 0.5, 12)  # of it

Predictor = Callable[[PairRecord], Array]


def fit_simple_predictors(records: Sequence[PairRecord]) -> dict[str, Predictor]:
    """Return what predicts the angle [rad] of a record, fitted to `records`, by name."""
    return {
        ONE_PLAY: _fit_one_play(records),
        f"Prandtl-Ishlinskii, {PLAYS} plays, linear in the bend": _fit_linear_model(
            records, [_compute_play_features]
        ),
        "LuGre, linear in the bend": _fit_linear_model(
            records, [_build_bristle_features(share) for share in BRISTLE_REACHES]
        ),
    }


def _fit_one_play(records: Sequence[PairRecord]) -> Predictor:
    def predict(values: Array, record: PairRecord) -> Array:
        gain, width, zero = values[:3] + values[3:] * record.bend
        return np.asarray(gain * apply_play(record.command, max(float(width), 0.0)) + zero)

    def off(values: Array) -> Array:
        return np.concatenate([(predict(values, r) - r.angle) / r.span for r in records])

    starts = [np.array([0.6, width, 0.0, -0.1, 0.05, 0.0]) for width in (0.05, 0.2, 0.5)]
    found = min((least_squares(off, start) for start in starts), key=lambda one: one.cost)
    return lambda record: predict(found.x, record)


def _fit_linear_model(
    records: Sequence[PairRecord], features: Iterable[Callable[[PairRecord], Array]]
) -> Predictor:
    """Return the best of models whose weights are linear in the bend, by least squares."""
    best, weights = np.inf, np.zeros(0)
    columns: Callable[[PairRecord], Array] = _compute_play_features
    for one in features:
        A = np.concatenate([_build_bend_features(one, r) / r.span for r in records])
        y = np.concatenate([r.angle / r.span for r in records])
        found = np.linalg.lstsq(A, y, rcond=None)[0]
        error = float(np.sum((A @ found - y) ** 2))
        if error < best:
            best, weights, columns = error, found, one
    return lambda record: np.asarray(_build_bend_features(columns, record) @ weights)


def _build_bend_features(features: Callable[[PairRecord], Array], record: PairRecord) -> Array:
    plain = np.column_stack([features(record), np.ones(len(record.time))])
    return np.column_stack([plain, plain * record.bend])


def _compute_play_features(record: PairRecord) -> Array:
    span = float(np.ptp(record.command))
    return np.column_stack([apply_play(record.command, share * span) for share in PLAY_WIDTHS])


def _build_bristle_features(share: float) -> Callable[[PairRecord], Array]:
    def features(record: PairRecord) -> Array:
        reach = np.full(len(record.time), share * float(np.ptp(record.command)))
        return np.column_stack([record.command, compute_bristle_deflection(record.command, reach)])

    return features
