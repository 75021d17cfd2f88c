"""Calibration of a sheath from the housing, by pulling and releasing with the tip blocked.

With the tip blocked the travel of the motor is elongation. Three ways lead from there to K:

* the **pattern** (T7): how the compliance is spread over friction, fitted to the whole loop; right
  for any curvature, needs neither EA nor L. This is the K to use;
* the **slopes** (T6): K = ln(M_rel/M_pull), right for a uniformly curved sheath, likewise;
* the **paper**: K from M_pull by Phee et al. 2009, eq. (13), right for a uniformly curved sheath,
  needs EA and L.

Where the first two disagree the sheath is not uniformly curved, or friction depends on direction.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array, Mask
from estimator.calibration.blocked_loop import BlockedLoop, Branch, CalibrationError, segment_loop
from estimator.calibration.model_averaging import UNMODELLED_UNCERTAINTY, ModelAverage, Rival
from estimator.calibration.model_averaging import average_antagonists as weighed_together
from estimator.calibration.pattern import NO_TAIL, Pattern, PatternLeastSquares, Tail
from estimator.calibration.pattern_search import PatternSearchResult, search_pattern
from estimator.fitting import MeasuredValue
from estimator.law.sheath import Sheath

# --- the calibration of Phee et al. 2009: K from the elongation constant of the pull, eq. (13)
# It needs EA and L beforehand, holds for a uniformly curved sheath, and enlarges the error of
# either 2 to 3.5 times (docs/explanation/theory.md (T8)).


def compute_friction_from_elongation(M_e: float, axial_stiffness: float, length: float) -> float:
    """Return K of a uniformly curved sheath from its elongation constant (T8).

    The closed form of Phee et al. 2009, eq. (13): with m = M_e EA/L,
    K = 1/m + W_0(-e^(-1/m)/m).

    Parameters
    ----------
    M_e : float
        Elongation over housing tension while pulling [m/N].
    axial_stiffness : float
        EA of tendon and sheath in series [N].
    length : float
        L [m].

    Raises
    ------
    CalibrationError
        If m is not in (0, 1): no friction makes a tendon stretch more than free of friction.
    """
    m = M_e * axial_stiffness / length
    if not 0.0 < m < 1.0:
        raise CalibrationError(
            f"M_e EA/L is {m:.4g}, must lie between 0 and 1: EA is too large or L too short for an "
            f"elongation of {M_e:.4g} m/N; measure both, or calibrate from a loop without them"
        )
    from scipy.special import lambertw  # here: the control processes import this module

    return float(1.0 / m + lambertw(-math.exp(-1.0 / m) / m).real)


def compute_paper_friction(
    M_e: MeasuredValue, axial_stiffness: float, length: float, stiffness_uncertainty: float
) -> MeasuredValue:
    """Return K by eq. (13) with its uncertainty; `stiffness_uncertainty` is that of EA/L over it.

    Raises
    ------
    CalibrationError
        If m is not in (0, 1).
    """
    K = compute_friction_from_elongation(M_e.value, axial_stiffness, length)
    relative = math.hypot(M_e.uncertainty / M_e.value, stiffness_uncertainty)
    slope = math.exp(-K) / -math.expm1(-K) - 1.0 / K  # d ln m / dK of m = (1 - e^-K)/K
    return MeasuredValue(K, relative / abs(slope))


# --- the slopes of a blocked-tip loop while the whole tendon slides (theory.md (T6))
# M_pull while it slides towards the motor, M_rel while it slides towards the tip. Where the
# ends of the straight parts are is known once K is.


_AVERAGES_MIN = 6
_SWING_MIN = 1.3  # ratio of tensions a straight part must span
_SLOPE_DIFFERENCE_MAX = 0.05  # by which the slope may differ between the halves of a straight part
_SIGNIFICANT_SIGMAS = 6.0  # standard uncertainties


def fit_pull_slope(loop: BlockedLoop, K: float) -> MeasuredValue:
    """Return M_pull [m/N], K being no larger than `K`.

    Raises
    ------
    CalibrationError
        If no pull shows it.
    """
    slope = _fit_common_slope(_select_sliding_pulls(loop, K))
    if slope is None:
        raise CalibrationError(
            f"no pull reaches the tension from which the whole tendon slides (K up to {K:.2f}): "
            "pull higher, or from a lower tension"
        )
    return slope


def fit_release_slope(loop: BlockedLoop, K: float) -> MeasuredValue | None:
    """Return M_rel [m/N], K being no larger than `K`; None if no release goes low enough."""
    parts = [
        (branch, float(loop.turns[number - 1]) * math.exp(-2.0 * K) > branch.T)
        for number, branch in enumerate(loop.branches)
        if not branch.pull
    ]
    return _fit_common_slope(parts)


def require_straight_pulls(loop: BlockedLoop, K: float) -> None:
    """Refuse a loop whose mobilised pulls are curved: the tip has given way.

    Raises
    ------
    CalibrationError
        If one is.
    """
    for branch, part in _select_sliding_pulls(loop, K):
        if part.sum() < 2 * _AVERAGES_MIN:
            continue
        T, q, n = branch.T[part], branch.q[part], branch.count[part]
        middle = 0.5 * (T.min() + T.max())
        low, high = (_fit_slope(T[half], q[half], n[half]) for half in (middle > T, middle <= T))
        difference = high.value - low.value
        is_significant = abs(difference) > _SIGNIFICANT_SIGMAS * math.hypot(
            low.uncertainty, high.uncertainty
        )
        if is_significant and abs(difference) > _SLOPE_DIFFERENCE_MAX * abs(low.value):
            raise CalibrationError(
                f"the pull is not straight, {low.value:.3g} m/N below and {high.value:.3g} m/N "
                f"above {middle:.3g} N: the tip gives way, or touches something soft before its "
                "stop"
            )


def _select_sliding_pulls(loop: BlockedLoop, K: float) -> list[tuple[Branch, Mask]]:
    """Return the pulls and where in them the whole tendon slides."""
    # A first pull has been cut already to what has forgotten the unknown past.
    begins = [0.0, *loop.turns.tolist()]
    return [
        (branch, begins[number] * math.exp(2.0 * K) < branch.T)
        for number, branch in enumerate(loop.branches)
        if branch.pull
    ]


def _fit_common_slope(parts: list[tuple[Branch, Mask]]) -> MeasuredValue | None:
    """Return dq/dT of all parts together, each with an offset of its own."""
    T, q, n = [], [], []
    for branch, part in parts:
        if part.sum() < 3:
            continue
        weight = branch.count[part]
        T.append(branch.T[part] - np.average(branch.T[part], weights=weight))
        q.append(branch.q[part] - np.average(branch.q[part], weights=weight))
        n.append(weight)
    used = [branch.T[part] for branch, part in parts if part.sum() >= 3]
    if sum(map(len, T)) < _AVERAGES_MIN or max(t.max() / t.min() for t in used) < _SWING_MIN:
        return None
    return _fit_line(np.concatenate(T), np.concatenate(q), np.concatenate(n), len(T))


def _fit_line(T: Array, q: Array, weight: Array, offsets: int) -> MeasuredValue:
    spread = float(weight @ T**2)
    slope = float(weight @ (T * q)) / spread
    residual = q - slope * T
    variance = float(weight @ residual**2) / max(len(T) - offsets - 1, 1)
    return MeasuredValue(slope, math.sqrt(variance / spread))


def _fit_slope(T: Array, q: Array, weight: Array) -> MeasuredValue:
    if len(T) < 3:
        return MeasuredValue(math.nan, math.inf)
    at_T, at_q = np.average(T, weights=weight), np.average(q, weights=weight)
    return _fit_line(T - at_T, q - at_q, weight, 1)


__all__ = [
    "AGREEMENT",
    "Calibration",
    "CalibrationError",
    "MeasuredValue",
    "calibrate",
    "combine_calibrations",
    "compute_friction_from_elongation",
]

AGREEMENT = 3.0
"""Standard uncertainties by which two values of K may differ and still agree."""

TOLERANCE = 0.1
"""Largest standard uncertainty of K accepted: T_out is off by the same share."""

ZERO_UNCERTAINTY = 0.02
"""Standard uncertainty [N] of a load cell's zero that nobody has stated."""

