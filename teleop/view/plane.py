"""A plot with axes of its own on Rerun's two-dimensional plane: T(x), and T_out over T_in.

Rerun's plane has y downwards and equal scales, so both quantities are divided by a reference: the
plot is `width` wide and 1 high.
"""

import math
from dataclasses import dataclass

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.view.batch import Sender

_TICK = 0.02


@dataclass(frozen=True, slots=True)
class Plane:
    """The references of a plot and the words at its axes."""

    right: float  # of the quantity across, at the right end
    top: float  # of the quantity upwards, at the top
    width: float
    across: str  # with its unit
    upwards: str

    def points(self, across: Array, upwards: Array) -> Array:
        """Return plane points, shape (..., 2)."""
        x, y = np.broadcast_arrays(self.width * across / self.right, -upwards / self.top)
        return np.stack([x, y], axis=-1)

    def axes(self) -> tuple[list[Array], list[tuple[Array, str]]]:
        """Return the lines of the axes with their ticks, and the labels with their places."""
        lines = [np.array([[0.0, 0.0], [self.width, 0.0]]), np.array([[0.0, 0.0], [0.0, -1.0]])]
        labels = [
            (np.array([self.width / 2, 0.19]), self.across),
            (np.array([0.02 + 0.022 * len(self.upwards), -1.12]), self.upwards),
        ]
        for x in compute_ticks(self.right):
            at = self.points(np.array(x), np.array(0.0))
            lines.append(np.array([at, _shift_point(at, 0, _TICK)]))
            labels.append((_shift_point(at, 0, 0.08), f"{x:g}"))
        for y in compute_ticks(self.top):
            at = self.points(np.array(0.0), np.array(y))
            lines.append(np.array([_shift_point(at, -_TICK, 0), at]))
            labels.append((_shift_point(at, -0.09, 0), f"{y:g}"))
        return lines, labels

    def draw_axes(self, sender: Sender, root: str) -> None:
        """Send the axes and their labels."""
        lines, labels = self.axes()
        sender.static(f"{root}/axes", rr.LineStrips2D(lines, colors=0x808080FF, radii=0.004))
        draw_words(sender, f"{root}/labels", labels)


def draw_words(sender: Sender, path: str, labels: list[tuple[Array, str]]) -> None:
    """Send texts at places of the plane."""
    words = rr.Points2D(
        [at for at, _ in labels],
        labels=[text for _, text in labels],
        colors=0xC0C0C0FF,
        radii=0.0001,
        show_labels=True,
    )
    sender.static(path, words)


def _shift_point(point: Array, right: float, down: float) -> Array:
    moved: Array = point + np.array([right, down])
    return moved


def _choose_tick_step(top: float) -> float:
    """Return the distance of round values, of which three to seven reach from 0 to `top`."""
    step = 10 ** math.floor(math.log10(top / 2))
    factor = next(factor for factor in (1, 2, 5, 10) if top / (step * factor) < 6)
    return float(step * factor)


def compute_ticks(top: float) -> list[float]:
    """Return round values from 0 to `top`, three to seven of them."""
    step = _choose_tick_step(top)
    return [round(k * step, 12) for k in range(math.floor(top / step * (1 + 1e-9)) + 1)]


def compute_axis_end(top: float) -> float:
    """Return where an axis for values up to `top` ends: on the last of its own ticks."""
    end, step = top, 0.0
    while step != _choose_tick_step(end):  # the longer axis may have another step
        step = _choose_tick_step(end)
        end = round(math.ceil(top / step * (1 - 1e-9)) * step, 12)
    return end


def compute_ticks_to_end(top: float) -> list[float]:
    """Return ticks and `top` itself, without a tick so near to it that labels would collide."""
    step = _choose_tick_step(top)
    return [value for value in compute_ticks(top) if value <= top - 0.5 * step] + [top]
