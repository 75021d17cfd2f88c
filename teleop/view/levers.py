"""Joint, tip, environment and hand in the scene, with the forces on them.

A joint is drawn as a link that turns with the travel of its tip, the hand as a handle. The force
at the tip is positive against pulling, that on the hand along its own positive travel. What comes
of one message is one entity where it can be: a page takes in blocks, whatever is in them.
"""

import math
from collections.abc import Mapping

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.view import colours
from teleop.view.columns import AnyTopic, Rows, Sender, Subsampler, build_columns
from teleop.view.config import ViewConfig
from teleop.view.scene_geometry import ARROW, Lever
from teleop.view.sheaths import Sheaths

Columns = list[rr.ComponentColumn]  # of one block of rows


class Levers:
    """Draws the moving ends of the session."""

    def __init__(
        self, config: ViewConfig, sender: Sender, sheaths: Sheaths, subsample: Subsampler
    ) -> None:
        self._config = config
        self._sender = sender
        self._sheaths = sheaths
        self._subsample = subsample
        self._drawn = False  # since forces were forgotten
        self._travel: dict[int, float] = {}  # joint -> [m] as last estimated

    def place(self) -> None:
        """Draw the static parts and set the styles."""
        stage = self._sheaths.stage
        if stage is None:
            return
        thick = self._config.tube_radius * stage.size
        for joint, lever in stage.joints.items():
            path = f"scene/joint_{joint}"
            self._draw_pivot(path, lever, colours.BODY, 1.6 * thick, f"joint {joint + 1}")
            self._set_style(f"{path}/link", colours.BODY, thick)
            self._set_style(f"{path}/asked", colours.COMMANDED, 0.35 * thick)
            self._set_arrow_style(f"{path}/force", colours.ESTIMATE, 0.7 * thick)
            self._set_number_style(f"{path}/force", colours.ESTIMATE)
            self._set_style(f"{path}/force", colours.INTERVAL, 0.35 * thick)
            self._set_arrow_style(f"{path}/truth", colours.TRUTH, 0.45 * thick)
            self._draw_environment(f"{path}/environment", joint, lever)
        for joint, lever in stage.hands.items():
            self._draw_pivot(
                f"scene/hand_{joint}", lever, colours.HAND, 1.6 * thick, f"hand {joint + 1}"
            )
            self._set_style(f"scene/hand_{joint}/handle", colours.HAND, thick)
            self._set_arrow_style(f"scene/hand_{joint}/handle", colours.HAND, 0.7 * thick)
            self._set_number_style(f"scene/hand_{joint}/handle", colours.HAND)

    def draw(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw some instants; returns the number of messages drawn."""
        if self._sheaths.stage is None:
            return 0
        drawn = 0
        for topic, paint in (
            (STATE, self._draw_tips),
            (COMMAND, self._draw_commanded),
            (TENDONS, self._draw_truth),
            (HAND, self._draw_hands),
        ):
            if topic in batches:
                self._drawn = True
                rows = self._subsample(batches[topic], self._config.rate_hz.levers)
                paint(rows)
                drawn += len(rows)
        return drawn

    def forget_forces(self, stamp_ns: int) -> None:
        """Draw no force from one instant [ns] on."""
        stage = self._sheaths.stage
        if stage is None or not self._drawn:
            return
        self._drawn = False
        none, at = np.array([False]), np.array([stamp_ns])
        nothing = np.empty((0, 3))
        arrow = build_columns(rr.Arrows3D, none, origins=nothing, vectors=nothing)
        number = build_columns(rr.Points3D, none, positions=nothing, labels=[])
        interval = build_columns(rr.LineStrips3D, none, strips=np.empty((0, 2, 3)))
        for joint in stage.joints:
            path = f"scene/joint_{joint}"
            self._sender.columns_at(f"{path}/force", at, arrow + number + interval)
            self._sender.columns_at(f"{path}/truth", at, arrow)
            self._sender.columns_at(f"scene/hand_{joint}/handle", at, arrow + number)

    def _draw_tips(self, rows: Rows) -> None:
        for joint, lever, path in self._joints(rows):
            travel, force = rows["position"][:, joint], rows["force"][:, joint]
            self._travel[joint] = float(travel[-1])
            ends, link = _build_link(lever, travel)
            self._sender.columns(f"{path}/link", rows, link)
            back = -lever.onward(travel) * self._compute_length(self._config.tension_scale_N)
            low, high = rows["force_low"][:, joint], rows["force_high"][:, joint]
            parts = _build_arrow(ends, force[:, None] * back)
            parts += self._build_number(ends + lever.label, force, joint)
            parts += self._build_interval(lever, ends, back, low, high)
            self._sender.columns(f"{path}/force", rows, parts)

    def _draw_commanded(self, rows: Rows) -> None:
        stage = self._sheaths.stage
        for joint, lever in () if stage is None else stage.joints.items():
            _, link = _build_link(lever, rows["position"][:, joint])
            self._sender.columns(f"scene/joint_{joint}/asked", rows, link)

    def _draw_truth(self, rows: Rows) -> None:
        """Draw the force of the bench sensors, if any."""
        stage = self._sheaths.stage
        for joint, lever in () if stage is None else stage.joints.items():
            force = compute_true_force(rows, self._sheaths.tendons_of(joint))
            travel = rows["bench_distal_displacement"][:, self._sheaths.tendons_of(joint)[0]]
            travel = np.where(np.isfinite(travel), travel, self._travel.get(joint, 0.0))
            back = -lever.onward(travel) * self._compute_length(self._config.tension_scale_N)
            ends = lever.tip(travel) + lever.aslant
            if np.isfinite(force).any():
                truth = _build_arrow(ends, force[:, None] * back)
                self._sender.columns(f"scene/joint_{joint}/truth", rows, truth)

    def _draw_hands(self, rows: Rows) -> None:
        stage = self._sheaths.stage
        count = int(rows["joints"][-1]) if len(rows) else 0
        for joint, lever in () if stage is None else stage.hands.items():
            if joint >= count:
                continue
            travel, force = rows["position"][:, joint], rows["force"][:, joint]
            ends, parts = _build_link(lever, travel)
            onward = lever.onward(travel) * self._compute_length(self._config.hand_scale_N)
            parts += _build_arrow(ends, force[:, None] * onward)
            parts += self._build_number(ends + lever.label, force, joint)
            self._sender.columns(f"scene/hand_{joint}/handle", rows, parts)

    def _joints(self, rows: Rows) -> list[tuple[int, Lever, str]]:
        stage = self._sheaths.stage
        count = int(rows["joints"][-1]) if len(rows) else 0
        levers = {} if stage is None else stage.joints
        return [(j, lever, f"scene/joint_{j}") for j, lever in levers.items() if j < count]

    def _compute_length(self, scale: float) -> float:
        """Return the drawn length per newton."""
        stage = self._sheaths.stage
        return 0.0 if stage is None else ARROW * stage.size / scale

    def _build_number(self, at: Array, force: Array, joint: int) -> Columns:
        """Return forces [N] at places clear of what is drawn; of several joints with the number."""
        stage = self._sheaths.stage
        of = f"{joint + 1}: " if stage is not None and len(stage.joints) > 1 else ""
        known = np.isfinite(at).all(axis=1) & np.isfinite(force)
        words = [f"{of}{value:.1f} N" for value in force[known]]
        return build_columns(rr.Points3D, known, positions=at[known], labels=words)

    def _build_interval(
        self, lever: Lever, ends: Array, back: Array, low: Array, high: Array
    ) -> Columns:
        """Return a line from the low to the high end beside the arrow, with a bar across each end.

        The interval can be far wider than the scene; an end beyond the scale of tension is drawn
        there, and has no bar.
        """
        known = np.isfinite(low) & np.isfinite(high)
        limit = self._config.tension_scale_N

        def end(force: Array) -> tuple[Array, Array]:
            place = ends[known] + np.clip(force, -limit, limit)[known, None] * back[known]
            return place, (np.abs(force) <= limit)[known, None] * lever.aslant

        (begin, a), (to, b) = end(low), end(high)
        strips = np.stack([begin - a, begin + a, begin, to, to - b, to + b], axis=1)
        return build_columns(rr.LineStrips3D, known, strips=strips)

    def _draw_environment(self, path: str, joint: int, lever: Lever) -> None:
        """Draw a wedge from the travel at contact."""
        known = self._config.environment_m
        if joint >= len(known) or not math.isfinite(known[joint]):
            return
        rim = lever.sweep(known[joint])
        centre = np.repeat(lever.pivot[None], len(rim) - 1, axis=0)
        triangles = np.stack([centre, rim[:-1], rim[1:]], axis=1).reshape(-1, 3)
        normal = np.cross(lever.along, lever.aside)
        wedge = rr.Mesh3D(
            vertex_positions=triangles,
            vertex_normals=np.repeat(normal[None], len(triangles), axis=0),
            albedo_factor=colours.ENVIRONMENT,
        )
        self._sender.static(path, wedge)

    def _draw_pivot(self, path: str, lever: Lever, colour: int, radius: float, label: str) -> None:
        pivot = rr.Points3D(
            [lever.pivot], radii=radius, colors=colour, labels=label, show_labels=True
        )
        self._sender.static(f"{path}/pivot", pivot)

    def _set_style(self, path: str, colour: int, radius: float) -> None:
        self._sender.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=radius))

    def _set_arrow_style(self, path: str, colour: int, radius: float) -> None:
        self._sender.static(path, rr.Arrows3D.from_fields(colors=colour, radii=radius))

    def _set_number_style(self, path: str, colour: int) -> None:
        """Let only the words of points be seen."""
        style = rr.Points3D.from_fields(colors=colour, radii=1e-6, show_labels=True)
        self._sender.static(path, style)


def _build_link(lever: Lever, travel: Array) -> tuple[Array, Columns]:
    """Return the far ends of a lever, and the columns that draw it."""
    ends = lever.tip(travel)
    known = np.isfinite(travel)
    to = ends[known]
    strips = np.stack([np.broadcast_to(lever.pivot, to.shape), to], axis=1)
    return ends, build_columns(rr.LineStrips3D, known, strips=strips)


def _build_arrow(origins: Array, vectors: Array) -> Columns:
    known = np.isfinite(vectors).all(axis=1) & np.isfinite(origins).all(axis=1)
    return build_columns(rr.Arrows3D, known, origins=origins[known], vectors=vectors[known])


def compute_true_force(rows: Rows, tendons: list[int]) -> Array:
    """Return the force [N] on a joint's tip from bench sensors: T_out,a less T_out,b."""
    force: Array = rows["bench_distal_tension"][:, tendons[0]].copy()
    for other in tendons[1:]:
        force -= rows["bench_distal_tension"][:, other]
    return force
