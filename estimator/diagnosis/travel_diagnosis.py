"""Diagnosis of motor travel and tip travel (or angles) without any tension.

Of the motor's travel u a reversal loses backlash, and elongation under the friction of the sheath.
Against a spring the latter grows with the load, backlash does not:

    y = g p + c,  p a play of u whose half-width is r + b |p - p0|, p0 where there is no load.

One tendon goes slack there: y stays. With L/EA, the spring k and friction K of a tendon, du/dy is
1 + k L/EA (e^K - 1)/K while it pulls and 1 + k L/EA (1 - e^-K)/K while it releases. Only ratios
follow: no force, and K only where both travels are of the same unit, unscaled. Everything is judged
on held-out halves, as in `estimator.diagnosis.api`.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array, Mask
from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import Record, RecordError, prepare_record
from estimator.diagnosis.scoring import (
    ChannelErrors,
    bootstrap_superiority,
    compute_channel_errors,
    compute_likelihood_gain,
    compute_residual_fraction,
    concatenate_errors,
)
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import DISTAL_DISPLACEMENT, PROXIMAL_DISPLACEMENT
from estimator.fitting import (
    COVERAGE_FACTOR,
    IntervalEstimate,
    build_interval,
    compute_clustered_errors,
)
from estimator.hysteresis_operators import apply_widening_play
from estimator.measured_data import MeasuredData
from estimator.noise_treatment import apply_play
from estimator.signals.sampling import drop_missing
from estimator.spline import evaluate_spline
from estimator.units import LINEAR, Units

WIDTH_SHARES = np.concatenate([[0.0], np.geomspace(2e-3, 0.35, 9)])  # of the motor's range
WIDENINGS = (0.0, 0.03, 0.1, 0.2, 0.35, 0.5)
VERTICES = {1: (-0.5, -0.15, 0.0, 0.07, 0.15, 0.3), 0: (0.35, 0.5, 0.65)}
"""Where the load is none, in shares of the motor's range: of one tendon, of two."""
TERMS_MAX = 2  # beside a play
KNOTS = 7  # coefficients of the curve of the tip over the play
SOFT_SHARES = (0.005, 0.015, 0.04, 0.1)  # of the range, half-widths of further plays
GRID_SAMPLES = 600  # that a grid is solved for
SAME_COST_RATIO = 1.1  # of squared errors in a half, below which a play of all samples is as good
JUMP_SHARE, JUMPS_MAX = 0.15, 5  # of the motor's range in one sample
STEPS = 2e-4  # of the range, and of widening, for derivatives


class Play(NamedTuple):
    """A play that widens, in the motor's unit."""

    half_width: float
    widening: float
    vertex: float
    side: int  # where the load grows: 1 with the motor's travel, -1 against it, 0 to both sides

    def apply(self, travel: Array) -> Array:
        """Return a travel after the play, shape (n,); that of one tendon ends where it is slack."""
        sign = self.side or 1
        p = apply_widening_play(sign * travel, self.half_width, self.widening, sign * self.vertex)
        return sign * (np.maximum(p, sign * self.vertex) if self.side else p)


class Stage(NamedTuple):
    """A model: what is added to a straight line, in words, and its held-out errors."""

    name: str
    words: str
    errors: dict[str, ChannelErrors]

    @property
    def rmse(self) -> float:
        """Root mean square held out, in the tip's unit."""
        return self.errors[DISTAL_DISPLACEMENT].rmse


class TravelDiagnosis(NamedTuple):
    """What two travels say of a transmission."""

    verdict: Verdict
    stages: tuple[Stage, ...]  # a line, plays, and what was named beside them, in this order
    others: tuple[Stage, ...]  # that were tried on the last one and not taken
    records: tuple[Record, ...]
    lost: IntervalEstimate  # motor travel that a reversal takes where the load is least
    lost_loaded: IntervalEstimate  # the same where it is largest
    gain: float  # travel of the tip over that of the motor
    friction: float  # K if the motor's travel is the tendon's own, unscaled; NaN if it cannot be
    stretch: float  # k L/EA, travel that a tendon without friction loses over that of the tip; same
    missed_share: float  # of the tip's rms about its mean
    noise: float  # of the tip, in its unit
    residual_fraction: float  # of the error beyond noise that a line leaves

    @property
    def units(self) -> Units:
        """Units of the records."""
        return self.records[0].units


