"""The scene: rows of messages become Rerun columns, a batch at a time.

Entities, all on the timeline `time` (the stamp its sender gave a message):

======================================= ========================================================
sheath/tendon_<i>/tube                  the sheath in space, coloured by the tension in it
sheath/tendon_<i>/front                 X', where the newest reversal has got to
profile/tendon_<i>/curve, /front        T(x) and X' as a plot
profile/tendon_<i>/tension              T(x) [N] itself: component `tension`, 65 numbers of 64 bits
tension, displacement, front, force,    curves over time, see `teleop.view.curves`
position, loop
events                                  the text log
======================================= ========================================================
"""

from collections.abc import Mapping

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from teleop.messages import PROFILE_POINTS, text_of
from teleop.session import State
from teleop.topics import EVENT, HAND, PROFILE, SHEATH, STATE, TENDONS, role_name
from teleop.view.batch import AnyTopic, Rows, split, thinned
from teleop.view.colours import rgba
from teleop.view.config import ViewConfig
from teleop.view.curves import CURVES, RED, Curve
from teleop.view.profile_plot import Plane
from teleop.view.shape import centreline

TIMELINE = "time"
_SEGMENTS = PROFILE_POINTS - 1
_PER_SEGMENT = 4  # straight pieces drawn per segment of one colour
_SERIES_COLOURS = (0x1F77B4FF, 0xFF7F0EFF, 0x2CA02CFF, 0xD62728FF, 0x9467BDFF, 0x8C564BFF)


