"""The hysteresis loop T_out over T_in as it grows, coloured by the paper's phases."""

import numpy as np
import rerun as rr

from teleop.messages.messages import PHASE_NAMES
from teleop.view.batch import Rows
from teleop.view.colours import PHASES
from teleop.view.columns import build_columns
from teleop.view.config import ViewConfig
from teleop.view.plane import Plane, compute_axis_end
from teleop.view.sender import Sender

_GAP_NS = 500_000_000  # [ns] without a sample: the loop begins anew


class LoopView:
    """Draws one loop for each tendon, under `loop/tendon_<i>`.

    Each row holds the one piece from the row before: the view shows all rows of its time range, so
    the loop grows and what is old leaves it.
    """

    def __init__(self, config: ViewConfig, sender: Sender) -> None:
        self._sender = sender
        top = compute_axis_end(config.tension_scale_N)
        self._plane = Plane(
            top, top, 1.0, "T_in [N], measured at the housing", "T_out [N], estimated at the tip"
        )
        self._last: Rows | None = None  # the row drawn last

    def draw(self, rows: Rows) -> None:
        """Draw TendonState rows, all tendons in use."""
        if len(rows) == 0:
            return
        if self._last is None:
            self._plane.draw_axes(self._sender, "loop")
            self._legend()
        whole = rows if self._last is None else np.concatenate([self._last, rows])
        self._last = rows[-1:]
        before, after = whole[:-1], whole[1:]
        near = after["stamp_ns"] - before["stamp_ns"] < _GAP_NS
        palette = np.array(PHASES, np.uint32)
        for tendon in range(int(rows["tendons"][-1])):
            begin, end = (
                self._plane.points(
                    part["proximal_tension"][:, tendon], part["distal_tension"][:, tendon]
                )
                for part in (before, after)
            )
            known = near & np.isfinite(begin).all(axis=1) & np.isfinite(end).all(axis=1)
            if not known.any():
                continue
            strips = np.stack([begin, end], axis=1)[known]
            phase = np.minimum(after["phase"][known, tendon], len(PHASES) - 1)
            radii = np.full(len(strips), 0.006)
            pieces = build_columns(
                rr.LineStrips2D, strips=strips, colors=palette[phase], radii=radii
            )
            path = f"loop/tendon_{tendon}/curve"
            self._sender.columns_at(path, after["stamp_ns"][known], pieces)

    def _legend(self) -> None:
        """Name the phases, each in its colour."""
        heights = -1.0 + 0.16 * np.arange(len(PHASES))
        at = np.stack([np.full(len(PHASES), 1.4), heights], axis=1)
        words = rr.Points2D(
            at, labels=list(PHASE_NAMES), colors=list(PHASES), radii=1e-4, show_labels=True
        )
        self._sender.static("loop/names", words)
