"""Whether a sheath still has the shape it was calibrated in, watched while the joint is used.

Whenever a motor that has pulled goes back, the tip rests until the front of the change has come
through the sheath. So what the motor travels meanwhile is elongation, whatever the joint and its
environment do, and it must be what the model predicts from the tension (docs/theory.md (T19)). If
all friction has changed by a factor f, the travel is another share of what is predicted, 1/f on an
evenly bent sheath, and T_out is wrong by a factor e^(K(f - 1)). What the other tendon has drawn
out may be in another state than the model has it, so only a pull that went on well beyond where
it should have reached the tip counts.

The tip rests only while nothing else moves the joint. A joint that comes to rest by itself lets
both tendons relax while the motor still goes on, and one that is let go by the other tendon gives
way: T_out is then not what it was at the end of the pull, and 20 % of it look like 10 % of K. So a
transition must begin where the motor turns, and is followed no further than what the other tendon
holds against it stays the same. One in which the environment moved the tip is no straight line of
travel over elongation, and is left out too.

A change at the tip alone does not show in the travel, and on a sheath bent there alone nothing is
watched. One transition is measured to a few percent; the median of the latest ones decides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.online import Status, TendonEstimate, TendonModel
from estimator.transmission import Phase

MOBILISED = 0.999  # of the length: the front has reached the tip
DEPTH = 0.7  # of K, up to which the front is surely inside even where friction has fallen
FURTHER = 1.8  # times the tension at which the model has the tip move: there it surely does
LEAST = 3  # transitions before anything is said
APART, APART_SHARE = 0.04, 0.2  # by which they may contradict each other; the share of the error
SPACING = 2e-6  # [m] of elongation between points of a line
POINTS = 5  # that a line needs
SPAN = 3e-5  # [m] of elongation that it needs
SLOWLY = 5.0  # times the lag that it must last; an average of what is curved would tilt the line
CROOKED = 0.03  # of the span: scatter about the line, above which the tip has moved
CURVED = 0.06  # of what the line is tilted by, and so much more: uneven friction curves it, too
AHEAD = 0.05  # of the span that the motor may still go on once the tension falls
STEADY = 0.04  # of T_out, by which what holds against it may change meanwhile

RESOLVED = 0.02  # of the travel, to which one transition is measured: the tip gives way so much
APART_IN_TIME = 0.5  # of the lag, by which tension and travel may be apart: a motor speeds up
SURE = 2.0  # times the doubt, from where an error counts
BLIND = 8.0 / 3.0  # of T_out by one of the travel: the most that an error may be amplified
PIECES = 200  # of each section, for its integrals
FACTORS = np.linspace(0.5, 2.0, 61)  # of all friction, that are told apart

Array = NDArray[np.float64]

_UNUSABLE = Status.TENSION_ONLY | Status.UNINITIALISED | Status.TIP_MOVED | Status.INVALID_INPUT


@dataclass(frozen=True, slots=True)
class MonitorConfig:
    """When to speak up; errors are those of T_out, relative."""

    advise: float = 0.07
    demand: float = 0.15
    transitions: int = 5  # the latest, whose median decides

    def __post_init__(self) -> None:
        """Refuse thresholds that mean nothing."""
        if not 0.0 < self.advise <= self.demand <= 10.0:
            raise ValueError("advise: must be above 0 and at most demand, which is at most 10")
        if not LEAST <= self.transitions <= 99:
            raise ValueError(f"transitions: must be {LEAST} to 99")


class Advice(IntEnum):
    """What to do about the calibration."""

    NONE = 0
    ADVISED = 1  # calibrate again when there is time
    DEMANDED = 2  # calibrate again before anything else


class Watched(NamedTuple):
    """A tendon's model, and what a transition would look like if its friction had changed."""

    K: float
    mobilised: float  # [m] where the front is when the tip moves
    depth: float  # [m] up to where a transition is followed
    lag: float  # [s] by which the estimator averages the tension
    shares: tuple[float, ...]  # of the travel predicted, rising
    factors: tuple[float, ...]  # of all friction that belong to them
    amplified: float  # relative error of T_out for one of the travel
    blind: bool  # whether such changes hardly show, as where all bends are at the tip


