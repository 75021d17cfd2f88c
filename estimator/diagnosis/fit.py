"""Fits by re-simulation: all of a record is simulated for every trial, so its memory is right."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    contexts_without,
    cost,
    residual,
    simulated,
    whole,
)
from estimator.diagnosis.layout import Layout
from estimator.diagnosis.model import MASS, TAUT, TIP, TIP_ZERO, Base
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_TENSION,
    EffectContext,
    Values,
)

Mask = NDArray[np.bool_]

STEP = 0.02  # of a parameter's step: for derivatives
ROUNDS = 8  # of a fit that is not the last
QUICK = 4  # of a first one
SEARCH = (2.0, 0.5, 0.12, 0.03)  # [s] about a time that is searched, more in a long record:
SPREAD = 32  # share of it between two first guesses, and half of it to either side
STEPS = 8  # on each of these
AROUND = 6  # samples to either side of a likely time that are tried
EQUAL = 1e-6  # of a cost
REDIRECTED = 3  # times at most that a fit goes on from other shapes
MULTIPLES = (0.4, 0.6, 0.8, 1.25, 1.6, 2.5)  # of a shape that are tried
TRUSTED = 0.5  # of the fall foreseen: slopes that foresaw a step as well are not taken anew
WEAK = 1e-8  # information on a number about which there is none


def improved(
    dataset: Dataset,
    about: Sequence[EffectContext],
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
    layout = Layout(dataset, start)
    jumping = [i for i, p in enumerate(layout.parameters) if p.jumps]
    if jumping and rounds > ROUNDS:  # a sample beside its time a descent takes an effect to nothing
        dated = simulated(dataset, about, start)
        for i in jumping:
            times = _likely_times(dataset, about, layout, dated, i)
            dated = _stepped(dataset, about, layout, dated, i, times)
        start = dated.model
    fit = _descended(dataset, about, layout, start, rounds, layout.smooth, robust=robust)
    for _ in range(REDIRECTED if rounds > ROUNDS else 0):
        model = _redirected(dataset, about, layout, fit)
        if model is None:
            break
        fit = _descended(dataset, about, layout, model, ROUNDS, layout.smooth)
    for i in jumping if rounds > ROUNDS else ():
        fit = _stepped(
            dataset, about, layout, fit, i, _likely_times(dataset, about, layout, fit, i)
        )
    reaches = SEARCH if rounds > ROUNDS else SEARCH[:1] if rounds > QUICK else ()
    for reach in (*far_reaches(dataset), *reaches) if jumping and reaches else ():
        for i in jumping:
            times = layout.values(fit.model)[i] + np.linspace(-reach, reach, STEPS)
            fit = _stepped(dataset, about, layout, fit, i, times)
        fit = _descended(whole(dataset), about, layout, fit.model, max(2, rounds // 3), layout.when)
        fit = _descended(dataset, about, layout, fit.model, max(2, rounds // 3), ~layout.when)
    return fit


def _redirected(
    dataset: Dataset, about: Sequence[EffectContext], layout: Layout, fit: Fit
) -> Model | None:
    """Return a fit's model with its shapes at better multiples of their values; None if none is."""
    best, least = fit, cost(dataset, fit)
    for i in np.flatnonzero(layout.shape):
        x = layout.pack(best.model)
        low, high = layout.bounds()
        for multiple in MULTIPLES:
            moved = x.copy()
            moved[i] = np.clip(multiple * x[i], low[i], high[i])
            other = simulated(dataset, about, layout.unpack(moved))
            found = cost(dataset, other)
            if found < least:
                best, least = other, found
    return None if best is fit else best.model


def _likely_times(
    dataset: Dataset, about: Sequence[EffectContext], layout: Layout, fit: Fit, i: int
) -> Array:
    """Return times about the one before which nothing fits better, and after which the effect [s].

    A search in steps passes by it: until a sample or two about the right time, the model of a
    sensor that slipped goes to the slip and back, and friction remembers it. They are between
    samples, each of which is then before it or after.
    """
    x = layout.pack(fit.model)
    ends = min(r.time[0] for r in dataset.records), max(r.time[-1] for r in dataset.records)
    without, within = x.copy(), x.copy()
    without[i], within[i] = (2.0 * ends[1] / layout.step(i), ends[0] / layout.step(i))
    off = [
        _distances(dataset, simulated(dataset, about, layout.unpack(row)))
        for row in (without, within)
    ]
    time = np.concatenate([record.time for record in dataset.records])
    order = np.argsort(time, kind="stable")
    gain = np.concatenate([[0.0], np.cumsum((off[0] - off[1])[order])])
    at = float(time[order][min(int(np.argmin(gain)), len(order) - 1)])
    step = min(float(np.median(np.diff(record.time))) for record in dataset.records)
    return np.asarray(at + step * (np.arange(-AROUND, AROUND) + 0.5))


