"""What the pattern of a sheath may be, weighed by its loop, or by that of its antagonist too."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.calibration.pattern import Pattern
from estimator.fitting import MeasuredValue

UNMODELLED_UNCERTAINTY = 0.01
"""Standard uncertainty of K that no rival's own allows for, as a pattern that was never tried."""

_K_TOLERANCE = 0.002  # of K: fits of one shape that differ by less are one
_WEIGHT_MIN = 1e-300


class Rival(NamedTuple):
    """A pattern, and -2 ln of its posterior probability."""

    pattern: Pattern
    score: float
    uncertainty: float  # of K, by noise alone


class ModelAverage(NamedTuple):
    """What stands for all rivals, and how sure they are of it."""

    K: MeasuredValue
    compliance: MeasuredValue  # L/EA [m/N]; what noise leaves open within each rival is not in it
    pattern: Pattern


def deduplicate_rivals(rivals: Iterable[Rival]) -> tuple[Rival, ...]:
    """Return the best of each kind, the best one first."""
    different: dict[tuple[int, int, int], Rival] = {}
    for rival in sorted(rivals, key=lambda rival: rival.score):
        pattern = rival.pattern
        straight = sum(1 << k for k, c in enumerate(pattern.straight) if c > 0.0)
        kind = (len(pattern.ends), straight, round(pattern.K / _K_TOLERANCE))
        different.setdefault(kind, rival)
    return tuple(different.values())


def average_rivals(rivals: tuple[Rival, ...]) -> ModelAverage:
    """Return what a loop by itself says."""
    K, uncertainty, score = _to_arrays(rivals)
    weight = np.exp(-0.5 * (score - score.min()))
    return _compute_weighted_median(rivals, K, uncertainty, weight / weight.sum())


def average_antagonists(
    a: tuple[Rival, ...], b: tuple[Rival, ...], total: MeasuredValue
) -> tuple[ModelAverage, ModelAverage]:
    """Return what the loops of two antagonists say where K_a + K_b is known, too.

    Every pair of rivals is as probable as its loops and the total make it; within a pair, what the
    total asks for is shared out by the variances of the two (Bayes' rule for normal errors).
    """
    K_a, own_a, score_a = _to_arrays(a)
    K_b, own_b, score_b = _to_arrays(b)
    own_a = np.hypot(own_a, UNMODELLED_UNCERTAINTY)[:, None]
    own_b = np.hypot(own_b, UNMODELLED_UNCERTAINTY)
    missing = total.value - K_a[:, None] - K_b
    variance = total.uncertainty**2 + own_a**2 + own_b**2
    score = score_a[:, None] + score_b + missing**2 / variance + np.log(variance)
    weight = np.exp(-0.5 * (score - score.min()))
    weight /= weight.sum()
    share_a, share_b = own_a**2 / variance, own_b**2 / variance
    return (
        _average_pairs(a, weight, share_a * missing, own_a**2 * (1.0 - share_a)),
        _average_pairs(b, weight.T, (share_b * missing).T, (own_b**2 * (1.0 - share_b)).T),
    )


def _average_pairs(
    rivals: tuple[Rival, ...], weight: Array, shift: Array, variance: Array
) -> ModelAverage:
    """Weigh rivals by pairs: what each asks for and leaves open of K, shape (rivals, of other)."""
    total_weight = np.maximum(weight.sum(axis=1), _WEIGHT_MIN)
    mean = (weight * shift).sum(axis=1) / total_weight
    variance_mean = (weight * (variance + (shift - mean[:, None]) ** 2)).sum(axis=1) / total_weight
    K, *_ = _to_arrays(rivals)
    return _compute_weighted_median(
        rivals, K + mean, np.sqrt(variance_mean), total_weight / total_weight.sum()
    )


def _to_arrays(rivals: tuple[Rival, ...]) -> tuple[Array, Array, Array]:
    """Return K, its own uncertainties, and scores."""
    return (
        np.array([rival.pattern.K for rival in rivals]),
        np.array([rival.uncertainty for rival in rivals]),
        np.array([rival.score for rival in rivals]),
    )


def _compute_weighted_median(
    rivals: tuple[Rival, ...], K: Array, uncertainty: Array, weight: Array
) -> ModelAverage:
    """Return the weighted median of K, its pattern, and the scatter about them."""
    compliance = np.array([rival.pattern.compliance for rival in rivals])
    order = np.argsort(K)
    middle = int(order[np.searchsorted(np.cumsum(weight[order]), 0.5)])
    u_K = math.sqrt(float(weight @ (uncertainty**2 + (K - K[middle]) ** 2)))
    spread = math.sqrt(float(weight @ (compliance - compliance[middle]) ** 2))
    return ModelAverage(
        MeasuredValue(float(K[middle]), u_K),
        MeasuredValue(float(compliance[middle]), spread),
        rivals[middle].pattern.adjust_friction(float(K[middle])),
    )