class Line(NamedTuple):
    """Sums of a straight line of motor travel over predicted elongation, about their means."""

    points: int = 0
    elongation: float = 0.0  # [m]
    travel: float = 0.0  # [m]
    ee: float = 0.0  # [m^2]
    eq: float = 0.0  # [m^2]
    qq: float = 0.0  # [m^2]
    first: float = math.nan  # [m] elongation
    last: float = math.nan  # [m]
    lasted: float = 0.0  # [s] since the second point
    ahead: float = 0.0  # [m] furthest that the motor has gone on from the first point
    tip: float = 0.0  # [N] T_out at the first point
    against: float = 0.0  # [N] T_out of the other tendon then
    begun: float = math.nan  # [m] travel then


class Watch(NamedTuple):
    """What is remembered of one tendon."""

    reached: float = math.nan  # [N] tension at which the front came to the tip, of this pull
    pulled: bool = False  # so much further that the next transition begins from a known profile
    travel: float = math.nan  # [m] averaged as the estimator averages the tension
    line: Line = Line()
    errors: tuple[float, ...] = ()  # of T_out, relative, by each of the latest transitions
    doubts: tuple[float, ...] = ()  # how far off each of them may be


def prepare(model: TendonModel) -> Watched:
    """Return what is to be known of a tendon before it is watched."""
    sheath = model.sheath
    if sheath.K == 0.0:  # no friction: no transition, by which a change could be told
        return Watched(0.0, math.inf, 0.0, 0.0, (), (), math.inf, blind=True)
    dx = np.concatenate([np.full(PIECES, section.length / PIECES) for section in sheath.sections])
    radius = np.concatenate([np.full(PIECES, section.radius) for section in sheath.sections])
    ds = sheath.friction * dx / radius
    s = np.cumsum(ds)
    front = DEPTH * sheath.K
    shares = _travel(dx, ds, FACTORS, front) / _travel(dx, ds, np.ones(1), front)
    order = np.argsort(shares)
    unchanged = int(np.argmin(np.abs(FACTORS - 1.0)))
    shown = abs(float(np.gradient(shares, FACTORS)[unchanged]))
    return Watched(
        K=sheath.K,
        mobilised=MOBILISED * sheath.length,
        depth=float(np.cumsum(dx)[np.searchsorted(s, front)]),
        lag=model.treatment.time_constant if model.tension_noise > 0.0 else 0.0,
        amplified=sheath.K / shown if shown > 0.0 else math.inf,
        shares=tuple(shares[order].tolist()),
        factors=tuple(FACTORS[order].tolist()),
        blind=BLIND * shown < sheath.K,
    )


def _travel(dx: Array, ds: Array, factors: Array, front: float) -> Array:
    """Return the motor's travel per tension before, from a full pull to a front at depth `front`.

    By (T5), pull to release, for friction `factors` times as large; in units of 1/EA.
    """
    middle = (np.cumsum(ds) - 0.5 * ds) * factors[:, None]
    inside = middle < front
    pulled, released = np.exp(-middle), np.exp(middle - 2.0 * front)
    return np.asarray(np.where(inside, pulled - released, 0.0) @ dx)


