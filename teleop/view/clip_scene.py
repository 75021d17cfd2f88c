"""The scene of a clip: sheaths, joints, hands and the forces on them, as seen from the eye."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from estimator.array_types import Array
from teleop.messages.topics import COMMAND, HAND, PROFILE, STATE, TENDONS
from teleop.view import colours
from teleop.view.clip_arms import ClipArm
from teleop.view.clip_canvas import Canvas
from teleop.view.clip_marks import Marks
from teleop.view.scene_geometry import ARROW, PIECES, SEGMENTS, Lever, Stage
from teleop.view.scene_joints import compute_true_force

_ARM_WIDTH = 1.4  # of what is drawn of an arm, relative to its sheaths


class ClipScene:
    """Draws the scene into axes; with `large` it has the whole picture."""

    def __init__(self, canvas: Canvas, axes: Axes, large: bool = False) -> None:
        self._canvas, self._data, self._theme = canvas, canvas.data, canvas.theme
        self._top = canvas.data.config.tension_scale_N
        axes.set_axis_off()
        if canvas.data.sheaths.stage is not None:
            self._draw(axes, canvas.data.sheaths.stage, large)

    def _draw(self, axes: Axes, stage: Stage, large: bool) -> None:
        tubes_beside = len(stage.joints) + sum(len(place.ends) / 2 for place in stage.arms)
        scale = (1.7 if large else 1.0) / math.sqrt(max(tubes_beside, 1))
        marks = Marks(self._canvas, axes, stage, scale)
        low, high = self._find_extent(marks)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        tubes = [self._draw_tube(marks, tendon) for tendon in stage.lines]
        scale_axes = axes.inset_axes((0.93, 0.2, 0.016, 0.55))
        bar = self._canvas.figure.colorbar(tubes[0], cax=scale_axes)
        scale_axes.set_title("T [N]", loc="center", fontsize=10.0, weight="normal")
        scale_axes.tick_params(labelsize=13.0 if large else 10.0)
        bar.outline.set_visible(False)
        mark = Line2D([], [], ls="", marker="o", color=self._theme.adapt(colours.FRONT))
        thick, thin = (Line2D([], [], color="#888888", lw=width) for width in (8.0, 3.0))
        axes.legend(
            [thick, thin, mark], ["slides", "friction holds", "X', the front"],
            loc="upper left", bbox_to_anchor=(0.0, 1.02), ncols=3, columnspacing=1.2,
            fontsize=12.0 if large else 9.0,
        )  # fmt: skip
        for joint, lever in stage.joints.items():
            self._draw_tip(marks, joint, lever)
        for joint, lever in stage.hands.items():
            self._draw_hand(marks, joint, lever)
        for number in range(len(stage.arms)):
            ClipArm(Marks(self._canvas, axes, stage, _ARM_WIDTH * scale), number)

    def _find_extent(self, marks: Marks) -> tuple[Array, Array]:
        """Return the corners of what is drawn at any time, with room for words and the scale."""
        stage = marks.stage
        states, hands = self._data.select(STATE)[::20], self._data.select(HAND)[::20]
        points = [*stage.lines.values()]
        points += [place.sample_points(0.5 * ARROW * stage.size) for place in stage.arms]
        for ends, rows, sign, scale in (
            (stage.joints, states, -1.0, self._top),
            (stage.hands, hands, 1.0, self._data.config.hand_scale_N),
        ):
            for joint, lever in ends.items():
                travel = rows["position"][:, joint]
                force = np.nan_to_num(rows["force"][:, joint])[:, None]
                arrow = sign * force * ARROW * stage.size / scale * lever.compute_direction(travel)
                points += [
                    lever.pivot[None],
                    lever.compute_tip(travel),
                    lever.compute_tip(travel) + arrow,
                ]
                points += [lever.compute_tip(travel) + lever.label]
        places = marks.project(np.concatenate(points))
        low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
        room = 0.05 * (high - low).max()
        return low - room * np.array([1.0, 1.6]), high + room * np.array([3.2, 1.6])

    def _draw_tube(self, marks: Marks, tendon: int) -> LineCollection:
        line = marks.project(marks.stage.lines[tendon])
        pieces = [line[k * PIECES : (k + 1) * PIECES + 1] for k in range(SEGMENTS)]
        edge = LineCollection(pieces, capstyle="round", joinstyle="round")
        edge.set(color=self._theme.fade(colours.UNKNOWN, 0.55))
        marks.axes.add_artist(edge)
        tube = marks.add_tendons(1.0)
        tube.set(segments=pieces, joinstyle="round")
        ink = self._theme.adapt(colours.FRONT)
        front = Line2D([], [], marker="o", ms=11 * marks.scale, color=ink)
        marks.axes.add_artist(front)
        for artist in (edge, tube, front):
            self._canvas.add(artist)
        rows = self._data.select(PROFILE, tendon)
        middles = (np.arange(SEGMENTS) + 0.5) / SEGMENTS
        knots = np.linspace(0.0, 1.0, len(line))

        def update(now_s: float) -> None:
            row = self._data.find_newest(rows, now_s)
            share = math.nan if row is None else float(row["front"] / row["length"])
            width = marks.scale * np.where(middles <= np.nan_to_num(share), 9.0, 4.0)
            tube.set_linewidth(width.tolist())
            edge.set_linewidth((width + 1.6).tolist())
            tension = np.full(SEGMENTS, np.nan) if row is None else row["tension"]
            tube.set_array(tension if row is None else (tension[1:] + tension[:-1]) / 2)
            front.set_data(*([np.interp(share, knots, line[:, k])] for k in range(2)))

        self._canvas.updates.append(update)
        return tube

    def _draw_tip(self, marks: Marks, joint: int, lever: Lever) -> None:
        data = self._data
        per_newton, bar = ARROW * marks.stage.size / self._top, lever.aslant
        known = data.config.environment_m
        if joint < len(known) and math.isfinite(known[joint]):
            wedge = marks.project(np.concatenate([lever.pivot[None], lever.sweep(known[joint])]))
            ink = self._theme.adapt(colours.ENVIRONMENT)
            marks.axes.add_patch(Polygon(wedge, color=ink, alpha=0.6, lw=0))
        marks.draw_place(lever.pivot, f"joint {joint + 1}", colours.BODY)
        asked = marks.add_line(colours.COMMANDED, 2.0)
        link = marks.add_line(colours.BODY, 6.0)
        interval = marks.add_line(colours.INTERVAL, 1.6)
        truth = marks.add_arrow(colours.TRUTH, 0.7)
        force, number = marks.add_arrow(colours.ESTIMATE), marks.add_number(colours.ESTIMATE)
        states, commands = data.select(STATE), data.select(COMMAND)
        tendons, own = data.select(TENDONS), data.sheaths.list_tendons(joint)

        def update(now_s: float) -> None:
            state, command = data.find_newest(states, now_s), data.find_newest(commands, now_s)
            sample = data.find_newest(tendons, now_s)
            wanted = math.nan if command is None else float(command["position"][joint])
            marks.move_line(asked, [lever.pivot, lever.compute_tip(np.array(wanted))])
            travel = math.nan if state is None else float(state["position"][joint])
            end, back = (
                lever.compute_tip(np.array(travel)),
                -per_newton * lever.compute_direction(np.array(travel)),
            )
            marks.move_line(link, [lever.pivot, end])
            value = math.nan if state is None else float(state["force"][joint])
            marks.move_arrow(force, end, value * back)
            marks.move_number(number, end + lever.label, value)
            ends = (math.nan,) * 2
            if state is not None:
                ends = state["force_low"][joint], state["force_high"][joint]
            low, high = (end + np.clip(part, -self._top, self._top) * back for part in ends)
            corners = [low - bar, low + bar, low, high, high - bar, high + bar]
            marks.move_line(interval, corners)
            true = math.nan
            if sample is not None:
                true = float(compute_true_force(np.array([sample]), own)[0])
            marks.move_arrow(truth, end + bar, true * back)

        self._canvas.updates.append(update)

    def _draw_hand(self, marks: Marks, joint: int, lever: Lever) -> None:
        data = self._data
        per_newton = ARROW * marks.stage.size / data.config.hand_scale_N
        marks.draw_place(lever.pivot, f"hand {joint + 1}", colours.HAND)
        handle = marks.add_line(colours.HAND, 6.0)
        arrow, number = marks.add_arrow(colours.HAND), marks.add_number(colours.HAND)
        rows = data.select(HAND)

        def update(now_s: float) -> None:
            row = data.find_newest(rows, now_s)
            travel = np.array(math.nan if row is None else float(row["position"][joint]))
            end, onward = lever.compute_tip(travel), lever.compute_direction(travel)
            marks.move_line(handle, [lever.pivot, end])
            value = math.nan if row is None else float(row["force"][joint])
            marks.move_arrow(arrow, end, value * per_newton * onward)
            marks.move_number(number, end + lever.label, value)

        self._canvas.updates.append(update)
