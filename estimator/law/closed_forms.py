"""The equations of Phee et al. 2009 by number, as they have to read, for readers and for tests.

S. J. Phee, S. C. Low, P. Valdastri, A. Menciassi, P. Dario, "Tendon sheath analysis for estimation
of distal end force and elongation", 2009. They describe one full pull from slack, then one release,
then one pull. `estimator.law.transmission` contains them and goes on from there; nothing in the
estimator calls this module. Where the printed equation differs, the docstring says how
(docs/theory.md has the table). Functions of tensions and positions take scalars or arrays.

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


def bend_tension(T_in: Values, mu: float, R: float, x: Values) -> Values:
    """Return T(x) = T_in e^(-mu x/R) while the tendon is pulled, eq. (1)."""
    return T_in * np.exp(-mu * x / R)


def sheath_compression(T: Values) -> Values:
    """Return the axial force in the sheath, C = -T, eq. (2); needs a sheath free to slide axially.

    It is why a load cell under the end of the sheath reads the tension of the tendon.
    """
    return -T


def friction_coordinates(mu: float, lengths: Sequence[float], radii: Sequence[float]) -> Array:
    """Return s at the start of the sheath and at the end of each section; the last is K, eq. (4).

    K = mu Σ (x_i - x_(i-1))/R_i with x_0 = 0; the print mixes x and X.
    """
    steps = mu * np.asarray(lengths, dtype=np.float64) / np.asarray(radii, dtype=np.float64)
    return np.concatenate([[0.0], np.cumsum(steps)])


def section_tension(
    T_in: Values, mu: float, lengths: Sequence[float], radii: Sequence[float], x: float
) -> Values:
    """Return T(x) of a pulled tendon through sections of different curvature, eq. (3)."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    s = np.interp(x, ends, friction_coordinates(mu, lengths, radii))
    return T_in * math.exp(-s)


def pull_tip_tension(T_in: Values, K: float) -> Values:
    """Return T_out = T_in e^(-K) in the pulling phase, eq. (4)."""
    return T_in * math.exp(-K)


def strain(T: Values, EA: float) -> Values:
    """Return T/EA, eq. (5). The print calls it the elongation; it is the strain at one point."""
    return T / EA


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


def section_elongations(
    T_in: float, mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float
) -> Array:
    """Return the elongation up to the end of each section of a pulled tendon, eqs. (9), (10).

    e_on = T_in/(EA mu) Σ_i R_i e^(-s_(i-1)) (1 - e^(-mu (x_i - x_(i-1))/R_i)). The print lost the e
    of the exponential, starts the inner sum one term early and has x_(j-1) for x_(i-1).
    """
    s = friction_coordinates(mu, lengths, radii)
    R = np.asarray(radii, dtype=np.float64)
    return T_in / (EA * mu) * np.cumsum(R * np.exp(-s[:-1]) * -np.expm1(-np.diff(s)))


def pull_constant(mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float) -> float:
    """Return M_e [m/N], the elongation per T_in of a pulled tendon: e = M_e T_in, eqs. (10), (11).

    Eq. (11) is printed as c_total = I M_e I_in.
    """
    return float(section_elongations(1.0, mu, lengths, radii, EA)[-1])


def release_constant(
    mu: float, lengths: Sequence[float], radii: Sequence[float], EA: float
) -> float:
    """Return M_rel [m/N], the elongation per T_in of a released tendon, in place of eq. (23).

    M_rel = 1/EA ∫ e^(+s) dx. Printed M_e e^K is right for uniform curvature, or curvature symmetric
    end to end, alone.
    """
    s = friction_coordinates(mu, lengths, radii)
    R = np.asarray(radii, dtype=np.float64)
    return float(np.sum(R * np.exp(s[:-1]) * np.expm1(np.diff(s))) / (EA * mu))


def uniform_pull_constant(K: float, L: float, EA: float) -> float:
    """Return M_e = L (1 - e^(-K))/(EA K) of a sheath of uniform curvature, eq. (12)."""
    return -L * math.expm1(-K) / (EA * K)


def friction_from_pull_constant(M_e: float, L: float, EA: float) -> float:
    """Return the K > 0 with e^(-K) = 1 - (M_e EA/L) K, eq. (13), in closed form (T8).

    K = 1/m + W_0(-e^(-1/m)/m), m = M_e EA/L in (0, 1), W_0 the principal Lambert W. The print reads
    m^2 e^2/L for the factor, and "no readily available solution". As K -> 0 the argument nears the
    branch point and half the digits are lost. K from M_e assumes uniform curvature.
    """
    m = M_e * EA / L
    if not 0.0 < m < 1.0:
        raise ValueError(f"M_e EA/L: {m:.4g}, must lie between 0 and 1")
    return 1.0 / m + float(lambertw(-math.exp(-1.0 / m) / m).real)


def pull_to_release_tip_tension(T_in0: Values, K: float) -> Values:
    """Return T_out = T_in0 e^(-K), held since the last maximum T_in0, eq. (14).

    It holds down to T_in = T_in0 e^(-2K); the text gives that level as if it were the drop.
    """
    return T_in0 * math.exp(-K)


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


def pull_to_release_elongation(
    T_in0: Values, T_in: Values, K: float, L: float, EA: float
) -> Values:
    """Return e = L/(EA K) (2 sqrt(T_in0 T_in) - T_in - T_in0 e^(-K)), eqs. (20), (21).

    Eq. (20) lost a bracket. Uniform curvature; else `transition_elongation`.
    """
    return L / (EA * K) * (2.0 * np.sqrt(T_in0 * T_in) - T_in - T_in0 * math.exp(-K))


def release_tip_tension(T_in: Values, K: float) -> Values:
    """Return T_out = T_in e^(+K) in the release phase, eq. (22), printed with T_in0 for T_in."""
    return T_in * math.exp(K)


def uniform_release_elongation(T_in: Values, M_e: float, K: float) -> Values:
    """Return e = M_e e^K T_in in the release phase, eq. (23): uniform curvature only."""
    return M_e * math.exp(K) * T_in


def release_to_pull_tip_tension(T_in0: Values, K: float) -> Values:
    """Return T_out = T_in0 e^(+K), held since the last minimum T_in0, eq. (24), printed e^(-K)."""
    return T_in0 * math.exp(K)


def release_to_pull_elongation(
    T_in0: Values, T_in: Values, K: float, L: float, EA: float
) -> Values:
    """Return e = L/(EA K) (T_in - 2 sqrt(T_in T_in0) + T_in0 e^K), eq. (25).

    Holds for T_in0 <= T_in <= T_in0 e^(2K). Uniform curvature.
    """
    return L / (EA * K) * (T_in - 2.0 * np.sqrt(T_in * T_in0) + T_in0 * math.exp(K))


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
    s = friction_coordinates(mu, lengths, radii)
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
