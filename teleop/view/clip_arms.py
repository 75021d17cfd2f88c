"""The arms in space of a clip: links, jaws, tendons, the force at the tip, the hand."""

import math

import numpy as np
from matplotlib.lines import Line2D

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.view import colours
from teleop.view.clip_marks import Marks
from teleop.view.scene_arm_geometry import NUMBER_DISTANCE
from teleop.view.scene_geometry import ARROW, UP

_UNCERTAIN = 0.35  # width of an arrow whose force may be 0, of that of others


class ClipArm:
    """Draws the arm of a number, from 0, and its hand into a scene."""

    def __init__(self, marks: Marks, number: int) -> None:
        self._marks, self._canvas = marks, marks.canvas
        self._place, size = marks.stage.arms[number], marks.stage.size
        self._length = ARROW * size / marks.canvas.data.config.hand_scale_N
        self._beside = NUMBER_DISTANCE * size * UP
        name = f"arm {number + 1}, x {self._place.scale:.2g}"
        marks.draw_place(self._place.base, name, colours.BODY)
        self._draw_axes(self._place.base, np.eye(3))
        self._draw_arm()
        self._draw_force()
        if self._place.arm.hand is not None:
            self._draw_axes(self._place.hand, self._place.arm.hand.rotation)
            self._draw_hand(number)

    def _draw_axes(self, origin: Array, rotation: Array) -> None:
        axes = self._place.build_axes(origin, rotation)
        for axis, colour in zip(axes, colours.AXES, strict=True):
            ink, width = self._canvas.theme.adapt(colour), 1.6 * self._marks.scale
            self._marks.axes.plot(*self._marks.project(axis).T, color=ink, lw=width)

    def _draw_arm(self) -> None:
        data, place, marks = self._canvas.data, self._place, self._marks
        tendons = marks.add_tendons(2.0 * marks.scale)
        links = marks.add_line(colours.BODY, 5.0)
        self._canvas.add(tendons)
        jaws = [marks.add_line(colours.BODY, 3.5) for _ in range(2)]
        joints, asked = self._add_mark(colours.BODY, 9.0), self._add_mark(colours.COMMANDED, 10.0)
        asked.set(markerfacecolor="none", markeredgewidth=2.0 * marks.scale)
        states, samples, commands = (data.select(topic) for topic in (STATE, TENDONS, COMMAND))

        def update(now_s: float) -> None:
            state, sample, command = (
                data.find_newest(r, now_s) for r in (states, samples, commands)
            )
            known = state is not None and place.arm.find_known(np.array([state]))[0]
            for part in (tendons, links, *jaws, joints):
                part.set_visible(bool(known))
            asked.set_visible(command is not None)
            if state is not None and known:
                lines = place.build_lines(state["position"][None])
                marks.move_line(links, lines.links[0])
                for part, jaw in zip(jaws, lines.jaws[0], strict=False):
                    marks.move_line(part, jaw)
                marks.move_line(joints, lines.joints[0])
                tendons.set_segments([marks.project(each[0]) for each in lines.tendons])
                numbers = list(place.tendons)
                unknown = np.full(len(numbers), np.nan)
                tendons.set_array(unknown if sample is None else sample["distal_tension"][numbers])
            if command is not None:
                tips = place.to_scene(place.arm.compute_tips(command["position"][None]))
                marks.move_line(asked, tips)

        self._canvas.updates.append(update)

    def _draw_force(self) -> None:
        data, place, marks = self._canvas.data, self._place, self._marks
        interval = [marks.add_line(colours.INTERVAL, 1.3) for _ in range(3)]
        thick, thin = (marks.add_arrow(colours.ESTIMATE, width) for width in (1.0, _UNCERTAIN))
        number = marks.add_number(colours.ESTIMATE)
        states, limit = data.select(STATE), data.config.hand_scale_N

        def update(now_s: float) -> None:
            state = data.find_newest(states, now_s)
            if state is None or not place.arm.find_known(np.array([state]))[0]:
                for part in (*interval, thick, thin):
                    part.set_visible(False)
                number.set_text("")
                return
            row = np.array([state])
            forces = place.arm.estimate_tip_forces(row)
            tip = place.to_scene(place.arm.compute_tips(row["position"]))
            vector = self._length * forces.force[0] @ place.rotation.T
            certain = bool(forces.along_low[0] > 0.0)
            nothing = np.full(3, np.nan)
            marks.move_arrow(thick, tip[0], vector if certain else nothing)
            marks.move_arrow(thin, tip[0], nothing if certain else vector)
            size = float(np.linalg.norm(forces.force[0]))
            marks.move_number(number, tip[0] + self._beside, size)
            lines = place.build_interval(tip, forces, limit, self._length)[0]
            for part, line in zip(interval, lines, strict=True):
                part.set_visible(True)
                marks.move_line(part, line)

        self._canvas.updates.append(update)

    def _draw_hand(self, number: int) -> None:
        data, place, marks = self._canvas.data, self._place, self._marks
        handle = self._add_mark(colours.HAND, 11.0)
        arrow, text = marks.add_arrow(colours.HAND), marks.add_number(colours.HAND)
        marks.draw_place(place.hand, f"hand {number + 1}", colours.HAND, 0.5)
        rows = data.select(HAND)

        def update(now_s: float) -> None:
            row = data.find_newest(rows, now_s)
            handle.set_visible(row is not None)
            at, force = np.full((2, 3), np.nan)
            if row is not None:
                at = place.place_hand(row["position"][None])[0]
                force = place.turn_hand(row["force"][None])[0]
                marks.move_line(handle, at[None])
            marks.move_arrow(arrow, at, self._length * force)
            size = float(np.linalg.norm(force)) if row is not None else math.nan
            marks.move_number(text, at + self._beside, size)

        self._canvas.updates.append(update)

    def _add_mark(self, colour: int, size: float) -> Line2D:
        mark = self._marks.add_line(colour, 0.0)
        mark.set(linestyle="", marker="o", markersize=size * self._marks.scale)
        return mark
