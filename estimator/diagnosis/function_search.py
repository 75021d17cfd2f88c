"""On what the missing part depends where no named cause explains it: a free function, fitted.

Each quantity of the model that can change is tried with each variable (`effects.functions`). A
linear step of the function's coefficients and all parameters together, for several smoothnesses,
ranks them by held-out likelihood; the best are fitted by re-simulation, as named causes are, and
judged by the same scores.
"""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    TIP_COMPLIANCE,
    Dataset,
    Fit,
    Model,
    build_contexts,
    compute_residual,
    rescale_residuals,
    simulate_dataset,
)
from estimator.diagnosis.fit import (
    ParameterLayout,
    compute_jacobian,
    fit_model,
    shift_parameters,
)
from estimator.diagnosis.scoring import (
    compute_bic_penalty,
    compute_errors,
    compute_log_likelihood_ratio,
    compute_missed_share,
)
from estimator.diagnosis.screening import (
    Candidate,
    build_candidate,
    map_parallel,
    thin_dataset,
)
from estimator.diagnosis.settings import SETTINGS, ProgressCallback
from estimator.effects.effect import Effect, EffectContext
from estimator.effects.functions import (
    COEFFICIENTS,
    FUNCTIONS,
    compute_basis,
    compute_penalty,
    penalise,
    split_values,
)

SUBSAMPLE_SIZE = 1200  # samples of a record in a first look
ROUGHNESSES = (1e-4, 1e-3, 1e-2, 0.1, 1.0)  # weights of second differences, over that of the data
# of a refit: a linear step from a bad model favours more than that from a good one
ROUGHNESS_RATIO = 0.3
MEAN_WEIGHTS = (1e-2, 1.0)  # the same of the mean, where the law does not take it up and where
STEPS_KEPT = 20  # linear steps that are simulated
FITTED_SIZE = 8000  # samples of all records that a function is fitted to
KEPT = 10, 4  # functions that are fitted to few samples, and to so many
ROUNDS = 8, 15  # of these fits
FOREIGN_RATIO = 1.5  # times what a model of a tendon may miss: such a first fit ends there
PERIODS_MIN, PERIODS_MAX = 3, 60  # of a cycle, in a record
FREQUENCY_STEP = 0.1  # periods more in a record
POWER_MIN = 1e-9  # squares of the residual: below it, nothing changes
BUMPS = 240  # in a record, of which a response to any function of time is made
PERIODS_TRIED = 16, 8  # that are simulated, and that are followed


class _LinearStep(NamedTuple):
    """What a function's coefficients do to the residual beside the model's own parameters."""

    effect: Effect
    shapes: tuple[float, ...]
    changes: Array  # of the residual by each coefficient, in its step, (n, coefficients)
    information: Array  # of the coefficients, (coefficients, coefficients)
    slope: Array  # of half the cost, (coefficients,)
    gain: float  # by which the cost would fall at most


class _Screened(NamedTuple):
    """An effect with the smoothness and the model that a linear step gives."""

    effect: Effect
    model: Model
    score: float
    roughness: float  # weights of its penalty
    mean: float
    step: _LinearStep

    @property
    def degrees(self) -> float:
        """Degrees of freedom that the penalty leaves."""
        A, rows = self.step.information, _compute_penalty_rows(self.step, self.roughness, self.mean)
        shapes = self.effect.parameters[: len(self.step.shapes)]
        free = sum(not p.is_fixed for p in shapes)
        return free + float(np.trace(np.linalg.solve(A + rows.T @ rows, A)))


