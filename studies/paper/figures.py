"""The experiment's figures, named after those of the paper that they repeat.

Colours are of Okabe and Ito's set, which readers with any colour vision can tell apart; truth is
black, and what differs in colour differs in line or mark as well.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.figure_style import BLACK, BLUE, GREEN, GREY, STYLE, VERMILION
from studies.paper import study
from studies.paper.methods import METHODS, OURS, PAPER, PAPER_AT_BEST
from studies.paper.study import (
    NESTED,
    PHASES,
    PROFILE,
    PUBLISHED,
    TARGETS,
    Demonstration,
    Outcome,
    collect_errors,
)
from teleop.runtime.output_file import save_figure

DASHED = (0, (4, 2))
COLOURS = {PAPER: VERMILION, PAPER_AT_BEST: GREEN, OURS: BLUE}
LINES = {PAPER: DASHED, PAPER_AT_BEST: (0, (1, 1)), OURS: "solid"}
MARKS = {PAPER: "v", PAPER_AT_BEST: "s", OURS: "o"}
SIGNALS = ("force", "elongation")
SHADES = ("#ffffff", "#eaf3f9", "#ffffff", "#eaf3f9", "#ffffff")  # of the phases
AXIS_MIN, AXIS_MAX = 1e-3, 30.0  # full scales that the distribution shows


def write_figures(shown: Demonstration, outcomes: list[Outcome], folder: Path) -> None:
    """Write all figures into `folder`."""
    with mpl.rc_context(STYLE):
        for name, figure in (
            ("distribution-along", draw_distributions(shown)),
            ("initialisation", draw_initialisation(shown)),
            ("tensions", draw_tensions(shown)),
            ("phases", draw_phases(shown)),
            ("sheaths", draw_sheath_shares(outcomes)),
            ("unevenness", draw_unevenness(outcomes)),
        ):
            save_figure(figure, folder / f"experiment-{name}.png")


def draw_distributions(shown: Demonstration) -> Figure:
    """Draw figure 4: the tension along the sheath while the housing lets go.

    The peak X' travels to the tip, which feels nothing until it arrives.
    """
    figure = Figure(figsize=(6.4, 4.0))
    axes = figure.add_subplot()
    shades = mpl.colormaps["cividis"](np.linspace(0.0, 0.72, len(shown.distributions)))
    for found, shade in zip(shown.distributions, shades, strict=True):
        axes.plot(found.true_x, found.true, color=shade, linewidth=3.0, alpha=0.75)
        axes.plot(found.x, found.estimate, color=BLACK, linewidth=0.9, linestyle=DASHED)
        axes.annotate(
            f"{found.T_in:.1f} N", (0.0, found.T_in), (-4, 0), textcoords="offset points",
            ha="right", va="center", fontsize=7.5, color=shade,
        )  # fmt: skip
    inside = [d for d in shown.distributions if 0.0 < d.front < d.x[-1] * 0.999]
    fronts = [d.front for d in inside], [d.front_tension for d in inside]
    axes.plot(*fronts, "o", color=VERMILION, markersize=6, label="X′, estimated")
    axes.plot([], [], color=shades[0], linewidth=3.0, alpha=0.75, label="plant")
    axes.plot([], [], color=BLACK, linewidth=0.9, linestyle=DASHED, label="ours")
    axes.set(xlabel="distance from the housing [m]", ylabel="tension [N]", ylim=(0.0, None))
    axes.set_xlim(-0.13, None)
    axes.legend(loc="upper right")
    return figure


def draw_initialisation(shown: Demonstration) -> Figure:
    """Draw figure 6: what both load cells read while one motor pulls against the stop."""
    figure = Figure(figsize=(6.4, 4.0))
    axes = figure.add_subplot()
    pulled, found = shown.initialised.pulled, shown.calibrated.direction
    rows = pulled.record.side[:, 0] == 0
    travel = 1e3 * pulled.travel[rows]
    axes.plot(travel, pulled.record.tension[rows, 1], color=GREY, linewidth=0.9, label="tendon b")
    axes.plot(travel, pulled.tension[rows], color=BLUE, label="tendon a, pulled")
    begins = 1e3 * shown.initialised.paper.begins
    axes.axvline(begins, color=VERMILION, linestyle=DASHED, linewidth=1.0)
    place = begins, 0.62 * pulled.tension[rows].max()
    axes.annotate(
        "stop, found from\nthe tension", place, (-6, 0), textcoords="offset points", ha="right",
        color=VERMILION,
    )  # fmt: skip
    true, K = shown.session.specimen.K, found.K
    axes.text(
        0.02,
        0.97,
        f"K = {K.value:.4f} ± {K.uncertainty:.4f} (true {true:.4f})\n"
        f"M_pull = {found.M_pull.value * 1e3:.4f} mm/N, M_rel = {found.M_rel.value * 1e3:.4f} mm/N",
        transform=axes.transAxes,
        va="top",
    )
    axes.set(xlabel="travel of motor a [mm]", ylabel="tension at the housing [N]")
    axes.legend(loc="center left")
    return figure


def draw_tensions(shown: Demonstration) -> Figure:
    """Draw figure 7: the tensions at both ends; shaded while the front is inside the sheath."""
    figure = Figure(figsize=(6.4, 3.4))
    axes = figure.add_subplot()
    record = shown.session.records[PROFILE]
    _shade_phases(axes, shown)
    axes.plot(record.time, record.tension, color=GREY, linewidth=1.0, label="housing, load cell")
    axes.plot(record.time, record.distal_tension, color=BLACK, label="tip, true")
    estimate = shown.estimates[OURS].distal_tension
    axes.plot(record.time, estimate, color=BLUE, linestyle=DASHED, label="tip, ours")
    axes.set(xlabel="time [s]", ylabel="tension [N]", xlim=(0.0, record.time[-1]))
    axes.legend(loc="lower right")
    return figure


def draw_phases(shown: Demonstration) -> Figure:
    """Draw figure 8: predicted and actual, leg by leg, for force and elongation.

    The paper's method is off as in the paper: M_e is too small by the share of T_in that it took to
    reach the stop, and (13) makes twice as much of it in K.
    """
    figure = Figure(figsize=(7.6, 7.2))
    record = shown.session.records[PROFILE]
    counts = study.select_taut(record.tension)
    names = ("first profile: pull", "second: release", "third: pull again")
    grid = figure.subplots(3, 2)
    for leg, (row, name) in enumerate(zip(grid, names, strict=True)):
        where = counts & (record.leg == leg)
        time = record.time[where]
        for axes, signal, factor, unit in (
            (row[0], "distal_tension", 1.0, "tension at the tip [N]"),
            (row[1], "elongation", 1e3, "elongation [mm]"),
        ):
            axes.plot(time, factor * getattr(record, signal)[where], color=BLACK, label="actual")
            for method in (PAPER, OURS):
                estimate = getattr(shown.estimates[method], signal)[where]
                style = {"linestyle": DASHED if method == OURS else (0, (1, 1)), "label": method}
                axes.plot(time, factor * estimate, color=COLOURS[method], **style)
            axes.set(ylabel=unit, title=name)
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    grid[0][0].legend(loc="upper left")
    return figure


def draw_sheath_shares(outcomes: list[Outcome]) -> Figure:
    """Draw the share of the sheaths on which an error is at most so large."""
    figure = Figure(figsize=(7.6, 5.6))
    grid = figure.subplots(2, 2, sharey=True)
    for row, item in zip(grid, ("largest", "average"), strict=True):
        for axes, signal in zip(row, SIGNALS, strict=True):
            which = 0 if item == "largest" else 1
            for method in METHODS:
                for motion, width in ((PROFILE, 1.8), (NESTED, 0.8)):
                    _draw_staircase(axes, outcomes, method, motion, signal, item, width)
            _draw_line(axes, PUBLISHED[signal][which], "the paper's one trial", BLACK, "dotted")
            _draw_line(axes, TARGETS[signal][which], "asked of ours", BLUE, "dashed")
            axes.set_xscale("log")
            limits = 100.0 * AXIS_MIN, 100.0 * AXIS_MAX
            axes.set(xlim=limits, xlabel=f"{item} error of {signal} [% of full scale]")
            axes.xaxis.set_major_formatter("{x:g}")
    for row in grid:
        row[0].set_ylabel("share of the sheaths")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def draw_unevenness(outcomes: list[Outcome]) -> Figure:
    """Draw where the paper's calibration fails: K against how uneven the curvature is.

    Zero is even; bends at the tip are on the left, which (13) takes for other friction.
    """
    figure = Figure(figsize=(7.6, 3.6))
    left, right = figure.subplots(1, 2)
    for method in METHODS:
        held = [o for o in outcomes if o.results[method].scores]
        x = [o.unevenness for o in held]
        off = [o.results[method].K / o.specimen.K - 1.0 for o in held]
        error = 100.0 * collect_errors(held, method, PROFILE, "force", "largest")
        style = {"color": COLOURS[method], "alpha": 0.8, "label": method}
        left.plot(x, 100.0 * np.array(off), MARKS[method], markersize=4, **style)
        right.plot(x, error, MARKS[method], markersize=4, **style)
    what = "unevenness of the curvature, ln(M_rel/M_pull) − K"
    left.set(xlabel=what, ylabel="error of K [%]")
    right.set(xlabel=what, ylabel="largest error of force [% of full scale]", yscale="log")
    right.yaxis.set_major_formatter("{x:g}")
    right.axhline(100.0 * TARGETS["force"][0], color=BLUE, linestyle="dashed", linewidth=0.9)
    left.legend(loc="upper left")
    return figure


def _shade_phases(axes: Axes, shown: Demonstration) -> None:
    record = shown.session.records[PROFILE]
    label = study.label_phases(record.leg, record.tension, record.distal_tension)
    for i, name in enumerate(PHASES):
        times = record.time[label == i]
        if times.size:
            axes.axvspan(times[0], times[-1], color=SHADES[i], linewidth=0.0)
            middle, words = 0.5 * (times[0] + times[-1]), name.replace(" to ", "\nto ")
            above = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
            axes.text(middle, 1.02, words, fontsize=7.5, **above)


def _draw_staircase(
    axes: Axes,
    outcomes: list[Outcome],
    method: str,
    motion: str,
    signal: str,
    item: str,
    width: float,
) -> None:
    errors = np.sort(collect_errors(outcomes, method, motion, signal, item))
    share = np.arange(1, len(errors) + 1) / len(errors)
    kept = np.isfinite(errors)
    x = np.concatenate([[AXIS_MIN], errors[kept], [AXIS_MAX]])
    y = np.concatenate([[0.0], share[kept], share[kept][-1:] if kept.any() else [0.0]])
    axes.step(
        100.0 * x, y, where="post", color=COLOURS[method], linestyle=LINES[method],
        linewidth=width, label=method if motion == PROFILE else None,
    )  # fmt: skip


def _draw_line(axes: Axes, share: float, label: str, colour: str, style: str) -> None:
    axes.axvline(100.0 * share, color=colour, linestyle=style, linewidth=1.0, label=label)
