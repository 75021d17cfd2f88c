"""The sheaths: known shapes, joints and places in the scene, and tubes coloured by tension."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.messages.messages import PROFILE_POINTS
from teleop.view.colours import FRONT, to_rgba
from teleop.view.columns import AnyTopic, Rows, Sender, Subsampler, build_columns
from teleop.view.config import ViewConfig
from teleop.view.scene_geometry import (
    PIECES,
    SEGMENTS,
    Shape,
    Stage,
    build_stage,
    compute_rotations_from_z,
)
from teleop.view.space_arm import SpaceArm

# --- certified band of T(x) from the tensions at both ends
# Friction changes the tension by a factor of at most e^k from the housing to x, for any history: |d
# ln T / dx| <= mu / R(x). With k(x) the friction up to x, K that of the whole sheath, and the tip's
# tension between T_low and T_high,
#
#     max(T_in e^-k, T_low e^-(K-k)) <= T(x) <= min(T_in e^k, T_high e^(K-k)).
#
# The law is that of docs/explanation/theory.md; an extended model with other friction may leave the
# band.


def compute_friction_profile(length: Array, radius: Array, K: float, points: int) -> Array:
    """Return k(x) at evenly spread points, from the sections: the share of the bends up to x.

    `length` and `radius` [m], infinite for a straight section, have the shape (sections,); `K` is
    the friction of the whole sheath.
    """
    bends = np.concatenate([[0.0], np.cumsum(length / np.abs(radius))])
    places = np.concatenate([[0.0], np.cumsum(length)])
    if bends[-1] == 0.0:
        return np.zeros(points)
    share: Array = np.interp(np.linspace(0.0, places[-1], points), places, bends) / bends[-1]
    return K * share


def compute_tension_band(k: Array, T_in: Array, T_low: Array, T_high: Array) -> tuple[Array, Array]:
    """Return the ends of the band [N], shapes (rows, points).

    `k`, shape (points,), is the friction from the housing to each point, the last one K; `T_in` at
    the housing and the certified ends at the tip [N] have the shape (rows,). Non-finite inputs give
    a non-finite band.
    """
    from_tip = k[-1] - k
    low = np.maximum(T_in[:, None] * np.exp(-k), T_low[:, None] * np.exp(-from_tip))
    high = np.minimum(T_in[:, None] * np.exp(k), T_high[:, None] * np.exp(from_tip))
    return low, high


class Sheaths:
    """From Sheath messages, once a second, and the arms that the config describes."""

    def __init__(self, config: ViewConfig, arms: Sequence[SpaceArm] = ()) -> None:
        self._config = config
        self.arms = tuple(arms)
        self.shapes: dict[int, Shape] = {}
        self.friction: dict[int, Array] = {}  # tendon -> k(x) at the profile's points
        self.stage: Stage | None = None

    def learn(self, rows: Rows) -> bool:
        """Process messages; returns whether the scene must be redrawn."""
        before = dict(self.shapes)
        for row in rows:
            count, tendon = int(row["sections"]), int(row["tendon"])
            length, radius = row["section_length"][:count], row["section_radius"][:count]
            if count == 0 or not length.sum() > 0:
                continue
            shape = Shape(int(row["joint"]), tuple(length.tolist()), tuple(radius.tolist()))
            self.shapes[tendon] = shape
            K = float(row["effective_friction"])
            self.friction[tendon] = compute_friction_profile(length, radius, K, PROFILE_POINTS)
        if self.shapes == before:
            return False
        self.stage = build_stage(self.shapes, self._config, self.arms)
        return True

    @property
    def joints(self) -> tuple[int, ...]:
        """The joints that have a sheath."""
        return tuple(sorted({shape.joint for shape in self.shapes.values()}))

    def list_tendons(self, joint: int) -> list[int]:
        """Return the tendons of a joint, `a` first."""
        return sorted(t for t, shape in self.shapes.items() if shape.joint == joint)

    def name_tendon(self, tendon: int) -> str:
        """Return the name of a tendon: joint and side (1a, 1b, 2a, ...)."""
        shape = self.shapes.get(tendon)
        if shape is None:
            return f"{tendon + 1}"
        return f"{shape.joint + 1}{'ab'[self.list_tendons(shape.joint).index(tendon) % 2]}"


_NOTHING = np.empty((0, 3))
_EMPTY: dict[Any, dict[str, Any]] = {
    rr.Arrows3D: {"origins": _NOTHING, "vectors": _NOTHING},
    rr.Points3D: {"positions": _NOTHING, "labels": []},
    rr.LineStrips3D: {"strips": np.empty((0, 2, 3))},
}


class Painter:
    """Draws a part of the session with Rerun, from blocks of rows."""

    _has_forces = False  # drawn since they were cleared

    def __init__(
        self, config: ViewConfig, sender: Sender, sheaths: Sheaths, subsample: Subsampler
    ) -> None:
        self._config, self._sender = config, sender
        self._sheaths, self._subsample = sheaths, subsample

    def _set_style(self, path: str, archetype: Any, **fields: Any) -> None:
        self._sender.send_static(path, archetype.from_fields(**fields))

    def _paint(
        self, batches: Mapping[AnyTopic, Rows], paint: Mapping[AnyTopic, Callable[[Rows], None]]
    ) -> None:
        """Draw what there is of each topic, at the rate of the scene."""
        for topic, draw in paint.items():
            if topic in batches and len(batches[topic]):
                self._has_forces = True
                draw(self._subsample(batches[topic], self._config.rate_hz.levers))

    def _clear(self, path: str, stamp_ns: int, *archetypes: Any) -> None:
        """Draw nothing of these archetypes from one instant [ns] on."""
        none = np.array([0])
        parts = [c for each in archetypes for c in build_columns(each, none, **_EMPTY[each])]
        self._sender.send_columns_at(path, np.array([stamp_ns]), parts)


# --- the sheaths in the scene: coloured by tension, thick where the tendon slides, and X'

_STICKING_WIDTH = 0.5  # radius where the tendon sticks, of that where it slides


class Tubes(Painter):
    """Draws the shapes, and the tension in them."""

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
            self._sender.send_static(f"scene/tendon_{tendon}/tube", tube)
            style = {"radii": 1.8 * radius, "colors": FRONT}
            self._set_style(f"scene/tendon_{tendon}/tube", rr.Points3D, **style)

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
        is_finite = np.isfinite(front)
        at = interpolate_line(stage.lines[tendon], (front / length)[is_finite])
        tube = build_columns(
            rr.Capsules3D, np.full(len(rows), SEGMENTS), colors=colours, radii=radii
        )
        tube += build_columns(rr.Points3D, is_finite, positions=at)
        self._sender.send_columns(f"scene/tendon_{tendon}/tube", rows, tube)


def find_sliding_segments(front: Array, length: Array) -> NDArray[np.bool_]:
    """Return for each segment of the profile whether its tendon slides: those before X'.

    The newest movement has got as far as X'; beyond it friction still holds what the last one
    left. A segment with X' in its middle or further on counts as sliding.
    """
    middles = (np.arange(SEGMENTS) + 0.5) / SEGMENTS
    slides: NDArray[np.bool_] = middles <= (front / length)[:, None]
    return slides


def interpolate_line(line: Array, positions: Array) -> Array:
    """Return the points of a line at `positions`, 0 at its start and 1 at its end."""
    knots = np.linspace(0.0, 1.0, len(line))
    return np.stack([np.interp(positions, knots, line[:, k]) for k in range(3)], axis=1)