class Scene:
    """Turns decoded batches into what is seen.

    Keeps only what later messages need: the sheaths' shapes, the number of joints, and which static
    things have been sent.
    """

    def __init__(self, config: ViewConfig, stream: rr.RecordingStream) -> None:
        self._config = config
        self._stream = stream
        self._joints = 0
        self._sheaths: dict[int, bytes] = {}  # tendon -> the shape as last sent
        self._lines: dict[int, NDArray[np.float64]] = {}  # tendon -> drawn centre line
        self._plane: Plane | None = None
        self._styled: set[str] = set()

    def send(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Send one batch of each topic; returns the number of rows that were shown."""
        shown = 0
        for topic, batch in batches.items():
            if topic in (STATE, HAND):
                self._joints = int(batch["joints"][-1])
        for topic, batch in batches.items():
            if topic is SHEATH:
                for tendon, rows in split(batch, "tendon").items():
                    self._sheath(tendon, rows[-1])
                    shown += 1
        for topic, batch in batches.items():
            if topic is PROFILE:
                for tendon, rows in split(batch, "tendon").items():
                    kept = thinned(rows, self._config.rate_hz.profile)
                    self._profile(tendon, kept)
                    shown += len(kept)
            elif topic is EVENT:
                self._events(batch)
                shown += len(batch)
            elif topic in CURVES:
                rate = getattr(self._config.rate_hz, topic.name, None)
                kept = batch if rate is None else thinned(batch, rate)
                self._curves(topic, kept)
                shown += len(kept)
        return shown

    def _columns(self, path: str, rows: Rows, columns: rr.ComponentColumnList) -> None:
        stamps = rows["stamp_ns"].astype("datetime64[ns]")
        self._stream.send_columns(path, [rr.TimeColumn(TIMELINE, timestamp=stamps)], columns)

    def _curves(self, topic: AnyTopic, rows: Rows) -> None:
        group = CURVES[topic]
        if group.over == "role":
            for role, own in split(rows, "role").items():
                for curve in group.curves:
                    self._curve(curve, role_name(role), own, own[curve.field])
            return
        count = int(rows["tendons"][-1]) if topic is TENDONS else self._joints
        for index in range(count):
            for curve in group.curves:
                self._curve(curve, f"{group.over}_{index}", rows, rows[curve.field][:, index])

    def _curve(self, curve: Curve, owner: str, rows: Rows, values: NDArray[np.generic]) -> None:
        numbers = values.astype(np.float64) * curve.factor
        known = np.isfinite(numbers) & ((numbers > 0) | (not curve.positive_only))
        if not known.any():
            return
        path, label = curve.path.format(owner), owner.rpartition("_")[2]
        if path not in self._styled:
            self._styled.add(path)
            style = rr.SeriesLines(
                colors=[curve.colour], widths=[curve.width], names=[f"{curve.name} {label}"]
            )
            self._stream.log(path, style, static=True)
        self._columns(path, rows[known], rr.Scalars.columns(scalars=numbers[known]))

    def _sheath(self, tendon: int, row: np.void) -> None:
        """Draw the sheath's shape; it is static and sent again only if it has changed."""
        count = int(row["sections"])
        length, radius = row["section_length"][:count], row["section_radius"][:count]
        shape = length.tobytes() + radius.tobytes()
        if count == 0 or self._sheaths.get(tendon) == shape:
            return
        self._sheaths[tendon] = shape
        spacing = self._config.tendon_spacing_m
        s = np.linspace(0.0, length.sum(), _SEGMENTS * _PER_SEGMENT + 1)
        line = centreline(length, radius, s, turn_gap=2 * spacing)
        line += (0.0, 0.0, tendon * spacing)
        self._lines[tendon] = line
        starts = np.arange(_SEGMENTS) * _PER_SEGMENT
        strips = line[starts[:, None] + np.arange(_PER_SEGMENT + 1)]
        tube = rr.LineStrips3D(strips, radii=self._config.tube_radius_m)
        self._stream.log(f"sheath/tendon_{tendon}/tube", tube, static=True)
        front = rr.Points3D.from_fields(radii=1.8 * self._config.tube_radius_m, colors=RED)
        self._stream.log(f"sheath/tendon_{tendon}/front", front, static=True)

    def _profile(self, tendon: int, rows: Rows) -> None:
        tension, length = rows["tension"], rows["length"]
        self._columns(
            f"profile/tendon_{tendon}/tension",
            rows,
            rr.AnyValues.columns(tension=tension.ravel()).partition([PROFILE_POINTS] * len(rows)),
        )
        place = np.clip(np.nan_to_num(rows["front"] / length), 0.0, 1.0)  # X'/L
        self._plot(tendon, rows, place)
        line = self._lines.get(tendon)
        if line is None:
            return  # its Sheath message comes once a second
        middle = (tension[:, 1:] + tension[:, :-1]) / 2
        colours = rgba(middle, self._config.tension_scale_N).ravel()
        self._columns(
            f"sheath/tendon_{tendon}/tube",
            rows,
            rr.LineStrips3D.columns(colors=colours).partition([_SEGMENTS] * len(rows)),
        )
        at = line[np.rint(place * (len(line) - 1)).astype(int)]
        self._columns(f"sheath/tendon_{tendon}/front", rows, rr.Points3D.columns(positions=at))

    def _plot(self, tendon: int, rows: Rows, place: NDArray[np.float64]) -> None:
        """Draw T(x), and X' on it."""
        tension, length = rows["tension"], rows["length"]
        longest = float(length.max())
        if not longest > 0:
            return
        if self._plane is None or longest > self._plane.length:
            self._plane = Plane(longest, self._config.tension_scale_N)
            self._axes(self._plane)
        path = f"profile/tendon_{tendon}"
        if path not in self._styled:
            self._styled.add(path)
            colour = _SERIES_COLOURS[tendon % len(_SERIES_COLOURS)]
            style = rr.LineStrips2D.from_fields(colors=colour, radii=0.006)
            self._stream.log(f"{path}/curve", style, static=True)
            mark = rr.Points2D.from_fields(colors=RED, radii=0.02)
            self._stream.log(f"{path}/front", mark, static=True)
        x = length[:, None] * np.linspace(0.0, 1.0, PROFILE_POINTS)
        strips = self._plane.points(x, tension)
        self._columns(f"{path}/curve", rows, rr.LineStrips2D.columns(strips=list(strips)))
        k = np.rint(place * _SEGMENTS).astype(int)
        marks = strips[np.arange(len(rows)), k]
        self._columns(f"{path}/front", rows, rr.Points2D.columns(positions=marks))

    def _axes(self, plane: Plane) -> None:
        """Draw the plot's axes; the tension axis is the colour scale of the tubes."""
        lines, labels = plane.axes()
        frame = rr.LineStrips2D(lines, colors=0x808080FF, radii=0.004)
        self._stream.log("profile/axes", frame, static=True)
        words = rr.Points2D(
            [at for at, _ in labels],
            labels=[text for _, text in labels],
            colors=0xC0C0C0FF,
            radii=0.0001,
            show_labels=True,
        )
        self._stream.log("profile/labels", words, static=True)
        rungs = np.linspace(0.0, plane.scale, _SEGMENTS + 1)
        edge = plane.points(np.zeros_like(rungs), rungs)
        scale = rr.LineStrips2D(
            np.stack([edge[:-1], edge[1:]], axis=1),
            colors=rgba((rungs[1:] + rungs[:-1]) / 2, plane.scale),
            radii=0.015,
        )
        self._stream.log("profile/scale", scale, static=True)

    def _events(self, rows: Rows) -> None:
        texts = [f"{role_name(int(row['role']))}: {text_of(tuple(row['text']))}" for row in rows]
        levels = ["ERROR" if row["state"] == State.FAULT else "INFO" for row in rows]
        self._columns("events", rows, rr.TextLog.columns(text=texts, level=levels))
