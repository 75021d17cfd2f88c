"""The equations of Phee et al. 2009 by number, as they have to read, for the comparison with it.

S. J. Phee, S. C. Low, P. Valdastri, A. Menciassi, P. Dario, "Tendon sheath analysis for estimation
of distal end force and elongation", 2009. They describe one full pull from slack, then one release,
then one pull. `estimator.law.transmission` contains them and goes on from there; nothing in the
estimator calls this module. Where the printed equation differs, the docstring says how
(docs/explanation/theory.md has the table). Functions of tensions and positions take scalars or
arrays.

Symbols: tensions T [N]; friction coordinate K of the tip; length L and bend radii R [m]; axial
rigidity EA [N], printed as E; elongation e [m]; T_in0 the tension at the last reversal.
"""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from scipy.special import lambertw

from estimator.array_types import Array

Values: TypeAlias = float | Array


def compute_friction_coordinates(
    mu: float, lengths: Sequence[float], radii: Sequence[float]
) -> Array:
    """Return s at the start of the sheath and at the end of each section; the last is K, eq. (4).

    K = mu Σ (x_i - x_(i-1))/R_i with x_0 = 0; the print mixes x and X.
    """
    steps = mu * np.asarray(lengths, dtype=np.float64) / np.asarray(radii, dtype=np.float64)
    return np.concatenate([[0.0], np.cumsum(steps)])


def compute_pull_tip_tension(T_in: Values, K: float) -> Values:
    """Return T_out = T_in e^(-K) in the pulling phase, eq. (4)."""
    return T_in * math.exp(-K)


def compute_section_elongations(
    T_in: float, mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float
) -> Array:
    """Return the elongation up to the end of each section of a pulled tendon, eqs. (9), (10).

    e_on = T_in/(EA mu) Σ_i R_i e^(-s_(i-1)) (1 - e^(-mu (x_i - x_(i-1))/R_i)). The print lost the e
    of the exponential, starts the inner sum one term early and has x_(j-1) for x_(i-1).
    """
    s = compute_friction_coordinates(mu, lengths, radii)
    R = np.asarray(radii, dtype=np.float64)
    return T_in / (EA * mu) * np.cumsum(R * np.exp(-s[:-1]) * -np.expm1(-np.diff(s)))


def compute_pull_constant(
    mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float
) -> float:
    """Return M_e [m/N], the elongation per T_in of a pulled tendon: e = M_e T_in, eqs. (10), (11).

    Eq. (11) is printed as c_total = I M_e I_in.
    """
    return float(compute_section_elongations(1.0, mu, lengths, radii, EA)[-1])


def compute_release_constant(
    mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float
) -> float:
    """Return M_rel [m/N], the elongation per T_in of a released tendon, in place of eq. (23).

    M_rel = 1/EA ∫ e^(+s) dx. Printed M_e e^K is right for uniform curvature, or curvature symmetric
    end to end, alone.
    """
    s = compute_friction_coordinates(mu, lengths, radii)
    R = np.asarray(radii, dtype=np.float64)
    return float(np.sum(R * np.exp(s[:-1]) * np.expm1(np.diff(s))) / (EA * mu))


def compute_friction_from_pull(M_e: float, L: float, EA: float) -> float:
    """Return the K > 0 with e^(-K) = 1 - (M_e EA/L) K, eq. (13), in closed form (T8).

    K = 1/m + W_0(-e^(-1/m)/m), m = M_e EA/L in (0, 1), W_0 the principal Lambert W. The print reads
    m^2 e^2/L for the factor, and "no readily available solution". As K -> 0 the argument nears the
    branch point and half the digits are lost. K from M_e assumes uniform curvature.
    """
    m = M_e * EA / L
    if not 0.0 < m < 1.0:
        raise ValueError(f"M_e EA/L: {m:.4g}, must lie between 0 and 1")
    return 1.0 / m + float(lambertw(-math.exp(-1.0 / m) / m).real)


def compute_pull_to_release_tension(T_in0: Values, K: float) -> Values:
    """Return T_out = T_in0 e^(-K), held since the last maximum T_in0, eq. (14).

    It holds down to T_in = T_in0 e^(-2K); the text gives that level as if it were the drop.
    """
    return T_in0 * math.exp(-K)


def compute_pull_to_release_elongation(
    T_in0: Values, T_in: Values, K: float, L: float, EA: float
) -> Values:
    """Return e = L/(EA K) (2 sqrt(T_in0 T_in) - T_in - T_in0 e^(-K)), eqs. (20), (21).

    Eq. (20) lost a bracket. Uniform curvature; else `transition_elongation`.
    """
    return L / (EA * K) * (2.0 * np.sqrt(T_in0 * T_in) - T_in - T_in0 * math.exp(-K))


def compute_release_tip_tension(T_in: Values, K: float) -> Values:
    """Return T_out = T_in e^(+K) in the release phase, eq. (22), printed with T_in0 for T_in."""
    return T_in * math.exp(K)


def compute_release_elongation(T_in: Values, M_e: float, K: float) -> Values:
    """Return e = M_e e^K T_in in the release phase, eq. (23): uniform curvature only."""
    return M_e * math.exp(K) * T_in


def compute_release_to_pull_tension(T_in0: Values, K: float) -> Values:
    """Return T_out = T_in0 e^(+K), held since the last minimum T_in0, eq. (24), printed e^(-K)."""
    return T_in0 * math.exp(K)


def compute_release_to_pull_elongation(
    T_in0: Values, T_in: Values, K: float, L: float, EA: float
) -> Values:
    """Return e = L/(EA K) (T_in - 2 sqrt(T_in T_in0) + T_in0 e^K), eq. (25).

    Holds for T_in0 <= T_in <= T_in0 e^(2K). Uniform curvature.
    """
    return L / (EA * K) * (T_in - 2.0 * np.sqrt(T_in * T_in0) + T_in0 * math.exp(K))
