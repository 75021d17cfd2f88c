"""Uniform cubic B-splines (de Boor, A Practical Guide to Splines, 1978), compiled."""

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile


@jit_compile
def evaluate_spline_at(coefficients: Array, share: float) -> float:
    """Return a spline at a share of its range; outside 0 to 1 it stays as at the end."""
    pieces = len(coefficients) - 3
    x = min(max(share, 0.0), 1.0) * pieces
    i = min(int(x), pieces - 1)
    t = x - i
    s = 1.0 - t
    return (
        float(
            s**3 * coefficients[i]
            + (3.0 * t**3 - 6.0 * t**2 + 4.0) * coefficients[i + 1]
            + (3.0 * s**3 - 6.0 * s**2 + 4.0) * coefficients[i + 2]
            + t**3 * coefficients[i + 3]
        )
        / 6.0
    )


@jit_compile
def evaluate_spline(coefficients: Array, share: Array) -> Array:
    """Return a spline at shares of its range, shape (n,)."""
    values = np.empty(len(share))
    for k in range(len(share)):
        values[k] = evaluate_spline_at(coefficients, share[k])
    return values
