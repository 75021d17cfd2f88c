"""Fits by re-simulation: bounded least squares, derivatives, and intervals of what they find.

All of a record is simulated for every trial, so its memory is right at every sample. Here is what
diagnosis, pair and calibration have in common.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

COVERAGE_FACTOR = 1.96
"""Standard deviations of a normal distribution on each side of 95 %."""

TRUST_RATIO = 0.5
"""Share of a predicted decrease of the cost at which derivatives are kept for the next step."""


# --- bounded least squares


def move_inside_bounds(values: Array, low: Array, high: Array, margin: float) -> Array:
    """Return values at a distance from their bounds of at least `margin`, shapes (p,)."""
    return np.clip(values, low + margin, high - margin)


class LeastSquaresSolution(NamedTuple):
    """What least squares found."""

    values: Array  # shape (p,)
    residual: Array  # there, shape (n,)
    jacobian: Array  # of the residual there, shape (n, p)

    @property
    def cost(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)


def minimise_squares(
    residual: Callable[[Array], Array],
    start: Array,
    low: Array | float = -math.inf,
    high: Array | float = math.inf,
    **options: Any,
) -> LeastSquaresSolution:
    """Return the values within bounds with the least sum of squared residuals near `start`.

    Trust-region reflective (Branch, Coleman, Li, SIAM J. Sci. Comput. 21, 1999).

    Parameters
    ----------
    residual : callable
        Of values, shape (p,), to residuals, shape (n,).
    start : ndarray
        Where the search begins, shape (p,), within the bounds.
    low, high : ndarray or float
        Bounds, shape (p,) or one for all.
    **options
        Derivatives, scales and tolerances, as of `scipy.optimize.least_squares`.
    """
    from scipy.optimize import least_squares  # here: the control processes import this module

    solution = least_squares(residual, start, bounds=(low, high), **options)
    return LeastSquaresSolution(np.asarray(solution.x), solution.fun, solution.jac)


def compute_forward_differences(
    evaluate: Callable[[Array], Array], x: Array, residual: Array, step: float, high: Array
) -> Array:
    """Return the derivatives of a residual at `x`, where it is `residual`, shape (n, p).

    One evaluation per parameter, a step up, or down where that would exceed `high`.
    """
    columns = []
    for i in range(len(x)):
        h = step if x[i] + step < high[i] else -step
        shifted = x.copy()
        shifted[i] += h
        columns.append((evaluate(shifted) - residual) / h)
    return np.column_stack(columns)


def compute_central_differences(
    evaluate: Callable[[Array], Array], x: Array, steps: Array
) -> Array:
    """Return the derivatives of a function at `x`, shape (n, p); `steps` by parameter, (p,)."""
    return np.column_stack(
        [(evaluate(x + h) - evaluate(x - h)) / (2.0 * float(h.sum())) for h in np.diag(steps)]
    )


class BroydenJacobian:
    """Derivatives of a residual along a descent.

    From one accepted step to the next they are updated by the change of the residual (Broyden,
    Math. Comput. 19, 1965), which costs nothing. Where they predicted a step badly they are
    computed anew, by one evaluation per parameter.

    Parameters
    ----------
    evaluate : callable
        Of values, shape (p,), to residuals, shape (n,).
    step : float
        Of each value, for differences.
    high : ndarray
        Upper bounds, shape (p,).
    first : ndarray, optional
        Derivatives where the descent begins, if they are known, shape (n, p).
    """

    def __init__(
        self,
        evaluate: Callable[[Array], Array],
        step: float,
        high: Array,
        first: Array | None = None,
    ) -> None:
        self._evaluate, self._step, self._high = evaluate, step, high
        self._first = first
        # of the last evaluation: derivatives are asked for there next
        self._evaluated: tuple[bytes, Array] = (b"", np.empty(0))
        self._x, self._r, self._J = np.empty(0), np.empty(0), np.empty((0, 0))

    def compute_residual(self, x: Array) -> Array:
        """Return the residual at `x`."""
        r = self._evaluate(x)
        self._evaluated = (x.tobytes(), r)
        return r

    def __call__(self, x: Array) -> Array:
        """Return the derivatives at `x`, shape (n, p)."""
        key, r = self._evaluated
        if key != x.tobytes():
            r = self._evaluate(x)
        if len(self._x):
            self._J = self._update(x, r)
        else:
            self._J = self._compute(x, r) if self._first is None else self._first
        self._x, self._r = x.copy(), r
        return self._J

    def _compute(self, x: Array, r: Array) -> Array:
        return compute_forward_differences(self._evaluate, x, r, self._step, self._high)

    def _update(self, x: Array, r: Array) -> Array:
        step = x - self._x
        predicted = self._r + self._J @ step
        cost_before = float(self._r @ self._r)
        cost_decrease = cost_before - float(r @ r)
        expected_decrease = cost_before - float(predicted @ predicted)
        if not cost_decrease > TRUST_RATIO * expected_decrease or not step.any():
            return self._compute(x, r)
        correction: Array = np.outer(r - predicted, step / float(step @ step))
        return self._J + correction


# --- autocorrelation: how many independent samples a residual amounts to
# Neighbouring residuals of a hysteresis model repeat each other. With their correlation r from one
# sample to the next (a first-order autoregressive process), n of them carry what n (1 - r)/(1 + r)
# independent ones would (Bartlett, J. R. Stat. Soc. Suppl. 8, 1946).

CORRELATION_MAX = 0.9999
"""Largest correlation from one sample to the next: one sample in 20 000 stays independent."""


WINDOW_TIMES = 5.0  # integrated autocorrelations, up to which one is summed
LAG_DIVISOR = 6  # of a residual's length, the longest lag


def estimate_correlation(
    residual: Array, *, centred: bool = True, correlation_max: float = CORRELATION_MAX
) -> float:
    """Return the correlation of a residual from one sample to the next, from 0 to a bound.

    Parameters
    ----------
    residual : ndarray
        Shape (n,), in order of time.
    centred : bool
        Take off the mean, as of a residual of one channel. False where residuals of several
        channels are in one row: what has a mean in one of them is an error that lasts.
    """
    centred_residual = residual - residual.mean() if centred else residual
    power = float(centred_residual @ centred_residual)
    r = float(centred_residual[1:] @ centred_residual[:-1]) / power if power > 0.0 else 0.0
    return min(max(r, 0.0), correlation_max)


def compute_correlation_time(residual: Array) -> float:
    """Return over how many samples a residual remembers: its integrated autocorrelation, 1 or more.

    Up to a lag of `WINDOW_TIMES` of it (Sokal, in Functional Integration, 1997).
    """
    n = len(residual)
    spectrum = np.fft.rfft(residual - residual.mean(), 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: max(n // LAG_DIVISOR, 1)]
    if not covariance[0] > 0.0:
        return 1.0
    times = 2.0 * np.cumsum(covariance) / covariance[0] - 1.0
    is_window = np.arange(len(times)) >= WINDOW_TIMES * times
    return max(float(times[np.argmax(is_window) if is_window.any() else -1]), 1.0)


def compute_independent_share(correlation: float) -> float:
    """Return the share of samples that are independent of the others."""
    return (1.0 - correlation) / (1.0 + correlation)


def compute_residual_variance(residual: Array, degrees: int, correlation: float) -> float:
    """Return the variance of a fit's residual, larger as fewer of its samples are independent.

    `degrees` of freedom are what parameters leave of its samples, at least 1.
    """
    power = float(residual @ residual)
    return power / max(degrees, 1) * (1.0 + correlation) / (1.0 - correlation)


def compute_clustered_errors(jacobian: Array, residual: Array, groups: NDArray[np.intp]) -> Array:
    """Return standard uncertainties that allow for errors which last a whole group, shape (p,).

    The sandwich (J'J)^-1 (sum over groups of J_g' r_g r_g' J_g) (J'J)^-1 (Liang and Zeger,
    Biometrika 73, 1986): residuals are a model's, not noise, and thousands of samples are no
    thousands of measurements.

    Parameters
    ----------
    jacobian, residual : ndarray
        Of a fit, shapes (n, p) and (n,).
    groups : ndarray
        Number of the group of each residual, from 0, shape (n,).
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    count = int(groups.max()) + 1
    scores = np.array([jacobian[groups == g].T @ residual[groups == g] for g in range(count)])
    correction = count / max(count - jacobian.shape[1], 1)
    errors: Array = np.sqrt(correction * np.diag(inverse @ (scores.T @ scores) @ inverse))
    return errors


# --- intervals


class IntervalEstimate(NamedTuple):
    """A fitted value and its 95 % interval."""

    value: float
    low: float
    high: float


def build_interval(value: float, half_width: float, low_min: float = -math.inf) -> IntervalEstimate:
    """Return a value with an interval to both sides, cut at the least that it can be."""
    return IntervalEstimate(value, max(value - half_width, low_min), value + half_width)


class MeasuredValue(NamedTuple):
    """A value and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float
