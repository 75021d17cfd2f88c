"""Psychometric functions: probability of a correct answer over the stimulus; fit and threshold.

    psi(x) = gamma + (1 - gamma - lambda) F((x - alpha) / beta)

with the guess rate gamma, which the task fixes (1/2 with two intervals), the lapse rate lambda, the
threshold alpha, at which F = 1/2, and the spread beta. F is a cumulative normal or logistic
distribution. Wichmann and Hill, "The psychometric function: I. Fitting, sampling, and goodness of
fit", Perception & Psychophysics 63 (2001) 1293-1313.

The function is fitted by maximum likelihood. The interval of the threshold is the central one of
the likelihood integrated over spread (uniform in its logarithm) and lapse rate, as in Schuett et
al., "Painfree and accurate Bayesian estimation of psychometric functions for (potentially)
overdispersed data", Vision Research 122 (2016) 105-123. The likelihood is the same whether stimuli
were fixed or adapted to the answers. With 30 to 80 trials the interval of the profile likelihood
holds the true threshold in 79 to 93 of 100 experiments instead of 95: the best spread of few
answers is too small, above all that of a staircase.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, special

from estimator.array_types import Array
from teleop.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Shape = Literal["normal", "logistic"]

LAPSE_MAX = 0.06  # upper bound of the lapse rate in a fit, as in Wichmann and Hill
_LOG_SPREADS = (math.log(0.02), math.log(2.0))  # bounds of the spread, in ranges of the stimulus
_THRESHOLDS = (-1.0, 2.0)  # bounds of the threshold, in ranges above the smallest stimulus
_THRESHOLD_COUNT, _SPREAD_COUNT = 101, 16  # of the grid
_GRID_PART = 1000  # points of the grid at a time
_DRAWS = 1000  # simulated data sets for the p-value of the deviance
_TINY = 1e-12


def compute_probability(
    stimulus: ArrayLike,
    threshold: ArrayLike,
    spread: ArrayLike,
    guess_rate: ArrayLike,
    lapse_rate: ArrayLike = 0.0,
    shape: Shape = "normal",
) -> Array:
    """Return psi, the probability of a correct answer; arguments broadcast."""
    z = (np.asarray(stimulus, float) - np.asarray(threshold, float)) / np.asarray(spread, float)
    cdf = special.ndtr(z) if shape == "normal" else special.expit(z)
    return np.asarray(
        guess_rate + (1.0 - np.asarray(guess_rate, float) - np.asarray(lapse_rate, float)) * cdf
    )


@dataclass(frozen=True)
class PsychometricFit:
    """A fitted psychometric function, stimuli in the unit that they were given in."""

    threshold: float  # stimulus at which F = 1/2: half-way from guessing to the upper asymptote
    low: float  # ends of the interval of the threshold; infinite where the answers set no bound
    high: float
    confidence: float  # of the interval
    spread: float  # beta
    guess_rate: float
    lapse_rate: float
    shape: Shape
    deviance: float  # 2 log of the likelihood ratio to a model with a free rate at each stimulus
    deviance_p: float  # share of data sets drawn from it whose own fit deviates as much or more
    levels: Array  # (levels,) distinct stimuli
    counts: Array  # (levels,) trials
    successes: Array  # (levels,) correct answers

    def compute_probability(self, stimulus: ArrayLike) -> Array:
        """Return the probability of a correct answer at each stimulus."""
        return compute_probability(
            stimulus, self.threshold, self.spread, self.guess_rate, self.lapse_rate, self.shape
        )

    def find_stimulus(self, probability: float) -> float:
        """Return the stimulus with this probability of a correct answer.

        Raises
        ------
        UsageError
            It is not between the asymptotes.
        """
        top = 1.0 - self.lapse_rate
        if not self.guess_rate < probability < top:
            raise UsageError(
                f"probability {probability:g}: must be above {self.guess_rate:g} and below {top:g}"
            )
        share = (probability - self.guess_rate) / (top - self.guess_rate)
        z = special.ndtri(share) if self.shape == "normal" else special.logit(share)
        return float(self.threshold + self.spread * z)


class _Likelihood:
    """Likelihood of answers that are counted by level, in ranges of the stimulus."""

    def __init__(
        self, x: Array, n: Array, k: Array, guess: float, lapse_max: float, shape: Shape
    ) -> None:
        self.x, self.n, self.k, self.guess, self.shape = x, n, k, guess, shape
        self.log_spreads = np.linspace(*_LOG_SPREADS, _SPREAD_COUNT)
        self.lapses = np.linspace(0.0, lapse_max, 3 if lapse_max else 1)
        self.thresholds = np.linspace(*_THRESHOLDS, _THRESHOLD_COUNT)
        self.logs = self.tabulate(self.thresholds)

    def compute_log(self, threshold: Array, log_spread: Array, lapse_rate: Array) -> Array:
        """Return log L; the parameters broadcast, with a last axis of one for the levels."""
        p = compute_probability(
            self.x, threshold, np.exp(log_spread), self.guess, lapse_rate, self.shape
        )
        p = np.clip(p, _TINY, 1.0 - _TINY)
        return np.asarray(np.log(p) @ self.k + np.log1p(-p) @ (self.n - self.k))

    def tabulate(self, thresholds: Array) -> Array:
        """Return log L on a grid, shape (thresholds, spreads, lapse rates)."""
        grids = (thresholds[:, None, None, None], self.log_spreads[:, None, None])
        return self.compute_log(*grids, self.lapses[:, None])

    def maximise(self) -> Array:
        """Return threshold, log spread and lapse rate of the largest likelihood."""
        grids = (self.thresholds, self.log_spreads, self.lapses)
        indices = np.unravel_index(np.argmax(self.logs), self.logs.shape)
        best = optimize.minimize(
            lambda values: -self.compute_log(*values),
            [grid[index] for grid, index in zip(grids, indices, strict=True)],
            method="L-BFGS-B",
            bounds=[(grid[0], grid[-1]) for grid in grids],
        )
        return np.asarray(best.x)

    def find_least_deviances(self, successes: Array) -> Array:
        """Return the deviance of the best fit on the grid to each row of answers by level."""
        p = compute_probability(
            self.x, self.thresholds[:, None, None, None], np.exp(self.log_spreads)[:, None, None],
            self.guess, self.lapses[:, None], self.shape,
        ).reshape(-1, len(self.x))  # fmt: skip
        p = np.clip(p, _TINY, 1.0 - _TINY)
        best: Array = np.full(len(successes), -np.inf)
        for part in np.array_split(p, 1 + len(p) // _GRID_PART):
            logs = successes @ np.log(part).T + (self.n - successes) @ np.log1p(-part).T
            best = np.maximum(best, logs.max(1))
        share = successes / self.n
        free = special.xlogy(successes, share) + special.xlogy(self.n - successes, 1.0 - share)
        return np.asarray(2.0 * (free.sum(1) - best))

    def find_interval(self, confidence: float) -> tuple[float, float]:
        """Return the central interval of the integrated likelihood of the threshold.

        An end is infinite where the threshold may as well lie beyond all that is looked at.
        """
        tail = 0.5 * (1.0 - confidence)
        weights = _integrate(self.logs)
        open_ends = weights[[0, -1]] > weights.max() * np.exp(
            -0.5 * special.chdtri(1, 1.0 - confidence)
        )
        kept = np.flatnonzero(weights > 1e-6 * weights.max())  # a finer grid where it matters
        first, last = max(kept[0] - 1, 0), min(kept[-1] + 1, len(weights) - 1)
        thresholds = np.linspace(self.thresholds[first], self.thresholds[last], _THRESHOLD_COUNT)
        weights = _integrate(self.tabulate(thresholds))
        cumulated = (np.cumsum(weights) - 0.5 * weights) / weights.sum()
        low, high = np.interp((tail, 1.0 - tail), cumulated, thresholds)
        return -np.inf if open_ends[0] else float(low), np.inf if open_ends[1] else float(high)


def _integrate(logs: Array) -> Array:
    """Return the likelihood of each threshold, up to a factor, summed over the other parameters."""
    return np.asarray(np.exp(logs - logs.max()).sum((1, 2)))


def fit_psychometric(
    stimulus: ArrayLike,
    correct: ArrayLike,
    *,
    guess_rate: float,
    lapse_max: float = LAPSE_MAX,
    shape: Shape = "normal",
    confidence: float = 0.95,
) -> PsychometricFit:
    """Fit a psychometric function to answers by maximum likelihood.

    Parameters
    ----------
    stimulus : array_like, shape (trials,)
        Larger ones are answered correctly more often.
    correct : array_like of bool, shape (trials,)
        Whether each answer was correct (or "yes", with a guess rate of 0).
    guess_rate : float
        1 / number of alternatives; 0 for yes or no.
    lapse_max : float
        Upper bound of the lapse rate; 0 fixes it at 0.
    shape : "normal" or "logistic"
        The distribution F.
    confidence : float
        Of the interval of the threshold.

    Raises
    ------
    UsageError
        There are fewer than two stimuli, a number is not finite, or a rate is out of range.
    """
    x, answers = np.asarray(stimulus, float), np.asarray(correct, float)
    if x.ndim != 1 or x.shape != answers.shape or not np.isfinite(x).all():
        raise UsageError("stimulus, correct: must be finite, one of each for a trial")
    if not np.isin(answers, (0.0, 1.0)).all():
        raise UsageError("correct: must be true or false for each trial")
    if not 0.0 < confidence < 1.0:
        raise UsageError(f"confidence {confidence:g}: must be above 0 and below 1, such as 0.95")
    if not (0.0 <= guess_rate < 0.9 and 0.0 <= lapse_max <= 0.5 * (1.0 - guess_rate)):
        raise UsageError("guess_rate: must be 0 to 0.9; lapse_max: at most half of the rest")
    levels, index = np.unique(x, return_inverse=True)
    if len(levels) < 2:
        raise UsageError("stimulus: a fit needs trials at two stimuli or more")
    counts: Array = np.bincount(index).astype(np.float64)
    successes: Array = np.bincount(index, answers).astype(np.float64)
    origin, unit = levels[0], levels[-1] - levels[0]
    likelihood = _Likelihood(
        (levels - origin) / unit, counts, successes, guess_rate, lapse_max, shape
    )
    best = likelihood.maximise()
    low, high = likelihood.find_interval(confidence)
    p = compute_probability(levels, origin + unit * best[0], unit * math.exp(best[1]), guess_rate,
                            best[2], shape)  # fmt: skip
    deviance = float(_compute_deviance(successes, counts, p))
    draws = np.random.default_rng(0).binomial(counts.astype(int), p, (_DRAWS, len(levels)))
    least = likelihood.find_least_deviances(np.vstack((successes, draws)))
    return PsychometricFit(
        threshold=float(origin + unit * best[0]),
        low=float(origin + unit * low),
        high=float(origin + unit * high),
        confidence=confidence,
        spread=float(unit * math.exp(best[1])),
        guess_rate=guess_rate,
        lapse_rate=float(best[2]),
        shape=shape,
        deviance=deviance,
        deviance_p=float(np.mean(least[1:] >= least[0] - 1e-9)),
        levels=levels,
        counts=counts,
        successes=successes,
    )


def _compute_deviance(successes: Array, counts: Array, p: Array) -> Array:
    """Return the deviance from the saturated model, along the last axis."""
    p = np.clip(p, _TINY, 1.0 - _TINY)
    misses = counts - successes
    hits = special.xlogy(successes, successes / (counts * p))
    return np.asarray(2.0 * (hits + special.xlogy(misses, misses / (counts * (1.0 - p)))).sum(-1))


def draw_psychometric(
    fits: PsychometricFit | Sequence[PsychometricFit],
    labels: Sequence[str] = (),
    stimulus: str = "stimulus",
) -> "Figure":
    """Return a figure of fitted functions: answers by stimulus, curves, thresholds and intervals.

    Parameters
    ----------
    labels : sequence of str
        One a fit, such as its condition.
    stimulus : str
        Label of the axis, with its unit.
    """
    from matplotlib.figure import Figure  # which takes a second, and no trial needs it

    from estimator import figure_style

    fits = [fits] if isinstance(fits, PsychometricFit) else list(fits)
    colours = (
        figure_style.BLUE,
        figure_style.VERMILION,
        figure_style.GREEN,
        figure_style.BLACK,
        figure_style.GREY,
    )
    with figure_style.use_style():
        figure = Figure(figsize=(5.0, 3.4))
        axes: Any = figure.subplots()
        for number, fit in enumerate(fits):
            colour = colours[number % len(colours)]
            label = labels[number] if number < len(labels) else None
            x = np.linspace(fit.levels[0], fit.levels[-1], 300)
            axes.plot(x, fit.compute_probability(x), color=colour, label=label)
            area = 12.0 + 60.0 * fit.counts / fit.counts.max()
            axes.scatter(fit.levels, fit.successes / fit.counts, area, color=colour, alpha=0.5)
            height = float(fit.compute_probability(fit.threshold))
            ends = np.clip((fit.low, fit.high), fit.levels[0], fit.levels[-1])
            axes.plot(ends, (height, height), color=colour, linewidth=3.0, alpha=0.6)
            axes.plot(fit.threshold, height, "|", color=colour, markersize=12.0)
        axes.set(xlabel=stimulus, ylabel="share correct", ylim=(-0.03, 1.03))
        if labels:
            axes.legend(loc="lower right")
    return figure
