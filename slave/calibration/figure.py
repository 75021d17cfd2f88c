"""The figure of a calibration: tension over motor travel, as figure 6 of Phee et al. 2009."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slave.calibration.calibration_file import Calibration, TendonCalibration
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_state import TENDON_NAMES, Phase

PULLED_COLOUR, OTHER_COLOUR, LINE_COLOUR = "#b2182b", "#2166ac", "#444444"


def draw_figure(record: ProcedureData, calibration: Calibration) -> Figure:
    """Return a row of panels for each joint done, one panel a tendon."""
    joints = [j for j, stops in enumerate(record.stops) if stops]
    columns = max(len(record.joints[j]) for j in joints)
    page = Figure(figsize=(5.5 * columns, 3.8 * len(joints)), layout="constrained")
    panels = page.subplots(len(joints), columns, squeeze=False)
    directions = {(d.joint - 1, d.tendon): d for d in calibration.directions}
    for row, j in zip(panels, joints, strict=True):
        for side, panel in enumerate(row):
            if side < len(record.joints[j]):
                _draw_panel(panel, record, j, side, directions[j, TENDON_NAMES[side]])
            else:
                panel.set_axis_off()
    return page


def _draw_panel(
    panel: Axes, record: ProcedureData, j: int, side: int, direction: TendonCalibration
) -> None:
    tendons = record.joints[j]
    phases = [Phase.SEEK, Phase.SLACKEN, Phase.RELEASE, Phase.PULL]
    rows = (record.side[:, j] == side) & np.isin(record.phase[:, j], phases)
    travel = 1e3 * record.travel[rows, tendons[side]]
    tension = record.tension[rows, tendons[side]]
    panel.plot(
        travel, tension, color=PULLED_COLOUR, lw=0.9, label=f"tendon {TENDON_NAMES[side]}, pulled"
    )
    if len(tendons) == 2:
        other = record.tension[rows, tendons[1 - side]]
        panel.plot(
            travel, other, color=OTHER_COLOUR, lw=0.9, label=f"tendon {TENDON_NAMES[1 - side]}"
        )
    peak = float(tension.max())
    released = peak * np.exp(-2.0 * direction.K.value)
    slopes = (
        ("M_pull", direction.M_pull.value, "--", (direction.free_tension, peak)),
        ("M_rel", direction.M_rel.value, "-.", (0.0, released)),
    )
    for name, slope, style, tensions in slopes:
        ends = np.array(tensions)
        line = 1e3 * (direction.stop + slope * ends)
        label = f"{name} = {1e3 * slope:.4f} mm/N"
        panel.plot(line, ends, color=LINE_COLOUR, ls=style, lw=1.4, label=label)
    panel.axvline(1e3 * direction.stop, color=LINE_COLOUR, ls=":", lw=1.0)
    panel.text(1e3 * direction.stop, 0.97 * peak, "stop ", fontsize=8, ha="right")
    panel.set_title(
        f"joint {direction.joint}, tendon {direction.tendon}: K = {direction.K.value:.3f}"
        f" ± {direction.K.uncertainty:.3f}",
        fontsize=10,
    )
    panel.set_xlabel("motor travel [mm]")
    panel.set_ylabel("tension at the housing [N]")
    panel.legend(fontsize=8, loc="center left")