def _distances(dataset: Dataset, fit: Fit) -> Array:
    """Return how far a model is off each sample, of all records, in their noises."""
    total = []
    for record, one, scale in zip(dataset.records, fit.simulated, dataset.scale, strict=True):
        off = np.zeros(len(record.time))
        for channel in record.compared:
            each = np.abs(one.signals[channel] - record.signals[channel]) / scale[channel]
            off += np.where(record.good[channel], each, 0.0)
        total.append(off)
    return np.concatenate(total)


def far_reaches(dataset: Dataset) -> list[float]:
    """Return the first reaches in records so long that no guess is as near as `SEARCH` [s]."""
    reach = max(float(np.ptp(record.time)) for record in dataset.records) / SPREAD
    reaches = []
    while reach > SEARCH[0]:
        reaches.append(reach)
        reach /= SEARCH[0] / SEARCH[1]
    return reaches


def refitted(
    part: Dataset, of: Dataset, about: Sequence[EffectContext], fit: Fit, rounds: int
) -> Fit:
    """Return a model of the whole, fitted again to a part of the samples.

    What the part cannot tell stays as the whole has it: when something happened, and whatever shows
    in hardly any of its samples, as where a record starts.
    """
    layout = Layout(of, fit.model)
    told = ~layout.when & (
        _uncertain(part, about, fit) < SETTINGS.blind * _uncertain(of, about, fit)
    )
    return _descended(part, about, layout, fit.model, rounds, told)


def own_only(dataset: Dataset, fit: Fit) -> Fit:
    """Return a model of other records of the dataset: only what each has for itself is fitted."""
    about = contexts_without(dataset, fit)
    if not dataset.base.own:
        return simulated(dataset, about, fit.model._replace(own=((),) * len(dataset.records)))
    compliance = dataset.base.compliance(fit.model.shared) or 0.0
    own = tuple(own_start(record, dataset.base, compliance) for record in dataset.records)
    model = fit.model._replace(own=own)
    layout = Layout(dataset, model)
    return _descended(dataset, about, layout, model, ROUNDS, layout.own)


def own_start(record: Record, base: Base, compliance: float, tip: float = 0.0) -> Values:
    """Return where to look for what a record has for itself.

    With L/EA about `compliance` and what the tip pulls at about `tip` [m/N].
    """
    start = {TIP.name: tip, MASS.name: 0.0}
    if TAUT in base.own:
        start[TAUT.name] = _taut_start(record, compliance)
    if TIP_ZERO in base.own:
        start[TIP_ZERO.name] = _tip_start(record)
    return tuple(start[p.name] for p in base.own)


def _taut_start(record: Record, compliance: float) -> float:
    """Return about where the drive begins to pull [m]; of a loop, where it carries no effort."""
    if record.loop:
        return float(np.median(record.drive[_idle(record)]))
    drive, tensions = record.first_tensions
    return drive - compliance * max(float(np.median(tensions)), 0.0)


def _tip_start(record: Record) -> float:
    """Return about where the tip is without effort [m]."""
    travel, rows = record.signals[DISTAL_DISPLACEMENT], record.known[DISTAL_DISPLACEMENT]
    if record.loop:
        idle = _idle(record)
        return float(np.median(travel[idle & rows if (idle & rows).any() else rows]))
    if DISTAL_TENSION in record.signals:
        low = rows & record.known[DISTAL_TENSION]
        low &= record.signals[DISTAL_TENSION] <= SETTINGS.loose_tension
        rows = low if low.any() else rows
    return float(np.min(travel[rows]))


def _idle(record: Record) -> Mask:
    """Return which samples of an effort of either sign are nearest to none, a tenth of them."""
    size, rows = np.abs(record.signals[PROXIMAL_TENSION]), record.known[PROXIMAL_TENSION]
    return np.asarray(rows & (size <= np.quantile(size[rows], 0.1)))


def moved(dataset: Dataset, model: Model, by: Array) -> Model:
    """Return a model with all its numbers moved, in their own steps, as far as they may be."""
    layout = Layout(dataset, model)
    low, high = layout.bounds()
    return layout.unpack(np.clip(layout.pack(model) + by, low, high))


