"""Fits by re-simulation: all of a record is simulated for every trial, so its memory is right."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from estimator.diagnosis.model import (
    COMPLIANCE,
    Base,
    Simulated,
    base_of,
    own_bounds,
    scene_of,
    simulate,
)
from estimator.diagnosis.record import Record, in_full
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    DISTAL_TENSION,
    PROXIMAL_TENSION,
    Effect,
    Parameter,
    Scene,
    Values,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEP = 0.02  # of a parameter's step: for derivatives
ROUNDS = 8  # of a fit that is not the last
QUICK = 4  # of a first one
SEARCH = (2.0, 0.5, 0.12, 0.03)  # [s] about a time that is searched
STEPS = 8  # on each of these
EQUAL = 1e-6  # of a cost
FARTHEST = 60.0  # [s] that a time is tried to be wrong by
HALVED = 5  # times, the step that is one too far
COVER = 1.96  # standard uncertainties on each side of a value
ROUGHLY = 3e-3  # of a channel's range
ACCURACY = 1e-3  # of it, that a simulation is taken to be off by itself
NOISE = 1.25  # times the tolerance: an error that is nothing wrong with the model
LEFT = 0.3  # of the root mean square that a model leaves
TAKEN_UP = (
    2.0  # standard uncertainties that a record which starts slack is taut at its start within
)
TAUT_LEAST = 1e-6  # [m]
BLIND = 4.0  # times as uncertain as from all samples: a part of them that cannot tell a number
WEAK = 1e-8  # information on a number about which there is none
LOOSE = 0.5  # [N] at the tip that hardly moves what it pulls at


class Bench(NamedTuple):
    """Records of one bench, which share its physics."""

    records: tuple[Record, ...]
    base: Base
    scale: tuple[dict[str, float], ...]  # what residuals count in, by record and channel


class Model(NamedTuple):
    """A model with its numbers."""

    shared: Values  # of the bench
    own: tuple[Values, ...]  # of each record
    effects: tuple[tuple[Effect, Values], ...]


class Fit(NamedTuple):
    """A fitted model, and what it makes of each record."""

    model: Model
    simulated: tuple[Simulated, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect.name for effect, _ in self.model.effects)


class Expected(NamedTuple):
    """Where a record that starts slack is expected to be taut [m], and how surely."""

    travel: float
    uncertainty: float


def bench_of(records: Sequence[Record]) -> Bench:
    """Return a bench whose residuals count in the noise, or in a small share of the range.

    What is not fitted yet is wrong in all channels; one that is measured very finely must not
    decide alone then.
    """
    scale = tuple(
        {
            channel: max(noise, ROUGHLY * float(np.ptp(record.signals[channel])))
            for channel, noise in record.noise.items()
        }
        for record in records
    )
    return Bench(tuple(records), base_of(records[0]), scale)


def mean_noise(bench: Bench) -> dict[str, float]:
    """Return the noise of each channel, in its unit."""
    return {
        channel: float(np.sqrt(np.mean([record.noise[channel] ** 2 for record in bench.records])))
        for channel in bench.records[0].compared
    }


def tolerance(bench: Bench) -> dict[str, float]:
    """Return the error of each channel that noise makes, and a simulation off by `ACCURACY`."""
    return {
        channel: math.hypot(
            noise, ACCURACY * max(float(np.ptp(one.signals[channel])) for one in bench.records)
        )
        for channel, noise in mean_noise(bench).items()
    }


def rescaled(bench: Bench, fit: Fit) -> Bench:
    """Return a bench whose residuals count in the noise and in a share of what a model leaves."""
    scale = []
    for record, one in zip(bench.records, fit.simulated, strict=True):
        each = {}
        for channel in record.compared:
            off = (one.signals[channel] - record.signals[channel])[record.good[channel]]
            each[channel] = math.hypot(record.noise[channel], LEFT * float(off.std()))
        scale.append(each)
    return bench._replace(scale=tuple(scale))


def scenes(bench: Bench, fit: Fit) -> tuple[Scene, ...]:
    """Return what effects may know of each record beside a model without them."""
    elastic = fit.model.shared[1] if len(fit.model.shared) > 1 else 0.0
    return tuple(
        scene_of(record, simulated, elastic)
        for record, simulated in zip(bench.records, fit.simulated, strict=True)
    )


def scenes_without(bench: Bench, fit: Fit) -> tuple[Scene, ...]:
    """Return what effects may know of records that have not been simulated yet."""
    elastic = fit.model.shared[1] if len(fit.model.shared) > 1 else 0.0
    return tuple(scene_of(record, None, elastic) for record in bench.records)


def simulated(bench: Bench, about: Sequence[Scene], model: Model) -> Fit:
    """Return a model with what it makes of each record."""
    done = tuple(
        simulate(record, scene, model.shared, own, model.effects)
        for record, scene, own in zip(bench.records, about, model.own, strict=True)
    )
    return Fit(model, done)


def residual(bench: Bench, fit: Fit) -> Array:
    """Return what is fitted: simulated less measured where it counts, and what is expected."""
    parts = []
    for record, one, scale, own in zip(
        bench.records, fit.simulated, bench.scale, fit.model.own, strict=True
    ):
        for channel in record.compared:
            counts = record.train & record.good[channel]
            off = one.signals[channel] - record.signals[channel]
            parts.append(off[counts] / scale[channel])
        expected = expected_taut(record, fit.model)
        if expected is not None:
            parts.append(np.array([(own[0] - expected.travel) / expected.uncertainty]))
    return np.concatenate(parts)


def expected_taut(record: Record, model: Model) -> Expected | None:
    """Return where the motor must be for the first tension that was read, in a slack start."""
    if record.driver == PROXIMAL_TENSION or not record.starts_slack:
        return None
    sigma = record.noise[PROXIMAL_TENSION]
    compliance = model.shared[1]
    tension = max(0.0, float(record.signals[PROXIMAL_TENSION][:5].mean()))
    return Expected(
        float(record.drive[0]) - compliance * tension,
        max(TAKEN_UP * compliance * sigma, TAUT_LEAST),
    )


def improved(
    bench: Bench,
    about: Sequence[Scene],
    start: Model,
    rounds: int = ROUNDS,
    *,
    robust: bool = False,
) -> Fit:
    """Return the model of least squares that is found from `start`.

    What jumps, as the time at which something begins, is searched in ever smaller steps. When it
    was and how long it took is then fitted to all samples: those that count may have none of that
    time. A `robust` fit goes by most of a record, however far it is off the rest.
    """
    layout = _Layout(bench, start)
    fit = _descended(bench, about, layout, start, rounds, layout.smooth, robust=robust)
    jumping = [i for i, p in enumerate(layout.parameters) if p.jumps]
    reaches = SEARCH if rounds > ROUNDS else SEARCH[:1] if rounds > QUICK else ()
    for reach in reaches if jumping else ():
        for i in jumping:
            fit = _stepped(bench, about, layout, fit, i, reach)
        fit = _descended(_whole(bench), about, layout, fit.model, max(2, rounds // 3), layout.when)
        fit = _descended(bench, about, layout, fit.model, max(2, rounds // 3), ~layout.when)
    return fit


def refitted(part: Bench, whole: Bench, about: Sequence[Scene], fit: Fit, rounds: int) -> Fit:
    """Return a model of the whole, fitted again to a part of the samples.

    What the part cannot tell stays as the whole has it: when something happened, and whatever shows
    in hardly any of its samples, as where a record starts.
    """
    layout = _Layout(whole, fit.model)
    told = ~layout.when & (_uncertain(part, about, fit) < BLIND * _uncertain(whole, about, fit))
    return _descended(part, about, layout, fit.model, rounds, told)


def _uncertain(bench: Bench, about: Sequence[Scene], fit: Fit) -> Array:
    """Return how uncertain each number of a model is, in its step, for residuals of 1."""
    J = slopes_of(bench, about, fit)
    information = J.T @ J + WEAK * np.eye(J.shape[1])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def _stepped(
    bench: Bench, about: Sequence[Scene], layout: "_Layout", fit: Fit, i: int, reach: float
) -> Fit:
    """Return the best of a fit and those with one number up to `reach` [s] more or less.

    Of equal ones the latest: what happened at rest shows with the first motion after it.
    """
    bench = _whole(bench)
    x = layout.pack(fit.model)
    best, least = fit, _cost(bench, fit)
    for off in np.linspace(-reach, reach, STEPS):
        moved = x.copy()
        moved[i] += off / layout.step(i)
        other = simulated(bench, about, layout.unpack(moved))
        cost = _cost(bench, other)
        if cost < least or (off > 0.0 and cost < (1.0 + EQUAL) * least):
            best, least = other, min(cost, least)
    return best


def _whole(bench: Bench) -> Bench:
    return bench._replace(records=tuple(map(in_full, bench.records)))


def _cost(bench: Bench, fit: Fit) -> float:
    return float(np.sum(residual(bench, fit) ** 2))


def _descended(
    bench: Bench,
    about: Sequence[Scene],
    layout: "_Layout",
    start: Model,
    rounds: int,
    free: Mask,
    *,
    robust: bool = False,
) -> Fit:
    low, high = layout.bounds()
    at_start = np.clip(layout.pack(start), low + 1e-9, high - 1e-9)

    def whole(x: Array) -> Array:
        row = at_start.copy()
        row[free] = x
        return row

    known: dict[bytes, Array] = {}  # of the numbers tried last: slopes are asked for at these

    def off(x: Array) -> Array:
        return residual(bench, simulated(bench, about, layout.unpack(whole(x))))

    def tried(x: Array) -> Array:
        known.clear()
        known[x.tobytes()] = r = off(x)
        return r

    def slopes(x: Array) -> Array:
        at = known.get(x.tobytes())
        return _differences(off, x, off(x) if at is None else at, high[free])

    found = least_squares(
        tried,
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
    return simulated(bench, about, layout.unpack(whole(np.asarray(found.x))))


def slopes_of(bench: Bench, about: Sequence[Scene], fit: Fit) -> Array:
    """Return the derivatives of the residual by all parameters, each in its own step."""
    layout = _Layout(bench, fit.model)
    _, high = layout.bounds()

    def off(x: Array) -> Array:
        return residual(bench, simulated(bench, about, layout.unpack(x)))

    return _differences(off, layout.pack(fit.model), residual(bench, fit), high)


def _differences(off: Callable[[Array], Array], x: Array, at: Array, high: Array) -> Array:
    """Return the derivatives of a residual that is `at` where its numbers are `x`."""
    columns = []
    for i in range(len(x)):
        h = STEP if x[i] + STEP < high[i] else -STEP
        moved = x.copy()
        moved[i] += h
        columns.append((off(moved) - at) / h)
    return np.column_stack(columns)


def own_only(bench: Bench, fit: Fit) -> Fit:
    """Return a model of other records of the bench: only what each has for itself is fitted."""
    about = scenes_without(bench, fit)
    if not bench.base.own:
        return simulated(bench, about, fit.model._replace(own=((),) * len(bench.records)))
    own = tuple(own_start(record, fit.model.shared[1]) for record in bench.records)
    model = fit.model._replace(own=own)
    layout = _Layout(bench, model)
    return _descended(bench, about, layout, model, ROUNDS, layout.own)


def own_start(record: Record, compliance: float) -> Values:
    """Return where to look for what a record has for itself, with L/EA [m/N] about known."""
    T = float(np.median(record.signals[PROXIMAL_TENSION][:5]))
    taut = float(record.drive[0]) - compliance * max(T, 0.0)
    if DISTAL_DISPLACEMENT not in record.signals:
        return (taut,)
    loose = record.signals[DISTAL_DISPLACEMENT]
    if DISTAL_TENSION in record.signals:
        low = record.signals[DISTAL_TENSION] <= LOOSE
        loose = loose[low] if low.any() else loose
    return (taut, float(np.min(loose)))


def moved(bench: Bench, model: Model, by: Array) -> Model:
    """Return a model with all its numbers moved, in their own steps, as far as they may be."""
    layout = _Layout(bench, model)
    low, high = layout.bounds()
    return layout.unpack(np.clip(layout.pack(model) + by, low, high))


class Named(NamedTuple):
    """One number of a model with its 95 % interval."""

    name: str
    parameter: Parameter
    value: float
    low: float
    high: float


def parameters(bench: Bench, about: Sequence[Scene], fit: Fit) -> tuple[Named, ...]:
    """Return all numbers of a model but those of single records, with their intervals.

    From the scatter of the residuals and their correlation from one sample to the next, and from
    what a simulation that is off by `ACCURACY` could make of a number at worst; of a time that no
    slope leads to, by how far it can be moved until the residuals are as much larger.
    """
    layout = _Layout(bench, fit.model)
    J, r = slopes_of(bench, about, fit), residual(bench, fit)
    inverse = np.linalg.pinv(J)
    correlation = float(r[1:] @ r[:-1]) / max(float(r @ r), 1e-30)
    correlation = min(max(correlation, 0.0), 0.995)
    spread = float(r @ r) / max(len(r) - J.shape[1], 1) * (1.0 + correlation) / (1.0 - correlation)
    sigma = np.sqrt((inverse**2).sum(axis=1) * spread)
    most_off = np.abs(inverse) @ _inaccuracy(bench, fit.model)
    found = []
    for i, value in enumerate(layout.values(fit.model)[: layout.common]):
        p = layout.parameters[i]
        reach = math.hypot(COVER * float(sigma[i]), float(most_off[i])) * layout.step(i)
        low, high = value - reach, value + reach
        if p.jumps:
            most = _cost(bench, fit) + COVER**2 * spread
            low = min(low, value + _reach(bench, about, layout, fit, i, -1.0, most))
            high = max(high, value + _reach(bench, about, layout, fit, i, 1.0, most))
        found.append(Named(layout.names[i], p, value, max(low, p.low), min(high, p.high)))
    return tuple(found)


def _inaccuracy(bench: Bench, model: Model) -> Array:
    """Return by how much each residual may be off because a simulation is."""
    parts = []
    for record, scale in zip(bench.records, bench.scale, strict=True):
        for channel in record.compared:
            count = int((record.train & record.good[channel]).sum())
            off = ACCURACY * float(np.ptp(record.signals[channel])) / scale[channel]
            parts.append(np.full(count, off))
        if expected_taut(record, model) is not None:
            parts.append(np.zeros(1))
    return np.concatenate(parts)


def _reach(
    bench: Bench,
    about: Sequence[Scene],
    layout: "_Layout",
    fit: Fit,
    i: int,
    way: float,
    most: float,
) -> float:
    """Return how far one number can go one way, in its unit, until the cost is more than `most`."""

    def bears(off: float) -> bool:
        x = layout.pack(fit.model)
        x[i] += off / layout.step(i)
        return _cost(bench, simulated(bench, about, layout.unpack(x))) <= most

    near, far = 0.0, way * SEARCH[-1]
    while bears(far) and abs(far) < FARTHEST:
        near, far = far, 2.0 * far
    for _ in range(HALVED):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if bears(middle) else (near, middle)
    return near


class _Layout:
    """Where the numbers of a model are in the row that is searched, each in its step."""

    def __init__(self, bench: Bench, model: Model) -> None:
        base = bench.base
        effects = [effect for effect, _ in model.effects]
        self.base, self.effects, self.records = base, effects, len(model.own)
        self.names = [p.name for p in base.shared]
        self.parameters = list(base.shared)
        for effect in effects:
            self.names += [f"{effect.name}.{p.name}" for p in effect.parameters]
            self.parameters += effect.parameters
        self.common = len(self.parameters)  # those of the bench come first
        for k, record in enumerate(bench.records):
            self.names += [f"{p.name} ({k + 1})" for p in base.own]
            self.parameters += [
                p._replace(low=low, high=high)
                for p, (low, high) in zip(base.own, own_bounds(record), strict=True)
            ]
        self._steps = [p.step for p in self.parameters]
        if COMPLIANCE in base.shared:  # known to a share of itself, whatever the tendon
            for i, p in enumerate(base.shared):
                if p.unit == "m/N":
                    self._steps[i] = 0.03 * max(model.shared[1], 1e-7)

    @property
    def smooth(self) -> Mask:
        """Which numbers a slope leads to."""
        return np.array([not p.jumps for p in self.parameters])

    @property
    def when(self) -> Mask:
        """Which numbers say when something happened, and how long it took."""
        mask = np.zeros(len(self.parameters), dtype=np.bool_)
        at = len(self.base.shared)
        for effect in self.effects:
            if any(p.jumps for p in effect.parameters):
                for i, p in enumerate(effect.parameters, start=at):
                    mask[i] = p.neutral is None
            at += len(effect.parameters)
        return mask

    @property
    def own(self) -> Mask:
        """Which numbers are of single records."""
        return np.arange(len(self.parameters)) >= self.common

    def step(self, i: int) -> float:
        """Return the step of a number."""
        return self._steps[i]

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the largest of each number."""
        steps = np.array(self._steps)
        low = np.array([p.low for p in self.parameters]) / steps
        return low, np.array([p.high for p in self.parameters]) / steps

    def values(self, model: Model) -> list[float]:
        """Return the numbers of a model, in a row."""
        of_effects = [value for _, values in model.effects for value in values]
        return [*model.shared, *of_effects, *(value for own in model.own for value in own)]

    def pack(self, model: Model) -> Array:
        """Return them in their steps."""
        return np.asarray(np.array(self.values(model)) / np.array(self._steps))

    def unpack(self, x: Array) -> Model:
        """Return the model of a row."""
        values = [float(a * b) for a, b in zip(x, self._steps, strict=True)]
        at = len(self.base.shared)
        shared = tuple(values[:at])
        effects = []
        for effect in self.effects:
            count = len(effect.parameters)
            effects.append((effect, tuple(values[at : at + count])))
            at += count
        size = len(self.base.own)
        own = tuple(tuple(values[at + k * size : at + (k + 1) * size]) for k in range(self.records))
        return Model(shared, own, tuple(effects))
