"""Calibration of a sheath from one pull-release loop with the tip blocked.

The housing alone carries the answer: with the tip blocked the travel of the motor is elongation, so
the slope of travel over tension is M_pull while the whole tendon slides towards the motor and M_rel
while all of it slides towards the tip (docs/theory.md (T6)). Three ways lead from the loop to K:

* ``loop``: K = ln(M_rel/M_pull), right for a uniformly curved sheath, needs no EA and no L;
* ``branch``: K = ½ ln(T_0/T_k), T_k being the tension at which the unloading curve becomes
  straight (T7), right for any sheath, to some 5 % where the curvature is far from uniform;
* ``paper``: K from M_pull by Phee et al. 2009, eq. (13), solved in closed form (T8), needs EA and
  L, right for a uniformly curved sheath, and their errors grow 2 to 3.5 times.

Where the first two disagree the sheath is not uniformly curved, or friction depends on direction.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import median_filter
from scipy.optimize import nnls
from scipy.special import lambertw

from estimator.signals import noise_sigma

Array = NDArray[np.float64]

LEAST_SAMPLES = 20
"""Samples a branch needs for a slope with an honest uncertainty."""

AGREEMENT = 3.0
"""Standard uncertainties by which two values of K may differ and still agree."""

_BELOW_PEAK = 0.97  # of T_0: where the pull branch is taken to end
_COARSE, _FINE = 4, (12, 14, 16)  # steps of the curvature pattern the branch method leaves free
_PATTERN_ERROR = 0.05  # of K: what equal steps cost on sheaths of two and three bends, measured
_LEAST_SHARE = 0.15  # of the mean compliance of a step that every step has
_AS_GOOD = 1.5  # ratio of squared residuals between fits that the data do not tell apart
_SMOOTHED = 9  # samples
_LEAST_SWING = 1.3  # ratio of tensions a mobilised branch must span to show that it is straight
_K_GRID = np.geomspace(0.05, 4.0, 80)
_TOE = 0.02  # of the peak: below it slack and take-up, not friction, shape the loop


class CalibrationError(ValueError):
    """Data that cannot carry a calibration; the message says what is missing and what to do."""


class Measured(NamedTuple):
    """A value and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float


@dataclass(frozen=True)
class Calibration:
    """What one pull-release loop says about a sheath.

    Uncertainties are standard (one sigma) and come from linearised least squares with the scatter
    of the residuals, so sensor noise is in them and model error is not. ``K_paper`` is None
    without EA and L.

    Attributes
    ----------
    K
        The friction coordinate to use: ``K_loop`` where ``uniform``, else ``K_branch``.
    K_loop, K_branch, K_paper
        By the three methods of this module.
    M_pull, M_rel
        Slopes de/dT_in of the mobilised branches [m/N].
    stiffness_per_length
        EA/L [N/m], by the uniform law where ``uniform``, else from the pattern fitted.
    T_peak
        Tension of the branch change T_0 [N].
    uniform
        Whether ``K_loop`` and ``K_branch`` agree. Where not, the curvature is far from uniform or
        friction depends on direction, and ``K_loop`` and ``K_paper`` are wrong.
    agree
        Whether all methods at hand agree. Where ``uniform`` and yet not, EA or L is wrong, or their
        uncertainty was not given.
    """

    K: Measured
    K_loop: Measured
    K_branch: Measured
    K_paper: Measured | None
    M_pull: Measured  # [m/N]
    M_rel: Measured  # [m/N]
    stiffness_per_length: Measured  # [N/m]
    T_peak: Measured  # [N]
    uniform: bool
    agree: bool


def friction_from_elongation(M_e: float, axial_stiffness: float, length: float) -> float:
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
    return float(1.0 / m + lambertw(-math.exp(-1.0 / m) / m).real)


