"""Friction of a pair against the bend of its sheath, and how well other bends are predicted."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array, Mask
from estimator.fitting import IntervalEstimate, build_interval, minimise_squares
from estimator.hysteresis_operators import compute_bristle_deflection
from estimator.noise_treatment import apply_play
from estimator.pair.pair_fit import (
    PairError,
    PairFit,
    PairVariant,
    check_records,
    fit,
    number_strokes,
    predict_angle,
)
from estimator.pair.pair_model import PairModel, PairRecord

# --- models of a pair that know no tendon: the angle as a hysteresis of the command
# What the model of the pair has to be better than. Their numbers are linear in the bend b:
#
# * one play operator with a gain: angle = (g0 + g1 b) play(command; r0 + r1 b) + c0 + c1 b;
# * a Prandtl-Ishlinskii model of five (Kuhnen, Eur. J. Control 9, 2003), with weights w0 + w1 b;
# * LuGre without a dependence on speed, which is Dahl's (Canudas de Wit et al., IEEE Trans. Autom.
#   Control 40, 1995): angle = (a0 + a1 b) command - (s0 + s1 b) z + c0 + c1 b.


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

    def compute_residuals(values: Array) -> Array:
        return np.concatenate([(predict(values, r) - r.angle) / r.span for r in records])

    starts = [np.array([0.6, width, 0.0, -0.1, 0.05, 0.0]) for width in (0.05, 0.2, 0.5)]
    solution = min(
        (minimise_squares(compute_residuals, start) for start in starts),
        key=lambda trial: trial.cost,
    )
    return lambda record: predict(solution.values, record)


def _fit_linear_model(
    records: Sequence[PairRecord], features: Iterable[Callable[[PairRecord], Array]]
) -> Predictor:
    """Return the best of models whose weights are linear in the bend, by least squares."""
    best, weights = np.inf, np.zeros(0)
    columns: Callable[[PairRecord], Array] = _compute_play_features
    for feature in features:
        A = np.concatenate([_build_bend_features(feature, r) / r.span for r in records])
        y = np.concatenate([r.angle / r.span for r in records])
        solution = np.linalg.lstsq(A, y, rcond=None)[0]
        error = float(np.sum((A @ solution - y) ** 2))
        if error < best:
            best, weights, columns = error, solution, feature
    return lambda record: np.asarray(_build_bend_features(columns, record) @ weights)


def _build_bend_features(features: Callable[[PairRecord], Array], record: PairRecord) -> Array:
    columns = np.column_stack([features(record), np.ones(len(record.time))])
    return np.column_stack([columns, columns * record.bend])


def _compute_play_features(record: PairRecord) -> Array:
    span = float(np.ptp(record.command))
    return np.column_stack([apply_play(record.command, share * span) for share in PLAY_WIDTHS])


def _build_bristle_features(share: float) -> Callable[[PairRecord], Array]:
    def features(record: PairRecord) -> Array:
        reach = np.full(len(record.time), share * float(np.ptp(record.command)))
        return np.column_stack([record.command, compute_bristle_deflection(record.command, reach)])

    return features


BENDS_MIN = 3
CONFIDENCE = 0.95

COMMAND = "command taken as the angle"
SHARE = "a fixed share of the command"

ProgressCallback = Callable[[str, float], None]


class HeldOutError(NamedTuple):
    """Error of the angle of a record that was not fitted."""

    rmse: float  # [rad]
    share: float  # of the span of the angle
    zeroed: float  # the same without its mean: what an unknown zero does not explain


class Validation(NamedTuple):
    """Errors of a record that was kept apart."""

    bend: float  # [rad]
    model_error: HeldOutError
    baselines: dict[str, HeldOutError]  # by method, of the records that were fitted


class PairStudy(NamedTuple):
    """All that was found."""

    records: tuple[PairRecord, ...]
    fit: PairFit  # one model for all records
    record_frictions: tuple[IntervalEstimate, ...]  # K of each record
    friction: IntervalEstimate  # K of the straight sheath
    growth: IntervalEstimate  # mu [1/rad]
    left_out: dict[str, tuple[HeldOutError, ...]]  # by method, for each record
    predicted: tuple[Array, ...]  # angle of each record [rad], by the model of the others
    validation: tuple[Validation, ...] = ()  # errors of records that were kept apart

    @property
    def best_simple(self) -> str:
        """The method that knows no tendon and is off least, by the mean of held-out shares."""
        laws = {law.value for law in PairVariant}
        simple = [method for method in self.left_out if method not in laws]
        return min(simple, key=lambda method: compute_mean_share(self.left_out[method]))


def ignore_progress(_what: str, _share: float) -> None:
    """Report nothing."""


def study_pair(
    records: Sequence[PairRecord],
    *,
    validate: Sequence[PairRecord] = (),
    progress: ProgressCallback = ignore_progress,
) -> PairStudy:
    """Measure how the friction of an antagonistic pair grows with the bend of its sheath.

    One model is fitted to all records; then each record is predicted by the fit of the others.

    Parameters
    ----------
    records : sequence of PairRecord
        Of one pair at three or more bends.
    validate : sequence of PairRecord
        At further bends, to be predicted and not fitted.
    progress : callable
        Called with what is being done and which share of it (0 to 1) is.

    Raises
    ------
    PairError
        There are fewer than three bends, or a record cannot be fitted.
    """
    check_records(validate)
    study = run_study(sorted(records, key=lambda record: record.bend), progress)
    return study._replace(validation=_validate_records(study, validate))


def run_study(
    records: Sequence[PairRecord], report: ProgressCallback = ignore_progress
) -> PairStudy:
    """Study a pair at several bends; `report` is told what is done, and which share of all.

    Raises
    ------
    PairError
        There are fewer than three bends, or a record cannot be fitted.
    """
    if len({record.bend for record in records}) < BENDS_MIN:
        raise PairError(f"records: at least {BENDS_MIN} bends are needed, to leave one out")
    check_records(records)
    steps = len(PairVariant) * (len(records) + 1) + 1
    completed = 0

    def next_step(task: str) -> None:
        nonlocal completed
        report(task, completed / steps)
        completed += 1

    left_out = cross_validate_baselines(records)
    full_fits: dict[PairVariant, PairFit] = {}
    left_out_fits: dict[PairVariant, list[PairFit]] = {}
    for law in PairVariant:
        next_step(f"fitting: {law.value}")
        full_fits[law] = fit(records, law)
        left_out_fits[law] = []
        for i in range(len(records)):
            next_step(f"leaving one out: {law.value}")
            other_records = [record for j, record in enumerate(records) if j != i]
            left_out_fits[law].append(fit(other_records, law, full_fits[law].model))
        left_out[law.value] = tuple(
            compute_error(predict_angle(left_out_fit.get_model(record.bend), record, law), record)
            for left_out_fit, record in zip(left_out_fits[law], records, strict=True)
        )
    next_step("fitting a K for each")
    full_fit = full_fits[PairVariant.FULL]
    free_fit = fit(records, PairVariant.FULL, full_fit.model, each_friction=True)
    full_left_out = left_out_fits[PairVariant.FULL]
    models = [
        left_out_fit.get_model(record.bend)
        for left_out_fit, record in zip(full_left_out, records, strict=True)
    ]
    return PairStudy(
        tuple(records),
        full_fit,
        tuple(
            _compute_interval(K, error, len(records))
            for K, error in zip(free_fit.frictions, free_fit.friction_errors, strict=True)
        ),
        _compute_jackknife_interval(full_fit.model, models, "friction"),
        _compute_jackknife_interval(full_fit.model, models, "growth"),
        left_out,
        tuple(predict_angle(m, r, PairVariant.FULL) for m, r in zip(models, records, strict=True)),
    )


def cross_validate_baselines(records: Sequence[PairRecord]) -> dict[str, tuple[HeldOutError, ...]]:
    """Return the errors of predictions without a model of the pair, each record left out once."""
    errors_by_method: dict[str, list[HeldOutError]] = {}
    for left_out_record in records:
        errors = _compute_baseline_errors(
            [record for record in records if record is not left_out_record], left_out_record
        )
        for method, error in errors.items():
            errors_by_method.setdefault(method, []).append(error)
    return {method: tuple(errors) for method, errors in errors_by_method.items()}


def _compute_baseline_errors(
    records: Sequence[PairRecord], record: PairRecord
) -> dict[str, HeldOutError]:
    """Return the errors of one record by what is fitted to others without a model of the pair."""
    angles = {COMMAND: record.command, SHARE: _fit_fixed_share(records) * record.command}
    angles |= {name: predict(record) for name, predict in fit_simple_predictors(records).items()}
    return {method: compute_error(angle, record) for method, angle in angles.items()}


def _validate_records(study: PairStudy, records: Sequence[PairRecord]) -> tuple[Validation, ...]:
    """Return the errors of further records, predicted from their command and bend."""
    return tuple(
        Validation(
            record.bend,
            compute_error(
                predict_angle(study.fit.get_model(record.bend), record, PairVariant.FULL), record
            ),
            _compute_baseline_errors(study.records, record),
        )
        for record in records
    )


def compute_mean_share(errors: Sequence[HeldOutError]) -> float:
    """Return the mean of errors as shares of the span."""
    return float(np.mean([error.share for error in errors]))


def compute_error(angle: Array, record: PairRecord) -> HeldOutError:
    """Return the error of a predicted angle [rad]."""
    error = angle - record.angle
    rmse = float(np.sqrt(np.mean(error**2)))
    return HeldOutError(rmse, rmse / record.span, float(error.std()) / record.span)


def _fit_fixed_share(records: Sequence[PairRecord]) -> float:
    commands = np.concatenate([record.command for record in records])
    up = np.concatenate([record.angle for record in records])
    return float(commands @ up) / float(commands @ commands)


def _compute_interval(value: float, error: float, count: int) -> IntervalEstimate:
    from scipy.special import stdtrit  # here: a command's help needs no scipy

    reach = float(stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE)) * error
    return build_interval(value, reach, 0.0)


def _compute_jackknife_interval(
    model: PairModel, left_out_models: Sequence[PairModel], name: str
) -> IntervalEstimate:
    """Return a parameter with the interval that leaving records out gives it."""
    n = len(left_out_models)
    values = np.array([getattr(left_out_model, name) for left_out_model in left_out_models])
    error = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
    return _compute_interval(getattr(model, name), error, n)


# --- what a model of a pair leaves of the angle, and what that depends on


REST_SPEED_RATIO = 0.1  # of the angle's greatest speed: below, it rests
FAR_COMMAND_RATIO = 1.0 / 3.0  # of the command's peak: beyond, it counts as far out


class ResidualPart(NamedTuple):
    """What is left in some of the samples (predicted less measured), as shares of the span."""

    what: str
    mean: float
    rms: float


def compute_offset_share(records: Sequence[PairRecord], predicted: Sequence[Array]) -> float:
    """Return which share of the mean square is a constant of each record."""
    residuals = [(p - r.angle) / r.span for p, r in zip(predicted, records, strict=True)]
    total = sum(float(np.mean(residual**2)) for residual in residuals)
    return (
        sum(float(np.mean(residual)) ** 2 for residual in residuals) / total if total > 0.0 else 0.0
    )


def analyse_residuals(
    records: Sequence[PairRecord], predicted: Sequence[Array]
) -> tuple[ResidualPart, ...]:
    """Return what is left by direction, motion, command and time, each record's mean taken off."""
    residuals, groups = [], []
    for record, angle in zip(records, predicted, strict=True):
        residual = (angle - record.angle) / record.span
        residuals.append(residual - residual.mean())
        groups.append(_group_samples(record))
    all_residuals = np.concatenate(residuals)
    parts = []
    for name in groups[0]:
        residual = all_residuals[np.concatenate([group[name] for group in groups])]
        if residual.size:
            parts.append(
                ResidualPart(name, float(residual.mean()), float(np.sqrt(np.mean(residual**2))))
            )
    return tuple(parts)


def _group_samples(record: PairRecord) -> dict[str, Mask]:
    rising = np.gradient(record.command, record.time) > 0.0
    speed = np.abs(np.gradient(record.angle, record.time))
    is_resting = speed < REST_SPEED_RATIO * speed.max()
    share = record.command / np.abs(record.command).max()
    is_first = number_strokes(record.command) == 0
    return {
        "command rises": rising,
        "command falls": ~rising,
        "joint moves up": rising & ~is_resting,
        "joint moves down": ~rising & ~is_resting,
        "joint rests": is_resting,
        "command is far out, positive": share > FAR_COMMAND_RATIO,
        "command is near zero": np.abs(share) <= FAR_COMMAND_RATIO,
        "command is far out, negative": share < -FAR_COMMAND_RATIO,
        "stroke is the first": is_first,
        "stroke is a later one": ~is_first,
    }