def fit_functions(
    dataset: Dataset,
    current_fit: Fit,
    effects: Sequence[Effect],
    report: ProgressCallback,
    workers: int = 1,
) -> list[Candidate]:
    """Return the models with one function more that held-out samples favour most, fitted.

    Parameters
    ----------
    current_fit : Fit
        The model without.
    effects : sequence of Effect
        With a `function` each.
    """
    dataset = rescale_residuals(dataset, current_fit)
    contexts = build_contexts(dataset, current_fit)
    few, few_fit, few_contexts = thin_dataset(dataset, current_fit, SUBSAMPLE_SIZE)
    screening = _Screening(few, few_fit, few_contexts)
    applicable = [effect for effect in effects if _is_applicable(effect, dataset)]
    steps = sorted(
        itertools.chain.from_iterable(
            map_parallel(screening.linearise, applicable, report, "trying functions", workers)
        ),
        key=lambda step: -step.gain,
    )
    further = [step for step in steps[STEPS_KEPT:] if step.effect.name.startswith("friction")]
    screened = sorted(
        map_parallel(
            screening.smooth, [*steps[:STEPS_KEPT], *further], report, "smoothing", workers
        ),
        key=lambda start: -start.score,
    )

    def fit_few(start: _Screened) -> tuple[float, _Screened]:
        effect = _penalise(start, 1.0)
        fit = fit_model(few, few_contexts, _set_last_effect(start.model, effect), ROUNDS[0])
        errors = compute_errors(few, fit)
        is_foreign = compute_missed_share(few, errors) > FOREIGN_RATIO * SETTINGS.foreign_share_max
        score = -math.inf if is_foreign else screening.compute_score(fit, start.degrees)
        return score, start._replace(model=fit.model)

    # no linear step leads to friction that rises at rest: it acts with the next motion only
    others = [
        start._replace(model=_set_coefficients(start.model, few_fit.model))
        for start in screened[KEPT[0] :]
        if start.effect.name.startswith("friction")
    ]
    best = sorted(
        map_parallel(
            fit_few, [*screened[: KEPT[0]], *others], report, "fitting functions", workers
        ),
        key=lambda pair: -pair[0],
    )
    fitted_size = max(FITTED_SIZE // len(dataset.records), SUBSAMPLE_SIZE)
    some, _, some_contexts = thin_dataset(dataset, current_fit, fitted_size)

    def weigh(start: _Screened, of: Dataset) -> Model:
        samples, first = (sum(len(record.time) for record in data.records) for data in (of, few))
        return _set_last_effect(start.model, _penalise(start, math.sqrt(samples / first)))

    def fit_some(pair: tuple[float, _Screened]) -> Candidate:
        fit = fit_model(some, some_contexts, weigh(pair[1], some), ROUNDS[1])
        model = weigh(pair[1]._replace(model=fit.model), dataset)
        return build_candidate(dataset, simulate_dataset(dataset, contexts, model))

    chosen = list({start.effect.name: (score, start) for score, start in reversed(best)}.values())
    chosen = sorted(chosen, key=lambda pair: -pair[0])[: KEPT[1]]
    chosen = [pair for pair in chosen if pair[0] > -math.inf]  # no fit makes a tendon of the rest

    def refine_smoothness(pair: tuple[float, _Screened]) -> tuple[float, _Screened]:
        while True:
            start = pair[1]._replace(roughness=ROUGHNESS_RATIO * pair[1].roughness)
            refined = fit_few(start)
            if refined[0] <= pair[0]:
                return pair
            pair = refined

    chosen = list(map_parallel(refine_smoothness, chosen, report, "smoothing further", workers))
    return list(map_parallel(fit_some, chosen, report, "finishing functions", workers))


def _is_applicable(effect: Effect, dataset: Dataset) -> bool:
    record, base = dataset.records[0], dataset.base
    has_load = TIP_COMPLIANCE in (*base.shared, *base.own)
    return (
        effect.required_channels <= set(record.signals)
        and not (record.loop and effect.name.startswith("elongation"))
        and (has_load or not effect.name.startswith("tip_load"))
        and not (effect.function and effect.function.is_periodic and len(dataset.records) > 1)
    )


def _set_last_effect(model: Model, effect: Effect) -> Model:
    return model._replace(effects=(*model.effects[:-1], (effect, model.effects[-1][1])))


def _set_coefficients(model: Model, base: Model) -> Model:
    """Return a base model with the last effect of another one, its function at zero."""
    effect, values = model.effects[-1]
    shapes, coefficients = split_values(effect, values)
    zero = (*shapes, *(len(coefficients) * [0.0]))
    return base._replace(effects=(*base.effects, (effect, zero)))


def _penalise(start: _Screened, density: float) -> Effect:
    """Return the effect with its penalty, for so many times as many samples (square root)."""
    return penalise(start.effect, density * start.roughness, density * start.mean, start.degrees)


def _compute_penalty_rows(step: _LinearStep, roughness: float, mean: float) -> Array:
    """Return the derivatives of the penalty by each coefficient, in its step."""
    by_roughness, by_mean = (
        _build_penalty_rows(step.effect, *of) for of in ((1.0, 0.0), (0.0, 1.0))
    )
    return np.asarray(roughness * by_roughness + mean * by_mean)


@lru_cache
def _build_penalty_rows(effect: Effect, roughness: float, mean: float) -> Array:
    shapes = (0.0,) * len(split_values(effect, effect.parameters)[0])
    columns = [
        compute_penalty((*shapes, *row), effect, roughness, mean) for row in _build_units(effect)
    ]
    return np.column_stack(columns)


def _place_bumps(duration: float) -> Array:
    """Return when bumps in a record are [s] from its begin."""
    return np.asarray(duration / BUMPS * (np.arange(BUMPS) + 0.5), dtype=np.float64)


@lru_cache(maxsize=1)
def _weigh_bumps(duration: float) -> list[tuple[float, Array]]:
    """Return the periods of a cycle [s], and what each bump is in a function of its phase."""
    by_phase = next(
        effect for effect in FUNCTIONS if effect.function and effect.function.is_periodic
    )
    periods = [duration / n for n in np.arange(PERIODS_MIN, PERIODS_MAX, FREQUENCY_STEP).tolist()]
    zero, centres = COEFFICIENTS * [0.0], _place_bumps(duration)
    return [(period, compute_basis(by_phase, (period, *zero), centres)) for period in periods]


def _build_units(effect: Effect) -> list[list[float]]:
    """Return coefficients of which one is a step of its parameter and the others are zero."""
    coefficients = split_values(effect, effect.parameters)[1]
    units: list[list[float]] = (coefficients[0].step * np.eye(len(coefficients))).tolist()
    return units


def _compute_gain(A: Array, b: Array) -> float:
    """Return by how much coefficients of information `A` and slope `b` lower the cost."""
    power = float(np.trace(A)) / len(A)
    if power < POWER_MIN:
        return 0.0
    return float(b @ np.linalg.solve(A + ROUGHNESSES[0] * power * np.eye(len(A)), b))


class _Screening:
    """Linear steps of functions on top of a model, on few samples."""

    def __init__(self, dataset: Dataset, fit: Fit, contexts: Sequence[EffectContext]) -> None:
        self._dataset, self._fit, self._contexts = dataset, fit, contexts
        self._errors = compute_errors(dataset, fit)
        self._residual = compute_residual(dataset, fit)
        J = compute_jacobian(dataset, contexts, fit)
        J[:, ~ParameterLayout(dataset, fit.model).is_smooth] = 0.0
        self._solve = np.linalg.pinv(J)
        self._basis = np.linalg.qr(J)[0] if J.any() else np.zeros((len(J), 1))
        self._smoothed: dict[int, _Screened] = {}  # by the identity of their steps

    def compute_score(self, fit: Fit, degrees: float) -> float:
        """Return the log-likelihood ratio of held-out samples to the model without, less BIC's."""
        ratio = compute_log_likelihood_ratio(compute_errors(self._dataset, fit), self._errors)
        return ratio - compute_bic_penalty(self._dataset, degrees)

    def linearise(self, effect: Effect) -> list[_LinearStep]:
        """Return the linear steps for the range of the variable, or for each likely period."""
        if effect.function is None:
            return []
        if effect.function.is_periodic:
            return self._linearise_periods(effect)
        parts = [
            effect.function.evaluate(context)[record.measured]
            for record, context in zip(self._dataset.records, self._contexts, strict=True)
        ]
        x = np.concatenate(parts)
        low, high = float(x.min()), float(x.max())
        if not high > low:
            return []
        changes = [
            self._simulate(effect, (low, high, *row)) - self._residual
            for row in _build_units(effect)
        ]
        return self._build_steps(effect, (low, high), np.column_stack(changes))

    def _linearise_periods(self, effect: Effect) -> list[_LinearStep]:
        """Return the linear steps for the periods with which held-out samples fit best.

        The response to any function of time is made of those to narrow bumps, so that a period
        costs no simulation; the periods that could explain most are then simulated.
        """
        name = effect.name.replace("_by_phase", "_by_time")
        over_time = next(function for function in FUNCTIONS if function.name == name)
        duration = float(np.ptp(self._dataset.records[0].time))
        spacing, centres = duration / BUMPS, _place_bumps(duration)
        bump = COEFFICIENTS * [0.0]
        bump[COEFFICIENTS // 2] = effect.parameters[-1].step
        # the coefficient's spline has its middle so many intervals from either end of the range
        before, after = COEFFICIENTS // 2 - 1, COEFFICIENTS // 2 - 2
        changes = np.column_stack(
            [
                self._simulate(over_time, (x - before * spacing, x + after * spacing, *bump))
                - self._residual
                for x in centres.tolist()
            ]
        )
        if not np.isfinite(changes).all():
            return []
        own = self._project(changes)
        information, slope = own.T @ own, own.T @ self._residual

        cycles = _weigh_bumps(duration)
        gain = np.array([_compute_gain(W.T @ information @ W, W.T @ slope) for _, W in cycles])
        edged = np.concatenate([[0.0], gain, [0.0]])
        peaks = np.flatnonzero((gain >= edged[:-2]) & (gain > edged[2:]))
        likely = [cycles[k] for k in peaks[np.argsort(-gain[peaks])[: PERIODS_TRIED[0]]]]
        steps = itertools.chain.from_iterable(
            self._build_steps(effect, (period,), changes @ W) for period, W in likely
        )
        return sorted(steps, key=lambda step: -self.smooth(step).score)[: PERIODS_TRIED[1]]

    def _project(self, changes: Array) -> Array:
        """Return what of changes of the residual no parameter of the model makes."""
        return np.asarray(changes - self._basis @ (self._basis.T @ changes))

    def _build_steps(
        self, effect: Effect, shapes: tuple[float, ...], changes: Array
    ) -> list[_LinearStep]:
        """Return the linear step of a function; none where nothing changes."""
        if not np.isfinite(changes).all():
            return []
        own = self._project(changes)
        A, b = own.T @ own, own.T @ self._residual
        gain = _compute_gain(A, b)
        return [_LinearStep(effect, shapes, changes, A, b, gain)] if gain > 0.0 else []

    def smooth(self, step: _LinearStep) -> _Screened:
        """Return the smoothness that held-out samples favour, and where its step leads."""
        if id(step) not in self._smoothed:
            self._smoothed[id(step)] = self._find_smoothness(step)
        return self._smoothed[id(step)]

    def _find_smoothness(self, step: _LinearStep) -> _Screened:
        effect, shapes, term = step.effect, step.shapes, step.effect.function
        power = float(np.trace(step.information)) / len(step.information)
        mean = math.sqrt(MEAN_WEIGHTS[bool(term and term.has_zero)] * power)

        def simulate_share(share: float, roughness: float) -> _Screened:
            rows = _compute_penalty_rows(step, roughness, mean)
            solved = np.linalg.solve(step.information + rows.T @ rows, -step.slope)
            c = np.asarray(solved, dtype=np.float64)
            model = self._build_model(effect, shapes, share * c, step.changes)
            fit = simulate_dataset(self._dataset, self._contexts, model)
            screened = _Screened(effect, model, 0.0, roughness, mean, step)
            return screened._replace(score=self.compute_score(fit, screened.degrees))

        whole = [simulate_share(1.0, math.sqrt(share * power)) for share in ROUGHNESSES]
        best = max(whole, key=lambda start: start.score)
        half = simulate_share(0.5, best.roughness)
        return max(best, half, key=lambda start: start.score)

    def _simulate(self, effect: Effect, values: tuple[float, ...]) -> Array:
        model = self._fit.model
        model = model._replace(effects=(*model.effects, (effect, values)))
        return compute_residual(
            self._dataset, simulate_dataset(self._dataset, self._contexts, model)
        )

    def _build_model(self, effect: Effect, shapes: tuple[float, ...], c: Array, F: Array) -> Model:
        shift = -(self._solve @ (self._residual + F @ c))
        model = shift_parameters(self._dataset, self._fit.model, shift)
        bounds = [(p.low, p.high) for p in effect.parameters[len(shapes) :]]
        limited = np.clip(c * effect.parameters[-1].step, *np.transpose(bounds)).tolist()
        return model._replace(effects=(*model.effects, (effect, (*shapes, *limited))))
