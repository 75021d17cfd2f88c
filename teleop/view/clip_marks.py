"""Marks of a clip's scene: where points are on the picture, arrows, numbers and names."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import FancyArrowPatch

from estimator.array_types import Array
from teleop.view import colours
from teleop.view.clip_canvas import Canvas
from teleop.view.scene_geometry import EYE, RIGHT, UP, Stage


def project(stage: Stage, points: Array) -> Array:
    """Return points of the scene [m] on the picture, as seen from the eye; shape (n, 2)."""
    far = float(np.linalg.norm(EYE))
    place = (points - stage.centre) / stage.span
    depth = far + place @ (-np.array(EYE) / far)
    place = place * (far / np.maximum(depth, 0.2 * far))[:, None]
    return np.stack([place @ RIGHT, place @ UP], axis=1)


def build_tension_colours() -> LinearSegmentedColormap:
    """Return the colours of tension of the live view."""
    return LinearSegmentedColormap.from_list("tension", colours.TENSION_MAP / 255)


def draw_place(
    canvas: Canvas, axes: Axes, stage: Stage, at: Array, name: str, colour: int, scale: float
) -> None:
    """Draw a point that does not move, with its name below."""
    (place,) = project(stage, at[None])
    axes.plot(*place, "o", color=canvas.theme.adapt(colour), ms=11 * scale, zorder=3)
    axes.annotate(
        name,
        place,
        (0, -9 * scale),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=9.0 * max(scale, 1.0),
    )


def add_arrow(canvas: Canvas, axes: Axes, colour: int, scale: float) -> FancyArrowPatch:
    """Return a new arrow that moves."""
    style = f"simple,tail_width={4 * scale},head_width={12 * scale},head_length={10 * scale}"
    arrow = FancyArrowPatch(
        (0, 0), (0, 0), arrowstyle=style, color=canvas.theme.adapt(colour), lw=0
    )
    axes.add_patch(arrow)
    canvas.add(arrow)
    return arrow


def add_number(canvas: Canvas, axes: Axes, colour: int, scale: float) -> Any:
    """Return a new number that moves."""
    text = axes.text(
        0,
        0,
        "",
        color=canvas.theme.adapt(colour),
        ha="center",
        va="center",
        weight="bold",
        fontsize=10.0 * max(scale, 0.8),
    )
    return canvas.add(text)


def set_arrow(arrow: FancyArrowPatch, stage: Stage, begin: Array, vector: Array) -> None:
    """Move an arrow; it is hidden where it is not finite or too short."""
    a, b = project(stage, np.stack([begin, begin + vector]))
    shown = bool(np.isfinite([a, b]).all()) and float(np.linalg.norm(b - a)) > 2e-3
    arrow.set_visible(shown)
    if shown:
        arrow.set_positions(tuple(a), tuple(b))


def set_number(text: Any, stage: Stage, at: Array, value: float) -> None:
    """Move a number and set its value [N]; it is empty where either is not finite."""
    known = math.isfinite(value) and bool(np.isfinite(at).all())
    text.set_text(f"{value:.1f} N" if known else "")
    if known:
        text.set_position(project(stage, at[None])[0])
