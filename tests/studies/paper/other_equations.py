"""Equations of Phee et al. 2009 and of docs/explanation/theory.md that nothing but tests evaluates.

Symbols as in `studies.paper.equations`.
"""

import math
from collections.abc import Sequence

import numpy as np

from studies.paper.equations import Values, compute_friction_coordinates


def bend_tension(T_in: Values, mu: float, R: float, x: Values) -> Values:
    """Return T(x) = T_in e^(-mu x/R) while the tendon is pulled, eq. (1)."""
    return T_in * np.exp(-mu * x / R)


def section_tension(
    T_in: Values, mu: float, lengths: Sequence[float], radii: Sequence[float], x: float
) -> Values:
    """Return T(x) of a pulled tendon through sections of different curvature, eq. (3)."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    s = np.interp(x, ends, compute_friction_coordinates(mu, lengths, radii))
    return T_in * math.exp(-s)


def bend_elongation(T_in: Values, mu: float, R: float, EA: float, x: Values) -> Values:
    """Return e = R/(EA mu) T_in (1 - e^(-mu x/R)), eqs. (6) and (7).

    In (6) the variable of integration must not be the limit x.
    """
    return R / (EA * mu) * T_in * -np.expm1(-mu * x / R)


def bend_elongation_from_ends(
    T_in: Values, T_out: Values, mu: float, R: float, EA: float
) -> Values:
    """Return e = R/(EA mu) (T_in - T_out), eq. (8)."""
    return R / (EA * mu) * (T_in - T_out)


def uniform_pull_constant(K: float, L: float, EA: float) -> float:
    """Return M_e = L (1 - e^(-K))/(EA K) of a sheath of uniform curvature, eq. (12)."""
    return -L * math.expm1(-K) / (EA * K)


def pull_to_release_front(T_in0: Values, T_in: Values, K: float, L: float) -> Values:
    """Return X' = L/(2K) ln(T_in0/T_in), where the tension peaks, eqs. (15), (16)."""
    return L / (2.0 * K) * np.log(T_in0 / T_in)


def release_to_pull_front(T_in0: Values, T_in: Values, K: float, L: float) -> Values:
    """Return X' = L/(2K) ln(T_in/T_in0) after a minimum T_in0, where the tension is lowest."""
    return L / (2.0 * K) * np.log(T_in / T_in0)


def pull_to_release_elongation_before_front(
    T_in: Values, X: Values, K: float, L: float, EA: float
) -> Values:
    """Return e_A, the elongation between housing and front X', eqs. (17), (18).

    The integral of (17) is measured back from the peak T_in e^(K X'/L) and in units of it.
    """
    return T_in * L / (EA * K) * np.exp(K * X / L) * -np.expm1(-K * X / L)


def pull_to_release_elongation_beyond_front(
    T_in: Values, X: Values, K: float, L: float, EA: float
) -> Values:
    """Return e_B, the elongation between front X' and tip, eq. (19)."""
    return T_in * L / (EA * K) * np.exp(K * X / L) * -np.expm1(-K * (1.0 - X / L))


def transition_elongation(
    T_in0: float,
    T_in: float,
    mu: float,
    lengths: Sequence[float],
    radii: Sequence[float],
    EA: float,
) -> float:
    """Return e after one reversal at T_in0 of the fully sliding tendon, any curvature (T5).

    A T_in up to T_in0 is a release after a pull, one above it a pull after a release.
    """
    s = compute_friction_coordinates(mu, lengths, radii)
    R = np.asarray(radii, dtype=np.float64)
    sign = 1.0 if T_in <= T_in0 else -1.0
    a = min(0.5 * abs(math.log(T_in0 / T_in)), float(s[-1]))
    near, far = np.minimum(s, a), np.maximum(s, a)
    moved = np.sum(R * np.abs(np.diff(np.exp(sign * near))))
    kept = np.sum(R * np.abs(np.diff(np.exp(-sign * far))))
    T_kept = T_in * math.exp(2.0 * sign * a)
    return float((T_in * moved + T_kept * kept) / (EA * mu))


def pull_to_release_backlash(T_in0: Values, K: float, L: float, EA: float) -> Values:
    """Return the motor travel lost after a maximum, L/(EA K) T_in0 (1 - e^(-K))^2 (T9)."""
    return L / (EA * K) * T_in0 * math.expm1(-K) ** 2


def release_to_pull_backlash(T_in0: Values, K: float, L: float, EA: float) -> Values:
    """Return the motor travel lost after a minimum, L/(EA K) T_in0 (e^K - 1)^2 (T9)."""
    return L / (EA * K) * T_in0 * math.expm1(K) ** 2


def virgin_elongation(T_p: float, T_in: Values, K: float, L: float, EA: float) -> Values:
    """Return e of the first pull from uniform pretension T_p, up to T_in = T_p e^K (T15).

    e - e_0 = L/(EA K) (T_in - T_p - T_p ln(T_in/T_p)), e_0 = T_p L/EA. Uniform curvature.
    """
    return T_p * L / EA + L / (EA * K) * (T_in - T_p - T_p * np.log(T_in / T_p))


def release_tension_from_elongation(
    T_in0: Values, e: Values, K: float, L: float, EA: float
) -> Values:
    """Return T_in at elongation `e` while a release runs back through a pull from T_in0 (T16).

    The inverse of eq. (21): T_in = (sqrt(T_in0) - sqrt(T_in0 (1 - e^(-K)) - e EA K/L))^2.
    """
    missing = T_in0 * -math.expm1(-K) - e * EA * K / L
    root: Values = np.sqrt(T_in0) - np.sqrt(np.maximum(missing, 0.0))
    return root * root
