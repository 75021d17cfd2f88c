"""Certified band of T(x) from the tensions at both ends.

Friction changes the tension by a factor of at most e^k from the housing to x, for any history: |d
ln T / dx| <= mu / R(x). With k(x) the friction up to x, K that of the whole sheath, and the tip's
tension between T_low and T_high,

    max(T_in e^-k, T_low e^-(K-k)) <= T(x) <= min(T_in e^k, T_high e^(K-k)).

The law is that of docs/theory.md; an extended model with other friction may leave the band.
"""

import numpy as np

from estimator.array_types import Array


def compute_friction_profile(length: Array, radius: Array, K: float, points: int) -> Array:
    """Return k(x) at evenly spread points, from the sections: the share of the bends up to x.

    Parameters
    ----------
    length, radius : ndarray, shape (sections,)
        [m], a straight section's radius being infinite.
    K : float
        Friction of the whole sheath.
    points : int
    """
    bends = np.concatenate([[0.0], np.cumsum(length / np.abs(radius))])
    places = np.concatenate([[0.0], np.cumsum(length)])
    if bends[-1] == 0.0:
        return np.zeros(points)
    share: Array = np.interp(np.linspace(0.0, places[-1], points), places, bends) / bends[-1]
    return K * share


def compute_tension_band(k: Array, T_in: Array, T_low: Array, T_high: Array) -> tuple[Array, Array]:
    """Return the ends of the band [N], shapes (rows, points).

    Parameters
    ----------
    k : ndarray, shape (points,)
        Friction from the housing to each point; the last is K.
    T_in, T_low, T_high : ndarray, shape (rows,)
        [N] at the housing, and the certified ends at the tip; non-finite inputs give a non-finite
        band.
    """
    from_tip = k[-1] - k
    low = np.maximum(T_in[:, None] * np.exp(-k), T_low[:, None] * np.exp(-from_tip))
    high = np.minimum(T_in[:, None] * np.exp(k), T_high[:, None] * np.exp(from_tip))
    return low, high
