"""The sheaths in the scene: coloured by tension, thick where the tendon slides, and X'."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.view.batch import Rows
from teleop.view.colours import FRONT, to_rgba
from teleop.view.columns import build_columns
from teleop.view.config import ViewConfig
from teleop.view.sender import Sender
from teleop.view.sheaths import Sheaths
from teleop.view.stage import PIECES, SEGMENTS, compute_rotations_from_z

_STICKING_WIDTH = 0.5  # radius where the tendon sticks, of that where it slides


class Tubes:
    """Draws the shapes, and the tension in them."""

    def __init__(self, config: ViewConfig, sender: Sender, sheaths: Sheaths) -> None:
        self._config = config
        self._sender = sender
        self._sheaths = sheaths

    def place(self) -> None:
        """Draw the shapes where they now stand."""
        stage = self._sheaths.stage
        if stage is None:
            return
        radius = self._config.tube_radius * stage.size
        for tendon, line in stage.lines.items():
            knots = line[::PIECES]
            steps = np.diff(knots, axis=0)
            tube = rr.Capsules3D(
                translations=knots[:-1],
                lengths=np.linalg.norm(steps, axis=1),
                quaternions=compute_rotations_from_z(steps),
                fill_mode="solid",
            )
            self._sender.static(f"scene/tendon_{tendon}/tube", tube)
            front = rr.Points3D.from_fields(radii=1.8 * radius, colors=FRONT)
            self._sender.static(f"scene/tendon_{tendon}/tube", front)

    def draw(self, tendon: int, rows: Rows) -> None:
        """Draw T(x) and X' of some instants."""
        stage = self._sheaths.stage
        if stage is None or tendon not in stage.lines:
            return
        tension, length, front = rows["tension"], rows["length"], rows["front"]
        middle = (tension[:, 1:] + tension[:, :-1]) / 2
        colours = to_rgba(middle, self._config.tension_scale_N).ravel()
        slides = find_sliding_segments(front, length)
        radius = self._config.tube_radius * stage.size
        radii = np.where(slides, radius, _STICKING_WIDTH * radius).astype(np.float32).ravel()
        known = np.isfinite(front)
        at = interpolate_line(stage.lines[tendon], (front / length)[known])
        tube = build_columns(
            rr.Capsules3D, np.full(len(rows), SEGMENTS), colors=colours, radii=radii
        )
        tube += build_columns(rr.Points3D, known, positions=at)
        self._sender.columns(f"scene/tendon_{tendon}/tube", rows, tube)


def find_sliding_segments(front: Array, length: Array) -> NDArray[np.bool_]:
    """Return for each segment of the profile whether its tendon slides: those before X'.

    The newest movement has got as far as X'; beyond it friction still holds what the last one
    left. A segment with X' in its middle or further on counts as sliding.
    """
    middles = (np.arange(SEGMENTS) + 0.5) / SEGMENTS
    slides: NDArray[np.bool_] = middles <= (front / length)[:, None]
    return slides


def interpolate_line(line: Array, place: Array) -> Array:
    """Return the points of a line at `place`, 0 at its start and 1 at its end."""
    whole = np.linspace(0.0, 1.0, len(line))
    return np.stack([np.interp(place, whole, line[:, k]) for k in range(3)], axis=1)
