"""transparency.html: the study on one self-contained page, and its figures."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.drawing import STYLE
from studies.transparency import hybrid, report, stiffness, zwidth
from studies.transparency.report import PARAMETERS, RIPPLE, TRUSTED, milliseconds, worst
from studies.transparency.study import CONTACT, HANDS, LOAD, PRETENSION, SPRING, Case, Study
from teleop.cli.html_page import Page
from teleop.runtime.output_file import save_figure

# --- the figures of the study; delays go from light to dark, in Okabe and Ito's colours or greys

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


def draw_figures(study: Study, cases: list[Case], folder: Path) -> dict[str, str]:
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
                axes.plot(true, np.where(rests, y, np.nan), color=colour)
                _mark(axes, true, y, rests, colour)
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
    ideal = {"h12": (study.force_scale, (0.0,)), "h21": (study.position_scale, (-180.0, 180.0))}
    for parameter, (above, below) in zip(PARAMETERS, grid.T, strict=True):
        for case, colour in _shaded(study, cases, name):
            frequency, response = case.hybrid.frequency, getattr(case.hybrid, parameter)
            size, turn = np.abs(response.value), np.degrees(np.angle(response.value))
            trusted = response.coherence >= TRUSTED
            above.plot(frequency, size, color=colour, linewidth=0.9)
            for axes, y in ((above, size), (below, turn)):
                _mark(axes, frequency, y, trusted, colour)
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
        found, frequency = hybrid.margin(case.hybrid), case.hybrid.frequency
        axes.plot(frequency, found.eta, color=colour, linewidth=1.0)
        _mark(axes, frequency, found.eta, found.stable, colour)
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


def _mark(axes: Axes, x: Array, y: Array, holds: NDArray[np.bool_], colour: Any) -> None:
    """Draw points, open where something does not hold."""
    for where, face in ((holds, colour), (~holds, "white")):
        axes.plot(x[where], y[where], "o", color=colour, markerfacecolor=face, markersize=3.5)


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


TITLE = "Transparency and stability of the couplings"

MISSING = (
    "The rig is ideal: no friction, a tip without mass, a motor of 12.5 ms lag, and an estimator "
    "that knows it. What a sheath adds is not in here.",
    "One axis, one amplitude. The clamps and slew limits of both sides are at work in the walls, "
    "and not reached in the hybrid parameters.",
    "Hands and device are assumed, not measured; no hand has a tremor, a reflex or a grip that "
    "changes.",
    "Z-width: between the stiffnesses that were tried, and below the first that failed, stability "
    "is assumed to be of one piece.",
    "Stable means stable with these hands in this motion. Only Llewellyn's criterion speaks of "
    "all, and only of a linear system.",
    "A hand that is held or that goes its way gives and takes no energy that a passivity "
    "controller would refuse: h12 and h22 of a passivity coupling are those of a direct one.",
)


def render(study: Study, cases: list[Case]) -> str:
    """Return the page."""
    page = Page(TITLE)
    page.text(
        "The live code of both loops, with the bytes of their messages, between a simulated hand "
        "and a simulated tip. How much of a spring is felt; how stiff a wall may be before a hand "
        "in it is shaken; what the system is as a two-port, over frequency; and whether that is "
        "stable with any passive hand and tissue."
    )
    page.heading("In short")
    page.table(report.summary(study, cases), mark="")
    page.points(_columns(study))
    with TemporaryDirectory() as folder:
        captions = draw_figures(study, cases, Path(folder))

        def figure(name: str) -> None:
            page.figure(Path(folder) / name, captions[name])

        page.heading("Settings")
        page.points(_settings(study))
        _add_stiffness(page, study, cases, figure)
        _add_widths(page, study, cases, figure)
        _add_hybrid(page, study, cases, figure)
        _add_stability(page, figure, drawn="llewellyn.png" in captions)
    page.heading("What is not shown")
    page.points(MISSING)
    return page.render()


def _add_stiffness(
    page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]
) -> None:
    """Add what is felt of a spring."""
    page.heading("Rendered against true stiffness")
    page.text(
        f"A hand that goes its way presses a spring in {stiffness.STEPS} steps, up to "
        f"{stiffness.FORCE:g} N at the tip, and rests after each. The slope of force over "
        "motion, at rest, is what is felt. A ripple of the force above "
        f"{report.RIPPLE:g} N is reported."
    )
    figure("stiffness.png")
    page.table(report.stiffnesses(study, cases), mark="")


def _add_widths(page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]) -> None:
    """Add how stiff a wall may be."""
    page.heading("Z-width")
    page.text(
        f"A hand reaches through a contact, {1e3 * CONTACT:g} mm of the tip away, into a wall, "
        f"pushes with {zwidth.PUSH:g} N and rests for {zwidth.REST:g} s. Stable: its swing in "
        f"the last {zwidth.SPAN:g} s, beside its straight trend, is at most "
        f"{1e3 * zwidth.SWING:g} mm, or at most {zwidth.FADES:g} times that of the same time "
        f"before; on balance it never got more than {1e3 * zwidth.ENERGY:g} mJ out of the "
        "system; and the session is still engaged. The stiffness rises "
        f"{study.factor:g}-fold from {study.lowest:g} N/m until a wall is not stable; then it "
        f"is halved in to {100 * (study.within - 1.0):.0f} %. Buzz is the standard deviation "
        "of the force on the resting hand, in the stiffest stable wall."
    )
    figure("z-width.png")
    page.table(report.widths(study, cases), mark="")


def _add_hybrid(page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]) -> None:
    """Add the two-port over frequency."""
    page.heading("Hybrid parameters")
    page.text(
        "f_h = h11 v_h + h12 f_e, −v_e = h21 v_h + h22 f_e (Hannaford 1989), f_h by the hand "
        "on the device, f_e against the tip's motion, the device included. First the hand is "
        f"moved by a multisine under a constant load of {LOAD:g} N, then it is held and the "
        f"load is a multisine. Per line: {1e3 * study.excitation.speed:g} mm/s of the tip, "
        f"{study.excitation.force:g} N; {study.excitation.draws} draws of phases, "
        f"{study.excitation.periods} periods of {study.excitation.period:g} s each. "
        "Coherence falls where an answer is noise or depends on the phases of other lines; "
        "distortion is the answer at harmonics that were not asked."
    )
    for name in study.couplings:
        figure(f"hybrid-{name}.png")
    page.table(report.quality(cases), mark="")


def _add_stability(page: Page, figure: Callable[[str], None], *, drawn: bool) -> None:
    """Add Llewellyn's criterion."""
    page.heading("Absolute stability")
    if drawn:
        page.text(
            "η = (2 Re h11 Re h22 − Re(h12 h21)) / |h12 h21| (Llewellyn 1952; Adams & "
            "Hannaford 1999). It is reported where the coupling's law is linear and the network "
            "constant; elsewhere it does not apply."
        )
        figure("llewellyn.png")
    else:
        page.text(
            "Llewellyn's criterion applies to linear systems with a constant network; none "
            "of these is one."
        )


