"""The shape of a sheath in space, from its sections."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def centreline(length: Array, radius: Array, s: Array, turn_gap: float = 0.0) -> Array:
    """Return the points of a sheath at the given arc lengths.

    The sheath starts at the origin along +x. Each section is straight or an arc in the x-y plane
    that turns by length / radius, to the left for a positive radius, and continues in the direction
    in which the last one ended. A section of more than a full turn would run into itself, so it
    climbs along z by `turn_gap` a turn, as a helix of the same length and the same bend angle.

    Parameters
    ----------
    length : ndarray, shape (sections,)
        [m]
    radius : ndarray, shape (sections,)
        [m] infinite (or 0) for a straight section.
    s : ndarray, shape (n,)
        [m] arc lengths, 0 at the housing.
    turn_gap : float
        [m]

    Returns
    -------
    ndarray, shape (n, 3)
        [m]
    """
    points = np.zeros((len(s), 3))
    position, heading, begin = np.zeros(3), 0.0, 0.0
    for k, (l_k, r_k) in enumerate(zip(length, radius, strict=True)):
        curvature = 1.0 / r_k if math.isfinite(r_k) and r_k != 0.0 else 0.0
        rise = 0.0
        if abs(l_k * curvature) > 2 * math.pi:
            rise = min(0.5, turn_gap * abs(curvature) / (2 * math.pi))
        inside = s >= begin
        if k < len(length) - 1:
            inside &= s < begin + l_k
        points[inside] = position + _along(s[inside] - begin, curvature, heading, rise)
        position = position + _along(np.array([l_k]), curvature, heading, rise)[0]
        heading += l_k * curvature
        begin += l_k
    return points


def _along(d: Array, curvature: float, heading: float, rise: float) -> Array:
    """Return the way travelled [m] after arc length `d` of one section; `rise` is dz/ds."""
    flat = math.sqrt(1.0 - rise * rise)
    if curvature == 0.0:
        x, y = d * math.cos(heading), d * math.sin(heading)
    else:
        angle = heading + d * curvature
        x = (np.sin(angle) - math.sin(heading)) / curvature
        y = (math.cos(heading) - np.cos(angle)) / curvature
    return np.stack([flat * x, flat * y, rise * d], axis=1)
