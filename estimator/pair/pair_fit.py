"""Fits of a pair to records of several bends, by re-simulation, each record with its own zero.

What counts is the share of a channel's span that is left; the angle counts as much as the two
tensions together. A joint with friction rests anywhere in a band when its sensor is zeroed, so that
each record has a neutral angle of its own. One that was not fitted is predicted with that between
its neighbours in bend, since a bend pulls at the two tendons unequally; outside of the bends that
were fitted, with their mean.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.fitting import compute_clustered_errors, minimise_squares, move_inside_bounds
from estimator.lumped.lumped_model import Motion
from estimator.pair.pair_model import (
    PairModel,
    PairRecord,
    combine_tendons,
    simulate_by_command,
    simulate_by_tensions,
    simulate_tendons_by_command,
    simulate_tendons_by_tensions,
)

SAMPLES_MAX = 180  # of a record that are fitted: the law does not depend on the rate
MIN_SAMPLES = 20
MAX_ITERATIONS = 30
COST_TOLERANCE = 1e-4  # relative change of the cost
BOUND_MARGIN = 1e-6  # from a bound where a fit begins
STEP = 3e-3  # of a parameter, for derivatives
TENSION_WEIGHT = 2.0**-0.5


class PairError(ValueError):
    """Records that no pair can be fitted to."""


class PairVariant(Enum):
    """What a model may have; each has a name for reports."""

    FRICTIONLESS = "no friction"
    ONE_K = "one K for all bends"
    EVEN = "K grows, tendons of one stiffness"
    FULL = "K grows, tendons that bed in"
    TENSIONS = "K grows, from the two tensions"


START = PairModel(0.4, 0.15, 0.26, 2.0, 6.5, 0.8, -0.02)
LOW = PairModel(1e-3, 0.0, 0.01, 0.0, 0.2, 0.0, -1.5)
HIGH = PairModel(3.0, 2.0, 5.0, 50.0, 200.0, 10.0, 1.5)

_ABSENT_PARAMETERS = {
    PairVariant.FRICTIONLESS: {"friction": 1e-3, "growth": 0.0, "joint_friction": 0.0},
    PairVariant.ONE_K: {"growth": 0.0},
    PairVariant.EVEN: {"bedding": 0.0},
    PairVariant.FULL: {},
    PairVariant.TENSIONS: {"compliance": START.compliance, "bedding": 0.0},
}
_SHARED_PARAMETERS = [name for name in PairModel._fields if name != "neutral"]


class PairFit(NamedTuple):
    """A fitted pair."""

    law: PairVariant
    model: PairModel  # its neutral angle is the mean of the records'
    bends: tuple[float, ...]  # of the records fitted [rad]
    neutrals: tuple[float, ...]  # of each [rad]
    frictions: tuple[float, ...]  # K of each
    friction_errors: tuple[float, ...]  # their standard uncertainties; NaN where K was not free

    def get_model(self, bend: float) -> PairModel:
        """Return the model at a bend [rad]: its neutral angle between those of its neighbours."""
        bends, group = np.unique(self.bends, return_inverse=True)
        group_means = np.bincount(group, self.neutrals) / np.bincount(group)
        mean = self.model.neutral
        return self.model._replace(
            neutral=float(np.interp(bend, bends, group_means, left=mean, right=mean))
        )


def fit(
    records: Sequence[PairRecord],
    law: PairVariant = PairVariant.FULL,
    start: PairModel = START,
    *,
    each_friction: bool = False,
) -> PairFit:
    """Fit one pair to records of several bends.

    Parameters
    ----------
    records : sequence of PairRecord
        At least two bends among them, unless the law has one K.
    law : PairVariant
        What the model has, and from what it predicts.
    start : PairModel
        Where the search begins.
    each_friction : bool
        Find a K for each record instead of a straight line over the bend.

    Raises
    ------
    PairError
        There are too few records or samples, or an angle that does not move.
    """
    check_records(records)
    _check_bends(records, law)
    layout = _ParameterLayout(records, law, start, each_friction)
    subsampled = [_subsample_record(record) for record in records]
    caches = [_TendonCache(record, law) for record in subsampled]

    def evaluate_residuals(values: Array) -> Array:
        parts = zip(layout.build_models(values), subsampled, caches, strict=True)
        return np.concatenate(
            [_compute_residuals(model, record, law, cache) for model, record, cache in parts]
        )

    solution = minimise_squares(
        evaluate_residuals,
        layout.begin,
        *layout.bounds,
        x_scale=np.maximum(np.abs(layout.begin), 0.02),
        diff_step=STEP,
        ftol=COST_TOLERANCE,
        max_nfev=MAX_ITERATIONS,
    )
    models = layout.build_models(solution.values)
    frictions = tuple(
        float(m.compute_friction(r.bend)) for m, r in zip(models, records, strict=True)
    )
    neutral = float(np.mean([m.neutral for m in models]))
    errors = np.full(len(records), np.nan)
    if each_friction:
        strokes = _group_by_stroke(subsampled, law)
        errors = compute_clustered_errors(solution.jacobian, solution.residual, strokes)
        errors = errors[layout.frictions]
    return PairFit(
        law,
        models[0]._replace(neutral=neutral),
        tuple(record.bend for record in records),
        tuple(m.neutral for m in models),
        frictions,
        tuple(map(float, errors)),
    )


def predict_angle(model: PairModel, record: PairRecord, law: PairVariant) -> Array:
    """Return the angle [rad] that a model predicts."""
    simulate = simulate_by_tensions if law is PairVariant.TENSIONS else simulate_by_command
    return simulate(model, record).angle


def number_strokes(command: Array) -> NDArray[np.intp]:
    """Return the number of the stroke that each sample is in; one ends where the command turns."""
    directions = np.sign(np.diff(command, prepend=command[0]))
    for i in range(1, len(directions)):
        if directions[i] == 0.0:
            directions[i] = directions[i - 1]
    turns = (directions[1:] != directions[:-1]) & (directions[:-1] != 0.0)
    return np.concatenate([[0], np.cumsum(turns)])


class _ParameterLayout:
    """Which numbers of a fit are free: shared ones, a K of each record if wanted, and its neutral.

    The search begins at `begin` and stays within `bounds`; `frictions` are those of single records.
    """

    def __init__(
        self, records: Sequence[PairRecord], law: PairVariant, start: PairModel, each_friction: bool
    ) -> None:
        own_K = {"growth": 0.0, "friction": start.friction} if each_friction else {}
        absent = _ABSENT_PARAMETERS[law] | own_K
        self._free = [name for name in _SHARED_PARAMETERS if name not in absent]
        self._first, self._count = start._replace(**absent), len(records)
        self._each_friction = each_friction
        self.frictions = slice(len(self._free), -len(records))
        own = ["friction"] * len(records) if each_friction else []
        names = [*self._free, *own, *["neutral"] * len(records)]
        low, high = (np.array([getattr(bound, name) for name in names]) for bound in (LOW, HIGH))
        begin = np.array([getattr(self._first, name) for name in names])
        if each_friction:
            begin[self.frictions] = [start.compute_friction(record.bend) for record in records]
        self.begin, self.bounds = move_inside_bounds(begin, low, high, BOUND_MARGIN), (low, high)

    def build_models(self, values: Array) -> list[PairModel]:
        """Return the model of each record."""
        shared = self._first._replace(**dict(zip(self._free, map(float, values), strict=False)))
        neutrals = values[-self._count :]
        if not self._each_friction:
            return [shared._replace(neutral=float(zero)) for zero in neutrals]
        pairs = zip(values[self.frictions], neutrals, strict=True)
        return [shared._replace(friction=float(K), neutral=float(zero)) for K, zero in pairs]


class _TendonCache:
    """The tendons of a record; they are simulated again only where what they depend on changes."""

    def __init__(self, record: PairRecord, law: PairVariant) -> None:
        self._record = record
        self._by = (
            simulate_tendons_by_tensions
            if law is PairVariant.TENSIONS
            else simulate_tendons_by_command
        )
        self._known: dict[tuple[float, ...], tuple[Motion, Motion]] = {}

    def __call__(self, model: PairModel) -> tuple[Motion, Motion]:
        """Return what both tendons do."""
        key = (model.compute_friction(self._record.bend), model.compliance, model.bedding)
        if key not in self._known:
            self._known[key] = self._by(model, self._record)
        return self._known[key]


def _compute_residuals(
    model: PairModel, record: PairRecord, law: PairVariant, tendons: _TendonCache
) -> Array:
    motion = combine_tendons(model, *tendons(model))
    parts = [(motion.angle - record.angle) / record.span]
    if law is PairVariant.TENSIONS:
        return parts[0]
    for tension, measured in (
        (motion.tension_a, record.tension_a),
        (motion.tension_b, record.tension_b),
    ):
        parts.append(TENSION_WEIGHT * (tension - measured) / np.ptp(measured))
    return np.concatenate(parts)


def _subsample_record(record: PairRecord) -> PairRecord:
    stride = -(-len(record.time) // SAMPLES_MAX)
    return PairRecord(record.bend, *(column[::stride] for column in record[1:]))


def _group_by_stroke(records: Sequence[PairRecord], law: PairVariant) -> NDArray[np.intp]:
    """Return a number for each residual: those of one stroke of one record go together."""
    parts, next_number = [], 0
    for record in records:
        strokes = next_number + number_strokes(record.command)
        parts += [strokes] * (1 if law is PairVariant.TENSIONS else 3)
        next_number = int(strokes[-1]) + 1
    return np.concatenate(parts)


def check_records(records: Sequence[PairRecord]) -> None:
    """Raise `PairError` where a record is too short or does not move."""
    for record in records:
        if len(record.time) < MIN_SAMPLES:
            raise PairError(f"time: {len(record.time)} samples, must be at least {MIN_SAMPLES}")
        for name in ("command", "angle", "tension_a", "tension_b"):
            if np.ptp(getattr(record, name)) == 0.0:
                raise PairError(f"{name}: does not change")


def _check_bends(records: Sequence[PairRecord], law: PairVariant) -> None:
    bends = {record.bend for record in records}
    grows = law not in (PairVariant.FRICTIONLESS, PairVariant.ONE_K)
    if len(bends) < (2 if grows else 1):
        raise PairError("records: at least two bends are needed to tell how K grows with the bend")
