"""The shape of a sheath in space, from its sections."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array


class CentreLine(NamedTuple):
    """A sheath's centre line and the frame at its end."""

    points: Array  # [m], shape (n, 3)
    along: Array  # unit vector, how the sheath runs at its end
    aside: Array  # unit vector, across it, in the plane of the last bend


def compute_centreline(
    length: Array,
    radius: Array,
    s: Array,
    turn_gap: float = 0.0,
    planes: Sequence[float] = (),
) -> CentreLine:
    """Return the points of a sheath at the given arc lengths.

    The sheath starts at the origin along +x. Each section is straight or an arc that turns by
    length / radius, to the left for a positive radius, and continues in the direction in which
    the last one ended. All bends lie in the x-y plane unless `planes` turns one out of it. A
    section of more than a full turn would run into itself, so it climbs across its plane by
    `turn_gap` a turn, as a helix of the same length and the same bend angle.

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
    planes : sequence of float
        [rad] by which the plane of bending turns about the sheath where each section begins, to the
        right seen from the housing. Sections that are not named have 0.
    """
    points = np.zeros((len(s), 3))
    position, begin = np.zeros(3), 0.0
    frame = np.eye(3)  # rows: along the sheath, to the left, up
    for k, (l_k, r_k) in enumerate(zip(length, radius, strict=True)):
        if k < len(planes):
            frame = _build_rotation(planes[k], 0) @ frame
        curvature = 1.0 / r_k if math.isfinite(r_k) and r_k != 0.0 else 0.0
        rise = 0.0
        if abs(l_k * curvature) > 2 * math.pi:
            rise = min(0.5, turn_gap * abs(curvature) / (2 * math.pi))
        inside = s >= begin
        if k < len(length) - 1:
            inside &= s < begin + l_k
        points[inside] = (
            position + _compute_section_path(s[inside] - begin, curvature, rise) @ frame
        )
        position = position + _compute_section_path(np.array([l_k]), curvature, rise)[0] @ frame
        frame = _build_rotation(l_k * curvature, 2) @ frame
        begin += l_k
    return CentreLine(points, frame[0], frame[1])


def _compute_section_path(d: Array, curvature: float, rise: float) -> Array:
    """Return the way travelled [m] after arc length `d` of one section, in the frame it began with.

    `rise` is the climb across the plane for a way of 1.
    """
    flat = math.sqrt(1.0 - rise * rise)
    angle = d * curvature
    x = d if curvature == 0.0 else np.sin(angle) / curvature
    y = np.zeros_like(d) if curvature == 0.0 else (1.0 - np.cos(angle)) / curvature
    return np.stack([flat * x, flat * y, rise * d], axis=1)


def _build_rotation(angle: float, axis: int) -> Array:
    """Return the rows of a frame turned about its own row `axis`."""
    turned = np.eye(3)
    i, k = (axis + 1) % 3, (axis + 2) % 3
    turned[i, i] = turned[k, k] = math.cos(angle)
    turned[i, k], turned[k, i] = math.sin(angle), -math.sin(angle)
    return turned