def step(
    config: MonitorConfig,
    watched: Watched,
    watch: Watch,
    estimate: TendonEstimate,
    tension: float,
    travel: float,
    against: float,
    dt: float,
) -> Watch:
    """Take in one sample of one tendon.

    Parameters
    ----------
    watched : Watched
        From `prepare`, of the model by which `estimate` was made.
    watch : Watch
        `Watch()` to begin with.
    estimate : TendonEstimate
        Of this sample.
    tension, travel : float
        T_in [N] and q_p [m] of this sample.
    against : float
        T_out [N] of the tendon that pulls the joint the other way; 0 where a spring does.
    dt : float
        Time since the last one [s].
    """
    if watched.blind or estimate.status & _UNUSABLE or not math.isfinite(travel):
        return Watch(errors=watch.errors, doubts=watch.doubts)
    share = -math.expm1(-dt / watched.lag) if watched.lag > 0.0 else 1.0
    before = travel if math.isnan(watch.travel) else watch.travel
    averaged = before + share * (travel - before)
    if estimate.phase == Phase.PULL and estimate.front >= watched.mobilised:
        reached = tension if math.isnan(watch.reached) else watch.reached
        return _closed(config, watched, watch)._replace(
            reached=reached, pulled=tension > FURTHER * reached, travel=averaged
        )
    if not watch.pulled:
        return watch._replace(travel=averaged, reached=math.nan)
    if estimate.phase == Phase.PULL or estimate.front > watched.depth:
        return _closed(config, watched, watch)._replace(travel=averaged)
    line = watch.line
    if line.points and abs(against - line.against) > STEADY * line.tip:
        return _closed(config, watched, watch)._replace(travel=averaged)
    line = _with(line, estimate, averaged, against, dt)
    return watch._replace(travel=averaged, line=line)


def force_error(watch: Watch) -> float:
    """Return by how much T_out is wrong while pulling, relative; 0 while too little is known.

    Positive where the estimate is too high. An error within its doubt says nothing, nor do
    transitions that contradict each other: an environment that moves the tip by itself has many
    ways to do so, a sheath has one shape.
    """
    if len(watch.errors) < LEAST:
        return 0.0
    middle = median(watch.errors)
    if abs(middle) < SURE * median(watch.doubts):
        return 0.0
    apart = median(abs(error - middle) for error in watch.errors)
    return middle if apart < APART + APART_SHARE * abs(middle) else 0.0


def advice(config: MonitorConfig, watches: Sequence[Watch]) -> Advice:
    """Return what is to be done about the calibration of a rig."""
    worst = max((abs(force_error(watch)) for watch in watches), default=0.0)
    if worst >= config.demand:
        return Advice.DEMANDED
    return Advice.ADVISED if worst >= config.advise else Advice.NONE


def _with(line: Line, estimate: TendonEstimate, travel: float, against: float, dt: float) -> Line:
    """Add a point, unless it is too near to the last one."""
    elongation = estimate.elongation
    if not line.points:
        line = Line(first=elongation, begun=travel, tip=estimate.distal_tension, against=against)
    line = line._replace(
        lasted=line.lasted + dt if line.points > 1 else 0.0,
        ahead=max(line.ahead, travel - line.begun),
    )
    if line.points and abs(elongation - line.last) < SPACING:
        return line
    n = line.points + 1
    de, dq = elongation - line.elongation, travel - line.travel
    return line._replace(
        points=n,
        elongation=line.elongation + de / n,
        travel=line.travel + dq / n,
        ee=line.ee + de * de * (n - 1) / n,
        eq=line.eq + de * dq * (n - 1) / n,
        qq=line.qq + dq * dq * (n - 1) / n,
        last=elongation,
    )


def _closed(config: MonitorConfig, watched: Watched, watch: Watch) -> Watch:
    """Take what the transition says, if it says anything, and wait for the next."""
    error = _error(watched, watch.line)
    if error is None:
        return Watch(errors=watch.errors, doubts=watch.doubts)
    doubt = RESOLVED + APART_IN_TIME * watched.lag / max(watch.line.lasted, watched.lag)
    return Watch(
        errors=(*watch.errors, error)[-config.transitions :],
        doubts=(*watch.doubts, watched.amplified * doubt)[-config.transitions :],
    )


def _error(watched: Watched, line: Line) -> float | None:
    """Return the relative error of T_out by one transition, None if it does not show one."""
    span = line.first - line.last
    if line.points < POINTS or not span > SPAN or line.lasted < SLOWLY * watched.lag:
        return None
    if line.ahead > AHEAD * span:
        return None
    slope = line.eq / line.ee
    scatter = math.sqrt(max(line.qq - slope * line.eq, 0.0) / line.points)
    if scatter > (CROOKED + CURVED * abs(slope - 1.0)) * span:
        return None
    factor = float(np.interp(slope, watched.shares, watched.factors))
    return math.expm1(watched.K * (factor - 1.0))
