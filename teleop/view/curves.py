"""The curves over time: their table, and sending them to Rerun."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from teleop.messages.messages import STAGE_NAMES
from teleop.messages.topics import (
    COMMAND,
    HAND,
    LATENCY,
    LEDGER,
    LINK,
    REPORT,
    SHEATH,
    STATE,
    TENDONS,
    Role,
    Topic,
    format_role,
)
from teleop.view import colours
from teleop.view.colours import AXES, BAND, TRUTH, darken_colour, lighten_colour
from teleop.view.columns import AnyTopic, Rows, build_columns, split_rows
from teleop.view.scene_joints import compute_true_force
from teleop.view.scene_sheaths import Painter
from teleop.view.space_arm import find_arm

STAGE_COLOURS = (colours.HAND, colours.HOUSING, colours.ESTIMATE, colours.COMMANDED, colours.TRUTH)
# [points] of a curve below another that is nearly equal: seen on both sides of it
UNDERLAY_WIDTH = 4.0
LOSS, LATENESS = colours.PHASES[2], colours.PHASES[4]


@dataclass(frozen=True, slots=True)
class Curve:
    """A field of a message as a curve.

    `path` is the entity; `{}` in it stands for the tendon, the joint or the role. Non-finite values
    are not sent (e.g. of a missing bench sensor).
    """

    path: str
    field: str
    name: str  # in the legend: measured, estimated, commanded or true where it is one of these
    colour: int  # 0xRRGGBBAA
    width: float = 1.5  # [points]
    factor: float = 1.0  # shown = factor * field
    positive_only: bool = False  # 0 and below mean "none"
    entry: int | None = None  # of an array field, where the group is not over its entries
    ahead: bool = False  # in a tab that is in front at first: a live page grows others less often


@dataclass(frozen=True, slots=True)
class Band:
    """The area between two fields of a message, behind the curves.

    Rerun's plots fill no area, so it is drawn as one line that goes up and down within each row's
    period, as broad as a period is on the screen.
    """

    path: str  # as in `Curve`; plots draw entities in alphabetical order, so it comes first
    low: str
    high: str
    name: str


@dataclass(frozen=True, slots=True)
class CurveGroup:
    """The curves drawn from one topic, and what their fields are arrays over."""

    # a message is of one "sheath"; of others, fields are arrays over tendons or joints
    over: Literal["tendon", "joint", "role", "role and joint", "sender", "sheath"]
    curves: tuple[Curve, ...]
    bands: tuple[Band, ...] = ()


_MS = 1e-6  # of nanoseconds
MILLI = 1e3  # of metres, of joules

CURVES: dict[Topic[Any], tuple[CurveGroup, ...]] = {
    TENDONS: (CurveGroup(
        "tendon",
        (
            Curve("tension/{}/in", "proximal_tension", "measured", colours.HOUSING, ahead=True),
            Curve("tension/{}/out", "distal_tension", "estimated",
                  colours.ESTIMATE, UNDERLAY_WIDTH, ahead=True),
            Curve("tension/{}/out_true", "bench_distal_tension", "true", colours.TRUTH, ahead=True),
            Curve("displacement/{}/in", "proximal_displacement", "measured",
                  colours.HOUSING, factor=MILLI),
            Curve("displacement/{}/asked", "commanded_displacement", "commanded",
                  colours.COMMANDED, factor=MILLI),
            Curve("displacement/{}/out_true", "bench_distal_displacement", "true",
                  colours.TRUTH, UNDERLAY_WIDTH, factor=MILLI, ahead=True),
            Curve("elongation/{}", "elongation", "estimated", colours.ESTIMATE, factor=MILLI),
        ),
    ),),
    STATE: (
        CurveGroup(
            "joint",
            (
                Curve("force/{}/tip", "force", "estimated", colours.ESTIMATE, UNDERLAY_WIDTH,
                      ahead=True),
                Curve("position/{}/tip", "position", "estimated", colours.ESTIMATE,
                      2.0, factor=MILLI, ahead=True),
            ),
            (Band("force/{}/interval", "force_low", "force_high", "interval"),),
        ),
        CurveGroup("sender", (
            Curve("age/slave/sample", "sample_age_ns", "newest sample", LATENESS, factor=_MS),
        )),
    ),
    HAND: (
        CurveGroup("joint", (
            Curve("hand/{}/force", "force", "commanded", colours.HAND, 2.0),
        )),
        CurveGroup("sender", (
            Curve("age/master/state", "state_age_ns", "newest state", colours.HAND,
                  factor=_MS, positive_only=True),
            Curve("age/master/round_trip", "round_trip_ns", "round trip", colours.COMMANDED,
                  factor=_MS, positive_only=True),
        )),
    ),
    COMMAND: (CurveGroup("joint", (
        Curve("position/{}/asked", "position", "commanded", colours.COMMANDED, factor=MILLI,
              ahead=True),
    )),),
    SHEATH: (CurveGroup("sheath", (
        Curve("friction/{}/K", "effective_friction", "estimated", colours.ESTIMATE, 2.0),
        *(Curve(f"friction/{{}}/{end}", f"friction_{end}", "interval", colours.INTERVAL)
          for end in ("low", "high")),
    )),),
    LEDGER: (CurveGroup("role and joint", tuple(
        Curve(f"energy/{{}}/{path}", field, name, colour, width, factor=MILLI)
        for path, field, name, colour, width in (
            ("put_in", "put_in", "put in", colours.HOUSING, 1.5),
            ("taken_out", "taken_out", "taken out", colours.TRUTH, 1.5),
            ("heard", "received", "received", colours.ESTIMATE, 1.5),
            ("dissipated", "dissipated", "dissipated", LOSS, 1.5),
            ("credit", "credit", "credit", colours.HAND, 2.0),
        )
    )),),
    REPORT: (CurveGroup("role", (
        Curve("rate/{}", "rate_hz", "rate", colours.HOUSING),
        Curve("latency/{}/p50", "latency_p50_ns", "median", colours.ESTIMATE, 2.0, factor=_MS,
              positive_only=True),
        Curve("latency/{}/p99", "latency_p99_ns", "99 %", colours.INTERVAL, factor=_MS,
              positive_only=True),
        Curve("latency/{}/late", "lateness_max_ns", "latest tick", LATENESS, factor=_MS),
        Curve("loss/{}/lost", "lost", "lost", LOSS),
        Curve("loss/{}/rejected", "rejected", "rejected", colours.COMMANDED),
        Curve("loss/{}/overruns", "overruns", "overruns", colours.TRUTH),
    )),),
    LINK: (CurveGroup("role", (
        Curve("latency/{}/round_trip", "round_trip_ns", "round trip", colours.HAND, factor=_MS,
              positive_only=True),
        Curve("latency/{}/jitter", "jitter_ns", "jitter", colours.COMMANDED, factor=_MS,
              positive_only=True),
    )),),
    LATENCY: (CurveGroup("sender", tuple(
        Curve(f"budget/{{}}/{k}", "p50_ns", name, colour, factor=_MS, entry=k, positive_only=True)
        for k, (name, colour) in enumerate(zip(STAGE_NAMES, STAGE_COLOURS, strict=True))
    )),),
}  # fmt: skip


# --- sending to Rerun

_TRUE_FORCE = Curve("force/{}/true", "", "true", TRUTH)
TIP_FORCE = tuple(
    Curve(f"tip_force/{{}}/{axis}", "", axis, colour, 2.0)
    for axis, colour in zip("xyz", AXES, strict=True)
)
_TIP_END_SHARE = 0.55  # of a component's colour in the lines of its ends
_TIP_ENDS = tuple(  # lines: areas of three components would hide each other
    tuple(
        Curve(f"tip_force/{{}}/{curve.name}_{end}", "", "interval",
              darken_colour(curve.colour, _TIP_END_SHARE), 1.0)
        for end in ("low", "high")
    )
    for curve in TIP_FORCE
)  # fmt: skip
_HIGH_END_OFFSET_NS = 1000  # [ns] from the newest row to its high end
_HIGH_END_SPAN_MAX_NS = 20_000_000  # [ns] from a row, at most, within which its high end is drawn
_HIDDEN_CURVE_PERIOD_NS = 1_000_000_000  # [ns] after which a live page's curves in tabs behind grow
_BAND_WIDTH = 2.5  # [points], about a row of 100 Hz in a plot of 10 s on 600 points


class Plots(Painter):
    """Draws the numbers against time; with `live` curves in tabs behind grow less often."""

    def __init__(self, *parts: Any, live: bool = False) -> None:
        super().__init__(*parts)
        self._live = live
        self._held: dict[AnyTopic, list[Rows]] = {}  # not yet drawn behind
        self._joints = 0

    def draw(self, batches: Mapping[AnyTopic, Rows]) -> int:
        """Draw one batch of each topic that has curves; returns the number of rows shown."""
        shown = 0
        for topic, batch in batches.items():
            if topic in (STATE, HAND) and len(batch):
                self._joints = int(batch["joints"][-1])
        for topic, batch in batches.items():
            if topic not in CURVES:
                continue
            displayed = self._subsample_rows(topic, batch)
            hidden = self._take_hidden_rows(topic, displayed)
            for group in CURVES[topic]:
                for ahead, due_rows in ((True, displayed), (False, hidden)):
                    for line in self._list_lines(topic, group, due_rows, ahead):
                        self._draw_line(*line)
                bands = group.bands if len(displayed) else ()
                for band, joint in itertools.product(bands, range(self._joints)):
                    self._draw_band(band, joint, displayed)
            if topic is TENDONS:
                self._draw_true_forces(displayed)
            if topic is STATE:
                self._draw_tip_forces(displayed)
            shown += len(displayed)
        return shown

    def _take_hidden_rows(self, topic: AnyTopic, rows: Rows) -> Rows:
        """Return what is due of the curves that are in tabs behind."""
        if not self._live:
            return rows
        pending = self._held.setdefault(topic, [])
        pending.append(rows)
        due_rows = np.concatenate(pending)
        if len(due_rows) == 0 or np.ptp(due_rows["stamp_ns"]) < _HIDDEN_CURVE_PERIOD_NS:
            return rows[:0]
        pending.clear()
        return due_rows

    def _subsample_rows(self, topic: AnyTopic, rows: Rows) -> Rows:
        rate = getattr(self._config.rate_hz, topic.name, None)
        if rate is None:
            return rows
        if topic is LEDGER:
            sides = [
                self._subsample(role_rows, rate) for role_rows in split_rows(rows, "role").values()
            ]
            return np.concatenate(sides)
        return self._subsample(rows, rate)

    def _list_lines(
        self, topic: AnyTopic, group: CurveGroup, rows: Rows, ahead: bool
    ) -> Iterator[tuple[Curve, str, str, Rows, NDArray[np.generic]]]:
        """Yield each line of a group: its curve, owner, label, rows and values."""
        curves = [curve for curve in group.curves if curve.ahead == ahead]
        if len(rows) == 0 or not curves:
            return
        if group.over in ("role", "role and joint"):
            for number, role_rows in split_rows(rows, "role").items():
                role = format_role(number)
                for curve in curves:
                    if group.over == "role":
                        yield curve, role, role, role_rows, role_rows[curve.field]
                        continue
                    for joint in range(int(role_rows["joints"][-1])):
                        values = role_rows[curve.field][:, joint]
                        yield curve, f"{role}/joint_{joint}", role, role_rows, values
        elif group.over == "sheath":
            for number, sheath_rows in split_rows(rows, "tendon").items():
                for curve in curves:
                    owner, label = f"tendon_{number}", self._sheaths.name_tendon(number)
                    yield curve, owner, label, sheath_rows, sheath_rows[curve.field]
        elif group.over == "sender":
            sender = format_role(topic.publisher or Role.LAUNCHER)
            for curve in curves:
                field = rows[curve.field]
                values = field if curve.entry is None else field[:, curve.entry]
                yield curve, sender, sender, rows, values
        else:
            tendons = group.over == "tendon"
            for index in range(int(rows["tendons"][-1]) if tendons else self._joints):
                label = (
                    self._sheaths.name_tendon(index) if tendons else ""
                )  # a view is of one joint
                for curve in curves:
                    yield curve, f"{group.over}_{index}", label, rows, rows[curve.field][:, index]

    def _draw_line(
        self, curve: Curve, owner: str, label: str, rows: Rows, values: NDArray[np.generic]
    ) -> None:
        numbers = values.astype(np.float64) * curve.factor
        is_shown = np.isfinite(numbers) & ((numbers > 0) | (not curve.positive_only))
        if not is_shown.any():
            return
        path = curve.path.format(owner)
        if not self._sender.has_style(path):
            colour = lighten_colour(curve.colour) if label.endswith("b") else curve.colour
            name = f"{curve.name} {label}".rstrip()
            style = rr.SeriesLines(colors=[colour], widths=[curve.width], names=[name])
            self._sender.send_once(path, style)
        self._sender.send_columns_at(
            path, rows["stamp_ns"][is_shown], build_columns(rr.Scalars, scalars=numbers[is_shown])
        )

    def _draw_band(self, band: Band, joint: int, rows: Rows) -> None:
        """Draw one area: each row's low end at its stamp, its high end half a period later."""
        low, high = rows[band.low][:, joint], rows[band.high][:, joint]
        is_finite = np.isfinite(low) & np.isfinite(high)
        if not is_finite.any():
            return
        path = band.path.format(f"joint_{joint}")
        style = rr.SeriesLines(
            colors=[BAND], widths=[_BAND_WIDTH], names=[band.name], aggregation_policy="Off"
        )
        self._sender.send_once(path, style)
        stamps = rows["stamp_ns"][is_finite]
        spans = np.minimum(
            np.diff(stamps, append=stamps[-1] + 2 * _HIGH_END_OFFSET_NS), _HIGH_END_SPAN_MAX_NS
        )
        times = np.stack([stamps, stamps + spans // 2], axis=1).ravel()
        ends = np.stack([low[is_finite], high[is_finite]], axis=1).ravel()
        self._sender.send_columns_at(path, times, build_columns(rr.Scalars, scalars=ends))

    def _draw_tip_forces(self, rows: Rows) -> None:
        """Draw the components of the force at the tip of each arm in space that can be told."""
        for number, arm in enumerate(self._sheaths.arms if len(rows) else ()):
            if self._joints < arm.joints.stop:
                continue
            forces = arm.estimate_tip_forces(rows)
            components = zip(TIP_FORCE, _TIP_ENDS, forces.list_components(), strict=True)
            for curve, ends, values in components:
                for line, shown in zip((curve, *ends), values, strict=True):
                    self._draw_line(line, f"arm_{number}", "", rows, shown)

    def _draw_true_forces(self, rows: Rows) -> None:
        """Draw what bench sensors say of the force at each tip that has tendons of its own."""
        for joint in self._sheaths.joints:
            if find_arm(self._sheaths.arms, joint) is not None:
                continue
            force = compute_true_force(rows, self._sheaths.list_tendons(joint))
            self._draw_line(_TRUE_FORCE, f"joint_{joint}", "", rows, force)
