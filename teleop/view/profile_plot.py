"""Plots with axes of their own on Rerun's two-dimensional plane: T(x), and T_out over T_in.

Rerun's plane has y downwards and equal scales, so both quantities are divided by a reference: the
plot is `width` wide and 1 high.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from estimator.array_types import Array
from teleop.messages.messages import PROFILE_POINTS
from teleop.view.colours import BAND, ESTIMATE, FRONT, LABEL, SECOND, to_rgba
from teleop.view.columns import Rows, Sender, build_columns
from teleop.view.scene_sheaths import Painter, compute_tension_band

_TICK = 0.02


@dataclass(frozen=True, slots=True)
class Plane:
    """The references of a plot and the words at its axes."""

    right: float  # of the quantity across, at the right end
    top: float  # of the quantity upwards, at the top
    width: float
    across: str  # with its unit
    upwards: str

    def to_points(self, across: Array, upwards: Array) -> Array:
        """Return plane points, shape (..., 2)."""
        x, y = np.broadcast_arrays(self.width * across / self.right, -upwards / self.top)
        return np.stack([x, y], axis=-1)

    def build_axes(self) -> tuple[list[Array], list[tuple[Array, str]]]:
        """Return the lines of the axes with their ticks, and the labels with their places."""
        lines = [np.array([[0.0, 0.0], [self.width, 0.0]]), np.array([[0.0, 0.0], [0.0, -1.0]])]
        labels = [
            (np.array([self.width / 2, 0.19]), self.across),
            (np.array([0.02 + 0.022 * len(self.upwards), -1.12]), self.upwards),
        ]
        for x in compute_ticks(self.right):
            at = self.to_points(np.array(x), np.array(0.0))
            lines.append(np.array([at, at + np.array([0, _TICK])]))
            labels.append((at + np.array([0, 0.08]), f"{x:g}"))
        for y in compute_ticks(self.top):
            at = self.to_points(np.array(0.0), np.array(y))
            lines.append(np.array([at - np.array([_TICK, 0]), at]))
            labels.append((at - np.array([0.09, 0]), f"{y:g}"))
        return lines, labels

    def draw_axes(self, sender: Sender, root: str) -> None:
        """Send the axes and their labels."""
        lines, labels = self.build_axes()
        sender.send_static(f"{root}/axes", rr.LineStrips2D(lines, colors=0x808080FF, radii=0.004))
        places, texts = zip(*labels, strict=True)
        sender.send_words(f"{root}/labels", rr.Points2D, places, texts, LABEL)


def _choose_tick_step(top: float) -> float:
    """Return the distance of round values, of which three to seven reach from 0 to `top`."""
    step = 10 ** math.floor(math.log10(top / 2))
    factor = next(factor for factor in (1, 2, 5, 10) if top / (step * factor) < 6)
    return float(step * factor)


def compute_ticks(top: float) -> list[float]:
    """Return round values from 0 to `top`, three to seven of them."""
    step = _choose_tick_step(top)
    return [round(k * step, 12) for k in range(math.floor(top / step * (1 + 1e-9)) + 1)]


def compute_axis_end(top: float) -> float:
    """Return where an axis for values up to `top` ends: on the last of its own ticks."""
    end, step = top, 0.0
    while step != _choose_tick_step(end):  # the longer axis may have another step
        step = _choose_tick_step(end)
        end = round(math.ceil(top / step * (1 - 1e-9)) * step, 12)
    return end


def compute_ticks_to_end(top: float) -> list[float]:
    """Return ticks and `top` itself, without a tick so near to it that labels would collide."""
    step = _choose_tick_step(top)
    return [value for value in compute_ticks(top) if value <= top - 0.5 * step] + [top]


# --- T(x) now: the curve with its certified band, the part that slides, and X'

WIDTH = 1.8
_TIME_DIFFERENCE_MAX_NS = 50_000_000  # [ns] between a profile and the tip's interval, at most
_TAIL_NS = 200_000_000
_BANDS = (BAND, 0x45431EFF)  # dim, so that the curve stands out: tendon a, tendon b
_CURVES = ((ESTIMATE, 0x3C7DA2FF), (SECOND, 0x97904CFF))  # slides, sticks: tendon a, tendon b
_SCALE_STEPS = 64


class ProfileView(Painter):
    """Draws T(x) of each tendon, under `profile/tendon_<i>`; with `values` sends its band too."""

    def __init__(self, *parts: Any, values: bool = True) -> None:
        super().__init__(*parts)
        self._values = values
        self._plane: Plane | None = None
        self._tail: Rows | None = None  # the newest TendonState rows

    def add(self, rows: Rows) -> None:
        """Add TendonState rows, for the interval at the tip."""
        tail = rows if self._tail is None else np.concatenate([self._tail, rows])
        self._tail = tail[tail["stamp_ns"] >= tail["stamp_ns"][-1] - _TAIL_NS]

    def draw(self, tendon: int, rows: Rows) -> None:
        """Draw some instants."""
        length = rows["length"]
        longest = float(length.max(initial=0.0))
        if not longest > 0:
            return
        if self._plane is None or longest > self._plane.right:
            ends = compute_axis_end(longest), compute_axis_end(self._config.tension_scale_N)
            self._plane = Plane(*ends, WIDTH, "x [m] from the housing", "T [N]")
            self._plane.draw_axes(self._sender, "profile")
            self._draw_scale(self._plane)
        x = length[:, None] * np.linspace(0.0, 1.0, PROFILE_POINTS)
        self._draw_band(tendon, rows, self._plane, x)
        self._draw_curve(tendon, rows, self._plane, x)

    def send_values(self, tendon: int, rows: Rows) -> None:
        """Send T(x) as numbers, for Rerun's tools."""
        tension = rr.AnyValues.columns(tension=rows["tension"].ravel())
        points = [PROFILE_POINTS] * len(rows)
        self._sender.send_columns(
            f"profile/tendon_{tendon}/tension", rows, tension.partition(points)
        )

    def _draw_curve(self, tendon: int, rows: Rows, plane: Plane, x: Array) -> None:
        """Draw T(x) in two pieces that meet at X'."""
        path, side = f"profile/tendon_{tendon}", self._find_side(tendon)
        slides, sticks = _CURVES[side]
        style = rr.LineStrips2D.from_fields(colors=[slides, sticks], radii=[0.012, 0.005])
        mark = rr.Points2D.from_fields(colors=FRONT, radii=0.022)
        if not self._sender.has_style(f"{path}/curve"):
            self._sender.send_once(f"{path}/curve", style)
            self._sender.send_static(f"{path}/curve", mark)
        name = rr.Points2D(
            [[WIDTH - 0.95 + 0.75 * side, -1.12]],
            labels=f"estimated {self._sheaths.name_tendon(tendon)}",
            colors=slides, radii=1e-4, show_labels=True,
        )  # fmt: skip
        self._sender.send_once(f"{path}/name", name)
        front = np.clip(np.nan_to_num(rows["front"]), 0.0, rows["length"])
        at = [np.interp(f, row, T) for f, row, T in zip(front, x, rows["tension"], strict=True)]
        top = 1.05 * plane.top  # what is beyond the plot runs along its edge, as its band
        fronts = plane.to_points(front, np.minimum(at, top))
        pieces = []
        for points, row, f, point in zip(
            plane.to_points(x, np.minimum(rows["tension"], top)), x, front, fronts, strict=True
        ):
            behind, ahead = row < f, row > f
            pieces.append(np.concatenate([points[behind], [point, point][: 2 - behind.any()]]))
            pieces.append(np.concatenate([[point, point][: 2 - ahead.any()], points[ahead]]))
        curve = build_columns(rr.LineStrips2D, np.full(len(rows), 2), strips=pieces)
        known = np.isfinite(rows["front"])
        curve += build_columns(rr.Points2D, known, positions=fronts[known])
        self._sender.send_columns(f"{path}/curve", rows, curve)

    def _draw_band(self, tendon: int, rows: Rows, plane: Plane, x: Array) -> None:
        """Draw the certified band of T(x) as one broad zigzag line."""
        ends = self._find_tip_interval(tendon, rows)
        if tendon not in self._sheaths.friction or ends is None:
            return
        path = f"profile/tendon_{tendon}/band"
        low, high = compute_tension_band(
            self._sheaths.friction[tendon], rows["tension"][:, 0], *ends
        )
        style = rr.LineStrips2D.from_fields(
            colors=_BANDS[self._find_side(tendon)],
            radii=0.9 * WIDTH / (PROFILE_POINTS - 1),  # more than half: no gaps
            draw_order=-10.0,
        )
        self._sender.send_once(path, style)
        known = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        top = 1.05 * plane.top  # the interval may be far wider than the plot
        bars = np.stack(
            [
                plane.to_points(x[known], np.minimum(low[known], top)),
                plane.to_points(x[known], np.minimum(high[known], top)),
            ],
            axis=2,
        )
        bars[:, 1::2] = bars[:, 1::2, ::-1]
        strips = bars.reshape(-1, 2 * PROFILE_POINTS, 2)
        drawn = build_columns(rr.LineStrips2D, known, strips=strips)
        if self._values:
            values = rr.AnyValues.columns(low=low.ravel(), high=high.ravel())
            drawn += values.partition([PROFILE_POINTS] * len(rows))
        self._sender.send_columns(path, rows, drawn)

    def _find_tip_interval(self, tendon: int, rows: Rows) -> tuple[Array, Array] | None:
        """Return the interval of T_out at each profile; NaN without one near it."""
        if self._tail is None:
            return None
        stamps = self._tail["stamp_ns"]
        at = np.clip(np.searchsorted(stamps, rows["stamp_ns"], side="right") - 1, 0, None)
        far = np.abs(stamps[at] - rows["stamp_ns"]) > _TIME_DIFFERENCE_MAX_NS
        low = np.where(far, np.nan, self._tail["distal_tension_low"][at, tendon])
        high = np.where(far, np.nan, self._tail["distal_tension_high"][at, tendon])
        return low, high

    def _find_side(self, tendon: int) -> int:
        """Return 0 for a joint's tendon a, 1 for b."""
        shape = self._sheaths.shapes.get(tendon)
        own = [tendon] if shape is None else self._sheaths.list_tendons(shape.joint)
        return own.index(tendon) % 2

    def _draw_scale(self, plane: Plane) -> None:
        """Draw the colour scale of the tubes along the tension axis."""
        rungs = np.linspace(0.0, plane.top, _SCALE_STEPS + 1)
        edge = plane.to_points(np.zeros_like(rungs), rungs)
        scale = rr.LineStrips2D(
            np.stack([edge[:-1], edge[1:]], axis=1),
            colors=to_rgba((rungs[1:] + rungs[:-1]) / 2, self._config.tension_scale_N),
            radii=0.015,
        )
        self._sender.send_static("profile/scale", scale)
