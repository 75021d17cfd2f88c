"""Fits by re-simulation: all of a record is simulated for every trial, so its memory is right."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.array_types import Array, Mask
from estimator.diagnosis.dataset import (
    COARSE_RATIO_MIN,
    OWN_LOADS,
    TAUT_TRAVEL,
    TIP_COMPLIANCE,
    TIP_MASS,
    TIP_ZERO,
    BaseParameters,
    CoarseSteps,
    Dataset,
    Fit,
    Model,
    build_coarse_steps,
    build_context,
    build_unsimulated_contexts,
    compute_cost,
    compute_record_bounds,
    compute_residual,
    find_record_zeros,
    simulate_dataset,
    use_all_samples,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_TENSION,
    EffectContext,
    Values,
)
from estimator.fitting import (
    BroydenJacobian,
    LeastSquaresSolution,
    compute_forward_differences,
    minimise_squares,
    move_inside_bounds,
)

# --- where the numbers of a model are in the row that a fit searches


class ParameterLayout:
    """The numbers of a model in a row, each counted in its step.

    Readings of encoders count from the first one: a fit ends at a step that is small beside its
    numbers, and begins with one that is large beside them.
    """

    def __init__(self, dataset: Dataset, model: Model) -> None:
        base = dataset.base
        effects = [effect for effect, _ in model.effects]
        self.base, self.effects, self.records = base, effects, len(model.own)
        self.names = [p.name for p in base.shared]
        self.parameters = list(base.shared)
        span = max(float(np.ptp(record.drive)) for record in dataset.records)
        for effect, values in model.effects:
            self.names += [f"{effect.name}.{p.name}" for p in effect.parameters]
            self.parameters += effect.limit_parameters(effect.parameters, span, values)
        self.common = len(self.parameters)  # those of the dataset come first
        for k, record in enumerate(dataset.records):
            self.names += [f"{p.name} ({k + 1})" for p in base.own]
            self.parameters += [
                p._replace(low=low, high=high)
                for p, (low, high) in zip(
                    base.own, compute_record_bounds(record, base), strict=True
                )
            ]
        zeros = [zero for record in dataset.records for zero in find_record_zeros(record, base)]
        self._zeros = np.array([0.0] * self.common + zeros)
        self._steps = [p.step for p in self.parameters]
        compliance = base.compliance(model.shared)
        if compliance is not None:  # known to a share of itself, whatever the tendon
            for i, p in enumerate(self.parameters):
                if p.unit == "m/N":
                    self._steps[i] = 0.03 * max(compliance, 1e-7)

    @property
    def is_smooth(self) -> Mask:
        """Which numbers a slope leads to."""
        return np.array([not (p.jumps or p.is_fixed) for p in self.parameters])

    @property
    def is_fixed(self) -> Mask:
        """Which numbers a fit leaves as they are."""
        return np.array([p.is_fixed for p in self.parameters])

    @property
    def is_shape(self) -> Mask:
        """Which numbers only shape an effect, and have a slope."""
        is_shape = np.array([p.neutral is None for p in self.parameters])
        return np.asarray(is_shape & self.is_smooth)

    @property
    def is_time(self) -> Mask:
        """Which numbers say when something happened, and how long it took."""
        mask = np.zeros(len(self.parameters), dtype=np.bool_)
        offset = len(self.base.shared)
        for effect in self.effects:
            if any(p.jumps for p in effect.parameters):
                for i, p in enumerate(effect.parameters, start=offset):
                    mask[i] = p.neutral is None
            offset += len(effect.parameters)
        return mask

    @property
    def load_indices(self) -> list[int]:
        """Places of what the tips of single records pull at."""
        load_names = {p.name for p in OWN_LOADS[self.base.loads]}
        own = [p.name in load_names for p in self.base.own] * self.records
        return [self.common + k for k, is_load in enumerate(own) if is_load]

    @property
    def is_own(self) -> Mask:
        """Which numbers are of single records."""
        return np.arange(len(self.parameters)) >= self.common

    def step(self, i: int) -> float:
        """Return the step of a number."""
        return self._steps[i]

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the largest of each number."""
        return (
            self._to_steps(np.array([p.low for p in self.parameters])),
            self._to_steps(np.array([p.high for p in self.parameters])),
        )

    def values(self, model: Model) -> list[float]:
        """Return the numbers of a model, in a row."""
        effect_values = [value for _, values in model.effects for value in values]
        return [*model.shared, *effect_values, *(value for own in model.own for value in own)]

    def pack(self, model: Model) -> Array:
        """Return them in their steps."""
        return self._to_steps(np.array(self.values(model)))

    def unpack(self, x: Array) -> Model:
        """Return the model of a row."""
        values = (np.asarray(x) * np.array(self._steps) + self._zeros).tolist()
        offset = len(self.base.shared)
        shared = tuple(values[:offset])
        effects = []
        for effect in self.effects:
            count = len(effect.parameters)
            effects.append((effect, tuple(values[offset : offset + count])))
            offset += count
        size = len(self.base.own)
        own = tuple(
            tuple(values[offset + k * size : offset + (k + 1) * size]) for k in range(self.records)
        )
        return Model(shared, own, tuple(effects))

    def _to_steps(self, values: Array) -> Array:
        return np.asarray((values - self._zeros) / np.array(self._steps))


