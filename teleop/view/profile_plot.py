"""The plot of T(x): metres and newtons laid out on Rerun's two-dimensional plane.

Rerun's plane has y downwards and equal scales, so x [m] and T [N] are both divided by a reference:
the plot is `WIDTH` wide for the longest sheath and 1 high for the tension scale.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WIDTH = 1.8
_TICK = 0.02

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Plane:
    """The two references of the plot."""

    length: float  # [m] at the right end
    scale: float  # [N] at the top

    def points(self, x: Array, tension: Array) -> Array:
        """Return plane points, shape (..., 2), of x [m] and T [N]."""
        across, up = np.broadcast_arrays(WIDTH * x / self.length, -tension / self.scale)
        return np.stack([across, up], axis=-1)

    def axes(self) -> tuple[list[Array], list[tuple[Array, str]]]:
        """Return the lines of the axes with their ticks, and the labels with their places."""
        lines = [np.array([[0.0, 0.0], [WIDTH, 0.0]])]
        labels = [
            (np.array([WIDTH / 2, 0.16]), "x [m] from the housing"),
            (np.array([-0.02, -1.1]), "T [N]"),
        ]
        for x in ticks(self.length):
            at = self.points(np.array(x), np.array(0.0))
            lines.append(np.array([at, _moved(at, 0, _TICK)]))
            labels.append((_moved(at, 0, 0.06), f"{x:g}"))
        for tension in ticks(self.scale):
            at = self.points(np.array(0.0), np.array(tension))
            lines.append(np.array([_moved(at, -_TICK, 0), at]))
            labels.append((_moved(at, -0.08, 0), f"{tension:g}"))
        return lines, labels


def _moved(point: Array, right: float, down: float) -> Array:
    moved: Array = point + np.array([right, down])
    return moved


def ticks(top: float) -> list[float]:
    """Return round values from 0 to `top`, four to nine of them."""
    step = 10 ** math.floor(math.log10(top / 2))
    step *= next(factor for factor in (1, 2, 5, 10) if top / (step * factor) < 6)
    return [round(k * step, 12) for k in range(math.floor(top / step * (1 + 1e-9)) + 1)]
