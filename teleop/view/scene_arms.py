"""Arms in space in the scene: links, jaws, tendons, the force at the tip, the hand that moves it.

What stands on one message is one entity where it can be, as in `teleop.view.scene_joints`.
"""

from collections.abc import Iterator, Mapping

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.view import colours
from teleop.view.columns import AnyTopic, Rows, build_columns
from teleop.view.scene_arm_geometry import NUMBER_DISTANCE, ArmPlacement
from teleop.view.scene_geometry import ARROW, UP
from teleop.view.scene_sheaths import Painter

_UNCERTAIN = 0.4  # width of an arrow whose force may be 0, of that of others


class Arms(Painter):
    """Draws the arms in space of the session."""

    def place(self) -> None:
        """Draw the static parts and set the styles."""
        for path, place in self._list_places():
            thick, style = self._config.tube_radius * place.size, self._set_style
            name = f"arm {int(path.rpartition('_')[2]) + 1}, x {place.scale:.2g}"
            self._sender.send_words(
                f"{path}/base", rr.Points3D, [place.base], name, colours.BODY, 1.8 * thick
            )
            self._draw_axes(f"{path}/axes", place, place.base, np.eye(3))
            style(f"{path}/links", rr.LineStrips3D, colors=colours.BODY, radii=0.5 * thick)
            style(f"{path}/links", rr.Points3D, colors=colours.BODY, radii=1.3 * thick)
            style(f"{path}/tendons", rr.LineStrips3D, colors=colours.UNKNOWN, radii=0.4 * thick)
            style(f"{path}/asked", rr.Points3D, colors=colours.COMMANDED, radii=0.9 * thick)
            style(f"{path}/interval", rr.LineStrips3D, colors=colours.INTERVAL, radii=0.2 * thick)
            style(f"{path}/force", rr.Arrows3D, colors=colours.ESTIMATE)
            words = {"colors": colours.ESTIMATE, "radii": 1e-6, "show_labels": True}
            style(f"{path}/force", rr.Points3D, **words)
            if place.arm.hand is not None:
                self._draw_axes(f"{path}/hand/axes", place, place.hand, place.arm.hand.rotation)
                handle = f"{path}/hand/handle"
                style(handle, rr.Points3D, colors=colours.HAND, radii=1.6 * thick)
                style(handle, rr.Arrows3D, colors=colours.HAND, radii=0.7 * thick)

    def draw(self, batches: Mapping[AnyTopic, Rows]) -> None:
        """Draw some instants."""
        if self._list_places():
            self._paint(batches, {
                STATE: self._draw_arms, COMMAND: self._draw_commanded,
                TENDONS: self._draw_tensions, HAND: self._draw_hands,
            })  # fmt: skip

    def forget_forces(self, stamp_ns: int) -> None:
        """Draw no force from one instant [ns] on."""
        for path, place in self._list_places() if self._has_forces else ():
            self._clear(f"{path}/force", stamp_ns, rr.Arrows3D, rr.Points3D)
            self._clear(f"{path}/interval", stamp_ns, rr.LineStrips3D)
            if place.arm.hand is not None:
                self._clear(f"{path}/hand/handle", stamp_ns, rr.Arrows3D)
        self._has_forces = False

    def _list_places(self) -> list[tuple[str, ArmPlacement]]:
        """Return the arms that are placed, each with its entity."""
        stage = self._sheaths.stage
        arms = () if stage is None else stage.arms
        return [(f"scene/arm_{k}", place) for k, place in enumerate(arms)]

    def _select_known(self, rows: Rows) -> Iterator[tuple[str, ArmPlacement, Rows]]:
        """Yield each arm with the rows in which all of its joints have positions."""
        for path, place in self._list_places():
            known = place.arm.find_known(rows)
            if known.any():
                yield path, place, rows[known]

    def _draw_arms(self, rows: Rows) -> None:
        for path, place, known in self._select_known(rows):
            lines = place.build_lines(known["position"])
            count, ones = len(known), np.ones(len(known), dtype=np.int64)
            strips = [strip for k in range(count) for strip in (lines.links[k], *lines.jaws[k])]
            parts = build_columns(rr.LineStrips3D, ones * (1 + lines.jaws.shape[1]), strips=strips)
            if lines.joints.shape[1]:
                at = lines.joints.reshape(-1, 3)
                parts += build_columns(rr.Points3D, ones * lines.joints.shape[1], positions=at)
            self._sender.send_columns(f"{path}/links", known, parts)
            tendons = [each[k] for k in range(count) for each in lines.tendons]
            strips_of_tendons = build_columns(
                rr.LineStrips3D, ones * len(lines.tendons), strips=tendons
            )
            self._sender.send_columns(f"{path}/tendons", known, strips_of_tendons)
            self._draw_force(path, place, known, lines.tip)

    def _draw_force(self, path: str, place: ArmPlacement, rows: Rows, tips: Array) -> None:
        """Draw the force on the tip, thin if it may be 0 in its direction, and its interval."""
        arm = place.arm
        forces = arm.estimate_tip_forces(rows)
        known = np.isfinite(forces.force).all(axis=1)
        length = ARROW * place.size / self._config.hand_scale_N
        thick = 0.7 * self._config.tube_radius * place.size
        radii = np.where(forces.along_low > 0.0, thick, _UNCERTAIN * thick)[known]
        vectors = length * forces.force[known] @ place.rotation.T
        parts = build_columns(rr.Arrows3D, known, origins=tips[known], vectors=vectors, radii=radii)
        size = np.linalg.norm(forces.force, axis=1)
        words = [f"{value:.1f} N" for value in size[known]]
        if arm.has_gripper:
            grip = rows["force"][known, arm.joints[-1]]
            words = [f"{word}, grip {value:.1f} N" for word, value in zip(words, grip, strict=True)]
        at = tips[known] + NUMBER_DISTANCE * place.size * UP
        parts += build_columns(rr.Points3D, known, positions=at, labels=words)
        self._sender.send_columns(f"{path}/force", rows, parts)
        lines = place.build_interval(tips, forces, self._config.hand_scale_N, length)
        shown = known & np.isfinite(lines).all(axis=(1, 2, 3))
        interval = build_columns(rr.LineStrips3D, 3 * shown, strips=lines[shown].reshape(-1, 2, 3))
        self._sender.send_columns(f"{path}/interval", rows, interval)

    def _draw_commanded(self, rows: Rows) -> None:
        for path, place, known in self._select_known(rows):
            at = place.to_scene(place.arm.compute_tips(known["position"]))
            self._sender.send_columns(
                f"{path}/asked", known, build_columns(rr.Points3D, positions=at)
            )

    def _draw_tensions(self, rows: Rows) -> None:
        """Colour the tendons along the arm by the tension at the ends of their sheaths."""
        for path, place in self._list_places():
            tension = rows["distal_tension"][:, list(place.tendons)]
            packed = colours.to_rgba(tension, self._config.tension_scale_N)
            counts = np.full(len(rows), len(place.tendons))
            colour = build_columns(rr.LineStrips3D, counts, colors=packed.ravel())
            self._sender.send_columns(f"{path}/tendons", rows, colour)

    def _draw_hands(self, rows: Rows) -> None:
        for path, place in self._list_places():
            if place.arm.hand is None:
                continue
            at = place.place_hand(rows["position"])
            vectors = place.turn_hand(rows["force"])
            vectors = ARROW * place.size / self._config.hand_scale_N * vectors
            known = np.isfinite(at).all(axis=1) & np.isfinite(vectors).all(axis=1)
            parts = build_columns(rr.Points3D, known, positions=at[known])
            parts += build_columns(rr.Arrows3D, known, origins=at[known], vectors=vectors[known])
            self._sender.send_columns(f"{path}/hand/handle", rows, parts)

    def _draw_axes(self, path: str, place: ArmPlacement, origin: Array, rotation: Array) -> None:
        axes = rr.LineStrips3D(
            list(place.build_axes(origin, rotation)),
            colors=np.array(colours.AXES, np.uint32),
            radii=0.25 * self._config.tube_radius * place.size,
            labels=["x", "y", "z"],
            show_labels=True,
        )
        self._sender.send_static(path, axes)