_EXTRAS = {
    "drift": "its zero or gain drifts with time",
    "lag": "it lags behind the motor in proportion to speed",
    "curve": "it follows the play by a curve, not a line: the tip's kinematics, or slack",
    "soft_reversals": "it leaves a reversal softly, as of friction spread along the sheath",
}


def is_travel_pair(data: MeasuredData) -> bool:
    """Return whether data have both travels and no tension."""
    return (
        not np.isfinite(data.proximal_tension).any()
        and data.distal_tension is None
        and data.proximal_displacement is not None
        and data.distal_displacement is not None
    )


def diagnose_travels(data: Sequence[MeasuredData]) -> TravelDiagnosis:
    """Return what motor travel and tip travel say of a transmission, all records together.

    Raises `RecordError` for data that say nothing.
    """
    records = []
    for file, item in enumerate(data, start=1):
        q_p, q_d = item.proximal_displacement, item.distal_displacement
        signals = {PROXIMAL_DISPLACEMENT: np.asarray(q_p), DISTAL_DISPLACEMENT: np.asarray(q_d)}
        units = getattr(item, "units", LINEAR)
        _check_continuity(signals[PROXIMAL_DISPLACEMENT], getattr(item, "path", None))
        records.append(replace(prepare_record(item.time, signals, units=units), file=file))
    search = _Search(records)
    line = search.judge("line", "a line, no hysteresis", (), has_play=False)
    even = search.judge("play", "play of constant width", (), widens=False)
    widening = search.judge("widening_play", "play that widens with the load", ())
    stages = [line]
    for stage in (even, widening):
        if search.is_significant(stage, stages[-1]):
            stages.append(stage)
    named: tuple[str, ...] = ()
    others: list[Stage] = []
    while len(named) < TERMS_MAX and not search.is_noise(stages[-1]):
        others = [
            search.judge(name, words, (*named, name))
            for name, words in _EXTRAS.items()
            if name not in named
        ]
        best = min(others, key=lambda stage: stage.rmse)
        if not search.is_significant(best, stages[-1]):
            break
        stages.append(best)
        others.remove(best)  # of the last stage, if no further one is tried
        named = (*named, best.name)
    return _conclude(search, stages, others, named)


def _check_continuity(travel: Array, path: object) -> None:
    """Raise `RecordError` for pieces of records one after another, of which a play says nothing."""
    known = drop_missing(travel)
    jumps = int(np.sum(np.abs(np.diff(known)) > JUMP_SHARE * float(np.ptp(known))))
    if jumps > JUMPS_MAX:
        raise RecordError(
            f"{f'{path}: ' if path else ''}the motor's travel jumps {jumps} times by more than "
            f"{JUMP_SHARE:.0%} of its range from one sample to the next: pieces of records one "
            "after another? Give them in their order, or each as a file of its own"
        )


def _conclude(
    search: "_Search", stages: list[Stage], others: list[Stage], named: tuple[str, ...]
) -> TravelDiagnosis:
    line, last, names = stages[0], stages[-1], [stage.name for stage in stages]
    widens = "widening_play" in names
    play = search.fit_play(named, None, widens or "play" in names, widens)
    half_widths, errors, gain = search.estimate_widths(play, named)
    lost = [
        build_interval(2.0 * value, 2.0 * COVERAGE_FACTOR * error, 0.0)
        for value, error in zip(half_widths, errors, strict=True)
    ]
    spread = max(float(r.signals[DISTAL_DISPLACEMENT].std()) for r in search.records)
    missed = last.rmse / spread
    fraction = compute_residual_fraction(last.errors, line.errors)
    if search.is_noise(line):
        verdict = Verdict.CLEAN
    elif missed > SETTINGS.foreign_share_max or (
        fraction > SETTINGS.unexplained_fraction_max and not search.is_noise(last)
    ):
        verdict = Verdict.UNEXPLAINED
    else:
        verdict = Verdict.CHARACTERISED
    friction = stretch = math.nan
    pull, release = ((1.0 + sign * play.widening) / abs(gain) for sign in (1.0, -1.0))
    if widens and play.side != 0 and verdict is Verdict.CHARACTERISED and release > 1.0:
        friction = math.log((pull - 1.0) / (release - 1.0))
        stretch = (pull - 1.0) * friction / math.expm1(friction)
    return TravelDiagnosis(
        verdict, tuple(stages), tuple(others), tuple(search.records), lost[0], lost[1], gain,
        friction, stretch, missed, search.noise, fraction,
    )  # fmt: skip


