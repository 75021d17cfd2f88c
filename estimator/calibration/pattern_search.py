"""Which pattern a loop speaks for, and how surely that decides K.

A finer pattern always fits better, and its last interval may then run on with next to nothing in
it. So a pattern is grown from one interval, each end and compliance having to earn a price in
chi², and shrunk again; what it could have been as well, its neighbours by one change, are weighed
against it. Most of the uncertainty of K is between them: whether the sheath ends straight or
in a slight bend.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from estimator.array_types import Mask
from estimator.calibration.model_averaging import (
    ModelAverage,
    Rival,
    average_rivals,
    deduplicate_rivals,
)
from estimator.calibration.pattern import (
    K_MAX,
    STEP_MIN,
    Pattern,
    PatternFit,
    PatternLeastSquares,
    Shape,
)
from estimator.fitting import MeasuredValue

GROWTH_PENALTY = 6.0  # of chi² for a parameter while growing
SCORE_PENALTY = 5.0  # of chi² for a parameter while weighing: ln of some hundred averages
INTERVALS_MAX = 6
BEND_DENSITY_MIN, BEND_DENSITY_LOG_SIGMA = 0.15, 0.45
"""The last interval's compliance per unit of s, over that of the sheath: below the first, which is
a bend of some 30 mm, it is rarer by one sigma for each factor e^0.45. Without this anything could
follow beyond the tip, as long as it has next to no compliance."""

_STARTS = (0.2, 0.4, 0.7, 1.0, 1.4, 1.9, 2.5)
_FREE_STEP = 0.03
_FREE_PARAMETERS = 12  # that a free pattern uses of a loop, about
_ADDED_WIDTHS = (0.03, 0.12)  # widths of s of a bend that is tried
_QUICK_EVALUATIONS = 6  # evaluations
_RIVALS_FITTED, _RIVALS_REFINED = 10, 3  # fitted in full, and with the turning tensions moved too
_WIDTH_STEP, _WIDTH_RANGE = 0.03, 0.5  # of s: of the widths tried for the last bend
_BEND_ODDS = 2.0  # times as often a sheath ends in a slight bend as straight
_WIDTHS = np.arange(0.5, 8.0) * _WIDTH_STEP
_WIDTH_MAX = float(_WIDTHS[-1])
_UNCERTAINTY_MAX = 0.03  # of K; linearised, a bend of no visible width has any uncertainty


class PatternSearchResult(NamedTuple):
    """What a loop may be, what stands for all of it, and what that leaves."""

    rivals: tuple[Rival, ...]
    weighed: ModelAverage
    compliance_noise: float  # [m/N] standard uncertainty of L/EA that the noise alone leaves
    zero: MeasuredValue  # [N]
    misfit: float  # least chi² of any pattern, over what noise alone would leave
    residual: float  # [N] root mean square


def search_pattern(fitter: PatternLeastSquares) -> PatternSearchResult:
    """Return the pattern of a loop."""
    fit = _fit_one_interval(fitter)
    fit = _select_shape(fitter, fit)
    fit, _ = fitter.refine(fit)
    fitter.weigh(fit.pattern)
    fit = _select_shape(fitter, fit)
    fit, uncertainty = fitter.refine(fit)
    misfit = _compute_misfit(fitter, fit)
    scale = max(misfit, 1.0)
    found = [_build_rival(fit, scale, uncertainty.K)]
    found += _find_rivals(fitter, fit, scale, uncertainty.K)
    rivals = deduplicate_rivals(found)
    return PatternSearchResult(
        rivals=rivals,
        weighed=average_rivals(rivals),
        compliance_noise=math.sqrt(scale) * uncertainty.compliance,
        zero=MeasuredValue(fitter.zero, uncertainty.zero * math.sqrt(scale)),
        misfit=misfit,
        residual=fitter.compute_tension_residual(fit),
    )


def _build_rival(fit: PatternFit, scale: float, uncertainty: float, prior: float = 0.0) -> Rival:
    score = (
        fit.chi2 / scale
        + SCORE_PENALTY * fit.shape.parameters
        + _compute_bend_penalty(fit.pattern)
        + prior
    )
    return Rival(fit.pattern, score, math.sqrt(scale) * uncertainty)


def _find_rivals(
    fitter: PatternLeastSquares, best: PatternFit, scale: float, uncertainty: float
) -> Iterator[Rival]:
    """Yield what the pattern could have been as well."""
    state = fitter.state

    def score(fit: PatternFit) -> float:
        return _build_rival(fit, scale, 0.0).score

    shapes = (*_generate_larger_shapes(best.shape), *_generate_smaller_shapes(best.shape))
    fits = sorted((fitter.fit(shape, _QUICK_EVALUATIONS) for shape in shapes), key=score)
    fits = sorted((fitter.fit(fit.shape) for fit in fits[:_RIVALS_FITTED]), key=score)
    for fit in fits[:_RIVALS_REFINED]:
        refined, own = fitter.refine(fit)
        yield _build_rival(refined, scale, min(own.K, _UNCERTAINTY_MAX))
        fitter.state = state
    yield from (_build_rival(fit, scale, uncertainty) for fit in fits[_RIVALS_REFINED:])
    ends, straight = best.shape
    before = float(ends[-2]) if len(ends) > 1 else 0.0
    if straight[-1]:
        ends = np.append(ends, ends[-1])
        straight = np.append(_replace_entry(straight, -1, value=False), False)
    elif float(ends[-1]) - before > _WIDTH_MAX:
        return
    # How wide the last bend is, is hardly seen where it is slight: each width counts for itself.
    middle = 0.5 * float(ends[-1] + ends[-2])
    for width in _WIDTHS:
        begin = max(middle - 0.5 * width, float(ends[-3]) + STEP_MIN if len(ends) > 2 else STEP_MIN)
        shape = Shape(np.append(ends[:-2], [begin, begin + width]), straight)
        prior = -2.0 * math.log(_BEND_ODDS * _WIDTH_STEP / _WIDTH_RANGE) - SCORE_PENALTY
        yield _build_rival(fitter.fit(shape, hold_last=True), scale, uncertainty, prior)


def _compute_misfit(fitter: PatternLeastSquares, fit: PatternFit) -> float:
    """Return the least chi² of any pattern, per degree of freedom."""
    return min(fitter.compute_free_chi2(_FREE_STEP), fit.chi2) / (fitter.n - _FREE_PARAMETERS)


def _fit_one_interval(fitter: PatternLeastSquares) -> PatternFit:
    straight = np.array([True, True])
    fits = [fitter.fit(Shape(np.array([K]), straight)) for K in _STARTS]
    best = min(fits, key=lambda fit: fit.chi2)
    for _ in range(2):
        fitter.weigh(best.pattern)
        best = fitter.fit(best.shape)
    return best


def _select_shape(fitter: PatternLeastSquares, fit: PatternFit) -> PatternFit:
    """Grow and shrink while that pays."""
    scale = max(_compute_misfit(fitter, fit), 1.0)

    def cost(fit: PatternFit) -> float:
        return fit.chi2 + scale * (
            GROWTH_PENALTY * fit.shape.parameters + _compute_bend_penalty(fit.pattern)
        )

    while len(fit.shape.ends) < INTERVALS_MAX:
        grown = [
            fitter.fit(shape, _QUICK_EVALUATIONS) for shape in _generate_larger_shapes(fit.shape)
        ]
        grown = [fitter.fit(other.shape) for other in sorted(grown, key=cost)[:2]]
        best = min(grown, key=cost)
        if cost(best) >= cost(fit):
            break
        fitter.weigh(best.pattern)
        fit = fitter.fit(best.shape)
    while smaller := [fitter.fit(shape) for shape in _generate_smaller_shapes(fit.shape)]:
        best = min(smaller, key=cost)
        if cost(best) >= cost(fit):
            break
        fit = best
    return fit


def _compute_bend_penalty(pattern: Pattern) -> float:
    """Return how improbably tight the last bend is, in units of chi²."""
    width = np.diff(pattern.ends, prepend=0.0)
    density = np.maximum(np.array(pattern.spread) / (width * pattern.compliance), 1e-9)
    rarity = np.log(BEND_DENSITY_MIN / density) / BEND_DENSITY_LOG_SIGMA
    return float(np.maximum(rarity, 0.0)[-1] ** 2)


def _generate_larger_shapes(shape: Shape) -> Iterator[Shape]:
    """Shapes with one bend or straight stretch more, or a bend for a straight stretch."""
    ends, straight = shape
    for i in np.flatnonzero(~straight):
        yield Shape(ends, _replace_entry(straight, int(i), value=True))
    if not straight[-1]:  # the last bend drawn in, a straight stretch behind it
        begin = float(ends[-2]) if len(ends) > 1 else 0.0
        shorter = np.append(ends[:-1], begin + 0.8 * (float(ends[-1]) - begin))
        yield Shape(shorter, _replace_entry(straight, -1, value=True))
    for j, (begin, end) in enumerate(zip((0.0, *ends[:-1]), ends, strict=True)):
        if end - begin < 4.0 * STEP_MIN:
            continue
        for share in (0.2, 0.5, 0.8):
            cut = np.insert(ends, j, begin + share * (end - begin))
            yield Shape(cut, np.insert(straight, j + 1, values=False))
            yield Shape(cut, np.insert(straight, j + 1, values=True))
    for width in _ADDED_WIDTHS:
        longer = np.append(ends, ends[-1] + width)
        if longer[-1] < K_MAX:
            yield Shape(longer, np.append(straight, False))
        for i in np.flatnonzero(straight):
            widened = np.insert(ends, i, 0.0 if i == 0 else ends[i - 1])
            widened[i:] += width
            yield Shape(
                widened, np.insert(_replace_entry(straight, int(i), value=False), i, values=False)
            )


def _generate_smaller_shapes(shape: Shape) -> Iterator[Shape]:
    """Shapes with one bend or straight stretch less, or a straight stretch for a bend."""
    ends, straight = shape
    for i in np.flatnonzero(straight):
        yield Shape(ends, _replace_entry(straight, int(i), value=False))
    for j in range(len(ends) - 1):
        yield Shape(np.delete(ends, j), np.delete(straight, j + 1))
        # the interval that follows, drawn together
        merged = np.delete(ends, j + 1)
        merged[j] = 0.5 * (ends[j] + ends[j + 1])
        yield Shape(merged, _replace_entry(np.delete(straight, j + 2), j + 1, value=True))


def _replace_entry(mask: Mask, index: int, *, value: bool) -> Mask:
    changed = mask.copy()
    changed[index] = value
    return changed