_LAW_UNCERTAINTY = 0.005  # of K that the law itself is trusted to
_DEPTH_MARGIN = 0.05  # of s that a loop must reach beyond the tip to see that it is the tip
_COMPLIANCE_MAX = 1e-3  # [m/N] 2 m of a tendon of 2 kN
# of L/EA: what stops, and joints held at theirs, yield looks like a straight end of the sheath
_BEHIND_UNCERTAINTY = 0.01
_RESIDUAL_MAX = 0.02  # of the peak: residual tension of what is a loop of dry friction at all


@dataclass(frozen=True)
class Calibration:
    """What a blocked-tip loop says about a sheath.

    Uncertainties are standard (one sigma): sensor noise, the scatter about the model, and for K and
    the stiffness which pattern it is.

    Attributes
    ----------
    K
        The friction coordinate to use, from the pattern.
    K_loop
        By the slopes, ln(M_rel/M_pull).
    K_paper
        By eq. (13) from M_pull; None without EA and L.
    K_paper_ratio
        By eq. (13) from M_e, as the paper does it; None without EA and L, or where M_e EA/L is not
        below 1.
    M_pull, M_rel
        Slopes de/dT_in of the mobilised branches [m/N]; M_rel from the pattern where no release
        goes low enough to show it.
    M_e
        Elongation over tension at the peak of the first pull, counted from the first sample [m/N].
    stiffness_per_length
        EA/L [N/m], from the pattern.
    T_peak
        Tension of the first branch change [N].
    zero
        Reading of the load cell without tension [N]; friction that does not depend on tension shows
        as a negative one (docs/explanation/theory.md, section 8).
    pattern
        How compliance is spread over friction.
    rivals
        Patterns that were weighed for it.
    compliance_noise
        Standard uncertainty of L/EA [m/N] that noise, and what yields behind the sheath of an arm,
        leave in any of them.
    misfit
        Squared residuals of the best pattern there is over those that noise would leave: 1 where
        the law says all, more where it misses something.
    uniform
        Whether the slopes agree with the pattern. Where not, the curvature is not uniform or
        friction depends on direction, and K_loop and K_paper are wrong.
    agree
        Whether all methods at hand agree. Where `uniform` and yet not, EA or L is wrong, or their
        uncertainty was not given.
    """

    K: MeasuredValue
    K_loop: MeasuredValue
    K_paper: MeasuredValue | None
    K_paper_ratio: MeasuredValue | None
    M_pull: MeasuredValue  # [m/N]
    M_rel: MeasuredValue  # [m/N]
    M_e: MeasuredValue  # [m/N]
    stiffness_per_length: MeasuredValue  # [N/m]
    T_peak: MeasuredValue  # [N]
    zero: MeasuredValue  # [N]
    pattern: Pattern
    rivals: tuple[Rival, ...]
    compliance_noise: float  # [m/N]
    misfit: float
    uniform: bool
    agree: bool

    def build_sheath(self, length: float, friction: float = 0.1) -> Sheath:
        """Return the sheath as a model, `length` [m] long; see `Pattern.build_sheath`."""
        return self.pattern.build_sheath(length, friction)


