"""The friction of two antagonists together, from one of them drawing the other one out.

While the joint moves freely and both tendons slide along their whole length, towards the end that
is pulled, T_in,1 = e^(K1) T_out,1 and T_out,2 = e^(K2) T_in,2; and T_out,1 is T_out,2 and what the
joint itself takes, f. So (docs/explanation/theory.md (T20))

    T_in,2 = e^-(K1 + K2) T_in,1 - e^-K2 f,

and the slope says K1 + K2: for any curvature, wherever it is along the sheath, and for any friction
and spring of the joint that the tensions do not change.
"""

import math

import numpy as np

from estimator.array_types import Array
from estimator.calibration.blocked_loop import CalibrationError
from estimator.fitting import MeasuredValue
from estimator.noise_treatment import estimate_noise_sigma

_MIN_SHARE = 0.3  # of the highest tension; above it the pull has wiped out what was before
_MIN_SAMPLES = 100
_LAW_UNCERTAINTY = 0.003  # of K1 + K2 that the law itself is trusted to
_RESIDUAL_SIGMAS = 2.0  # times the noise: residuals that are no noise
_RESIDUAL_SHARE = 0.01  # of the highest tension of the tendon drawn out, and so much more


def fit_friction_sum(pulled: Array, drawn: Array, travel: Array) -> MeasuredValue:
    """Return K1 + K2 from a drag in which both tensions rise and fall.

    The tension of the tendon drawn out is fitted by that of the one pulled, which has the smaller
    relative noise, and by the joint's travel, for a spring at the joint.

    Parameters
    ----------
    pulled, drawn : ndarray
        T_in of the tendon that is pulled, and of the one drawn out [N], shape (n,).
    travel : ndarray
        Of the joint [m], shape (n,).

    Raises
    ------
    CalibrationError
        If the tensions are not such.
    """
    if len(pulled) < _MIN_SAMPLES:
        raise CalibrationError(f"{len(pulled)} samples of a drag, {_MIN_SAMPLES} are needed")
    high = np.flatnonzero(pulled > _MIN_SHARE * pulled.max())
    rows = slice(int(high[0]), int(high[-1]) + 1)
    T, q, drawn = pulled[rows], travel[rows], drawn[rows]
    noise = estimate_noise_sigma(drawn)
    columns = np.column_stack([T, q - q.mean(), np.ones_like(T)])
    fit, *_ = np.linalg.lstsq(columns, drawn, rcond=None)
    slope = float(fit[0])
    if not 0.0 < slope <= 1.0:
        raise CalibrationError(f"the tendon drawn out has {slope:.3g} of the change of tension")
    residual = float(np.std(drawn - columns @ fit))
    if residual > _RESIDUAL_SIGMAS * noise + _RESIDUAL_SHARE * float(drawn.max()):
        raise CalibrationError(
            f"the tensions of a drag are {residual:.2g} N from a straight line: one tendon does "
            "not slide, or the joint is not free"
        )
    variance = np.linalg.pinv(columns.T @ columns)[0, 0]
    uncertainty = max(residual, noise) * math.sqrt(float(variance)) / slope
    return MeasuredValue(-math.log(slope), math.hypot(uncertainty, _LAW_UNCERTAINTY))
