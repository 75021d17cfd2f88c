"""The slopes of a blocked-tip loop while the whole tendon slides (docs/theory.md (T6)).

M_pull while it slides towards the motor, M_rel while it slides towards the tip. Where the ends of
the straight parts are is known once K is.
"""

import math

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.calibration.blocked_loop import BlockedLoop, Branch
from estimator.calibration.measured import CalibrationError, MeasuredValue

_LEAST_AVERAGES = 6
_LEAST_SWING = 1.3  # ratio of tensions a straight part must span
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
        if part.sum() < 2 * _LEAST_AVERAGES:
            continue
        T, q, n = branch.T[part], branch.q[part], branch.count[part]
        middle = 0.5 * (T.min() + T.max())
        low, high = (_fit_slope(T[half], q[half], n[half]) for half in (middle > T, middle <= T))
        off = high.value - low.value
        sure = abs(off) > _SIGNIFICANT_SIGMAS * math.hypot(low.uncertainty, high.uncertainty)
        if sure and abs(off) > _SLOPE_DIFFERENCE_MAX * abs(low.value):
            raise CalibrationError(
                f"the pull is not straight, {low.value:.3g} m/N below and {high.value:.3g} m/N "
                f"above {middle:.3g} N: the tip gives way, or touches something soft before its "
                "stop"
            )


def _select_sliding_pulls(loop: BlockedLoop, K: float) -> list[tuple[Branch, NDArray[np.bool_]]]:
    """Return the pulls and where in them the whole tendon slides."""
    # A first pull has been cut already to what has forgotten the unknown past.
    before = [0.0, *loop.turns.tolist()]
    return [
        (branch, before[number] * math.exp(2.0 * K) < branch.T)
        for number, branch in enumerate(loop.branches)
        if branch.pull
    ]


def _fit_common_slope(parts: list[tuple[Branch, NDArray[np.bool_]]]) -> MeasuredValue | None:
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
    if sum(map(len, T)) < _LEAST_AVERAGES or max(t.max() / t.min() for t in used) < _LEAST_SWING:
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
