"""What is wrong with an arm: with a joint, with how tendons pass it, or with a single tendon.

Every tendon is simulated with the motion of all joints known (`arm_model`). Which tendons a cause
(`arm_causes`) explains decides whether it is named of a joint, of a row of the routing or of one
tendon. Causes are compared by held-out log-likelihood with a BIC penalty, as those of one tendon.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array, Mask
from estimator.diagnosis.arm_causes import ArmCause, list_arm_causes
from estimator.diagnosis.arm_model import (
    ArmData,
    ArmTendon,
    Simulated,
    TendonValues,
    prepare_tendons,
)
from estimator.diagnosis.record import RecordError
from estimator.diagnosis.scoring import (
    ChannelErrors,
    bootstrap_superiority,
    compute_channel_errors,
    compute_log_likelihood_ratio,
)
from estimator.diagnosis.settings import SETTINGS, ProgressCallback, ignore_progress
from estimator.fitting import (
    IntervalEstimate,
    build_interval,
    compute_clustered_errors,
    minimise_squares,
)
from estimator.law.sheath import Sheath
from estimator.routing.routing import Routing

CAUSES_MAX = 4
FOLLOWED = 4  # candidates that are fitted, at most, after all were tried linearly
FOLLOWED_SHARE = 0.1  # of what the best one gains then, that others gain at least
ROUNDS = 12  # of a fit
K_STEP = 0.01  # of K, for derivatives
OUTLIER_DEVIATIONS = 9.0  # median errors, from which on a sample is far off
OUTLIERS_MAX = 0.05  # share of the samples that may be far off and are left out
GAIN_MIN = 0.3  # by which a cause lowers the squared error of its tendons
STIFFNESS_SPREAD = 0.005, 0.02  # of stiffnesses over the config's, at least; of few tendons
TENDONS_FEW = 4
HALF_WIDTH = 1.96  # of a 95 % interval, in standard errors


class NamedCause(NamedTuple):
    """A cause with its size."""

    cause: ArmCause
    value: IntervalEstimate
    score: float  # log-likelihood ratio of held-out data, less the BIC penalty
    rivals: tuple[ArmCause, ...]  # that the data do not distinguish from it


class TendonReport(NamedTuple):
    """Held-out errors of one tendon, rms by channel, in N and m; none if it is not judged."""

    name: str
    K: float  # of its sheath, fitted with the causes
    known: float  # K of the config
    noise: dict[str, float]  # that nothing explains, with the law's own
    before: dict[str, float]
    after: dict[str, float]
    is_explained: bool


class ArmDiagnosis(NamedTuple):
    """What is wrong with an arm."""

    causes: tuple[NamedCause, ...]
    tendons: tuple[TendonReport, ...]
    routing: Routing
    has_encoders: bool
    is_at_anchor: bool

    @property
    def is_clean(self) -> bool:
        """Whether nothing is wrong beyond noise."""
        return not self.causes and all(tendon.is_explained for tendon in self.tendons)


class _Fit(NamedTuple):
    """Fitted numbers of causes and of tendons, and what they make of the latter."""

    numbers: tuple[float, ...]  # of the causes
    K: dict[int, float]
    simulated: dict[int, Simulated]
    jacobian: Array = np.empty((0, 0))
    residual: Array = np.empty(0)


def diagnose_arm(
    data: ArmData,
    routing: Routing,
    sheaths: Sequence[Sheath],
    *,
    noise: dict[str, float] | None = None,
    report: ProgressCallback = ignore_progress,
) -> ArmDiagnosis:
    """Find what is wrong with an arm, with the motion of all of its joints known.

    Parameters
    ----------
    data : ArmData
    routing : Routing
        As it is known: of the tendons of the data, in their order.
    sheaths : sequence of Sheath
        Of each tendon; K is fitted, stiffness only compared.
    noise : dict, optional
        Standard deviation of the noise of channels, where it is known.
    report : callable
        Told what is being done and which share of it is.

    Raises
    ------
    RecordError
        If the data of a tendon cannot be diagnosed.
    """
    report("fitting each tendon", 0.0)
    search = _Search(prepare_tendons(data, routing, sheaths, noise or {}), report)
    causes = search.select_judged(list_arm_causes(data, routing))
    named: list[NamedCause] = []
    base = fits = search.start
    while len(named) < CAUSES_MAX:
        next_cause = search.find_next(causes, [entry.cause for entry in named], fits, len(named))
        if next_cause is None:
            break
        named.append(next_cause)
        kept, numbers = [entry.cause for entry in named], [*fits.numbers, next_cause.value.value]
        search.select_sliding(kept, numbers, fits.K)
        base, fits = search.fit_all([], fits.K), search.fit_all(kept, fits.K, numbers)
    report("estimating intervals", 0.95)
    named = search.measure(named, fits)
    tendons = tuple(search.describe(i, base, fits) for i in range(len(search.tendons)))
    return ArmDiagnosis(tuple(named), tendons, routing, data.has_encoders, data.is_at_anchor)


class _Search:
    """Fits causes to the tendons of an arm."""

    def __init__(self, tendons: Sequence[ArmTendon], report: ProgressCallback) -> None:
        self.tendons, self._report = tendons, report
        self._judged = [i for i, tendon in enumerate(tendons) if tendon.has_samples]
        if not self._judged:
            raise RecordError(
                "no tendon slides under tension for long: move all joints to and fro, with all "
                "tendons taut; or diagnose one tendon (--tendon)"
            )
        self._stiffness = [1.0, math.inf]  # expected over the config's, and its spread
        self.start = self.fit_all([], {})
        stiffness = np.array([sim.stiffness for sim in self.start.simulated.values()])
        middle = float(np.median(stiffness))
        spread = 1.48 * float(np.median(np.abs(stiffness - middle)))
        least = STIFFNESS_SPREAD[len(tendons) < TENDONS_FEW]
        self._stiffness = [middle, max(spread, least * middle)]

    def select_judged(self, causes: Sequence[ArmCause]) -> list[ArmCause]:
        """Return the causes, each in those of its tendons that have samples."""
        chosen = [
            replace(cause, tendons=tuple(i for i in cause.tendons if i in self._judged))
            for cause in causes
        ]
        return [cause for cause in chosen if cause.tendons]

    def fit_all(
        self, causes: Sequence[ArmCause], K: dict[int, float], start: Sequence[float] = ()
    ) -> _Fit:
        """Return the fit of some causes and of K of all tendons, from a start."""
        numbers, simulated = list(start), dict[int, Simulated]()
        for chosen, tendons in self._split(causes):
            fit = self._fit(tendons, [causes[k] for k in chosen], [numbers[k] for k in chosen], K)
            K, simulated = K | fit.K, simulated | fit.simulated
            for k, number in zip(chosen, fit.numbers, strict=True):
                numbers[k] = number
        return _Fit(tuple(numbers), K, simulated)

    def select_sliding(
        self, causes: Sequence[ArmCause], numbers: Sequence[float], K: dict[int, float]
    ) -> None:
        """Let those samples count in which tendons slide with some causes."""
        self.tendons = [
            tendon.select_sliding(self._apply(i, causes, numbers, K[i])) if i in K else tendon
            for i, tendon in enumerate(self.tendons)
        ]

    def _split(self, causes: Sequence[ArmCause]) -> list[tuple[list[int], list[int]]]:
        """Return what can be fitted by itself: places of causes, and the tendons they change."""
        parts: list[tuple[list[int], set[int]]] = [([], {i}) for i in self._judged]
        for k, cause in enumerate(causes):
            joined = [part for part in parts if part[1] & set(cause.tendons)]
            parts = [part for part in parts if part not in joined]
            places = [place for part in joined for place in part[0]]
            parts.append(([*places, k], set().union(*(part[1] for part in joined))))
        return [(places, sorted(tendons)) for places, tendons in parts]

    def _fit(
        self,
        tendons: Sequence[int],
        causes: Sequence[ArmCause],
        numbers: Sequence[float],
        K: dict[int, float],
        *,
        is_full: bool = False,
    ) -> _Fit:
        """Return the fit of the numbers of causes and of K of `tendons`, from a start."""
        steps = np.array([cause.step for cause in causes] + [K_STEP] * len(tendons))
        start = np.array([*numbers, *(K.get(i, self.tendons[i].values.K) for i in tendons)]) / steps
        rows = self._count_rows(tendons, is_full)
        of_tendon = np.repeat(np.arange(len(tendons)), rows)

        def evaluate(x: Array) -> Array:
            numbers, K = (x * steps)[: len(causes)], (x * steps)[len(causes) :]
            parts = []
            for i, k in zip(tendons, K.tolist(), strict=True):
                parts.append(
                    self._compute_residual(
                        i, self._simulate(i, causes, numbers, k, is_full), is_full
                    )
                )
            return np.concatenate(parts)

        def differentiate(x: Array) -> Array:
            residual, place = evaluate(x), np.arange(len(x))
            columns = [
                _compute_difference(evaluate, x, place == k, residual) for k in range(len(causes))
            ]
            all_K = _compute_difference(evaluate, x, place >= len(causes), residual)
            columns += [np.where(of_tendon == i, all_K, 0.0) for i in range(len(tendons))]
            return np.column_stack(columns)

        low = np.array([-np.inf] * len(causes) + [1e-3] * len(tendons))
        solution = minimise_squares(
            evaluate, start, np.where(np.isfinite(low), low / steps, low), np.inf,
            jac=differentiate, x_scale=1.0, loss="soft_l1", f_scale=3.0, ftol=1e-3, xtol=1e-4,
            max_nfev=ROUNDS,
        )  # fmt: skip
        fitted = solution.values * steps
        fitted_K = dict(zip(tendons, fitted[len(causes) :].tolist(), strict=True))
        simulated = {
            i: self._simulate(i, causes, fitted[: len(causes)], k, is_full)
            for i, k in fitted_K.items()
        }
        return _Fit(
            tuple(fitted[: len(causes)].tolist()), fitted_K, simulated,
            solution.jacobian / steps, solution.residual,
        )  # fmt: skip

    def _simulate(
        self, i: int, causes: Sequence[ArmCause], numbers: Sequence[float] | Array, K: float,
        is_full: bool = False,
    ) -> Simulated:  # fmt: skip
        tendon = self.tendons[i]
        rows = np.ones_like(tendon.record.train) if is_full else None
        return tendon.simulate(self._apply(i, causes, numbers, K), rows)

    def _apply(
        self, i: int, causes: Sequence[ArmCause], numbers: Sequence[float] | Array, K: float
    ) -> TendonValues:
        values = self.tendons[i].values._replace(K=K)
        for cause, number in zip(causes, numbers, strict=True):
            if i in cause.tendons:
                values = cause.change(values, float(number))
        return values

    def _compute_residual(self, i: int, simulated: Simulated, is_full: bool = False) -> Array:
        record, parts = self.tendons[i].record, []
        for channel in record.compared:
            rows = record.valid[channel] & (record.train | is_full)
            error = simulated.signals[channel] - record.signals[channel]
            parts.append((error / record.sigma[channel])[rows])
        return np.concatenate([*parts, [math.sqrt(self._compute_penalty(simulated))]])

    def _count_rows(self, tendons: Sequence[int], is_full: bool) -> list[int]:
        records = [self.tendons[i].record for i in tendons]
        return [
            1 + sum(int((r.valid[c] & (r.train | is_full)).sum()) for c in r.compared)
            for r in records
        ]

    def _compute_penalty(self, simulated: Simulated) -> float:
        """Return by how much a stiffness differs from that of the other tendons, squared."""
        middle, spread = self._stiffness
        return float(((simulated.stiffness - middle) / spread) ** 2)

    def _compute_errors(
        self,
        simulated: dict[int, Simulated],
        tendons: Sequence[int],
        best: dict[int, Simulated] | None = None,
    ) -> dict[str, ChannelErrors]:
        """Return the held-out errors of tendons, by tendon and channel.

        The few samples that are far off what `best` simulates are left out: they are of a short
        rest or a turn that was taken for sliding.
        """
        errors = {}
        for i in tendons:
            record, reference = self.tendons[i].record, (best or simulated)[i]
            for channel in record.compared:
                size = np.abs(reference.signals[channel] - record.signals[channel])
                valid = record.valid[channel]
                is_far = size > OUTLIER_DEVIATIONS * float(np.median(size[valid]))
                if is_far[valid].mean() > OUTLIERS_MAX:
                    is_far[:] = False
                rows = ~record.train & ~is_far
                signal = simulated[i].signals[channel]
                errors[f"{i} {channel}"] = compute_channel_errors(record, channel, signal, rows)
        return errors

    def is_explained(self, simulated: dict[int, Simulated], i: int) -> bool:
        """Return whether the held-out errors of a tendon are no larger than noise."""
        return all(
            math.sqrt(errors.mean_square) < SETTINGS.noise_ratio
            for errors in self._compute_errors(simulated, [i]).values()
        )

    def find_next(
        self, causes: Sequence[ArmCause], named: Sequence[ArmCause], current: _Fit, round_: int
    ) -> NamedCause | None:
        """Return the cause that explains most beside those that are named; None if none does."""
        begin = 0.9 * round_ / CAUSES_MAX
        unexplained = {i for i in self._judged if not self.is_explained(current.simulated, i)}
        promising = [
            cause for cause in causes if cause not in named and unexplained & set(cause.tendons)
        ]
        if not promising:
            return None
        slopes_K = {i: self._compute_friction_slope(i, named, current) for i in self._judged}
        screened = []
        for k, cause in enumerate(promising):
            self._report("trying causes", begin + 0.12 * k / len(promising))
            screened.append((*self._screen_cause(cause, named, current, slopes_K), cause))
        screened.sort(key=lambda entry: -entry[0])
        if screened[0][0] <= 0.0:
            return None
        tried = []
        followed = [e for e in screened[:FOLLOWED] if e[0] > FOLLOWED_SHARE * screened[0][0]]
        for k, (_, number, cause) in enumerate(followed):
            self._report(f"fitting {cause.kind}", begin + 0.12 + 0.1 * k / FOLLOWED)
            tried.append((cause, *self._try(cause, number, named, current)))
        cause, score, is_better, number = max(tried, key=lambda entry: entry[1])
        if score < SETTINGS.score_min or not is_better:
            return None
        rivals = tuple(
            other for other, its_score, _, _ in tried
            if other is not cause and score - its_score < SETTINGS.equivalent_score_max
        )  # fmt: skip
        return NamedCause(cause, IntervalEstimate(number, number, number), score, rivals)

    def _compute_friction_slope(self, i: int, named: Sequence[ArmCause], current: _Fit) -> Array:
        shifted = self._simulate(i, named, current.numbers, current.K[i] + K_STEP)
        return self._compute_residual(i, shifted) - self._compute_residual(i, current.simulated[i])

    def _screen_cause(
        self, cause: ArmCause, named: Sequence[ArmCause], current: _Fit, slopes_K: dict[int, Array]
    ) -> tuple[float, float]:
        """Return the log-likelihood that a cause gains if all is linear, and its number then."""
        parts = []
        for i in cause.tendons:
            residual = self._compute_residual(i, current.simulated[i])
            shifted = self._simulate(
                i, [*named, cause], [*current.numbers, cause.step], current.K[i]
            )
            slope = self._compute_residual(i, shifted) - residual
            of_K = slopes_K[i] / max(float(np.linalg.norm(slopes_K[i])), 1e-12)
            # K takes its part first
            parts.append((residual - of_K * (of_K @ residual), slope - of_K * (of_K @ slope)))
        square = sum(float(slope @ slope) for _, slope in parts)
        number = -sum(float(slope @ residual) for residual, slope in parts) / max(square, 1e-12)
        gain = sum(
            0.5 * len(residual) * math.log(
                max(float(residual @ residual), 1e-12)
                / max(float(np.sum((residual + number * slope) ** 2)), 0.5 * len(residual), 1e-12)
            )
            for residual, slope in parts
        )  # fmt: skip
        return gain, number * cause.step

    def _try(
        self, cause: ArmCause, number: float, named: Sequence[ArmCause], current: _Fit
    ) -> tuple[float, bool, float]:
        """Return the score of a cause beside others, whether it surely is better, its number."""
        together = [*named, cause]
        chosen, tendons = next(
            part for part in self._split(together) if len(together) - 1 in part[0]
        )
        start = [*current.numbers, number]
        fit = self._fit(
            tendons, [together[k] for k in chosen], [start[k] for k in chosen], current.K
        )
        errors = self._compute_errors(fit.simulated, tendons)
        before = self._compute_errors(current.simulated, tendons, fit.simulated)
        samples = sum(len(self.tendons[i].record.time) for i in tendons)
        ratio = compute_log_likelihood_ratio(errors, before)
        penalty = sum(
            self._compute_penalty(fit.simulated[i]) - self._compute_penalty(current.simulated[i])
            for i in tendons
        )
        after, earlier = (
            sum(
                e.mean_square
                for e in self._compute_errors(
                    state.simulated, cause.tendons, fit.simulated
                ).values()
            )
            for state in (fit, current)
        )
        is_better = (
            after < (1.0 - GAIN_MIN) * earlier
            and bootstrap_superiority(errors, before) > SETTINGS.confidence
        )
        number = fit.numbers[chosen.index(len(named))]
        return ratio - 0.5 * penalty - 0.5 * math.log(samples), is_better, number

    def measure(self, named: Sequence[NamedCause], fits: _Fit) -> list[NamedCause]:
        """Return causes with their sizes, fitted to all samples."""
        causes, measured = [entry.cause for entry in named], list(named)
        for chosen, tendons in self._split(causes):
            if not chosen:
                continue
            fit = self._fit(
                tendons, [causes[k] for k in chosen], [fits.numbers[k] for k in chosen], fits.K,
                is_full=True,
            )  # fmt: skip
            blocks = [
                np.append(np.concatenate([r.block[r.valid[c]] for c in r.compared]), 0)
                for r in (self.tendons[i].record for i in tendons)
            ]
            errors = compute_clustered_errors(fit.jacobian, fit.residual, np.concatenate(blocks))
            for place, k in enumerate(chosen):
                half = HALF_WIDTH * float(errors[place])
                measured[k] = named[k]._replace(value=build_interval(fit.numbers[place], half))
        return measured

    def describe(self, i: int, before: _Fit, after: _Fit) -> TendonReport:
        """Return the held-out errors of a tendon without and with causes."""
        known = self.tendons[i].values.K
        if i not in self._judged:
            return TendonReport(self.tendons[i].name, math.nan, known, {}, {}, {}, True)
        record = self.tendons[i].record
        before_rms, after_rms = (
            {
                c.partition(" ")[2]: e.rmse
                for c, e in self._compute_errors(fit.simulated, [i], after.simulated).items()
            }
            for fit in (before, after)
        )
        noise = {channel: float(record.sigma[channel][0]) for channel in record.compared}
        is_explained = self.is_explained(after.simulated, i)
        return TendonReport(
            self.tendons[i].name, after.K[i], known, noise, before_rms, after_rms, is_explained
        )


def _compute_difference(
    evaluate: Callable[[Array], Array], x: Array, which: Mask, residual: Array
) -> Array:
    step = 0.1 * which
    return (evaluate(x + step) - residual) / 0.1
