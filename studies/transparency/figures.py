"""The figures of the study; delays go from light to dark, in Okabe and Ito's colours or greys."""

from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from estimator.drawing import STYLE
from studies.transparency import llewellyn
from studies.transparency.report import PARAMETERS, RIPPLE, TRUSTED, milliseconds, worst
from studies.transparency.study import HANDS, Case, Study
from teleop.runtime.output_file import save_figure

COLOURS = {"direct": "#D55E00", "passivity": "#0072B2", "wave": "#009E73"}
UNITS = {"h11": "N s/m", "h12": "1", "h21": "1", "h22": "m/(N s)"}
NAMES = {
    "h11": "drag in free motion",
    "h12": "force, tip to hand",
    "h21": "motion, hand to tip",
    "h22": "yielding of the tip",
}
IDEAL = "#888888"
GREY: dict[str, Any] = {"color": IDEAL, "linewidth": 3.0, "alpha": 0.4, "zorder": 0}
APART = 9.0  # [points] between two labels of lines, at least


class Label(NamedTuple):
    """What a line is called, at its end."""

    y: float
    text: str
    colour: Any


def draw(study: Study, cases: list[Case], folder: Path) -> dict[str, str]:
    """Write all figures into `folder`; return their captions by file name."""
    captions = {}
    with mpl.rc_context(STYLE):
        for name, figure, caption in _figures(study, cases):
            save_figure(figure, folder / f"{name}.png")
            captions[f"{name}.png"] = caption
    return captions


def _figures(study: Study, cases: list[Case]) -> Iterator[tuple[str, Figure, str]]:
    yield "stiffness", *pressed(study, cases)
    yield "z-width", *walls(study, cases)
    for name in study.couplings:
        yield f"hybrid-{name}", *two_ports(study, name, [c for c in cases if c.coupling == name])
    if linear := [c for c in cases if study.linear(c.coupling, c.round_trip)]:
        yield "llewellyn", *margins(study, linear)


def pressed(study: Study, cases: list[Case]) -> tuple[Figure, str]:
    """Draw rendered against true stiffness and their ratio, a column per coupling."""
    columns = len(study.couplings)
    figure = Figure(figsize=(3.4 * columns + 0.6, 5.4))
    grid = figure.subplots(2, columns, sharex=True, sharey="row", squeeze=False)
    true = np.array(study.stiffnesses)
    scale, ends = study.force_scale * study.position_scale, []
    for (above, below), name in zip(grid.T, study.couplings, strict=True):
        above.plot(true, scale * true, **GREY)
        below.axhline(100.0, **GREY)
        labels = []
        for case, colour in _shaded(study, cases, name):
            felt = np.array([p.felt for p in case.pressed])
            share = np.array([100.0 * p.rendered for p in case.pressed])
            rests = np.array([p.ripple <= RIPPLE for p in case.pressed])
            for axes, y in ((above, np.where(felt > 0.0, felt, np.nan)), (below, share)):
                axes.plot(true, np.where(rests, y, np.nan), "o-", color=colour, markersize=3)
                axes.plot(true[~rests], y[~rests], "o", color=colour, mfc="white", markersize=4)
            labels.append(
                Label(min(max(share[-1], 0.0), 130.0), milliseconds(case.round_trip), colour)
            )
        above.set(xscale="log", yscale="log", title=name)
        below.set(ylim=(0.0, 130.0), xlabel="stiffness at the tip [N/m]")
        ends.append((below, labels, true[-1]))
    grid[0, 0].set_ylabel("stiffness at the hand [N/m]")
    grid[1, 0].set_ylabel("felt of it [%]")
    _label(figure, ends)
    return figure, (
        "Stiffness felt at the hand against the true one, where a hand rests in a spring, for each "
        f"round trip; below, in % of what the scales make of the true one, {scale:g} times (grey). "
        f"Open: the force did not come to rest (ripple above {RIPPLE:g} N), a slope means little."
    )


def walls(study: Study, cases: list[Case]) -> tuple[Figure, str]:
    """Draw the stiffest stable wall against the delay."""
    count = len(study.dampings)
    figure = Figure(figsize=(3.9 * count + 0.8, 3.6))
    row, ends = np.atleast_1d(figure.subplots(1, count, sharey=True)), []
    for axes, damping in zip(row, study.dampings, strict=True):
        labels, last = [], 1e3 * study.round_trips[-1]
        for k, name in enumerate(study.couplings):
            found = [(c.round_trip, worst(c, damping).width) for c in cases if c.coupling == name]
            delay = np.array([1e3 * d for d, _ in found])
            # so little apart that both show, where both reach the cap
            stable = np.array([max(w.stable, study.lowest / 2) for _, w in found]) * 1.04**k
            axes.plot(delay, stable, color=COLOURS[name])
            for x, y, (_, w) in zip(delay, stable, found, strict=True):
                mark = "^" if not isfinite(w.unstable) else "o" if w.stable > 0.0 else "v"
                axes.plot(x, y, mark, color=COLOURS[name], markersize=6)
            labels.append(Label(stable[-1], name, COLOURS[name]))
        axes.axhspan(study.lowest / 4, study.lowest, color="#f2f2f2", zorder=0)
        axes.set(
            yscale="log",
            ylim=(study.lowest / 4, 2.0 * study.cap),
            title=f"device damping {damping:g} N s/m",
            xlabel="round trip [ms]",
        )
        ends.append((axes, labels, last))
    _label(figure, ends)
    row[0].set_ylabel("stiffest stable wall at the tip [N/m]")
    return figure, (
        f"Z-width with the worse of {len(HANDS)} hands. ▲ stable up to the cap of "
        f"{study.cap:g} N/m, beyond which nothing was tried; ▼ not even {study.lowest:g} N/m "
        "(grey), below which nothing was tried. Lines that reach the cap are set a little apart."
    )


