"""The calibration of Phee et al. 2009: K from the elongation constant of the pull, eq. (13).

It needs EA and L beforehand, holds for a uniformly curved sheath, and enlarges the error of either
2 to 3.5 times (docs/theory.md (T8)).
"""

import math

from estimator.calibration.measured import CalibrationError, MeasuredValue


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
