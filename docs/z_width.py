"""A picture of docs/explanation/coupling.md, Z-width against its bounds: `python -m docs.z_width`.

Draws the stiffest wall that each coupling renders stably without network delay over the damping of
hand and device, and two bounds of `direct`: that of the sampled device alone, and that of the loop
through the motor. No clock and fixed seeds: the same numbers on every run, in 5 minutes.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from estimator.array_types import Array
from estimator.figure_style import STYLE
from studies.testbed.parallel import map_in_parallel
from studies.transparency import zwidth
from studies.transparency.hand import DT
from studies.transparency.rig import TENDON, Rig, build_wall
from studies.transparency.study import CONTACT, FRICTION, HANDS, PRETENSION, SPRING, Study
from studies.transparency.system import Network, Teleoperator, build_rig_model, build_settings
from teleop.coupling import Bilateral
from teleop.runtime.machine import count_processors

IMAGE = Path(__file__).parent / "images" / "z-width.svg"
STUDY = Study()
SCALES = STUDY.force_scale * STUDY.position_scale
HAND = HANDS["relaxed"]
DAMPINGS = (0.5, 2.0, 8.0)  # [N s/m] of the device
DELAY = 2.0 * DT  # [s] of the simulated loops: command to motor, tension to force
FAST = 0.001  # [s] lag of a motor without the usual one
COLOURS = {"direct": "#D55E00", "passivity": "#0072B2", "wave": "#009E73"}  # Okabe and Ito
OFFSET: dict[str, Any] = {"textcoords": "offset points", "color": "#888888"}
CURVES = (
    ("direct", Rig.lag),
    ("direct", FAST),
    ("passivity", Rig.lag),
    ("wave", Rig.lag),
)


class Cell(NamedTuple):
    """A wall to look for."""

    coupling: str
    lag: float  # [s] of the motor
    damping: float  # [N s/m] of the device


def sampling_bound(damping: float) -> float:
    """Return 2 b / T [N/m] at the hand (Colgate & Schenkel 1997)."""
    return 2.0 * damping / DT


def loop_bound(damping: float, lag: float) -> float:
    """Return the stiffness [N/m] at the hand up to which the loop of `direct` is passive.

        K (T/2 + delay + lag (1 + r) + T r) = b,     r = K_tip / tendon

    The motor also takes up the stretch of the tendon, a tick and its lag later: the tip follows by
    the lag times 1 + r and a tick times r, K_tip = K / (product of the scales).
    """
    a, c = (lag + DT) / (SCALES * TENDON), DT / 2.0 + DELAY + lag
    return (math.sqrt(c * c + 4.0 * a * damping) - c) / (2.0 * a)


def stiffest(cell: Cell) -> float:
    """Return the stiffest stable wall [N/m] at the hand; infinite if the cap was stable."""
    device = replace(STUDY.device, damping=cell.damping)

    def stable(stiffness: float) -> bool:
        rig = Rig(build_wall(stiffness, CONTACT), SPRING, PRETENSION)
        rig.lag = cell.lag
        system = Teleoperator(
            Bilateral(coupling=STUDY.coupling(cell.coupling)),
            rig,
            Network(),
            build_settings(STUDY.force_scale, STUDY.position_scale, Network()),
            build_rig_model(FRICTION),
        )
        record = zwidth.push_wall(system, HAND, device, CONTACT / STUDY.position_scale)
        return zwidth.has_settled(record)

    width = zwidth.find_largest_width(stable, STUDY.lowest, STUDY.cap, 10.0, 1.1)
    return math.inf if math.isinf(width.unstable) else SCALES * width.stable


def draw(found: dict[Cell, float]) -> Figure:
    """Draw the stiffest stable walls and both bounds."""
    figure = Figure(figsize=(6.4, 4.0))
    axes = figure.subplots()
    total = np.geomspace(3.0, 13.0, 40)
    axes.plot(total, [sampling_bound(b) for b in total], color="#888888")
    axes.annotate("2 b/T", (total[8], sampling_bound(total[8])), (4, -12), **OFFSET)
    cap, shift = SCALES * STUDY.cap, 1.0
    for name, lag in CURVES:
        colour, fast = COLOURS[name], lag == FAST
        if name == "direct":
            axes.plot(total, [loop_bound(b, lag) for b in total], "--", color=colour, lw=1.0)
        b = np.array(DAMPINGS) + HAND.damping
        y: Array = np.array([found[Cell(name, lag, damping)] for damping in DAMPINGS])
        capped = np.isinf(y)
        shift *= 0.93 if capped.any() else 1.0  # so little apart that both show
        fill: dict[str, Any] = {"color": colour, "markerfacecolor": "white" if fast else colour}
        axes.plot(b[capped], np.full(capped.sum(), cap * shift), "^", **fill)
        label = f"{name}, motor {1e3 * lag:g} ms"
        axes.plot(b[~capped], y[~capped], "o", **fill)
        axes.plot([], [], "^" if capped.all() else "o", label=label, **fill)
    axes.plot([], [], "--", color=COLOURS["direct"], lw=1.0, label="loop through the motor")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="damping b of hand and device [N s/m]",
        ylabel="stiffest stable wall at the hand [N/m]",
        xticks=[3, 5, 8, 12],
        xticklabels=["3", "5", "8", "12"],
    )
    axes.minorticks_off()
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def main() -> None:
    """Measure, print and draw."""
    cells = [Cell(name, lag, b) for name, lag in CURVES for b in DAMPINGS]
    found = dict(zip(cells, map_in_parallel(stiffest, cells, count_processors()), strict=True))
    for cell, stiffness in found.items():
        b = cell.damping + HAND.damping
        bounds = f"2 b/T {sampling_bound(b):.0f}, loop {loop_bound(b, cell.lag):.0f}"
        print(f"{cell.coupling}, {1e3 * cell.lag:g} ms, b {b:g}: {stiffness:.0f} N/m; {bounds}")
    with mpl.rc_context({**STYLE, "svg.hashsalt": "z-width", "svg.fonttype": "none"}):
        draw(found).savefig(IMAGE, metadata={"Date": None})


if __name__ == "__main__":
    main()