DIFFERENCE_STEP = 0.02  # of a parameter's step: for derivatives
ROUNDS = 8  # of a fit that is not the last
QUICK_ROUNDS = 4  # of a first one
SEARCH_REACHES = (2.0, 0.5, 0.12, 0.03)  # [s] about a time that is searched, more in a long record:
SEARCH_DIVISIONS = 32  # share of it between two first guesses, and half of it to either side
SEARCH_POINTS = 8  # on each of these
SAMPLES_AROUND = 6  # samples to either side of a likely time that are tried
COST_TOLERANCE = 1e-6  # of a cost
SHAPE_RESTARTS_MAX = 3  # times at most that a fit goes on from other shapes
SHAPE_MULTIPLES = (0.4, 0.6, 0.8, 1.25, 1.6, 2.5)  # of a shape that are tried
COARSE_SIZE = 1200  # samples of a long record that are simulated while a descent is under way
COARSE_PASSES = 3  # descents at most, each by coarse steps about where the one before ended
COARSE_TOLERANCE = 1e-3  # of a cost, by which coarse steps may be off where a descent ends
BOUND_MARGIN = 1e-9  # of a parameter's step, from a bound where a fit begins
REGULARISATION = 1e-8  # information on a number about which there is none


class _Search:
    """Searches the numbers of a model, from a model with the same effects."""

    def __init__(self, dataset: Dataset, contexts: Sequence[EffectContext], model: Model) -> None:
        self.layout = ParameterLayout(dataset, model)
        self._dataset, self._full, self._contexts = dataset, use_all_samples(dataset), contexts
        samples_max = max(len(record.time) for record in dataset.records)
        self._is_long = samples_max >= COARSE_RATIO_MIN * COARSE_SIZE

    def simulate(self, x: Array, coarse: Sequence[CoarseSteps | None] = ()) -> Fit:
        """Return the model of a row, and what it makes of the records."""
        return simulate_dataset(self._dataset, self._contexts, self.layout.unpack(x), coarse)

    def build_coarse_steps(self, fit: Fit, is_free: Mask) -> tuple[CoarseSteps | None, ...]:
        """Return coarse steps about a fit, none of few samples, or for times: to a sample."""
        if not self._is_long or (is_free & self.layout.is_time).any():
            return ()
        return build_coarse_steps(self._dataset, self._contexts, fit, COARSE_SIZE)

    def compute_jacobian(self, fit: Fit) -> Array:
        """Return the derivatives of the residual at a fit by all parameters, by coarse steps."""
        x, (_, high) = self.layout.pack(fit.model), self.layout.bounds()
        coarse = self.build_coarse_steps(fit, ~self.layout.is_fixed)

        def evaluate(x: Array) -> Array:
            return compute_residual(self._dataset, self.simulate(x, coarse))

        # of the same arithmetic: what rounds off would be a slope by numbers that change nothing
        residual = evaluate(x) if coarse else compute_residual(self._dataset, fit)
        J = compute_forward_differences(evaluate, x, residual, DIFFERENCE_STEP, high)
        J[:, self.layout.is_fixed] = 0.0
        return J

    def descend(
        self, start: Model, rounds: int, is_free: Mask, *, robust: bool = False, full: bool = False
    ) -> Fit:
        """Return the fit of least squares of the free numbers; `full` to all samples."""
        is_free = is_free & ~self.layout.is_fixed
        if not is_free.any():
            return simulate_dataset(self._dataset, self._contexts, start)
        low, high = self.layout.bounds()
        x_start = move_inside_bounds(self.layout.pack(start), low, high, BOUND_MARGIN)
        dataset = self._full if full else self._dataset
        fit = self.simulate(x_start)
        best, jacobian = fit, None
        for k in range(COARSE_PASSES):
            coarse = self.build_coarse_steps(best, is_free)
            if not coarse:
                return self._descend_once(dataset, fit, x_start, rounds, is_free, robust)[0]
            fit, solution = self._descend_once(
                dataset, best, x_start, rounds, is_free, robust, coarse, jacobian
            )
            cost = compute_cost(dataset, fit)
            if cost > compute_cost(dataset, best) and not robust:
                if k > 0:
                    return best
                return self._descend_once(dataset, best, x_start, rounds, is_free, robust)[0]
            if abs(cost - solution.cost) < COARSE_TOLERANCE * cost:
                return fit
            best, jacobian = fit, None if robust else solution.jacobian
            x_start = move_inside_bounds(self.layout.pack(fit.model), low, high, BOUND_MARGIN)
        return best

    def _descend_once(
        self,
        dataset: Dataset,
        start: Fit,
        x_start: Array,
        rounds: int,
        is_free: Mask,
        robust: bool,
        coarse: Sequence[CoarseSteps | None] = (),
        jacobian: Array | None = None,
    ) -> tuple[Fit, LeastSquaresSolution]:
        """Return the fit of a descent by coarse steps, simulated in all samples, and its end."""
        low, high = self.layout.bounds()
        # derivatives by coarse steps are of the same arithmetic, or what rounds off were a slope
        fits = {} if coarse else {x_start[is_free].tobytes(): start}
        cost_min = math.inf

        def simulate_free(x: Array, coarse: Sequence[CoarseSteps | None]) -> Fit:
            row = x_start.copy()
            row[is_free] = x
            return self.simulate(row, coarse)

        def evaluate(x: Array) -> Array:
            nonlocal fits, cost_min
            fit = fits.get(x.tobytes()) or simulate_free(x, coarse)
            r = compute_residual(dataset, fit)
            if not coarse and r @ r < cost_min:
                fits, cost_min = {x.tobytes(): fit}, float(r @ r)
            return r

        derivatives = BroydenJacobian(evaluate, DIFFERENCE_STEP, high[is_free], jacobian)
        solution = minimise_squares(
            derivatives.compute_residual,
            x_start[is_free],
            low[is_free],
            high[is_free],
            jac=derivatives,
            x_scale="jac",
            loss="cauchy" if robust else "linear",
            ftol=1e-4,
            xtol=1e-4,
            gtol=1e-9,
            max_nfev=rounds,
        )
        return fits.get(solution.values.tobytes()) or simulate_free(solution.values, ()), solution

    def search_shape_multiples(self, fit: Fit) -> Model | None:
        """Return a model with its shapes at better multiples of their values; None if none is."""
        best, cost_min = fit, compute_cost(self._dataset, fit)
        low, high = self.layout.bounds()
        coarse = self.build_coarse_steps(fit, self.layout.is_shape)
        for i in np.flatnonzero(self.layout.is_shape):
            x = self.layout.pack(best.model)
            for multiple in SHAPE_MULTIPLES:
                shifted = x.copy()
                shifted[i] = np.clip(multiple * x[i], low[i], high[i])
                trial = self.simulate(shifted, coarse)
                cost = compute_cost(self._dataset, trial)
                if cost < cost_min:
                    best, cost_min = trial, cost
        return None if best is fit else best.model

    def search_times(self, fit: Fit, i: int, times: Array) -> Fit:
        """Return the best of a fit and those with one number at each of `times` [s].

        Of equal ones the latest: what happened at rest shows with the first motion after it.
        """
        x = self.layout.pack(fit.model)
        best, cost_min = fit, compute_cost(self._full, fit)
        current_time = float(self.layout.values(fit.model)[i])
        for time in times.tolist():
            shifted = x.copy()
            shifted[i] = time / self.layout.step(i)
            trial = self.simulate(shifted)
            cost = compute_cost(self._full, trial)
            is_later = time > current_time and cost < (1.0 + COST_TOLERANCE) * cost_min
            if cost < cost_min or is_later:
                best, cost_min = trial, min(cost, cost_min)
        return best

    def search_change_time(self, fit: Fit, i: int) -> Fit:
        """Return the best fit with a time about the one at which the effect begins to fit better.

        A search in steps passes by it: until a sample or two about the right time, the model of a
        sensor that slipped goes to the slip and back, and friction remembers it. The times are
        between samples, each of which is then before it or after.
        """
        records = self._dataset.records
        x_without, x_with = self.layout.pack(fit.model), self.layout.pack(fit.model)
        x_without[i] = 2.0 * max(r.time[-1] for r in records) / self.layout.step(i)
        x_with[i] = min(r.time[0] for r in records) / self.layout.step(i)
        errors = [
            _compute_scaled_errors(self._dataset, self.simulate(x)) for x in (x_without, x_with)
        ]
        time = np.concatenate([record.time for record in records])
        order = np.argsort(time, kind="stable")
        gain = np.concatenate([[0.0], np.cumsum((errors[0] - errors[1])[order])])
        change_time = float(time[order][min(int(np.argmin(gain)), len(order) - 1)])
        step = min(float(np.median(np.diff(record.time))) for record in records)
        around = step * (np.arange(-SAMPLES_AROUND, SAMPLES_AROUND) + 0.5)
        return self.search_times(fit, i, np.asarray(change_time + around))