def _columns(study: Study) -> list[str]:
    return [
        "felt: stiffness at the hand, in % of what the scales make of the true one.",
        f"Z-width: stiffest wall that is stable with the worse of two hands; ≥ {study.cap:g}: "
        f"nothing was unstable up to there; < {study.lowest:g}: not even that was stable.",
        "buzz: standard deviation of the force on a hand that rests in that wall, the worst.",
        "drag: Re h11, what a hand feels in free motion, the device's own damping of "
        f"{study.device.damping:g} N s/m included.",
    ]


def _settings(study: Study) -> list[str]:
    device = study.device
    return [
        f"Scales: force {study.force_scale:g}, motion {study.position_scale:g}.",
        f"Network: half of each round trip each way, jitter ±{1e3 * study.jitter:g} ms of the "
        f"round trip (never more than that itself), {100.0 * study.loss:g} % loss each way.",
        f"Device: {device.mass:g} kg, {device.damping:g} N s/m (Z-width: "
        f"{', '.join(f'{b:g}' for b in study.dampings)}), encoder of "
        f"{1e6 * device.resolution:g} µm, velocity filtered over {1e3 * device.smoothing:g} ms, "
        "force held for 1 ms.",
        *(
            f"Hand, {name}: {h.mass:g} kg, {h.stiffness:g} N/m, {h.damping:g} N s/m."
            for name, h in HANDS.items()
        ),
        f"Rig: one tendon of 6 kN/m, pretension {PRETENSION:g} N, for the walls a return spring "
        f"of {SPRING:g} N/m; tension noise 0.01 N.",
        *(_coupling(study, name) for name in study.couplings),
    ]


def _coupling(study: Study, name: str) -> str:
    """Return what is set of a coupling, in SI units and those of the tip."""
    values = asdict(study.coupling(name))
    values.pop("type")
    parameters = ", ".join(f"{key} {value:g}" for key, value in values.items())
    return f"Coupling {name}: {parameters or 'nothing to set'}."
