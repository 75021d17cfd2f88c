"""Results of the experiment per sheath, and their targets."""

from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from studies.paper.scoring import WHOLE, Score
from studies.paper.sheaths import Specimen

PUBLISHED = {"force": (0.07, 0.02), "elongation": (0.03, 0.02)}
"""Largest and average error of the paper's one trial, in shares of full scale: about 7 %, about
3 %, both below 2 % on average."""

TARGETS = {"force": (0.03, 0.007), "elongation": (0.015, 0.007)}
"""The same of ours, asked on every sheath."""


class Result(NamedTuple):
    """One method on one sheath."""

    K: float  # NaN where refused
    refusal: str  # reason of a failure; empty if none
    scores: dict[str, dict[str, Score]]  # by motion, then by phase and WHOLE; empty where refused


class Outcome(NamedTuple):
    """One sheath."""

    specimen: Specimen
    unevenness: float  # ln(M_rel/M_pull) - K, zero where curvature is spread evenly
    results: dict[str, Result]  # by method


class Spread(NamedTuple):
    """Of one error over the sheaths, in shares of full scale, infinite where refused."""

    median: float
    ninetieth: float  # 90 % of the sheaths are at or below it
    largest: float
    within: int  # sheaths at or below the target
    sheaths: int


def values(outcomes: list[Outcome], method: str, motion: str, signal: str, item: str) -> Array:
    """Return one error for each sheath: signal force or elongation, item largest or average."""
    return np.array(
        [
            getattr(getattr(scores[motion][WHOLE], signal), item)
            if (scores := outcome.results[method].scores)
            else np.inf
            for outcome in outcomes
        ]
    )


def spread(errors: Array, target: float) -> Spread:
    """Return how one error is spread over the sheaths."""
    ranked = np.sort(errors)
    ninetieth = ranked[int(np.ceil(0.9 * len(ranked))) - 1]
    within = int(np.sum(errors <= target))
    return Spread(
        float(ranked[(len(ranked) - 1) // 2]),
        float(ninetieth),
        float(ranked[-1]),
        within,
        len(ranked),
    )