def fit_model(
    dataset: Dataset,
    contexts: Sequence[EffectContext],
    start: Model,
    rounds: int = ROUNDS,
    *,
    robust: bool = False,
) -> Fit:
    """Return the model of least squares that is found from `start`.

    Parameters without a gradient, such as the time at which something begins, are searched in ever
    smaller steps; those that only shape an effect are tried at multiples of their values too, since
    a valley that bends ends a descent. When it was and how long it took is then fitted to all
    samples: those that count may have none of that time. A `robust` fit goes by most of a record,
    however far it is off the rest.
    """
    search = _Search(dataset, contexts, start)
    layout = search.layout
    jump_indices = [i for i, p in enumerate(layout.parameters) if p.jumps]
    is_last = rounds > ROUNDS
    # a sample beside its time a descent takes an effect to nothing
    if jump_indices and is_last:
        timed_fit = simulate_dataset(dataset, contexts, start)
        for i in jump_indices:
            timed_fit = search.search_change_time(timed_fit, i)
        start = timed_fit.model
    fit = search.descend(start, rounds, layout.is_smooth, robust=robust)
    for _ in range(SHAPE_RESTARTS_MAX if is_last else 0):
        model = search.search_shape_multiples(fit)
        if model is None:
            break
        fit = search.descend(model, ROUNDS, layout.is_smooth)
    for i in jump_indices if is_last else ():
        fit = search.search_change_time(fit, i)
    reaches = SEARCH_REACHES if is_last else SEARCH_REACHES[:1] if rounds > QUICK_ROUNDS else ()
    for reach in (*compute_search_reaches(dataset), *reaches) if jump_indices and reaches else ():
        for i in jump_indices:
            times = layout.values(fit.model)[i] + np.linspace(-reach, reach, SEARCH_POINTS)
            fit = search.search_times(fit, i, times)
        fit = search.descend(fit.model, max(2, rounds // 3), layout.is_time, full=True)
        fit = search.descend(fit.model, max(2, rounds // 3), ~layout.is_time)
    return fit


def _compute_scaled_errors(dataset: Dataset, fit: Fit) -> Array:
    """Return how far a model is off each sample, of all records, in their noises."""
    parts = []
    for record, simulated, scale in zip(dataset.records, fit.simulated, dataset.scale, strict=True):
        errors = np.zeros(len(record.time))
        for channel in record.compared:
            channel_errors = (
                np.abs(simulated.signals[channel] - record.signals[channel]) / scale[channel]
            )
            errors += np.where(record.valid[channel], channel_errors, 0.0)
        parts.append(errors)
    return np.concatenate(parts)


def compute_search_reaches(dataset: Dataset) -> list[float]:
    """Return the first reaches [s] in records so long that no guess is near enough."""
    reach = max(float(np.ptp(record.time)) for record in dataset.records) / SEARCH_DIVISIONS
    reaches = []
    while reach > SEARCH_REACHES[0]:
        reaches.append(reach)
        reach /= SEARCH_REACHES[0] / SEARCH_REACHES[1]
    return reaches


def refit_subset(
    subset: Dataset, full: Dataset, contexts: Sequence[EffectContext], fit: Fit, rounds: int
) -> Fit:
    """Return a model of the whole dataset, refitted to a part of its samples.

    What the part does not determine stays as in the whole: when something happened, and what shows
    in hardly any of its samples, as where a record starts.
    """
    search = _Search(subset, contexts, fit.model)
    is_determined = ~search.layout.is_time & (
        _compute_uncertainty(subset, contexts, fit)
        < SETTINGS.uncertainty_ratio_max * _compute_uncertainty(full, contexts, fit)
    )
    return search.descend(fit.model, rounds, is_determined)


def fit_record_parameters(dataset: Dataset, fit: Fit) -> Fit:
    """Return a model of other records of the dataset: only what each has for itself is fitted."""
    contexts = build_unsimulated_contexts(dataset, fit)
    if not dataset.base.own:
        return simulate_dataset(
            dataset, contexts, fit.model._replace(own=((),) * len(dataset.records))
        )
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    own = tuple(
        guess_record_parameters(record, dataset.base, compliance) for record in dataset.records
    )
    model = fit.model._replace(own=own)
    search = _Search(dataset, contexts, model)
    return search.descend(model, ROUNDS, search.layout.is_own)


def guess_record_parameters(
    record: Record, base: BaseParameters, compliance: float, tip: float = 0.0
) -> Values:
    """Return where to look for what a record has for itself.

    With L/EA about `compliance` and what the tip pulls at about `tip` [m/N].
    """
    start = {TIP_COMPLIANCE.name: tip, TIP_MASS.name: 0.0}
    if TAUT_TRAVEL in base.own:
        start[TAUT_TRAVEL.name] = _guess_taut_travel(record, compliance)
    if TIP_ZERO in base.own:
        start[TIP_ZERO.name] = _guess_tip_zero(record)
    return tuple(start[p.name] for p in base.own)


def _guess_taut_travel(record: Record, compliance: float) -> float:
    """Return about where the drive begins to pull [m]; of a loop, where it carries no effort."""
    if record.loop:
        return float(np.median(record.drive[_find_idle_samples(record)]))
    drive, tensions = record.first_tensions
    return drive - compliance * max(float(np.median(tensions)), 0.0)


def _guess_tip_zero(record: Record) -> float:
    """Return about where the tip is without effort [m]."""
    travel, rows = record.signals[DISTAL_DISPLACEMENT], record.present[DISTAL_DISPLACEMENT]
    if record.loop:
        idle = _find_idle_samples(record)
        return float(np.median(travel[idle & rows if (idle & rows).any() else rows]))
    if DISTAL_TENSION in record.signals:
        low = rows & record.present[DISTAL_TENSION]
        low &= record.signals[DISTAL_TENSION] <= SETTINGS.loose_tension
        rows = low if low.any() else rows
    return float(np.min(travel[rows]))


def _find_idle_samples(record: Record) -> Mask:
    """Return which samples of an effort of either sign are nearest to none, a tenth of them."""
    size, rows = np.abs(record.signals[PROXIMAL_TENSION]), record.present[PROXIMAL_TENSION]
    return np.asarray(rows & (size <= np.quantile(size[rows], 0.1)))


def shift_parameters(dataset: Dataset, model: Model, shift: Array) -> Model:
    """Return a model with all parameters shifted by `shift`, in their steps, within bounds."""
    layout = ParameterLayout(dataset, model)
    low, high = layout.bounds()
    return layout.unpack(np.clip(layout.pack(model) + shift, low, high))


def compute_jacobian(dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit) -> Array:
    """Return the derivatives of the residual by all parameters, each in its own step."""
    return _Search(dataset, contexts, fit.model).compute_jacobian(fit)


def _compute_uncertainty(dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit) -> Array:
    """Return how uncertain each number of a model is, in its step, for residuals of 1."""
    J = compute_jacobian(dataset, contexts, fit)
    information = J.T @ J + REGULARISATION * np.eye(J.shape[1])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


BASELINE_ROUNDS = 15


def refit_baseline(dataset: Dataset, fit: Fit) -> Fit:
    """Return the fit of the base law, started from a fit of the same records, other weights."""
    return fit_model(dataset, build_initial_contexts(dataset), fit.model, BASELINE_ROUNDS)


def fit_robustly(dataset: Dataset, fit: Fit) -> Fit:
    """Return the robust fit, started from the ordinary fit `fit`.

    Where something happened at one time, what came before it and what came after it are each fitted
    badly by one model; this one fits the longer part.
    """
    return fit_model(
        dataset, build_initial_contexts(dataset), fit.model, BASELINE_ROUNDS, robust=True
    )


def build_initial_contexts(dataset: Dataset) -> list[EffectContext]:
    """Return what effects may know of each record while no model of it is fitted."""
    return [build_context(record, None, 1e-4) for record in dataset.records]
