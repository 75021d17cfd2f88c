"""Marks of a clip's scene: where points are on the picture, lines, arrows, numbers and names."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch

from estimator.array_types import Array
from teleop.view import colours
from teleop.view.clip_canvas import Canvas
from teleop.view.scene_geometry import EYE, RIGHT, UP, Stage


class Marks:
    """Draws into the axes of a scene, as seen from the eye; `scale` is of widths and letters."""

    def __init__(self, canvas: Canvas, axes: Axes, stage: Stage, scale: float) -> None:
        self.canvas, self.axes, self.stage, self.scale = canvas, axes, stage, scale

    def project(self, points: Array | Sequence[Array]) -> Array:
        """Return points of the scene [m] on the picture, shape (n, 2)."""
        far = float(np.linalg.norm(EYE))
        place = (np.asarray(points) - self.stage.centre) / self.stage.span
        depth = far + place @ (-np.array(EYE) / far)
        place = place * (far / np.maximum(depth, 0.2 * far))[:, None]
        return np.stack([place @ RIGHT, place @ UP], axis=1)

    def draw_place(self, at: Array, name: str, colour: int, size: float = 1.0) -> None:
        """Draw a point that does not move, with its name below."""
        (place,), scale = self.project(at[None]), size * self.scale
        ink = self.canvas.theme.adapt(colour)
        self.axes.plot(*place, "o", color=ink, ms=11 * scale, zorder=3)
        self.axes.annotate(
            name, place, (0, -9 * scale), textcoords="offset points", ha="center", va="top",
            fontsize=9.0 * max(scale, 1.0),
        )  # fmt: skip

    def add_line(self, colour: int, width: float) -> Line2D:
        """Return a new line that moves."""
        return self.canvas.add_line(self.axes, colour, width * self.scale)

    def add_tendons(self, width: float) -> LineCollection:
        """Return new lines that move, coloured by tension as in the live view."""
        lines = LineCollection([], capstyle="round", linewidth=width)
        tension = LinearSegmentedColormap.from_list("tension", colours.TENSION_MAP / 255)
        lines.set(cmap=tension, norm=Normalize(0, self.canvas.data.config.tension_scale_N))
        self.axes.add_artist(lines)
        return lines

    def add_arrow(self, colour: int, size: float = 1.0) -> FancyArrowPatch:
        """Return a new arrow that moves."""
        tail, wide, long = (part * size * self.scale for part in (4, 12, 10))
        style = f"simple,tail_width={tail},head_width={wide},head_length={long}"
        ink = self.canvas.theme.adapt(colour)
        arrow = FancyArrowPatch((0, 0), (0, 0), arrowstyle=style, color=ink, lw=0)
        self.axes.add_patch(arrow)
        self.canvas.add(arrow)
        return arrow

    def add_number(self, colour: int) -> Any:
        """Return a new number that moves."""
        text = self.axes.text(
            0, 0, "", color=self.canvas.theme.adapt(colour), ha="center", va="center",
            weight="bold", fontsize=10.0 * max(self.scale, 0.8),
        )  # fmt: skip
        return self.canvas.add(text)

    def move_line(self, line: Line2D, points: Array | Sequence[Array]) -> None:
        """Let a line run through points, or a mark be at one."""
        line.set_data(*self.project(points).T)

    def move_arrow(self, arrow: FancyArrowPatch, begin: Array, vector: Array) -> None:
        """Move an arrow; it is hidden where it is not finite or too short."""
        a, b = self.project([begin, begin + vector])
        shown = bool(np.isfinite([a, b]).all()) and float(np.linalg.norm(b - a)) > 2e-3
        arrow.set_visible(shown)
        if shown:
            arrow.set_positions(tuple(a), tuple(b))

    def move_number(self, text: Any, at: Array, value: float) -> None:
        """Move a number and set its value [N]; it is empty where either is not finite."""
        known = math.isfinite(value) and bool(np.isfinite(at).all())
        text.set_text(f"{value:.1f} N" if known else "")
        if known:
            text.set_position(self.project(at[None])[0])
