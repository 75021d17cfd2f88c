"""What the pattern of a sheath may be, weighed by its loop, or by that of its antagonist too."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.calibration.measured import Measured
from estimator.calibration.pattern import Pattern

UNSEEN = 0.01
"""Standard uncertainty of K that no rival's own allows for, as a pattern that was never tried."""

_ALIKE = 0.002  # of K: fits of one shape that differ by less are one
_LEAST_WEIGHT = 1e-300


class Rival(NamedTuple):
    """A pattern, and -2 ln of its posterior probability."""

    pattern: Pattern
    score: float
    uncertainty: float  # of K, by noise alone


class Weighed(NamedTuple):
    """What stands for all rivals, and how sure they are of it."""

    K: Measured
    compliance: Measured  # L/EA [m/N]; what noise leaves open within each rival is not in it
    pattern: Pattern


def distinct(rivals: Iterable[Rival]) -> tuple[Rival, ...]:
    """Return the best of each kind, the best one first."""
    different: dict[tuple[int, int, int], Rival] = {}
    for rival in sorted(rivals, key=lambda rival: rival.score):
        pattern = rival.pattern
        straight = sum(1 << k for k, c in enumerate(pattern.straight) if c > 0.0)
        kind = (len(pattern.ends), straight, round(pattern.K / _ALIKE))
        different.setdefault(kind, rival)
    return tuple(different.values())


def alone(rivals: tuple[Rival, ...]) -> Weighed:
    """Return what a loop by itself says."""
    K, own, score = _arrays(rivals)
    weight = np.exp(-0.5 * (score - score.min()))
    return _weighed(rivals, K, own, weight / weight.sum())


def together(
    a: tuple[Rival, ...], b: tuple[Rival, ...], total: Measured
) -> tuple[Weighed, Weighed]:
    """Return what the loops of two antagonists say where K_a + K_b is known, too.

    Every pair of rivals is as probable as its loops and the total make it; within a pair, what the
    total asks for is shared out by the variances of the two (Bayes' rule for normal errors).
    """
    K_a, own_a, score_a = _arrays(a)
    K_b, own_b, score_b = _arrays(b)
    own_a, own_b = np.hypot(own_a, UNSEEN)[:, None], np.hypot(own_b, UNSEEN)
    missing = total.value - K_a[:, None] - K_b
    variance = total.uncertainty**2 + own_a**2 + own_b**2
    score = score_a[:, None] + score_b + missing**2 / variance + np.log(variance)
    weight = np.exp(-0.5 * (score - score.min()))
    weight /= weight.sum()
    share_a, share_b = own_a**2 / variance, own_b**2 / variance
    return (
        _in_pairs(a, weight, share_a * missing, own_a**2 * (1.0 - share_a)),
        _in_pairs(b, weight.T, (share_b * missing).T, (own_b**2 * (1.0 - share_b)).T),
    )


def _in_pairs(rivals: tuple[Rival, ...], weight: Array, shift: Array, variance: Array) -> Weighed:
    """Weigh rivals by pairs: what each asks for and leaves open of K, shape (rivals, of other)."""
    each = np.maximum(weight.sum(axis=1), _LEAST_WEIGHT)
    mean = (weight * shift).sum(axis=1) / each
    left = (weight * (variance + (shift - mean[:, None]) ** 2)).sum(axis=1) / each
    K, *_ = _arrays(rivals)
    return _weighed(rivals, K + mean, np.sqrt(left), each / each.sum())


def _arrays(rivals: tuple[Rival, ...]) -> tuple[Array, Array, Array]:
    """Return K, its own uncertainties, and scores."""
    return (
        np.array([rival.pattern.K for rival in rivals]),
        np.array([rival.uncertainty for rival in rivals]),
        np.array([rival.score for rival in rivals]),
    )


def _weighed(rivals: tuple[Rival, ...], K: Array, own: Array, weight: Array) -> Weighed:
    """Return the weighted median of K, its pattern, and the scatter about them."""
    compliance = np.array([rival.pattern.compliance for rival in rivals])
    order = np.argsort(K)
    middle = int(order[np.searchsorted(np.cumsum(weight[order]), 0.5)])
    u_K = math.sqrt(float(weight @ (own**2 + (K - K[middle]) ** 2)))
    between = math.sqrt(float(weight @ (compliance - compliance[middle]) ** 2))
    return Weighed(
        Measured(float(K[middle]), u_K),
        Measured(float(compliance[middle]), between),
        rivals[middle].pattern.ending(float(K[middle])),
    )
