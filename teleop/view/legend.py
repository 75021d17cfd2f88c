"""Fit the scene into its view, with the colour scale beside it."""

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.view.colours import to_rgba
from teleop.view.config import ViewConfig
from teleop.view.plane import compute_ticks_to_end
from teleop.view.sender import Sender
from teleop.view.stage import Stage

_STEPS = 65
_HALF_WIDTH = 0.035  # of its height
_TITLE_HEIGHT = 1.2  # likewise


def draw_stage(sender: Sender, config: ViewConfig, stage: Stage) -> None:
    """Fit the scene into the view, with the colour scale beside it."""
    scale = 1.0 / stage.span
    fit = rr.Transform3D(translation=-scale * stage.centre, scale=scale)
    sender.static("scene", fit)
    _draw_scale(sender, stage.legend, stage.legend_up, config.tension_scale_N)


def _draw_scale(sender: Sender, foot: Array, up: Array, top: float) -> None:
    """Draw the colours from 0 to `top` [N] along `up` from `foot`, with round values beside."""
    tall = float(np.linalg.norm(up))
    levels = np.linspace(0.0, 1.0, _STEPS)
    half = np.array([_HALF_WIDTH * tall, 0.0, 0.0])
    edge = foot + levels[:, None] * up
    left = np.arange(_STEPS - 1)
    right = left + _STEPS
    bar = rr.Mesh3D(  # without normals it is not shaded, so colours are exact
        vertex_positions=np.concatenate([edge - half, edge + half]),
        triangle_indices=np.concatenate(
            [np.stack([left, right, right + 1], 1), np.stack([left, right + 1, left + 1], 1)]
        ),
        vertex_colors=np.tile(to_rgba(levels * top, top), 2),
    )
    sender.static("scene/legend/scale", bar)
    beside = np.array([0.13 * tall, 0.0, 0.0])
    marks = compute_ticks_to_end(top)
    words = rr.Points3D(
        [foot + value / top * up + beside for value in marks],
        labels=[f"{value:g}" for value in marks],
        colors=0xC0C0C0FF,
        radii=1e-6,
        show_labels=True,
    )
    sender.static("scene/legend/values", words)
    title = rr.Points3D(
        [foot + _TITLE_HEIGHT * up], labels="tension [N]", colors=0xFFFFFFFF, radii=1e-6,
        show_labels=True,
    )  # fmt: skip
    sender.static("scene/legend/title", title)
