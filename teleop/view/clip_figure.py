"""The frames of a clip, drawn by Matplotlib: the panels of the live view, without a screen.

What does not move is drawn once; each frame draws only what does on top of it.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

from estimator.array_types import Array
from teleop.messages.messages import PROFILE_POINTS
from teleop.messages.topics import COMMAND, HAND, PROFILE, STATE, TENDONS, Role
from teleop.view import colours
from teleop.view.clip_canvas import THEMES, Canvas, ClipData, ThemeName, Update
from teleop.view.clip_scene import ClipScene
from teleop.view.colours import compute_luminance, to_rgb
from teleop.view.columns import AnyTopic, Rows
from teleop.view.config import Layout
from teleop.view.curves import CURVES, TIP_FORCE, Curve
from teleop.view.panel import build_banner
from teleop.view.scene_joints import compute_true_force
from teleop.view.scene_sheaths import compute_tension_band
from teleop.view.space_arm import find_arm

_HEIGHT = 7.2  # [inches] of every figure: text has the same share of it at any size


class _Line(NamedTuple):
    """A curve over time."""

    curve: Curve
    times: Array  # [s]
    values: Array
    dashed: bool = False


class _Interval(NamedTuple):
    """An area between two curves over time."""

    times: Array  # [s]
    low: Array
    high: Array
    colour: int = colours.ESTIMATE


class ClipFigure:
    """Draws the frames of a clip.

    `size` is width and height [pixels]; curves are those of `joint`, from 0, the scene has all.
    """

    def __init__(
        self, data: ClipData, layout: Layout, theme: ThemeName, size: tuple[int, int], joint: int
    ) -> None:
        self._data, self._theme = data, THEMES[theme]
        self._top = data.config.tension_scale_N
        self._joint, self._tendons = joint, data.sheaths.list_tendons(joint)
        self._arm = find_arm(data.sheaths.arms, joint)
        arrange = {
            "experiment": self._arrange_experiment,
            "presentation": self._arrange_presentation,
            "surgeon": self._arrange_surgeon,
        }[layout]
        with mpl.rc_context(self._build_style()):
            width = _HEIGHT * size[0] / size[1]
            self.figure = Figure((width, _HEIGHT), dpi=size[1] / _HEIGHT)
            self._canvas = Canvas(self.figure, data, self._theme)
            self._agg = cast(Any, FigureCanvasAgg(self.figure))
            arrange()
            self._agg.draw()
        self._ground = self._agg.copy_from_bbox(self.figure.bbox)

    def draw(self, now_s: float) -> NDArray[np.uint8]:
        """Return the frame at a time [s], shape (height, width, 3)."""
        self._agg.restore_region(self._ground)
        for update in self._canvas.updates:
            update(now_s)
        for artist in self._canvas.moving:
            (artist.axes or self.figure).draw_artist(artist)
        return np.asarray(self._agg.buffer_rgba())[..., :3].copy()

    def _build_style(self) -> dict[Any, Any]:
        theme = self._theme
        ink = dict.fromkeys(
            ("text.color", "axes.labelcolor", "xtick.color", "ytick.color", "axes.edgecolor"),
            theme.ink,
        )
        return {
            **ink,
            "figure.facecolor": theme.background,
            "axes.facecolor": theme.background,
            "grid.color": theme.grid,
            "axes.grid": True,
            "axes.axisbelow": True,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.titlelocation": "left",
            "axes.titlesize": 11.0,
            "axes.titleweight": "bold",
            "font.size": 10.0,
            "legend.frameon": False,
            "legend.fontsize": 9.0,
        }

    # --- layouts

    def _arrange_experiment(self) -> None:
        self._draw_header(0.965, 15.0)
        ClipScene(self._canvas, self.figure.add_axes((0.005, 0.37, 0.50, 0.54)))
        self._draw_profile(self.figure.add_axes((0.045, 0.085, 0.44, 0.22)))
        panels = [self._draw_tension, self._draw_force, self._draw_position]
        if self._arm is not None:
            panels.insert(0, self._draw_tip_force)
        grid = self.figure.add_gridspec(
            len(panels), 1, left=0.555, right=0.985, bottom=0.085, top=0.88, hspace=0.34
        )
        for place, draw in enumerate(panels):
            axes = self.figure.add_subplot(grid[place])
            draw(axes)
            if place < len(panels) - 1:
                axes.tick_params(labelbottom=False)
            else:
                axes.set_xlabel("time [s] before now", labelpad=1.0)

    def _arrange_presentation(self) -> None:
        self._draw_header(0.965, 15.0)
        ClipScene(self._canvas, self.figure.add_axes((0.01, 0.01, 0.98, 0.91)), large=True)

    def _arrange_surgeon(self) -> None:
        self._draw_header(0.85, 56.0, tall=0.30)
        joints = max(len(self._data.sheaths.joints), 1)
        for joint in range(joints):
            tall = 0.60 / joints
            bottom = 0.06 + tall * (joints - 1 - joint)
            axes = self.figure.add_axes((0.42, bottom + 0.25 * tall, 0.54, 0.5 * tall))
            self._draw_force_bar(axes, joint, min(90.0, 220.0 * tall), joints > 1)

    # --- the state, over the whole width

    def _draw_header(self, middle: float, size: float, tall: float = 0.07) -> None:
        area = Rectangle((0, middle - tall / 2), 1, tall, linewidth=0)
        self.figure.add_artist(area)
        big = tall > 0.1
        state = self.figure.text(
            0.5 if big else 0.02, middle + 0.03 * big, "", fontsize=size, weight="bold",
            ha="center" if big else "left", va="center_baseline",
        )  # fmt: skip
        reason = self.figure.text(
            0.5, middle - (0.10 if big else 0.0), "", fontsize=20.0 if big else 12.0,
            ha="center", va="center_baseline",
        )  # fmt: skip
        clock = self.figure.text(
            0.98, 0.03 if big else middle, "", fontsize=13.0, ha="right", va="center_baseline"
        )
        for artist in (area, state, reason, clock):
            self._canvas.add(artist)
        sides = {
            role: self._data.select(topic)
            for role, topic in ((Role.MASTER, HAND), (Role.SLAVE, STATE))
        }

        def update(now_s: float) -> None:
            rows = {
                role: self._data.find_newest(all_rows, now_s) for role, all_rows in sides.items()
            }
            banner = build_banner(
                {r: (int(row["state"]), int(row["reason"])) for r, row in rows.items() if row}
            )
            colour = colours.STATES.get(banner.state, colours.STATES["off"])
            rgb = to_rgb(colour)
            ink = "black" if compute_luminance(rgb) > 0.3 else "white"
            area.set_facecolor(rgb)
            state.set(text=banner.state, color=ink)
            reason.set(text=banner.reason, color=ink)
            clock.set(text=f"{now_s:.1f} s", color=self._theme.ink if big else ink)

        self._canvas.updates.append(update)

    # --- T(x) now

    def _draw_profile(self, axes: Axes) -> None:
        data, theme = self._data, self._theme
        rows = {tendon: data.select(PROFILE, tendon) for tendon in self._tendons}
        length = max((float(r["length"].max()) for r in rows.values() if len(r)), default=1.0)
        axes.set(xlim=(0, length), ylim=(0, 1.08 * self._top))
        axes.set_title("T(x) [N]")
        axes.set_xlabel("x [m] from the housing", labelpad=1.0)
        samples = data.select(TENDONS)
        handles: list[tuple[Any, str]] = []
        for tendon in self._tendons:
            colour = (colours.ESTIMATE, colours.SECOND)[self._tendons.index(tendon) % 2]
            band = axes.add_patch(Polygon([(0, 0)], color=theme.fade(colour, theme.band_share)))
            self._canvas.add(band)
            stuck, sliding = (self._canvas.add_line(axes, colour, width) for width in (1.6, 3.6))
            front = Line2D([], [], ls="", marker="o", ms=8, color=theme.adapt(colours.FRONT))
            true = Line2D([], [], ls="", marker="D", ms=7, color=theme.adapt(colours.TRUTH))
            for mark in (front, true):
                axes.add_line(mark)
                self._canvas.add(mark)
            true.set_clip_on(False)
            name = f" {data.sheaths.name_tendon(tendon)}" if len(self._tendons) > 1 else ""
            handles.append((sliding, f"estimated{name}"))
            if tendon == self._tendons[-1]:
                handles += [(band, "interval"), (front, "X'"), (true, "true")]
            parts = band, stuck, sliding, front, true
            self._canvas.updates.append(
                self._build_profile_update(tendon, rows[tendon], samples, parts)
            )
        _add_legend(axes, handles)

    def _build_profile_update(
        self, tendon: int, rows: Rows, samples: Rows, parts: tuple[Any, ...]
    ) -> Update:
        """Return what moves the curve of a tendon, its band and its marks."""
        band, stuck, sliding, front, true = parts
        friction = self._data.sheaths.friction.get(tendon, np.zeros(PROFILE_POINTS))

        def update(now_s: float) -> None:
            row, sample = (
                self._data.find_newest(rows, now_s),
                self._data.find_newest(samples, now_s),
            )
            for part in parts:
                part.set_visible(row is not None and sample is not None)
            if row is None or sample is None:
                return
            x = np.linspace(0.0, float(row["length"]), PROFILE_POINTS)
            tension, at = row["tension"], float(np.nan_to_num(row["front"]))
            stuck.set_data(x, tension)
            height = float(np.interp(at, x, tension))
            sliding.set_data([*x[x < at], at], [*tension[x < at], height])
            front.set_data([at], [height])
            low, high = compute_tension_band(
                friction,
                tension[:1],
                sample["distal_tension_low"][tendon : tendon + 1],
                sample["distal_tension_high"][tendon : tendon + 1],
            )
            there, back = np.stack([x, low[0]], 1), np.stack([x, high[0]], 1)[::-1]
            band.set_xy(np.nan_to_num(np.concatenate([there, back]), posinf=2.0 * self._top))
            true.set_data(x[-1:], [sample["bench_distal_tension"][tendon]])

        return update

    # --- curves over time

    def _draw_tension(self, axes: Axes) -> None:
        names = [f"tension/{{}}/{part}" for part in ("in", "out", "out_true")]
        curves = [(curve, t) for t in self._tendons for curve in find_curves(TENDONS, names)]
        title = "Tension [N]"
        if len(self._tendons) > 1:
            first, second, *_ = map(self._data.sheaths.name_tendon, self._tendons)
            title += f"  {first}, dashed: {second}"
        self._draw_curves(axes, title, [(TENDONS, *each) for each in curves])

    def _draw_force(self, axes: Axes) -> None:
        states, tendons = self._data.select(STATE), self._data.select(TENDONS)
        (curve,) = find_curves(STATE, ["force/{}/tip"])
        lines = [_Line(curve, self._data.to_seconds(states), states["force"][:, self._joint])]
        if self._arm is None:  # tendons of other joints load those of an arm, too
            truth = Curve("", "", "true", colours.TRUTH)
            true = compute_true_force(tendons, self._tendons)
            lines.append(_Line(truth, self._data.to_seconds(tendons), true))
        low, high = (states[name][:, self._joint] for name in ("force_low", "force_high"))
        interval = _Interval(self._data.to_seconds(states), low, high)
        title = "Force at the tip [N]" if self._arm is None else "Force at the joint [N]"
        self._draw_lines(axes, title, lines, [interval])

    def _draw_tip_force(self, axes: Axes) -> None:
        """Draw the components of the force at the tip of the arm that can be told."""
        arm = self._arm
        if arm is None:
            return
        states = self._data.select(STATE)
        times, forces = self._data.to_seconds(states), arm.estimate_tip_forces(states)
        lines, intervals = [], []
        for curve, (force, low, high) in zip(TIP_FORCE, forces.list_components(), strict=True):
            lines.append(_Line(curve, times, force))
            intervals.append(_Interval(times, low, high, curve.colour))
        self._draw_lines(axes, "Force at the tip of the arm [N]", lines, intervals)

    def _draw_position(self, axes: Axes) -> None:
        first = self._tendons[0]
        (truth,) = find_curves(TENDONS, ["displacement/{}/out_true"])
        (asked,) = find_curves(COMMAND, ["position/{}/asked"])
        (tip,) = find_curves(STATE, ["position/{}/tip"])
        series: list[tuple[AnyTopic, Curve, int]]
        series = [(TENDONS, truth, first), (STATE, tip, self._joint), (COMMAND, asked, self._joint)]
        self._draw_curves(axes, "Tip [mm]", series)

    def _draw_curves(
        self, axes: Axes, title: str, series: Sequence[tuple[AnyTopic, Curve, int]]
    ) -> None:
        lines = []
        for topic, curve, column in series:
            rows = self._data.select(topic)
            values = rows[curve.field][:, column] * curve.factor
            dashed = topic is TENDONS and column != self._tendons[0]
            lines.append(_Line(curve, self._data.to_seconds(rows), values, dashed))
        self._draw_lines(axes, title, lines)

    def _draw_lines(
        self, axes: Axes, title: str, lines: Sequence[_Line], intervals: Sequence[_Interval] = ()
    ) -> None:
        """Draw curves over the recent past, and intervals behind them."""
        window = self._data.config.window_s
        lines = [line for line in lines if np.isfinite(line.values).any()]
        low = min((float(np.nanmin(line.values)) for line in lines), default=0.0)
        high = max((float(np.nanmax(line.values)) for line in lines), default=1.0)
        room = 0.12 * max(high - low, 1e-3)
        axes.set(xlim=(-window, 0), ylim=(min(low, 0.0) - room, high + room))
        axes.set_title(title)
        handles: list[tuple[Any, str]] = []
        moved: list[tuple[Line2D, _Line]] = []
        for number, (times, low_end, high_end, colour) in enumerate(intervals):
            if len(intervals) > 1:  # one is seen through the others
                area = PolyCollection([], facecolor=self._theme.adapt(colour), linewidth=0)
                area.set_alpha(self._theme.band_share)
            else:
                faded = self._theme.fade(colour, self._theme.band_share)
                area = PolyCollection([], facecolor=faded, linewidth=0)
            axes.add_collection(area, autolim=False)
            self._canvas.add(area)
            if number == 0:
                handles.append((area, "interval"))
            self._canvas.updates.append(_build_area_update(area, times, low_end, high_end, window))
        for line in lines:
            artist = self._canvas.add_line(axes, line.curve.colour, 1.1 * line.curve.width)
            moved.append((artist, line))
            if line.dashed:
                artist.set_linestyle((0, (3.0, 2.0)))
            else:
                handles.append((artist, line.curve.name))
        _add_legend(axes, handles)

        def update(now_s: float) -> None:
            for artist, line in moved:
                shown = _select_window(line.times, now_s, window)
                artist.set_data(line.times[shown] - now_s, line.values[shown])

        self._canvas.updates.append(update)

    # --- force in large letters

    def _draw_force_bar(self, axes: Axes, joint: int, size: float, named: bool) -> None:
        data = self._data
        limits = data.select(COMMAND)["force_max"]
        limits = limits[np.isfinite(limits) & (limits > 0)]
        limit = float(limits[-1]) if len(limits) else self._top
        two_way = len(data.sheaths.list_tendons(joint)) > 1
        axes.set(xlim=(-limit if two_way else 0.0, limit), ylim=(-0.5, 0.5), yticks=[])
        axes.spines[["top", "right"]].set_visible(True)
        name = f"joint {joint + 1}, " if named else ""
        axes.set_title(f"{name}force at the tip, limit {limit:g} N", weight="normal", fontsize=15.0)
        axes.tick_params(labelsize=13.0)
        bar = self._canvas.add(axes.add_patch(Rectangle((0, -0.5), 0, 1, linewidth=0)))
        number = axes.text(
            -0.06, 0.5, "", fontsize=size, weight="bold", ha="right", va="center",
            transform=axes.transAxes, clip_on=False,
        )  # fmt: skip
        self._canvas.add(number)
        rows = data.select(STATE)

        def update(now_s: float) -> None:
            row = data.find_newest(rows, now_s)
            value = math.nan if row is None else float(row["force"][joint])
            colour = self._theme.adapt(colours.choose_force_colour(np.nan_to_num(value / limit)))
            bar.set(width=np.clip(np.nan_to_num(value), -limit, limit), facecolor=colour)
            number.set(text="" if math.isnan(value) else f"{value:.1f} N", color=colour)

        self._canvas.updates.append(update)


# --- places and parts


def find_curves(topic: AnyTopic, paths: Sequence[str]) -> list[Curve]:
    """Return curves of the live view by their paths."""
    curves = {curve.path: curve for group in CURVES[topic] for curve in group.curves}
    return [curves[path] for path in paths]


def _select_window(times: Array, now_s: float, window_s: float) -> slice:
    first, last = np.searchsorted(times, (now_s - window_s, now_s), side="right")
    return slice(int(first), int(last))


def _build_area_update(
    area: PolyCollection, times: Array, low: Array, high: Array, window_s: float
) -> Update:
    """Return what moves an area between two curves; it has gaps where one is not finite."""

    def update(now_s: float) -> None:
        shown = _select_window(times, now_s, window_s)
        x, ends = times[shown] - now_s, (low[shown], high[shown])
        known = np.isfinite(ends[0]) & np.isfinite(ends[1])
        runs = np.split(np.arange(len(x)), np.flatnonzero(np.diff(known)) + 1)
        area.set_verts(
            [
                np.concatenate(
                    [np.stack([x[r], ends[0][r]], 1), np.stack([x[r], ends[1][r]], 1)[::-1]]
                )
                for r in runs
                if len(r) > 1 and known[r[0]]
            ]
        )

    return update


def _add_legend(axes: Axes, handles: Sequence[tuple[Any, str]]) -> None:
    """Name what is drawn, right of the title."""
    artists, names = [h for h, _ in handles], [name for _, name in handles]
    axes.legend(
        artists, names, loc="lower right", bbox_to_anchor=(1.01, 0.97), ncols=len(names),
        columnspacing=1.1, handlelength=1.3, borderaxespad=0.2,
    )  # fmt: skip
