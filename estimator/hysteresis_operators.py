"""Hysteresis operators over a record that know no tendon."""

import math

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile


@jit_compile
def apply_proportional_play(tension: Array, K: float) -> Array:
    """Return a tension after a play operator from T e^-K to T e^K, shape (n,)."""
    out = tension.copy()
    for i in range(1, len(tension)):
        low, high = tension[i] * math.exp(-K), tension[i] * math.exp(K)
        out[i] = min(max(out[i - 1], low), high)
    return out


@jit_compile
def compute_bristle_deflection(drive: Array, reach: Array) -> Array:
    """Return LuGre's bristle deflection z over a drive, shape (n,); exact for steps of `drive`."""
    z = np.zeros_like(drive)
    for i in range(1, len(drive)):
        step = drive[i] - drive[i - 1]
        end = reach[i] if step > 0.0 else -reach[i]
        z[i] = end + (z[i - 1] - end) * np.exp(-abs(step) / reach[i])
    return z


@jit_compile
def apply_widening_play(travel: Array, half_width: float, widening: float, vertex: float) -> Array:
    """Return a travel after a play whose half-width grows with the output's distance to `vertex`.

    p moves only where |travel - p| would exceed half_width + widening |p - vertex|, widening below
    1: travel that friction takes of a tendon whose tension grows in proportion to p; shape (n,).
    """
    out = travel.copy()
    for i in range(len(travel)):
        low, high = travel[i] - half_width - vertex, travel[i] + half_width - vertex
        low /= 1.0 + widening if low > 0.0 else 1.0 - widening
        high /= 1.0 - widening if high > 0.0 else 1.0 + widening
        previous = travel[0] if i == 0 else out[i - 1]
        out[i] = min(max(previous, low + vertex), high + vertex)
    return out
