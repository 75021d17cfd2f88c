"""The figure of a calibration: tension over motor travel, as figure 6 of Phee et al. 2009."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slave.calibration.file import Calibration, Direction
from slave.calibration.memory import Phase
from slave.calibration.refusals import TENDON_NAMES
from slave.calibration.run import Record

PULLED, OTHER, LINE = "#b2182b", "#2166ac", "#444444"


def figure(record: Record, calibration: Calibration) -> Figure:
    """Return a row of panels for each joint done, one panel a tendon."""
    done = [j for j, stops in enumerate(record.stops) if stops]
    across = max(len(record.joints[j]) for j in done)
    page = Figure(figsize=(5.5 * across, 3.8 * len(done)), layout="constrained")
    panels = page.subplots(len(done), across, squeeze=False)
    found = {(d.joint - 1, d.tendon): d for d in calibration.directions}
    for row, j in zip(panels, done, strict=True):
        for side, panel in enumerate(row):
            if side < len(record.joints[j]):
                _panel(panel, record, j, side, found[j, TENDON_NAMES[side]])
            else:
                panel.set_axis_off()
    return page


def _panel(panel: Axes, record: Record, j: int, side: int, direction: Direction) -> None:
    tendons = record.joints[j]
    phases = [Phase.SEEK, Phase.SLACKEN, Phase.RELEASE, Phase.PULL]
    rows = (record.side[:, j] == side) & np.isin(record.phase[:, j], phases)
    travel = 1e3 * record.travel[rows, tendons[side]]
    if len(tendons) == 2:
        loose = record.tension[rows, tendons[1 - side]]
        panel.plot(travel, loose, color=OTHER, lw=0.8, label=f"tendon {TENDON_NAMES[1 - side]}")
    tension = record.tension[rows, tendons[side]]
    panel.plot(travel, tension, color=PULLED, lw=0.8, label=f"tendon {TENDON_NAMES[side]}, pulled")
    peak = float(tension.max())
    ends = np.array([direction.free_tension, peak])
    for slope, from_, name in (
        (direction.M_pull.value, direction.stop, "M_pull"),
        (direction.M_rel.value, direction.stop, "M_rel"),
    ):
        top = ends if name == "M_pull" else np.array([0.0, peak * np.exp(-2.0 * direction.K.value)])
        line = 1e3 * (from_ + slope * top)
        panel.plot(line, top, color=LINE, ls="--", lw=1.0)
        panel.annotate(
            f"{name} = {1e3 * slope:.4f} mm/N",
            (line[-1], top[-1]),
            fontsize=8,
            xytext=(6, -10),
            textcoords="offset points",
        )
    panel.axvline(1e3 * direction.stop, color=LINE, ls=":", lw=1.0)
    panel.annotate(
        "stop",
        (1e3 * direction.stop, 0.95 * peak),
        fontsize=8,
        ha="right",
        xytext=(-3, 0),
        textcoords="offset points",
    )
    panel.set_title(
        f"joint {direction.joint}, tendon {direction.tendon}: K = {direction.K.value:.3f}"
        f" ± {direction.K.uncertainty:.3f}",
        fontsize=10,
    )
    panel.set_xlabel("motor travel [mm]")
    panel.set_ylabel("tension at the housing [N]")
    panel.legend(fontsize=8, loc="upper left")