def two_ports(study: Study, name: str, cases: list[Case]) -> tuple[Figure, str]:
    """Draw magnitude and phase of the hybrid parameters of a coupling."""
    figure = Figure(figsize=(11.6, 5.0))
    grid = figure.subplots(2, len(PARAMETERS), sharex=True)
    ideal = {
        "h12": (study.force_scale, (0.0,)),
        "h21": (study.position_scale, (-180.0, 180.0)),
    }
    for parameter, (above, below) in zip(PARAMETERS, grid.T, strict=True):
        for case, colour in _shaded(study, cases, name):
            frequency, response = case.hybrid.frequency, getattr(case.hybrid, parameter)
            size, turn = np.abs(response.value), np.degrees(np.angle(response.value))
            trusted = response.coherence >= TRUSTED
            above.plot(frequency, size, color=colour, linewidth=0.9)
            for axes, y in ((above, size), (below, turn)):
                axes.plot(frequency[trusted], y[trusted], "o", color=colour, markersize=3.5)
                axes.plot(
                    frequency[~trusted],
                    y[~trusted],
                    "o",
                    markerfacecolor="white",
                    color=colour,
                    markersize=3.5,
                )
        if parameter in ideal:
            size, turns = ideal[parameter]
            above.set_ylim(0.003 * size, 5.0 * size)
            above.axhline(size, **GREY)
            for turn in turns:
                below.axhline(turn, **GREY)
        above.set(xscale="log", yscale="log", title=f"{parameter}: {NAMES[parameter]}")
        above.set_ylabel(f"|{parameter}| [{UNITS[parameter]}]")
        below.set(ylim=(-190, 190), yticks=range(-180, 181, 90), xlabel="frequency [Hz]")
        below.set_ylabel("phase [°]")
        above.xaxis.set_major_formatter("{x:g}")
    handles = [
        Line2D([], [], color=colour, label=milliseconds(case.round_trip))
        for case, colour in _shaded(study, cases, name)
    ]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), title="round trip"
    )
    linear = any(study.linear(name, c.round_trip) for c in cases)
    return figure, (
        f"Hybrid parameters of {name}. Grey: the ideal of h12 and h21; that of h11 and h22 "
        f"is zero. Open: coherence below {TRUSTED:g}, there is no linear answer. "
        + (
            ""
            if linear
            else "This coupling is not linear, or the network not constant: describing functions, "
            "right for inputs of this kind and size only."
        )
    )


def margins(study: Study, cases: list[Case]) -> tuple[Figure, str]:
    """Draw Llewellyn's margin over frequency."""
    figure = Figure(figsize=(6.8, 3.8))
    axes = figure.add_subplot()
    labels = []
    for case, colour in _shaded(study, cases, cases[0].coupling):
        found, frequency = llewellyn.margin(case.hybrid), case.hybrid.frequency
        axes.plot(frequency, found.eta, color=colour, linewidth=1.0)
        for where, face in ((found.stable, colour), (~found.stable, "white")):
            axes.plot(
                frequency[where], found.eta[where], "o", color=colour, markerfacecolor=face, ms=5
            )
        labels.append(Label(found.eta[-1], milliseconds(case.round_trip), colour))
    axes.axhspan(-1.0, 1.0, color="#f2f2f2", zorder=0)
    axes.axhline(1.0, color=IDEAL, linewidth=1.0)
    axes.set(xscale="log", xlabel="frequency [Hz]", ylabel="η", title="direct")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -1.1), max(high, 1.3))
    axes.xaxis.set_major_formatter("{x:g}")
    _label(figure, [(axes, labels, cases[0].hybrid.frequency[-1])])
    return figure, (
        "Llewellyn's absolute stability margin. Below 1 (grey) there are a passive hand and a "
        "passive environment with which the system is unstable. Open: one of the three conditions "
        "fails; where η is 1 or more, that is Re h11 < 0 or Re h22 < 0. Measured at the marks only."
    )


def _shaded(study: Study, cases: list[Case], name: str) -> list[tuple[Case, Any]]:
    """Return the cases of a coupling with the shade of their delay."""
    shades = mpl.colormaps["cividis_r"](np.linspace(0.12, 1.0, max(len(study.round_trips), 2)))
    return [(c, shades[study.round_trips.index(c.round_trip)]) for c in cases if c.coupling == name]


def _label(figure: Figure, ends: Sequence[tuple[Axes, list[Label], float]]) -> None:
    """Write labels beside the ends of lines, at an x each, none over another."""
    figure.draw_without_rendering()
    points = 72.0 / figure.dpi
    for axes, labels, x in ends:
        below = -np.inf
        for label in sorted((one for one in labels if isfinite(one.y)), key=lambda one: one.y):
            at = axes.transData.transform((x, label.y))[1] * points
            shift = max(at, below + APART) - at
            below = at + shift
            axes.annotate(
                label.text,
                (x, label.y),
                (6, shift),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=label.colour,
            )