def slopes_of(dataset: Dataset, about: Sequence[EffectContext], fit: Fit) -> Array:
    """Return the derivatives of the residual by all parameters, each in its own step."""
    layout = Layout(dataset, fit.model)
    _, high = layout.bounds()

    def off(x: Array) -> Array:
        return residual(dataset, simulated(dataset, about, layout.unpack(x)))

    return _differences(off, layout.pack(fit.model), residual(dataset, fit), high)


def _uncertain(dataset: Dataset, about: Sequence[EffectContext], fit: Fit) -> Array:
    """Return how uncertain each number of a model is, in its step, for residuals of 1."""
    J = slopes_of(dataset, about, fit)
    information = J.T @ J + WEAK * np.eye(J.shape[1])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def _stepped(
    dataset: Dataset,
    about: Sequence[EffectContext],
    layout: Layout,
    fit: Fit,
    i: int,
    times: Array,
) -> Fit:
    """Return the best of a fit and those with one number at each of `times` [s].

    Of equal ones the latest: what happened at rest shows with the first motion after it.
    """
    dataset = whole(dataset)
    x = layout.pack(fit.model)
    best, least = fit, cost(dataset, fit)
    now = float(layout.values(fit.model)[i])
    for time in times.tolist():
        moved = x.copy()
        moved[i] = time / layout.step(i)
        other = simulated(dataset, about, layout.unpack(moved))
        found = cost(dataset, other)
        if found < least or (time > now and found < (1.0 + EQUAL) * least):
            best, least = other, min(found, least)
    return best


def _descended(
    dataset: Dataset,
    about: Sequence[EffectContext],
    layout: Layout,
    start: Model,
    rounds: int,
    free: Mask,
    *,
    robust: bool = False,
) -> Fit:
    from scipy.optimize import least_squares  # here: the control processes import this module

    if not free.any():
        return simulated(dataset, about, start)
    low, high = layout.bounds()
    at_start = np.clip(layout.pack(start), low + 1e-9, high - 1e-9)

    def full(x: Array) -> Array:
        row = at_start.copy()
        row[free] = x
        return row

    def off(x: Array) -> Array:
        return residual(dataset, simulated(dataset, about, layout.unpack(full(x))))

    slopes = _Slopes(off, high[free])
    found = least_squares(
        slopes.residual,
        at_start[free],
        jac=slopes,
        bounds=(low[free], high[free]),
        x_scale="jac",
        loss="cauchy" if robust else "linear",
        ftol=1e-4,
        xtol=1e-4,
        gtol=1e-9,
        max_nfev=rounds,
    )
    return simulated(dataset, about, layout.unpack(full(np.asarray(found.x))))


class _Slopes:
    """Derivatives of a residual along a descent.

    From one accepted step to the next they are corrected by what the step taught (Broyden, Math.
    Comput. 19, 1965), which costs nothing. Where they foresaw a step badly they are taken anew, by
    one simulation for each number.
    """

    def __init__(self, off: Callable[[Array], Array], high: Array) -> None:
        self._off, self._high = off, high
        self._tried: tuple[bytes, Array] = (b"", np.empty(0))  # slopes are asked for there next
        self._x, self._r, self._J = np.empty(0), np.empty(0), np.empty((0, 0))

    def residual(self, x: Array) -> Array:
        """Return the residual where the numbers are `x`."""
        r = self._off(x)
        self._tried = (x.tobytes(), r)
        return r

    def __call__(self, x: Array) -> Array:
        """Return its derivatives there, shape (samples, numbers)."""
        known, r = self._tried
        if known != x.tobytes():
            r = self._off(x)
        self._J = self._corrected(x, r) if len(self._x) else self._anew(x, r)
        self._x, self._r = x.copy(), r
        return self._J

    def _anew(self, x: Array, r: Array) -> Array:
        return _differences(self._off, x, r, self._high)

    def _corrected(self, x: Array, r: Array) -> Array:
        step = x - self._x
        foreseen = self._r + self._J @ step
        before = float(self._r @ self._r)
        fell, expected = before - float(r @ r), before - float(foreseen @ foreseen)
        if not fell > TRUSTED * expected or not step.any():
            return self._anew(x, r)
        correction: Array = np.outer(r - foreseen, step / float(step @ step))
        return self._J + correction


def _differences(off: Callable[[Array], Array], x: Array, at: Array, high: Array) -> Array:
    """Return the derivatives of a residual that is `at` where its numbers are `x`."""
    columns = []
    for i in range(len(x)):
        h = STEP if x[i] + STEP < high[i] else -STEP
        moved = x.copy()
        moved[i] += h
        columns.append((off(moved) - at) / h)
    return np.column_stack(columns)
