"""What the panels of a clip share: its data, its colours, and the artists that move."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimator.array_types import Array
from teleop.view import colours
from teleop.view.colours import Rgb, compute_luminance, to_rgb
from teleop.view.columns import AnyTopic, Rows
from teleop.view.config import ViewConfig
from teleop.view.scene_sheaths import Sheaths

ThemeName = Literal["light", "dark"]
STALE_S = 1.0  # [s] after which the newest message no longer counts
_CONTRAST_MIN = 3.0  # of a line on its background (WCAG 2.2, 1.4.11)


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of what carries no meaning."""

    background: Rgb
    ink: str
    grid: str
    band_share: float  # of the estimate's colour in the area of its interval

    def adapt(self, colour: int) -> Rgb:
        """Return a colour of the live view, dark or light enough for this background."""
        red, green, blue = to_rgb(colour)
        while _compute_contrast((red, green, blue), self.background) < _CONTRAST_MIN:
            red, green, blue = 0.95 * red, 0.95 * green, 0.95 * blue
        return red, green, blue

    def fade(self, colour: int, share: float) -> Rgb:
        """Return a mixture of a colour with the background."""
        pairs = zip(self.adapt(colour), self.background, strict=True)
        red, green, blue = (share * part + (1.0 - share) * ground for part, ground in pairs)
        return red, green, blue


def _compute_contrast(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the contrast ratio of two sRGB colours, as WCAG defines it."""
    bright, dark = sorted(map(compute_luminance, (a, b)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


_R, _G, _B = (part / 255 for part in colours.BACKGROUND)
THEMES: dict[ThemeName, Theme] = {
    "light": Theme((1.0, 1.0, 1.0), "#222222", "#e4e4e4", 0.25),
    "dark": Theme((_R, _G, _B), "#e8e8e8", "#2c3038", 0.40),
}


@dataclass(frozen=True, slots=True)
class ClipData:
    """What a clip is drawn from."""

    config: ViewConfig
    sheaths: Sheaths
    rows: Mapping[AnyTopic, Rows]  # by stamp
    begin_ns: int  # of the recording: second 0

    def select(self, topic: AnyTopic, tendon: int | None = None) -> Rows:
        """Return the rows of a topic, of one tendon if it has one message for each."""
        rows = self.rows.get(topic)
        if rows is None:
            return np.empty(0, topic.message.schema.dtype)
        return rows if tendon is None else rows[rows["tendon"] == tendon]

    def to_seconds(self, rows: Rows) -> Array:
        """Return the times of rows [s], from the beginning of the recording."""
        times: Array = (rows["stamp_ns"] - self.begin_ns) * 1e-9
        return times

    def find_newest(self, rows: Rows, now_s: float) -> np.void | None:
        """Return the newest row at a time [s]; None if there is none, or it is stale."""
        stamp_ns = self.begin_ns + round(now_s * 1e9)
        at = int(np.searchsorted(rows["stamp_ns"], stamp_ns, side="right")) - 1
        if at < 0 or stamp_ns - int(rows["stamp_ns"][at]) > STALE_S * 1e9:
            return None
        row: np.void = rows[at]
        return row


Update = Callable[[float], None]
"""Moves what a panel draws to a time [s]."""


@dataclass(slots=True)
class Canvas:
    """A figure, and which of its artists move from frame to frame."""

    figure: Figure
    data: ClipData
    theme: Theme
    updates: list[Update] = field(default_factory=list)
    moving: list[Any] = field(default_factory=list)  # in the order in which they are drawn

    def add(self, artist: Any) -> Any:
        """Take an artist that moves out of what is drawn once; return it."""
        artist.set_animated(True)
        self.moving.append(artist)
        return artist

    def add_line(self, axes: Axes, colour: int, width: float) -> Line2D:
        """Return a new line that moves, of a colour of the live view."""
        line = Line2D([], [], color=self.theme.adapt(colour), lw=width, solid_capstyle="round")
        axes.add_line(line)
        self.add(line)
        return line