def calibrate(
    proximal_tension: ArrayLike,
    proximal_displacement: ArrayLike,
    *,
    axial_stiffness: float | None = None,
    length: float | None = None,
    stiffness_uncertainty: float = 0.0,
    zero_uncertainty: float = ZERO_UNCERTAINTY,
    tolerance: float = TOLERANCE,
    tail: Tail = NO_TAIL,
) -> Calibration:
    """Calibrate from pulls and releases with the tip blocked.

    Parameters
    ----------
    proximal_tension, proximal_displacement : array_like
        T_in [N] and q_p [m], shape (n,), in order of time: a pull to the peak from any past, a
        release to well below the peak over e^2K, and, better, a pull to the peak again (and so on).
    axial_stiffness, length : float, optional
        EA [N] and L [m]; only the paper's method needs them.
    stiffness_uncertainty : float
        Relative standard uncertainty of EA/L, for the paper's method.
    zero_uncertainty : float
        Standard uncertainty of the load cell's zero [N]. It is fitted within these bounds, since at
        the low end of the loop a hundredth of a newton is per cents.
    tolerance : float
        Largest standard uncertainty of K that is accepted.
    tail : Tail
        How the tendon goes on behind its sheath, in an arm; K, its slopes' too, and EA/L are of the
        sheath alone.

    Raises
    ------
    CalibrationError
        If the data are insufficient for a calibration.
    """
    if (axial_stiffness is None) != (length is None):
        raise CalibrationError(
            "the paper's K needs both axial_stiffness and length: give the other"
        )
    loop = segment_loop(proximal_tension, proximal_displacement)
    search = search_pattern(PatternLeastSquares(loop, zero_uncertainty, tail))
    K, pattern = search.weighed.K, search.weighed.pattern
    largest = K.value + 2.0 * K.uncertainty + max(tail.depth, default=0.0)
    _require_plausible_sheath(loop, search)
    require_straight_pulls(loop, largest)
    _require_identifiable(loop, search, tolerance)
    M_pull = fit_pull_slope(loop, largest)
    M_rel = fit_release_slope(loop, largest) or MeasuredValue(
        pattern.compute_slope(1.0, tail), K.uncertainty * pattern.compute_slope(1.0, tail)
    )
    of_sheath = [
        slope._replace(value=slope.value - pattern.compute_tail_slope(sign, tail))
        for sign, slope in ((-1.0, M_pull), (1.0, M_rel))
    ]
    K_loop = _compute_loop_friction(*of_sheath)
    M_e = _compute_elongation_constant(loop)
    K_paper = K_paper_ratio = None
    if axial_stiffness is not None and length is not None:
        K_paper = compute_paper_friction(
            of_sheath[0], axial_stiffness, length, stiffness_uncertainty
        )
        if M_e.value * axial_stiffness < length:
            K_paper_ratio = compute_paper_friction(
                M_e, axial_stiffness, length, stiffness_uncertainty
            )
    uniform = _is_consistent(K, K_loop)
    yields = _BEHIND_UNCERTAINTY * pattern.compliance if tail.share else 0.0
    compliance_noise = math.hypot(search.compliance_noise, yields)
    return Calibration(
        K=K,
        K_loop=K_loop,
        K_paper=K_paper,
        K_paper_ratio=K_paper_ratio,
        M_pull=M_pull,
        M_rel=M_rel,
        M_e=M_e,
        stiffness_per_length=_compute_stiffness(search.weighed, compliance_noise),
        T_peak=MeasuredValue(loop.peak, loop.sigma),
        zero=search.zero,
        pattern=pattern,
        rivals=search.rivals,
        compliance_noise=compliance_noise,
        misfit=search.misfit,
        uniform=uniform,
        agree=uniform and (K_paper is None or _is_consistent(K, K_paper)),
    )