def calibrate(
    proximal_tension: ArrayLike,
    proximal_displacement: ArrayLike,
    *,
    axial_stiffness: float | None = None,
    length: float | None = None,
    stiffness_uncertainty: float = 0.0,
) -> Calibration:
    """Calibrate from one pull-release loop with the tip blocked.

    Parameters
    ----------
    proximal_tension, proximal_displacement : array_like
        T_in [N] and q_p [m], shape (n,), in order of time: a pull from slack (or from a low tension
        after a release) to one peak, and a release to well below the peak over e^2K.
    axial_stiffness, length : float, optional
        EA [N] and L [m]; only the paper's method needs them.
    stiffness_uncertainty : float
        Relative standard uncertainty of EA/L, for the paper's method.

    Raises
    ------
    CalibrationError
        If the data cannot carry it.
    """
    T, q = _checked(proximal_tension, proximal_displacement)
    if (axial_stiffness is None) != (length is None):
        raise CalibrationError(
            "the paper's K needs both axial_stiffness and length: give the other"
        )
    peak = int(np.argmax(median_filter(T, _SMOOTHED, mode="nearest")))
    _require_loop(T, q, peak)
    start = float(np.median(T[: max(3, peak // 50)]))

    rise, fall = slice(0, peak + 1), slice(peak, len(T))
    T_0 = _peak_tension(T[rise], q[rise])
    branch = _branch_change(T[fall], q[fall], T_0, _COARSE)
    K_b = branch.K.value
    floor = _TOE * T_0.value

    pull_from = max(floor, start * math.exp(2.0 * K_b) if start > floor else 0.0)
    M_pull = _slope(
        T[rise], q[rise], pull_from, _BELOW_PEAK * T_0.value, "pull: start it from slack"
    )
    release_to = T_0.value * math.exp(-2.0 * (K_b + 2.0 * branch.K.uncertainty))
    M_rel = _slope(
        T[fall][::-1], q[fall][::-1], floor, release_to, "release: let go to slack, and slowly"
    )
    if not M_rel.value > M_pull.value:
        raise CalibrationError(
            f"the release slope {M_rel.value:.3g} m/N is not above the pull slope "
            f"{M_pull.value:.3g} m/N: no friction shows; check that the tip is blocked"
        )
    K_loop = Measured(
        math.log(M_rel.value / M_pull.value),
        math.hypot(M_rel.uncertainty / M_rel.value, M_pull.uncertainty / M_pull.value),
    )
    K_paper = None
    uniform = _agree(K_loop, branch.K)
    if not uniform:
        branch = _branch_change_fine(T[fall], q[fall], T_0)
    if axial_stiffness is not None and length is not None:
        K_paper = _paper(M_pull, axial_stiffness, length, stiffness_uncertainty)
    agree = uniform and (K_paper is None or _agree(K_loop, K_paper))
    if uniform:
        K, stiffness = K_loop, _uniform_stiffness(M_pull, M_rel, K_loop)
    else:
        K, stiffness = branch.K, branch.stiffness
    return Calibration(K, K_loop, branch.K, K_paper, M_pull, M_rel, stiffness, T_0, uniform, agree)


class _Branch(NamedTuple):
    K: Measured
    stiffness: Measured  # EA/L [N/m]


def _checked(tension: ArrayLike, displacement: ArrayLike) -> tuple[Array, Array]:
    T = np.asarray(tension, dtype=np.float64)
    q = np.asarray(displacement, dtype=np.float64)
    if T.ndim != 1 or T.shape != q.shape:
        raise CalibrationError(
            f"tension {T.shape} and displacement {q.shape}: give two rows of equal length"
        )
    if len(T) < 2 * LEAST_SAMPLES:
        raise CalibrationError(
            f"{len(T)} samples, at least {2 * LEAST_SAMPLES} are needed: record more densely"
        )
    bad = ~(np.isfinite(T) & np.isfinite(q))
    if bad.any():
        raise CalibrationError(
            f"{int(bad.sum())} samples are not finite, the first at index {int(bad.argmax())}: "
            "remove them"
        )
    return T, q


def _require_loop(T: Array, q: Array, peak: int) -> None:
    swing = float(np.ptp(T))
    if peak < LEAST_SAMPLES:
        raise CalibrationError("no pull before the release: record the loop from before the pull")
    if len(T) - peak < LEAST_SAMPLES or T[peak] - T[peak:].min() < 0.1 * swing:
        raise CalibrationError("no release after the pull: record the loop to the end")
    if not np.ptp(q) > 0.0 or not swing > 0.0:
        raise CalibrationError("nothing moves: pull the tendon against the blocked tip")


def _peak_tension(T: Array, q: Array) -> Measured:
    """Return T_0: the pull branch near its end, read at the largest displacement.

    The largest sample of T would be high by some three sigma of its noise.
    """
    near = (T - 0.7 * T.max() > 0.0) & (T - _BELOW_PEAK * T.max() < 0.0)
    if near.sum() < 4:
        raise CalibrationError(
            "too little of the pull: record it from slack to the peak, slowly or more densely"
        )
    noise = noise_sigma(q)
    line, covariance = _line(q[near] - q.max(), T[near])
    return Measured(float(line[0]), math.hypot(math.sqrt(covariance[0, 0]), 2.0 * noise * line[1]))


def _line(x: Array, y: Array) -> tuple[Array, Array]:
    """Return (intercept, slope) of y over x by least squares, and their covariance."""
    A = np.column_stack([np.ones_like(x), x])
    solution, *_ = np.linalg.lstsq(A, y, rcond=None)
    residual = y - A @ solution
    covariance = np.linalg.inv(A.T @ A) * float(residual @ residual) / (len(x) - 2)
    return np.asarray(solution), np.asarray(covariance)


def _slope(T: Array, q: Array, low: float, high: float, remedy: str) -> Measured:
    # One stretch of time, its ends found on a smoothed tension: choosing single samples by their
    # noise would tilt the line.
    smooth = median_filter(T, _SMOOTHED, mode="nearest")
    last = int(np.argmax(smooth >= high)) or len(T)
    inside = slice(int(np.argmax(smooth >= low)), last)
    if len(T[inside]) < LEAST_SAMPLES or high < _LEAST_SWING * low:
        raise CalibrationError(
            f"no mobilised branch between {low:.3g} N and {high:.3g} N in the {remedy}"
        )
    line, covariance = _line(T[inside], q[inside])
    return Measured(float(line[1]), math.sqrt(covariance[1, 1]))


def _branch_change(T: Array, q: Array, T_0: Measured, steps: int) -> _Branch:
    """Fit K to the unloading curve, the curvature pattern left free (T7).

    With the profile T(s) = min(T_in e^s, T_0 e^-s) the travel is linear in the compliance of each
    of `steps` equal steps of s, whatever their pattern, so K is the only parameter to search.
    """
    T_in = np.clip(T, 0.0, T_0.value)
    cost = np.array([_unloading(T_in, q, T_0.value, K, steps)[0] for K in _K_GRID])
    # A larger K with next to no compliance in its last steps fits nearly as well.
    good = cost < _AS_GOOD * cost.min()
    good[:-1] &= cost[:-1] <= cost[1:]
    k = int(np.argmax(good))
    if k == len(_K_GRID) - 1:
        raise _not_mobilised(T_in, T_0.value)
    lo, hi = math.log(_K_GRID[max(k - 1, 0)]), math.log(_K_GRID[k + 1])
    for _ in range(40):
        third = (hi - lo) / 3.0
        left = _unloading(T_in, q, T_0.value, math.exp(lo + third), steps)[0]
        right = _unloading(T_in, q, T_0.value, math.exp(hi - third), steps)[0]
        lo, hi = (lo, hi - third) if left < right else (lo + third, hi)
    K = math.exp(0.5 * (lo + hi))
    if T_0.value * math.exp(-2.0 * K) < _LEAST_SWING * max(float(T_in.min()), _TOE * T_0.value):
        raise _not_mobilised(T_in, T_0.value)
    _, free, w = _unloading(T_in, q, T_0.value, K, steps)
    h = 1e-4
    # The compliance is split afresh at each K, so the derivative holds the pattern in s/K.
    tilt = (
        (
            _patterns(T_in, T_0.value, K * (1 + h), steps)[:, free]
            - _patterns(T_in, T_0.value, K * (1 - h), steps)[:, free]
        )
        @ w
        / (2.0 * h * K)
    )
    A = np.column_stack([_patterns(T_in, T_0.value, K, steps)[:, free], np.ones_like(T_in), tilt])
    residual = q - q.mean() - (A[:, :-2] - A[:, :-2].mean(axis=0)) @ w
    scale = np.linalg.norm(A, axis=0)
    inverse = np.linalg.pinv((A / scale).T @ (A / scale))
    # The tension's noise weighs with the slope, which grows along the curve: a sandwich covariance.
    middle = ((A / scale) * residual[:, None] ** 2).T @ (A / scale)
    covariance = inverse @ middle @ inverse / np.outer(scale, scale)
    u_K = math.hypot(math.sqrt(covariance[-1, -1]), 0.5 * T_0.uncertainty / T_0.value)
    ones = np.zeros(A.shape[1])
    share = (1.0 + _LEAST_SHARE) / steps
    ones[: int(free.sum())] = K * share
    ones[-1] = float(w.sum()) * share
    compliance = float(w.sum()) * K * share  # L/EA
    u_compliance = math.sqrt(float(ones @ covariance @ ones))
    return _Branch(Measured(K, u_K), Measured(1.0 / compliance, u_compliance / compliance**2))


def _branch_change_fine(T: Array, q: Array, T_0: Measured) -> _Branch:
    """Fit K with finer patterns, and count what depends on the fineness as uncertainty."""
    fits = [_branch_change(T, q, T_0, steps) for steps in _FINE]
    K = _pooled([fit.K for fit in fits])
    stiffness = _pooled([fit.stiffness for fit in fits])
    return _Branch(
        Measured(K.value, math.hypot(K.uncertainty, _PATTERN_ERROR * K.value)), stiffness
    )


def _pooled(fits: list[Measured]) -> Measured:
    values = np.array([fit.value for fit in fits])
    within = float(np.mean([fit.uncertainty for fit in fits]))
    return Measured(float(values.mean()), math.hypot(within, float(values.std())))


def _not_mobilised(T: Array, T_0: float) -> CalibrationError:
    return CalibrationError(
        f"the release from {T_0:.3g} N to {max(float(T.min()), 0.0):.3g} N ends before the whole "
        "tendon slides back, which takes a ratio of e^2K: release to slack"
    )


def _patterns(T: Array, T_0: float, K: float, steps: int) -> Array:
    """Return `_basis` for patterns of which no step is without compliance, shape (n, steps).

    A last step of none at all would fit as well at any larger K.
    """
    basis = _basis(T, T_0, K, steps)
    return np.asarray(basis + _LEAST_SHARE / steps * basis.sum(axis=1, keepdims=True))


def _basis(T: Array, T_0: float, K: float, steps: int) -> Array:
    """Return ∫ T(s) ds over each of the equal steps of s while unloading, shape (n, steps)."""
    edges = np.linspace(0.0, K, steps + 1)
    front = 0.5 * np.log(T_0 / np.maximum(T, 1e-9))
    inner = np.minimum(edges[None, :], np.maximum(front, 0.0)[:, None])
    outer = np.maximum(edges[None, :], np.maximum(front, 0.0)[:, None])
    rising = np.diff(np.exp(inner), axis=1) * T[:, None]
    falling = -np.diff(np.exp(-outer), axis=1) * T_0
    return np.asarray(rising + falling)


def _unloading(
    T: Array, q: Array, T_0: float, K: float, steps: int
) -> tuple[float, NDArray[np.bool_], Array]:
    """Return the squared residual of the best pattern at `K`, which steps are in it, and them."""
    basis = _patterns(T, T_0, K, steps)
    centred = basis - basis.mean(axis=0)
    target = q - q.mean()
    scale = float(np.abs(centred).max())
    w, norm = nnls(centred / scale, target)
    free = w > 0.0
    return float(norm**2), free, w[free] / scale


def _paper(M_pull: Measured, EA: float, length: float, stiffness_uncertainty: float) -> Measured:
    K = friction_from_elongation(M_pull.value, EA, length)
    relative = math.hypot(M_pull.uncertainty / M_pull.value, stiffness_uncertainty)
    # d ln m / dK of m = (1 - e^-K)/K
    slope = math.exp(-K) / -math.expm1(-K) - 1.0 / K
    return Measured(K, relative / abs(slope))


def _uniform_stiffness(M_pull: Measured, M_rel: Measured, K: Measured) -> Measured:
    """Return EA/L = (1 - e^-K)/(K M_pull) with K = ln(M_rel/M_pull) (T6)."""
    k = K.value
    value = -math.expm1(-k) / (k * M_pull.value)
    by_K = math.exp(-k) / -math.expm1(-k) - 1.0 / k  # d ln value / dK
    relative = math.hypot(
        by_K * M_rel.uncertainty / M_rel.value, (1.0 + by_K) * M_pull.uncertainty / M_pull.value
    )
    return Measured(value, relative * value)


def _agree(a: Measured, b: Measured) -> bool:
    return abs(a.value - b.value) <= AGREEMENT * math.hypot(a.uncertainty, b.uncertainty)