class _Search:
    """Fits of plays with further terms, and their held-out errors."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        self.low = min(float(record.drive.min()) for record in records)
        self.span = max(float(record.drive.max()) for record in records) - self.low
        self.noise = max(record.noise[DISTAL_DISPLACEMENT] for record in records)
        self.rows = [record.valid[DISTAL_DISPLACEMENT] for record in records]
        self.fit_play = cache(self._fit_part)

    def judge(
        self, name: str, words: str, terms: tuple[str, ...], *, has_play: bool = True,
        widens: bool = True,
    ) -> Stage:  # fmt: skip
        """Return a model with its errors on both halves, each by the fit of the other."""
        parts = []
        for half in (True, False):
            play = self.fit_play(terms, half, has_play, widens)
            weights, _ = self._solve(play, terms, self._select(half))
            for record in self.records:
                tip, samples = (
                    self._build_design(record, play, terms) @ weights,
                    record.train != half,
                )
                parts.append(compute_channel_errors(record, DISTAL_DISPLACEMENT, tip, samples))
        return Stage(name, words, {DISTAL_DISPLACEMENT: concatenate_errors(parts)})

    def is_noise(self, stage: Stage) -> bool:
        """Return whether a model leaves no more than noise."""
        return math.sqrt(stage.errors[DISTAL_DISPLACEMENT].mean_square) < SETTINGS.noise_ratio

    def is_significant(self, stage: Stage, base: Stage) -> bool:
        """Return whether a model is better than a simpler one, as a named effect must be."""
        return (
            compute_likelihood_gain(stage.errors, base.errors) > SETTINGS.gain_min
            and bootstrap_superiority(stage.errors, base.errors) > SETTINGS.confidence
        )

    def _select(self, half: bool | None) -> list[Mask]:
        pairs = zip(self.rows, self.records, strict=True)
        return [rows if half is None else rows & (r.train == half) for rows, r in pairs]

    def _fit_part(
        self, terms: tuple[str, ...], half: bool | None, has_play: bool, widens: bool
    ) -> Play:
        """Return the play that leaves least in a half or (None) in all: of a grid, then refined.

        That of all samples where a half does not tell it from its own.
        """
        from scipy.optimize import minimize

        if not has_play:
            return Play(0.0, 0.0, self.low, 0)
        rows = self._select(half)

        def compute_cost(play: Play, rows: Sequence[NDArray[Any]] = rows) -> float:
            error = self._solve(play, terms, rows)[1]
            return float(error @ error)

        if terms:
            best = self.fit_play((), half, has_play, widens)
        else:
            few = [k[:: -(-len(k) * len(rows) // GRID_SAMPLES)] for k in map(np.flatnonzero, rows)]
            grid = itertools.product(WIDTH_SHARES, WIDENINGS if widens else (0.0,), (1, -1, 0))
            best = min(
                (
                    self._build_play(np.array([share, widening, vertex]), side)
                    for share, widening, side in grid
                    for vertex in (VERTICES[abs(side)] if widens else (0.0,) * (side == 0))
                ),
                key=lambda play: compute_cost(play, few),
            )
        share = (best.vertex - self.low) / self.span
        share = 1.0 - share if best.side < 0 else share
        start = np.array([best.half_width / self.span, best.widening, share])
        free = 3 if widens else 1
        steps = np.diag([0.01, 0.03, 0.04])[:free]
        minimum = minimize(
            lambda x: compute_cost(self._build_play(np.concatenate([x, start[free:]]), best.side)),
            start[:free],
            method="Nelder-Mead",
            options={
                "initial_simplex": start[:free] + np.vstack([np.zeros(free), steps[:, :free]]),
                "maxfev": 50 * free,
            },
        )
        play = self._build_play(np.concatenate([minimum.x, start[free:]]), best.side)
        if half is None:
            return play
        common = self.fit_play(terms, None, has_play, widens)
        return common if compute_cost(common) < SAME_COST_RATIO * compute_cost(play) else play

    def _build_play(self, x: Array, side: int) -> Play:
        """Return a play of a width and a vertex in shares of the motor's range."""
        share = 1.0 - float(x[2]) if side < 0 else float(x[2])
        vertex = self.low + share * self.span
        return Play(abs(float(x[0])) * self.span, float(np.clip(x[1], 0.0, 0.9)), vertex, side)

    def _build_design(self, record: Record, play: Play, terms: tuple[str, ...]) -> Array:
        u, t = record.drive, record.time
        p = play.apply(u)
        columns = [(p - self.low) / self.span, *np.eye(len(self.records))[:, record.file - 1, None]]
        columns = [np.broadcast_to(c, u.shape) for c in columns]
        if "drift" in terms:
            columns += [t / t[-1], columns[0] * t / t[-1]]
        if "lag" in terms:
            columns += [record.speed / max(float(np.abs(record.speed).max()), 1e-30)]
        if "curve" in terms:
            share = (p - self.low) / self.span
            columns += [evaluate_spline(row, share) for row in np.eye(KNOTS)]
        if "soft_reversals" in terms:
            columns += [(apply_play(u, share * self.span) - p) / self.span for share in SOFT_SHARES]
        return np.column_stack(columns)

    def _solve(
        self, play: Play, terms: tuple[str, ...], rows: Sequence[NDArray[Any]]
    ) -> tuple[Array, Array]:
        """Return the weights of all columns, and the error of the rows that are fitted."""
        pairs = list(zip(self.records, rows, strict=True))
        A = np.concatenate([self._build_design(r, play, terms)[k] for r, k in pairs])
        y = np.concatenate([r.signals[DISTAL_DISPLACEMENT][k] for r, k in pairs])
        normal = A.T @ A
        normal[np.diag_indices_from(normal)] += 1e-9 * np.trace(normal)
        weights = np.linalg.solve(normal, A.T @ y)
        return weights, y - A @ weights

    def estimate_widths(
        self, play: Play, terms: tuple[str, ...]
    ) -> tuple[tuple[float, float], tuple[float, float], float]:
        """Return half-widths at the least and the largest load, their errors, and the gain."""
        _, error = self._solve(play, terms, self.rows)
        reach = max(play.vertex - self.low, self.low + self.span - play.vertex)
        size = STEPS * self.span
        changed = (
            play._replace(half_width=play.half_width + size),
            play._replace(widening=play.widening + STEPS),
        )
        slopes = [(self._solve(p, terms, self.rows)[1] - error) / STEPS for p in changed]
        pairs = list(zip(self.records, self.rows, strict=True))
        blocks = [r.block[k] + 10**6 * r.file for r, k in pairs]
        _, groups = np.unique(np.concatenate(blocks), return_inverse=True)
        ends = (play.half_width, play.half_width + play.widening * reach)
        design = np.column_stack([slopes[0] / self.span, slopes[1]])
        J = np.column_stack([design[:, 0] - design[:, 1] / reach, design[:, 1] / reach])
        errors = compute_clustered_errors(J, error, groups)
        weights, _ = self._solve(play, tuple(set(terms) - {"curve"}), self.rows)
        slope = float(weights[0])
        if "drift" in terms:  # as in the middle of the record
            slope += 0.5 * float(weights[len(self.records) + 2])
        return ends, (float(errors[0]), float(errors[1])), slope / self.span