def _compute_loop_friction(M_pull: MeasuredValue, M_rel: MeasuredValue) -> MeasuredValue:
    """Return K = ln(M_rel/M_pull) (T6)."""
    if not M_rel.value > M_pull.value:
        raise CalibrationError(
            f"the release slope {M_rel.value:.3g} m/N is not above the pull slope "
            f"{M_pull.value:.3g} m/N: no friction shows; check that the tip is blocked"
        )
    return MeasuredValue(
        math.log(M_rel.value / M_pull.value),
        math.hypot(M_rel.uncertainty / M_rel.value, M_pull.uncertainty / M_pull.value),
    )


def combine_calibrations(
    a: Calibration, b: Calibration, total: MeasuredValue
) -> tuple[Calibration, Calibration]:
    """Return the calibrations of two antagonists, put right by K_a + K_b.

    `total` comes from `drag`; it knows what hides at the tips, where a blocked loop tells
    little. What sets the two apart is known from their loops alone.

    Raises
    ------
    CalibrationError
        If the loops cannot be so far off.
    """
    K_a, K_b = a.K, b.K
    loops = MeasuredValue(
        K_a.value + K_b.value,
        math.hypot(
            K_a.uncertainty, K_b.uncertainty, UNMODELLED_UNCERTAINTY, UNMODELLED_UNCERTAINTY
        ),
    )
    allowed = AGREEMENT * math.hypot(total.uncertainty, loops.uncertainty)
    if abs(total.value - loops.value) > allowed:
        raise CalibrationError(
            f"K of both tendons is {total.value:.3f} by the drags, {loops.value:.3f} by the loops"
        )
    of_a, of_b = weighed_together(a.rivals, b.rivals, total)
    return _update_calibration(a, of_a), _update_calibration(b, of_b)


