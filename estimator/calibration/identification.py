"""Identification by re-simulation: the parameters with which the law reproduces a record.

The whole record is simulated for every trial, so the memory is right at every sample and nothing is
regressed on a residual. Two fits of the symmetric, uniform law (docs/explanation/theory.md (T11),
(T13)):

* `fit_bench`: K from both tensions, as a calibration bench measures them;
* `fit_blocked_tip`: K and EA from tension and travel at the housing, the tip blocked.

The record must start slack; one that starts otherwise is right from its first swing of e^2K on.
Noise of T_in moves K by some tenths of a per cent (section 9), which the intervals do not hold.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.calibration.blocked_loop import validate_signals
from estimator.fitting import (
    COVERAGE_FACTOR,
    IntervalEstimate,
    build_interval,
    compute_residual_variance,
    estimate_correlation,
)
from estimator.law.sheath import Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions

STARTS = (0.1, 0.3, 0.6, 1.0, 1.5, 2.2)
"""Values of K from which the search is begun; the cost has more than one local minimum."""

RMSE_SHARE_MAX = 0.05
"""Share of the signal's peak the RMSE may be for the fit to be accepted."""

_K_MAX = 4.0
_SAMPLES_MIN = 50


class IdentificationError(ValueError):
    """A record that cannot be fitted; the message says what is missing and what to do."""


@dataclass(frozen=True)
class FitResult:
    """What a fit found, and whether to accept it."""

    parameters: dict[str, IntervalEstimate]  # "K" [-]; "axial_stiffness" [N] where travel is fitted
    rmse: float  # root mean square of the residuals, in the unit of the signal
    residuals: Array  # measured less simulated, shape (n,)
    n: int  # number of samples
    identifiable: bool  # whether the record decides K at all
    accept: bool  # whether the law describes the record
    reason: str  # one line that justifies `accept`


def fit_bench(proximal_tension: ArrayLike, distal_tension: ArrayLike) -> FitResult:
    """Fit K to the tension measured at both ends.

    Parameters
    ----------
    proximal_tension, distal_tension : array_like
        T_in and T_out [N], shape (n,), in order of time.

    Raises
    ------
    IdentificationError
        If the record cannot be fitted.
    """
    T_in, T_out = _validate_signals(proximal_tension, distal_tension)
    if np.mean(T_out) > np.mean(T_in):
        raise IdentificationError(
            "the tip pulls harder than the housing, on the whole: are the two columns swapped?"
        )

    def residual(K: float) -> Array:
        return T_out - _simulate(T_in, K)[0]

    K = _search_friction(lambda K: float(np.sum(residual(K) ** 2)))
    at_best = residual(K)
    slope = (residual(K * (1.0 + 1e-3)) - residual(K * (1.0 - 1e-3)))[:, None] / (2e-3 * K)
    covariance = _compute_covariance(slope, at_best)
    identifiable, accept, reason = _judge_fit(T_in, T_out, at_best, K)
    parameters = {"K": _compute_interval(K, covariance[0, 0])}
    return FitResult(
        parameters, _compute_rms(at_best), at_best, len(T_in), identifiable, accept, reason
    )


def fit_blocked_tip(
    proximal_tension: ArrayLike, proximal_displacement: ArrayLike, length: float
) -> FitResult:
    """Fit K and EA to tension and travel at the housing while the tip is blocked.

    Travel is elongation up to a constant, which is fitted too: e = L/EA times a shape that K alone
    decides, so only K is searched.

    Parameters
    ----------
    proximal_tension, proximal_displacement : array_like
        T_in [N] and q_p [m], shape (n,), in order of time.
    length : float
        L [m].

    Raises
    ------
    IdentificationError
        If the record cannot be fitted.
    """
    T_in, q = _validate_signals(proximal_tension, proximal_displacement)

    def shape(K: float) -> tuple[Array, float, Array]:
        stretch = _simulate(T_in, K)[1]
        centred = stretch - stretch.mean()
        compliance = float(centred @ q) / float(centred @ centred)
        return centred, compliance, q - q.mean() - compliance * centred

    K = _search_friction(lambda K: float(np.sum(shape(K)[2] ** 2)))
    centred, compliance, at_best = shape(K)
    if not compliance > 0.0:
        raise IdentificationError("travel falls while tension rises: check the sign of the encoder")
    EA = length / compliance
    by_K = (shape(K * (1.0 + 1e-3))[0] - shape(K * (1.0 - 1e-3))[0]) * compliance / (2e-3 * K)
    covariance = _compute_covariance(np.column_stack([by_K, centred * compliance]), at_best)
    identifiable, accept, reason = _judge_fit(T_in, q - q.min(), at_best, K)
    parameters = {
        "K": _compute_interval(K, covariance[0, 0]),
        "axial_stiffness": _compute_interval(EA, covariance[1, 1] * EA**2),
    }
    return FitResult(
        parameters, _compute_rms(at_best), at_best, len(T_in), identifiable, accept, reason
    )


def _validate_signals(tension: ArrayLike, signal_values: ArrayLike) -> tuple[Array, Array]:
    T, signal = validate_signals(tension, signal_values, _SAMPLES_MIN, IdentificationError)
    if not (np.ptp(T) > 0.0 and np.ptp(signal) > 0.0):
        raise IdentificationError("a signal never changes: record while pulling and releasing")
    return T, signal


def _simulate(T_in: Array, K: float) -> tuple[Array, Array]:
    """Return T_out [N] and the elongation of a tendon of L/EA = 1 m/N, from slack."""
    table = build_tables(Sheath.uniform(K, 1.0, 1.0))
    return simulate_tensions(table, build_slack_profile(table), T_in)


def _search_friction(cost: Callable[[float], float]) -> float:
    """Return the K of least cost, each start searched between its neighbours."""
    from scipy.optimize import minimize_scalar  # here: a command's help needs no scipy

    edges = (1e-3, *STARTS, _K_MAX)
    minima = [
        minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
        for low, high in zip(edges[:-2], edges[2:], strict=True)
    ]
    return float(min(minima, key=lambda minimum: float(minimum.fun)).x)


def _compute_covariance(slopes: Array, residuals: Array) -> Array:
    """Return the covariance of least squares, residuals counted as the fewer they amount to."""
    variance = compute_residual_variance(
        residuals, len(residuals) - slopes.shape[1] - 1, estimate_correlation(residuals)
    )
    return np.asarray(np.linalg.pinv(slopes.T @ slopes) * variance)


def _compute_interval(value: float, variance: float) -> IntervalEstimate:
    return build_interval(value, COVERAGE_FACTOR * math.sqrt(max(variance, 0.0)), 0.0)


def _compute_rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))


def _judge_fit(T_in: Array, signal: Array, residuals: Array, K: float) -> tuple[bool, bool, str]:
    if K > 0.99 * _K_MAX or K < 2e-3:
        return False, False, f"K = {K:.3g} is the end of the search: the record does not decide it"
    if T_in.max() < math.exp(2.0 * K) * max(float(T_in.min()), 1e-3 * float(T_in.max())):
        return False, False, "tension never swings by e^2K: the start of the record decides the fit"
    share = _compute_rms(residuals) / float(np.abs(signal).max())
    reason = f"residual is {share:.1%} of the peak"
    if share > RMSE_SHARE_MAX:
        reason += f", more than {RMSE_SHARE_MAX:.0%}: the symmetric law misses something"
    return True, share <= RMSE_SHARE_MAX, reason
