"""The curves of `teleop.view.curves` sent to Rerun."""

from collections.abc import Iterator, Mapping

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from teleop.messages.topics import HAND, LEDGER, STATE, TENDONS, Role, format_role
from teleop.view.batch import AnyTopic, Rows, Sender, Subsampler, split_rows
from teleop.view.colours import BAND, TRUTH, lighten_colour
from teleop.view.columns import build_columns
from teleop.view.config import ViewConfig
from teleop.view.curves import CURVES, Band, Curve, CurveGroup
from teleop.view.levers import compute_true_force
from teleop.view.sheaths import Sheaths

_TRUE_FORCE = Curve("force/{}/true", "", "true", TRUTH)
_HIGH_END_OFFSET_NS = 1000  # [ns] from the newest row to its high end
_HIGH_END_SPAN_MAX_NS = 20_000_000  # [ns] from a row, at most, within which its high end is drawn
_HIDDEN_CURVE_PERIOD_NS = 1_000_000_000  # [ns] after which a live page's curves in tabs behind grow
_BAND_WIDTH = 2.5  # [points], about a row of 100 Hz in a plot of 10 s on 600 points


class Plots:
    """Draws the numbers against time; with `live` curves in tabs behind grow less often."""

    def __init__(
        self,
        config: ViewConfig,
        sender: Sender,
        sheaths: Sheaths,
        thinned: Subsampler,
        live: bool = False,
    ) -> None:
        self._live = live
        self._held: dict[AnyTopic, list[Rows]] = {}  # not yet drawn behind
        self._rates = config.rate_hz
        self._sender = sender
        self._sheaths = sheaths
        self._thinned = thinned
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
            kept = self._at_rate(topic, batch)
            for behind, some in ((False, kept), (True, self._behind(topic, kept))):
                for group in CURVES[topic]:
                    for line in self._lines(topic, group, some, behind):
                        self._line(*line)
            for group in CURVES[topic]:
                self._bands(group, kept)
            if topic is TENDONS:
                self._true_forces(kept)
            shown += len(kept)
        return shown

    def _behind(self, topic: AnyTopic, rows: Rows) -> Rows:
        """Return what is due of the curves that are in tabs behind."""
        if not self._live:
            return rows
        held = self._held.setdefault(topic, [])
        held.append(rows)
        whole = np.concatenate(held)
        if len(whole) == 0 or np.ptp(whole["stamp_ns"]) < _HIDDEN_CURVE_PERIOD_NS:
            return rows[:0]
        held.clear()
        return whole

    def _at_rate(self, topic: AnyTopic, rows: Rows) -> Rows:
        rate = getattr(self._rates, topic.name, None)
        if rate is None:
            return rows
        if topic is LEDGER:
            sides = [self._thinned(own, rate) for own in split_rows(rows, "role").values()]
            return np.concatenate(sides)
        return self._thinned(rows, rate)

    def _lines(
        self, topic: AnyTopic, group: CurveGroup, rows: Rows, behind: bool
    ) -> Iterator[tuple[Curve, str, str, Rows, NDArray[np.generic]]]:
        """Yield each line of a group: its curve, owner, label, rows and values."""
        curves = [curve for curve in group.curves if curve.behind == behind]
        if len(rows) == 0 or not curves:
            return
        if group.over in ("role", "role and joint"):
            for number, own in split_rows(rows, "role").items():
                role = format_role(number)
                for curve in curves:
                    if group.over == "role":
                        yield curve, role, role, own, own[curve.field]
                        continue
                    for joint in range(int(own["joints"][-1])):
                        values = own[curve.field][:, joint]
                        yield curve, f"{role}/joint_{joint}", role, own, values
        elif group.over == "sender":
            sender = format_role(topic.publisher or Role.LAUNCHER)
            for curve in curves:
                field = rows[curve.field]
                values = field if curve.entry is None else field[:, curve.entry]
                yield curve, sender, sender, rows, values
        else:
            tendons = group.over == "tendon"
            for index in range(int(rows["tendons"][-1]) if tendons else self._joints):
                label = self._sheaths.name(index) if tendons else ""  # a view is of one joint
                for curve in curves:
                    yield curve, f"{group.over}_{index}", label, rows, rows[curve.field][:, index]

    def _line(
        self, curve: Curve, owner: str, label: str, rows: Rows, values: NDArray[np.generic]
    ) -> None:
        numbers = values.astype(np.float64) * curve.factor
        known = np.isfinite(numbers) & ((numbers > 0) | (not curve.positive_only))
        if not known.any():
            return
        path = curve.path.format(owner)
        if not self._sender.styled(path):
            colour = lighten_colour(curve.colour) if label.endswith("b") else curve.colour
            name = f"{curve.name} {label}".rstrip()
            style = rr.SeriesLines(colors=[colour], widths=[curve.width], names=[name])
            self._sender.once(path, style)
        self._sender.columns_at(
            path, rows["stamp_ns"][known], build_columns(rr.Scalars, scalars=numbers[known])
        )

    def _bands(self, group: CurveGroup, rows: Rows) -> None:
        """Draw the areas of a group over joints."""
        for band in group.bands if len(rows) else ():
            for joint in range(self._joints):
                self._band(band, joint, rows)

    def _band(self, band: Band, joint: int, rows: Rows) -> None:
        """Draw one area: each row's low end at its stamp, its high end half a period later."""
        low, high = rows[band.low][:, joint], rows[band.high][:, joint]
        known = np.isfinite(low) & np.isfinite(high)
        if not known.any():
            return
        path = band.path.format(f"joint_{joint}")
        style = rr.SeriesLines(
            colors=[BAND], widths=[_BAND_WIDTH], names=[band.name], aggregation_policy="Off"
        )
        self._sender.once(path, style)
        stamps = rows["stamp_ns"][known]
        apart = np.minimum(
            np.diff(stamps, append=stamps[-1] + 2 * _HIGH_END_OFFSET_NS), _HIGH_END_SPAN_MAX_NS
        )
        times = np.stack([stamps, stamps + apart // 2], axis=1).ravel()
        ends = np.stack([low[known], high[known]], axis=1).ravel()
        self._sender.columns_at(path, times, build_columns(rr.Scalars, scalars=ends))

    def _true_forces(self, rows: Rows) -> None:
        """Draw what bench sensors say of the force at each tip."""
        for joint in self._sheaths.joints:
            force = compute_true_force(rows, self._sheaths.tendons_of(joint))
            self._line(_TRUE_FORCE, f"joint_{joint}", "", rows, force)
