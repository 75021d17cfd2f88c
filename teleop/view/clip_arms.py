"""The arms in space of a clip: links, jaws, tendons, the force at the tip, the hand."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.view import colours
from teleop.view.arm_place import NUMBER_DISTANCE
from teleop.view.clip_canvas import Canvas
from teleop.view.clip_marks import (
    add_arrow,
    add_number,
    build_tension_colours,
    draw_place,
    project,
    set_arrow,
    set_number,
)
from teleop.view.scene_geometry import ARROW, UP, Stage
from teleop.view.space_arm import TipForces

_UNCERTAIN = 0.35  # width of an arrow whose force may be 0, of that of others


class ClipArm:
    """Draws an arm and its hand into the axes of the scene.

    Parameters
    ----------
    number : int
        Of the arm, from 0.
    scale : float
        Of widths and letters.
    """

    def __init__(self, canvas: Canvas, axes: Axes, stage: Stage, number: int, scale: float) -> None:
        self._canvas, self._axes, self._stage, self._scale = canvas, axes, stage, scale
        self._place = stage.arms[number]
        self._length = ARROW * stage.size / canvas.data.config.hand_scale_N
        self._beside = NUMBER_DISTANCE * stage.size * UP
        name = f"arm {number + 1}, x {self._place.scale:.2g}"
        draw_place(canvas, axes, stage, self._place.base, name, colours.BODY, scale)
        self._draw_axes(self._place.base, np.eye(3))
        self._draw_arm()
        self._draw_force()
        if self._place.arm.hand is not None:
            self._draw_axes(self._place.hand, self._place.arm.hand.rotation)
            self._draw_hand(number)

    def _draw_axes(self, origin: Array, rotation: Array) -> None:
        for axis, colour in zip(
            self._place.build_axes(origin, rotation), colours.AXES, strict=True
        ):
            line = project(self._stage, axis).T
            self._axes.plot(*line, color=self._canvas.theme.adapt(colour), lw=1.6 * self._scale)

    def _draw_arm(self) -> None:
        data, place, scale = self._canvas.data, self._place, self._scale
        top = data.config.tension_scale_N
        tendons = LineCollection([], capstyle="round", linewidth=2.0 * scale)
        tendons.set(cmap=build_tension_colours(), norm=Normalize(0, top))
        self._axes.add_artist(tendons)
        links = self._canvas.add_line(self._axes, colours.BODY, 5.0 * scale)
        self._canvas.add(tendons)
        jaws = [self._canvas.add_line(self._axes, colours.BODY, 3.5 * scale) for _ in range(2)]
        marks = [
            self._add_mark(colours.BODY, 9.0 * scale),
            self._add_mark(colours.COMMANDED, 10.0 * scale),
        ]
        marks[1].set(markerfacecolor="none", markeredgewidth=2.0 * scale)
        states, samples, commands = (data.select(topic) for topic in (STATE, TENDONS, COMMAND))

        def update(now_s: float) -> None:
            state, sample, command = (data.newest(r, now_s) for r in (states, samples, commands))
            known = state is not None and place.arm.find_known(np.array([state]))[0]
            for part in (tendons, links, *jaws, marks[0]):
                part.set_visible(bool(known))
            marks[1].set_visible(command is not None)
            if state is not None and known:
                lines = place.build_lines(state["position"][None])
                _set_points(links, self._stage, lines.links[0])
                for part, jaw in zip(jaws, lines.jaws[0], strict=False):
                    _set_points(part, self._stage, jaw)
                _set_points(marks[0], self._stage, lines.joints[0])
                tendons.set_segments([project(self._stage, each[0]) for each in lines.tendons])
                numbers = list(place.tendons)
                unknown = np.full(len(numbers), np.nan)
                tendons.set_array(unknown if sample is None else sample["distal_tension"][numbers])
            if command is not None:
                tips = place.to_scene(place.arm.compute_tips(command["position"][None]))
                _set_points(marks[1], self._stage, tips)

        self._canvas.updates.append(update)

    def _draw_force(self) -> None:
        data, place = self._canvas.data, self._place
        interval = [
            self._canvas.add_line(self._axes, colours.INTERVAL, 1.3 * self._scale) for _ in range(3)
        ]
        thick, thin = (
            add_arrow(self._canvas, self._axes, colours.ESTIMATE, width * self._scale)
            for width in (1.0, _UNCERTAIN)
        )
        number = add_number(self._canvas, self._axes, colours.ESTIMATE, self._scale)
        states, limit = data.select(STATE), data.config.hand_scale_N

        def update(now_s: float) -> None:
            state = data.newest(states, now_s)
            if state is None or not place.arm.find_known(np.array([state]))[0]:
                for part in (*interval, thick, thin):
                    part.set_visible(False)
                number.set_text("")
                return
            row = np.array([state])
            forces: TipForces = place.arm.estimate_tip_forces(row)
            tip = place.to_scene(place.arm.compute_tips(row["position"]))
            vector = self._length * forces.force[0] @ place.rotation.T
            certain = bool(forces.along_low[0] > 0.0)
            nothing = np.full(3, np.nan)
            set_arrow(thick, self._stage, tip[0], vector if certain else nothing)
            set_arrow(thin, self._stage, tip[0], nothing if certain else vector)
            size = float(np.linalg.norm(forces.force[0]))
            set_number(number, self._stage, tip[0] + self._beside, size)
            lines = place.build_interval(tip, forces, limit, self._length)[0]
            for part, line in zip(interval, lines, strict=True):
                part.set_visible(True)
                _set_points(part, self._stage, line)

        self._canvas.updates.append(update)

    def _draw_hand(self, number: int) -> None:
        data, place = self._canvas.data, self._place
        mark = self._add_mark(colours.HAND, 11.0 * self._scale)
        arrow = add_arrow(self._canvas, self._axes, colours.HAND, self._scale)
        text = add_number(self._canvas, self._axes, colours.HAND, self._scale)
        draw_place(
            self._canvas, self._axes, self._stage, place.hand, f"hand {number + 1}", colours.HAND,
            0.5 * self._scale,
        )  # fmt: skip
        rows = data.select(HAND)

        def update(now_s: float) -> None:
            row = data.newest(rows, now_s)
            mark.set_visible(row is not None)
            at, force = np.full((2, 3), np.nan)
            if row is not None:
                at = place.place_hand(row["position"][None])[0]
                force = place.turn_hand_force(row["force"][None])[0]
                _set_points(mark, self._stage, at[None])
            set_arrow(arrow, self._stage, at, self._length * force)
            size = float(np.linalg.norm(force)) if row is not None else math.nan
            set_number(text, self._stage, at + self._beside, size)

        self._canvas.updates.append(update)

    def _add_mark(self, colour: int, size: float) -> Line2D:
        mark = Line2D([], [], ls="", marker="o", ms=size, color=self._canvas.theme.adapt(colour))
        self._axes.add_line(mark)
        marked: Line2D = self._canvas.add(mark)
        return marked


def _set_points(line: Any, stage: Stage, points: Array) -> None:
    line.set_data(*project(stage, points).T)
