"""Joint, tip, environment and hand in the scene, with the forces on them.

A joint is drawn as a link that turns with the travel of its tip, the hand as a handle. The force
at the tip is positive against pulling, that on the hand along its own positive travel. What comes
of one message is one entity where it can be: a page takes in blocks, whatever is in them.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.view import colours
from teleop.view.columns import AnyTopic, Rows, build_columns
from teleop.view.scene_geometry import ARROW, Lever, Stage
from teleop.view.scene_sheaths import Painter

Columns = list[rr.ComponentColumn]  # of one block of rows


class Levers(Painter):
    """Draws the moving ends of the session."""

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._travel: dict[int, float] = {}  # joint -> [m] as last estimated

    def place(self) -> None:
        """Draw the static parts and set the styles."""
        stage, style = self._sheaths.stage, self._set_style
        if stage is None:
            return
        thick = self._config.tube_radius * stage.size
        words = {"radii": 1e-6, "show_labels": True}  # of points only the words are seen
        for joint, lever in stage.joints.items():
            path = f"scene/joint_{joint}"
            self._draw_pivot(path, lever, colours.BODY, 1.6 * thick, f"joint {joint + 1}")
            style(f"{path}/link", rr.LineStrips3D, colors=colours.BODY, radii=thick)
            style(f"{path}/asked", rr.LineStrips3D, colors=colours.COMMANDED, radii=0.35 * thick)
            style(f"{path}/force", rr.Arrows3D, colors=colours.ESTIMATE, radii=0.7 * thick)
            style(f"{path}/force", rr.Points3D, colors=colours.ESTIMATE, **words)
            style(f"{path}/force", rr.LineStrips3D, colors=colours.INTERVAL, radii=0.35 * thick)
            style(f"{path}/truth", rr.Arrows3D, colors=colours.TRUTH, radii=0.45 * thick)
            self._draw_environment(f"{path}/environment", joint, lever)
        for joint, lever in stage.hands.items():
            path = f"scene/hand_{joint}"
            self._draw_pivot(path, lever, colours.HAND, 1.6 * thick, f"hand {joint + 1}")
            style(f"{path}/handle", rr.LineStrips3D, colors=colours.HAND, radii=thick)
            style(f"{path}/handle", rr.Arrows3D, colors=colours.HAND, radii=0.7 * thick)
            style(f"{path}/handle", rr.Points3D, colors=colours.HAND, **words)

    def draw(self, batches: Mapping[AnyTopic, Rows]) -> None:
        """Draw some instants."""
        if (stage := self._sheaths.stage) is not None:
            self._paint(batches, {
                STATE: partial(self._draw_tips, stage),
                COMMAND: partial(self._draw_commanded, stage),
                TENDONS: partial(self._draw_truth, stage),
                HAND: partial(self._draw_hands, stage),
            })  # fmt: skip

    def forget_forces(self, stamp_ns: int) -> None:
        """Draw no force from one instant [ns] on."""
        stage = self._sheaths.stage
        for joint in stage.joints if stage is not None and self._has_forces else ():
            path, handle = f"scene/joint_{joint}", f"scene/hand_{joint}/handle"
            self._clear(f"{path}/force", stamp_ns, rr.Arrows3D, rr.Points3D, rr.LineStrips3D)
            self._clear(f"{path}/truth", stamp_ns, rr.Arrows3D)
            self._clear(handle, stamp_ns, rr.Arrows3D, rr.Points3D)
        self._has_forces = False

    def _draw_tips(self, stage: Stage, rows: Rows) -> None:
        per_newton = ARROW * stage.size / self._config.tension_scale_N
        for joint, lever in stage.joints.items():
            if joint >= rows["joints"][-1]:
                continue
            path = f"scene/joint_{joint}"
            travel, force = rows["position"][:, joint], rows["force"][:, joint]
            self._travel[joint] = float(travel[-1])
            ends, link = _build_link(lever, travel)
            self._sender.send_columns(f"{path}/link", rows, link)
            back = -lever.compute_direction(travel) * per_newton
            low, high = rows["force_low"][:, joint], rows["force_high"][:, joint]
            parts = _build_arrow(ends, force[:, None] * back)
            parts += _build_number(stage, ends + lever.label, force, joint)
            parts += self._build_interval(lever, ends, back, low, high)
            self._sender.send_columns(f"{path}/force", rows, parts)

    def _draw_commanded(self, stage: Stage, rows: Rows) -> None:
        for joint, lever in stage.joints.items():
            _, link = _build_link(lever, rows["position"][:, joint])
            self._sender.send_columns(f"scene/joint_{joint}/asked", rows, link)

    def _draw_truth(self, stage: Stage, rows: Rows) -> None:
        """Draw the force of the bench sensors, if any."""
        per_newton = ARROW * stage.size / self._config.tension_scale_N
        for joint, lever in stage.joints.items():
            force = compute_true_force(rows, self._sheaths.list_tendons(joint))
            travel = rows["bench_distal_displacement"][:, self._sheaths.list_tendons(joint)[0]]
            travel = np.where(np.isfinite(travel), travel, self._travel.get(joint, 0.0))
            if np.isfinite(force).any():
                vectors = -force[:, None] * lever.compute_direction(travel) * per_newton
                truth = _build_arrow(lever.compute_tip(travel) + lever.aslant, vectors)
                self._sender.send_columns(f"scene/joint_{joint}/truth", rows, truth)

    def _draw_hands(self, stage: Stage, rows: Rows) -> None:
        per_newton = ARROW * stage.size / self._config.hand_scale_N
        for joint, lever in stage.hands.items():
            if joint >= rows["joints"][-1]:
                continue
            travel, force = rows["position"][:, joint], rows["force"][:, joint]
            ends, parts = _build_link(lever, travel)
            parts += _build_arrow(
                ends, force[:, None] * lever.compute_direction(travel) * per_newton
            )
            parts += _build_number(stage, ends + lever.label, force, joint)
            self._sender.send_columns(f"scene/hand_{joint}/handle", rows, parts)

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
        self._sender.send_static(path, wedge)

    def _draw_pivot(self, path: str, lever: Lever, colour: int, radius: float, label: str) -> None:
        place = [lever.pivot]
        self._sender.send_words(f"{path}/pivot", rr.Points3D, place, label, colour, radius)


def _build_link(lever: Lever, travel: Array) -> tuple[Array, Columns]:
    """Return the far ends of a lever, and the columns that draw it."""
    ends = lever.compute_tip(travel)
    known = np.isfinite(travel)
    to = ends[known]
    strips = np.stack([np.broadcast_to(lever.pivot, to.shape), to], axis=1)
    return ends, build_columns(rr.LineStrips3D, known, strips=strips)


def _build_number(stage: Stage, at: Array, force: Array, joint: int) -> Columns:
    """Return forces [N] at places clear of what is drawn; of several joints with the number."""
    of = f"{joint + 1}: " if len(stage.joints) > 1 else ""
    known = np.isfinite(at).all(axis=1) & np.isfinite(force)
    words = [f"{of}{value:.1f} N" for value in force[known]]
    return build_columns(rr.Points3D, known, positions=at[known], labels=words)


def _build_arrow(origins: Array, vectors: Array) -> Columns:
    known = np.isfinite(vectors).all(axis=1) & np.isfinite(origins).all(axis=1)
    return build_columns(rr.Arrows3D, known, origins=origins[known], vectors=vectors[known])


def compute_true_force(rows: Rows, tendons: list[int]) -> Array:
    """Return the force [N] on a joint's tip from bench sensors: T_out,a less T_out,b."""
    force: Array = rows["bench_distal_tension"][:, tendons[0]].copy()
    for other in tendons[1:]:
        force -= rows["bench_distal_tension"][:, other]
    return force