def _update_calibration(calibration: Calibration, weighed: ModelAverage) -> Calibration:
    """Return a calibration of which other rivals stand."""
    uniform = _is_consistent(weighed.K, calibration.K_loop)
    return replace(
        calibration,
        K=weighed.K,
        stiffness_per_length=_compute_stiffness(weighed, calibration.compliance_noise),
        pattern=weighed.pattern,
        uniform=uniform,
        agree=uniform
        and (calibration.K_paper is None or _is_consistent(weighed.K, calibration.K_paper)),
    )


def _compute_stiffness(weighed: ModelAverage, noise: float) -> MeasuredValue:
    """Return EA/L [N/m]."""
    value, spread = weighed.compliance
    return MeasuredValue(1.0 / value, math.hypot(spread, noise) / value**2)


def _compute_elongation_constant(loop: BlockedLoop) -> MeasuredValue:
    T_0 = float(loop.turns[0])
    value = loop.travel / T_0
    return MeasuredValue(value, value * math.hypot(loop.sigma / T_0, loop.step / loop.travel))


def _require_identifiable(loop: BlockedLoop, search: PatternSearchResult, tolerance: float) -> None:
    K, reach = search.weighed.K, _compute_reach(loop)
    if K.value + _DEPTH_MARGIN > reach or K.uncertainty > tolerance:
        raise CalibrationError(
            f"a loop between {loop.peak:.3g} N and {loop.peak * math.exp(-2.0 * reach):.3g} N "
            f"decides K = {K.value:.2f} only to {K.uncertainty:.2g}, its range reaching to "
            f"{reach:.2f}: release further, pull higher, or go more slowly"
        )


def _compute_reach(loop: BlockedLoop) -> float:
    """Return the s down to which the whole loop slides."""
    return 0.5 * math.log(loop.peak / max(float(loop.turns.min()), loop.slack))


def _require_plausible_sheath(loop: BlockedLoop, search: PatternSearchResult) -> None:
    compliance = search.weighed.compliance.value
    if compliance > _COMPLIANCE_MAX:
        raise CalibrationError(
            f"EA/L is {1.0 / compliance:.3g} N/m, softer than any sheath: the tip is not blocked"
        )
    if search.residual > _RESIDUAL_MAX * loop.peak:
        raise CalibrationError(
            f"no friction and no stiffness describe this loop to better than {search.residual:.2g} "
            f"N of {loop.peak:.3g} N: the tip moves, or the tension is not that of this tendon"
        )


def _is_consistent(a: MeasuredValue, b: MeasuredValue) -> bool:
    allowed = AGREEMENT * math.hypot(a.uncertainty, b.uncertainty, _LAW_UNCERTAINTY * a.value)
    return abs(a.value - b.value) <= allowed
