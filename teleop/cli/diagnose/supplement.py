"""A supplement for a paper: one page, its figures as SVG and its tables as CSV beside it."""

import csv
import sysconfig
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import yaml
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis import report_tables, report_text
from estimator.diagnosis.figures import draw_figures
from estimator.diagnosis.outcome import Diagnosis, PredictedRecord
from estimator.diagnosis.residual_structure import Autocorrelation, autocorrelate_channel
from estimator.effects import Effect
from estimator.figure_style import BLACK, BLUE, STYLE, to_svg
from estimator.report_table import Table
from estimator.units import Units
from teleop.cli.html_page import Page
from teleop.data.measured_table import write_table
from teleop.data.raw_table import Column
from teleop.runtime.output_file import replace_file
from teleop.runtime.process import write_text_file

# --- the extended law as mathematics, in the notation of matplotlib's mathtext
# Symbols are those of docs/explanation/theory.md: T tension, s friction coordinate from 0 at the
# housing to K at the tip, q_p and q_d travel at the housing and at the tip, e elongation, L/EA
# compliance, c compliance of the load at the tip; r what a sensor reads.


LAW = (
    r"\left|\frac{\partial T}{\partial s}\right| \leq T, \quad"
    r" \frac{\partial T}{\partial s} = -T\,\mathrm{sgn}\,v\ \mathrm{where\ it\ slides},"
    r" \quad 0 \leq s \leq K"
)
TRAVEL = r"q_p = q_d + e, \quad e = \frac{L}{EA}\,\frac{1}{K}\int_0^K T\,\mathrm{d}s"
TIP = r"q_d = c\,T(K)"

_FRICTION = r"\frac{\partial T}{\partial s} = -\mathrm{sgn}(v)\,"
_DELAY = r"r(t) = x(t - \tau), \quad \tau = \mathrm{time}"
_FILTER = r"\mathrm{time}\,\dot r + r = x"
_STRIBECK = r"K(v) = K\left(1 + \mathrm{ratio}\;e^{-(v/\mathrm{speed})^2}\right)"
_SENSORS = {
    "the load cell at the housing": "T(0)",
    "the load cell at the tip": "T(K)",
    "the encoder at the motor": "q_p",
    "the encoder at the tip": "q_d",
}

FORMULAS = {
    "friction_step": r"K(t) = K\,(1 + \mathrm{change}\cdot[\,t \geq \mathrm{onset}\,])",
    "friction_drift": r"K(t) = K\,(1 + \mathrm{rate}\;t)",
    "constant_drag": _FRICTION + r"(T + \mathrm{drag})",
    "viscous_friction": _FRICTION + r"(T + \mathrm{viscosity}\,|v|)",
    "stribeck_friction (by the motor's speed)": _STRIBECK + r", \quad v = \dot q_p",
    "stribeck_friction (by each contact's own, with a memory)": _STRIBECK
    + r", \quad \mathrm{memory}\,\dot v + v = v_{\mathrm{contact}}",
    "presliding (the same distance at any tension)": r"\mathrm{d}F = \frac{T}{\mathrm{distance}}\,"
    r"\mathrm{d}x, \quad |F| \leq T",
    "presliding (the same stiffness at any tension)": r"\mathrm{d}F ="
    r" \frac{10\,\mathrm{N}}{\mathrm{distance}}\,\mathrm{d}x, \quad |F| \leq T",
    "direction_asymmetry": r"\frac{\partial \ln T}{\partial s} = -1\ \mathrm{(pulling)}, \quad"
    r" +\mathrm{ratio}\ \mathrm{(releasing)}",
    "tension_dependent_friction (a power of the tension)": _FRICTION
    + r"T\left(\frac{T}{10\,\mathrm{N}}\right)^{\mathrm{exponent}-1}",
    "tension_dependent_friction (linear in the tension)": _FRICTION + r"T\,(1 + \mathrm{rise}\;T)",
    "stick_slip": r"K\,(1 + \mathrm{ratio}\;a), \quad \dot a ="
    r" \frac{1 - a}{\mathrm{time}} - \frac{a\,|v|}{\mathrm{distance}}",
    "nonuniform_curvature (gradually along the sheath)": r"\frac{\mathrm{d}x}{\mathrm{d}s} \propto"
    r" e^{\mathrm{ratio}\;s/K}",
    "nonuniform_curvature (two sections)": r"\frac{\mathrm{d}x}{\mathrm{d}s} \propto"
    r" e^{\mathrm{ratio}\cdot[\,s > \mathrm{cut}\;K\,]}",
    "nonlinear_stiffness": r"e \to e + \mathrm{toe}\left(1 - e^{-T/\mathrm{tension}}\right)",
    "creep": r"e \to e + \kappa, \quad \dot\kappa = \frac{\mathrm{share}\;e - \kappa}"
    r"{\mathrm{time}}",
    "sheath_compression": r"e \to e + \mathrm{compression}\,"
    r"\left(\max(T(0) - \mathrm{threshold},\,0)\right)^2",
    "slack": r"q_p \to q_p - \mathrm{length}\ \mathrm{before}\ T > 0",
    "thermal_expansion": r"e \to e + \mathrm{rate}\;\mathrm{time}\left(1 -"
    r" e^{-t/\mathrm{time}}\right)",
    "pretension (the same all along)": r"T(s, 0) = \mathrm{tension}",
    "joint_backlash": r"r = P_{\mathrm{width}/2}[q_d]\ \mathrm{(play\ operator)}",
    "joint_friction": r"T(K) = q_d/c + \mathrm{friction}\;\mathrm{sgn}\,\dot q_d",
    "antagonist_tension": r"T(K) = q_d/c + \mathrm{tension}\,(e^{\sigma} - 1), \quad"
    r" -K_2 \leq \sigma \leq K_2",
    "tip_contact": r"T(K) = q_d/c + \frac{\mathrm{hardness}}{1 - \mathrm{hardness}}\,"
    r"\max(q_d - \mathrm{travel},\,0)/c",
    "tip_inertia": r"T(K) = q_d/c + \mathrm{damping}\;\dot q_d + \mathrm{mass}\;\ddot q_d",
    "link_gravity": r"T(K) = q_d/c + \mathrm{sine}\,\sin q_p + \mathrm{cosine}\,\cos q_p - w\,q_p,"
    r" \quad w^2 = \mathrm{sine}^2 + \mathrm{cosine}^2",
    "tip_moved (and left it there)": r"q_d = c\,T(K) + \mathrm{size}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "tip_moved (and took it back)": r"q_d = c\,T(K) + \mathrm{size}\cdot"
    r"[\,\mathrm{onset} \leq t < \mathrm{return}\,]",
    "proximal_tension_gain": r"r = (1 + \mathrm{gain})\,T(0)",
    "distal_tension_gain": r"r = (1 + \mathrm{gain})\,T(K)",
    "proximal_tension_bias": r"r = T(0) + \mathrm{bias}",
    "distal_tension_bias": r"r = T(K) + \mathrm{bias}",
    "proximal_tension_drift": r"r = T(0) + \mathrm{rate}\;t",
    "distal_tension_drift": r"r = T(K) + \mathrm{rate}\;t",
    **{
        f"sensor_lag ({sensor}, by a {kind})": rf"{formula}, \quad x = {signal}"
        for kind, formula in (("delay", _DELAY), ("filter", _FILTER))
        for sensor, signal in _SENSORS.items()
    },
    "sensor_lag (all sensors at the tip, by their clock)": _DELAY + r", \quad x = T(K),\ q_d",
    "saturation (the load cell at the housing)": r"r = \min(T(0),\ \mathrm{limit})",
    "saturation (the load cell at the tip)": r"r = \min(T(K),\ \mathrm{limit})",
    "encoder_scale (the encoder at the motor)": r"r = (1 + \mathrm{gain})\,q_p",
    "encoder_scale (the encoder at the tip)": r"r = (1 + \mathrm{gain})\,q_d",
    "encoder_slip (the encoder at the motor)": r"r = q_p + \mathrm{slip}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "encoder_slip (the encoder at the tip)": r"r = q_d + \mathrm{slip}\cdot"
    r"[\,t \geq \mathrm{onset}\,]",
    "pulley_eccentricity": r"r = q_p + \mathrm{sine}\,\sin\frac{q_p}{\mathrm{radius}} +"
    r" \mathrm{cosine}\,\cos\frac{q_p}{\mathrm{radius}}",
    "cogging_ripple": r"r = T(0) + \mathrm{sine}\,\sin(\mathrm{number}\;q_p) +"
    r" \mathrm{cosine}\,\cos(\mathrm{number}\;q_p)",
    "sheath_rub": r"r = T(0) + \mathrm{force}\;\mathrm{sgn}\,\dot q_p\ \mathrm{(a\ play\ of"
    r"\ the\ width)}",
}
"""What each effect adds, by its label; others are given by their equation in words."""


def _format_equation_text(effect: Effect) -> str:
    words = effect.equation
    for sign in "\\_^{}$%#&":
        words = words.replace(sign, " ")
    return r"\mathrm{" + words.replace(" ", r"\ ") + "}"


# --- how to cite this software, from CITATION.cff

CITATION_FILE = "CITATION.cff"
CITATION_PATHS = (
    Path(__file__).parents[3] / CITATION_FILE,  # of the sources
    Path(sysconfig.get_path("data"))
    / "share"
    / "tendon-teleop"
    / CITATION_FILE,  # of an installed wheel
)


def load_citations() -> tuple[str, ...]:
    """Return the references to be cited: the software, then the papers that it names."""
    path = next((candidate for candidate in CITATION_PATHS if candidate.is_file()), None)
    if path is None:
        return (
            f"tendon-teleop {version('tendon-teleop')} ({CITATION_FILE} is not in this "
            f"installation)",
        )
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    software = (
        f"{_format_authors(tree)}. {tree['title']} (version {tree['version']}) [software]. "
        f"{tree['license']}."
    )
    return (software, *(_format_reference(reference) for reference in tree.get("references", ())))


def _format_reference(tree: dict[str, Any]) -> str:
    year = f" ({tree['year']})" if "year" in tree else ""
    return f"{_format_authors(tree)}{year}. {tree['title']}."


def _format_authors(tree: dict[str, Any]) -> str:
    names = [
        author.get("name") or f"{author['family-names']}, {author['given-names']}"
        for author in tree["authors"]
    ]
    return ", ".join(names)


SYMBOLS = (
    "T tension at the friction coordinate s, from 0 at the housing to K at the tip; q_p, q_d "
    "travel at the housing and at the tip; e elongation; L/EA compliance of the tendon; c "
    "compliance of the load at the tip; v sliding speed; F friction per unit of s; t time from the "
    "first sample; x a signal, r its reading; a, κ and σ inner states."
)


class Sources(NamedTuple):
    """What a supplement says of its making."""

    command: str
    files: tuple[str, ...]
    further: tuple[str, ...]  # for validation
    read_as: Sequence[str]  # how each was read


def write_supplement(folder: Path, diagnosis: Diagnosis, sources: Sources) -> Path:
    """Write the page, its figures and its tables into a folder; return the page's path."""
    page = Page(build_title(diagnosis, sources.files))
    page.add_points(
        [
            f"Date: {datetime.now(UTC).date().isoformat()}",
            f"Software: tendon-teleop {version('tendon-teleop')}",
            f"Command: {sources.command}",
        ]
    )
    page.add_text(report_text.format_verdict(diagnosis))
    _add_data(page, diagnosis, sources)
    _add_law(page, diagnosis, folder)
    _add_table(page, folder, "parameters", report_tables.build_parameter_table(diagnosis))
    if diagnosis.rivals:
        page.add_heading("Rivals")
        page.add_text("Causes that explain the data equally well, each fitted to all samples.")
        _add_table(page, folder, "rivals", report_tables.build_rival_parameter_table(diagnosis))
    if diagnosis.rival_forces:
        _add_table(page, folder, "rival-forces", report_tables.build_rival_table(diagnosis))
    _add_errors(page, diagnosis, folder, sources)
    _add_residuals(page, diagnosis, folder)
    page.add_heading("How to cite")
    page.add_points(load_citations())
    _write_records(folder, diagnosis)
    path = folder / "supplement.html"
    write_text_file(path, page.render(), "the supplement")
    return path


def build_title(diagnosis: Diagnosis, files: Sequence[str]) -> str:
    """Return a short title."""
    names = [Path(file).name for file in files]
    subject = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    causes = " and ".join(step.effect.label for step in diagnosis.steps)
    return f"Model of {subject}: {causes or diagnosis.verdict.value}"


def _add_data(page: Page, diagnosis: Diagnosis, sources: Sources) -> None:
    rows = []
    for file, record in zip(sources.files, diagnosis.dataset.records, strict=True):
        count, time = int(record.measured.sum()), record.time[record.measured]
        excluded = sum(trouble.samples for trouble in record.issues if trouble.excluded)
        rows.append(
            (
                Path(file).name,
                f"{record.start:.6g} to {record.start + float(time[-1]):.6g} s",
                str(count),
                f"{1.0 / float(np.median(np.diff(time))):.4g} Hz",
                str(excluded),
                ", ".join(map(record.units.name_channel, record.signals)),
            )
        )
    head = ("file", "time", "samples", "rate", "samples excluded", "channels")
    page.add_section("Data", Table(head, tuple(rows)))
    page.add_points(sources.read_as)
    driver = diagnosis.dataset.records[0].driver
    judged = (
        "All samples were fitted; errors are in-sample."
        if diagnosis.fit_all
        else "Held-out errors are those of two-fold cross-validation on alternating blocks of time."
    )
    page.add_text(f"The {diagnosis.units.name_channel(driver)} drives the simulation. {judged}")


def _add_law(page: Page, diagnosis: Diagnosis, folder: Path) -> None:
    page.add_heading("Extended law")
    lines = [LAW, TRAVEL, TIP] if len(diagnosis.dataset.base.shared) > 1 else [LAW]  # no travel
    effects = [effect for effect, _ in diagnosis.extended.model.effects]
    lines += [FORMULAS.get(effect.label) or _format_equation_text(effect) for effect in effects]
    for k, line in enumerate(lines, start=1):
        figure = Figure(figsize=(6.0, 0.6))
        figure.set_layout_engine("none")
        figure.text(0.0, 0.4, f"${line}$", fontsize=14)
        drawing = to_svg(figure, cut=True)
        write_text_file(folder / f"equation-{k}.svg", drawing, "an equation")
        page.add_drawing(drawing, f"({k})")
    page.add_text(SYMBOLS)


def _add_errors(page: Page, diagnosis: Diagnosis, folder: Path, sources: Sources) -> None:
    names = report_tables.name_records(diagnosis, sources.files, sources.further)
    fitted = len(diagnosis.dataset.records)
    page.add_heading("Cross-validation" if not diagnosis.fit_all else "Errors")
    _add_table(page, folder, "errors", report_tables.build_error_table(diagnosis))
    _add_table(page, folder, "models", report_tables.build_model_table(diagnosis))
    for records, title, name, own in (
        (diagnosis.validation, "Validation", "validation", names[fitted:]),
        (diagnosis.left_out, "Leave-one-file-out cross-validation", "left-out", names[:fitted]),
    ):
        if records:
            page.add_heading(title)
            table = report_tables.build_prediction_table(records, own)
            _add_table(page, folder, name, table)
    if diagnosis.forces:
        page.add_heading("Estimated force")
        _add_table(page, folder, "forces", report_tables.build_force_table(diagnosis, names))
    page.add_heading("Figures")
    with mpl.rc_context(STYLE):
        for drawn in draw_figures(diagnosis, sources.files, sources.further):
            drawing = to_svg(drawn.figure)
            write_text_file(folder / f"{drawn.name}.svg", drawing, "a figure")
            page.add_drawing(drawing, drawn.caption)


def _add_residuals(page: Page, diagnosis: Diagnosis, folder: Path) -> None:
    page.add_heading("Residual")
    page.add_points(
        [
            f"{diagnosis.units.name_channel(item.channel)}: the residual correlates with "
            f"{item.what}, which explains {item.share:.0%} of its variance"
            for item in diagnosis.residual_dependences
        ]
        or ["The residual correlates with no tension, speed, direction, travel or time."]
    )
    channels = report_tables.list_compared_channels(diagnosis)
    parts = {
        channel: autocorrelate_channel(diagnosis.dataset, diagnosis.extended, channel)
        for channel in channels
    }
    drawing = to_svg(draw_autocorrelations(parts, diagnosis.units))
    write_text_file(folder / "autocorrelation.svg", drawing, "a figure")
    page.add_drawing(
        drawing,
        "Autocorrelation of the residual of the extended law; 95 % of white noise lie in the band.",
    )
    for channel, item in parts.items():
        write_table(
            folder / f"autocorrelation-{channel}.csv",
            {"lag_s": item.lag, "autocorrelation": item.value},
        )


def draw_autocorrelations(parts: dict[str, Autocorrelation], units: Units) -> Figure:
    """Draw the autocorrelation of the residual of each channel."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, 0.4 + 1.8 * len(parts)))
        grid = figure.subplots(len(parts), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (channel, autocorrelation) in zip(grid, parts.items(), strict=True):
            axes.axhspan(
                -autocorrelation.band, autocorrelation.band, color="#e6e6e6", linewidth=0.0
            )
            axes.plot(autocorrelation.lag, autocorrelation.value, color=BLUE)
            axes.axhline(0.0, color=BLACK, linewidth=0.6)
            axes.set(title=units.name_channel(channel), ylabel="autocorrelation")
        grid[-1].set_xlabel("lag [s]")
        return figure


def _add_table(page: Page, folder: Path, name: str, table: Table) -> None:
    """Add a table to the page, and write it beside it."""
    page.add_table(table)
    with (
        replace_file(folder / f"{name}.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file).writerows([table.head, *table.rows])


def _write_records(folder: Path, diagnosis: Diagnosis) -> None:
    """Write what was measured and simulated, a file for each record."""
    fits = (diagnosis.baseline.simulated, diagnosis.extended.simulated)
    for k, record in enumerate(diagnosis.dataset.records):
        prediction = PredictedRecord(record, *(fit[k] for fit in fits))
        _write_record(folder / f"residuals-{k + 1}.csv", prediction)
    for kind, records in (("validation", diagnosis.validation), ("left-out", diagnosis.left_out)):
        for k, prediction in enumerate(records):
            _write_record(folder / f"residuals-{kind}-{k + 1}.csv", prediction)


def _write_record(path: Path, prediction: PredictedRecord) -> None:
    rows = prediction.record.measured
    columns = {"time_s": (prediction.record.time + prediction.record.start)[rows]}
    for channel in prediction.record.compared:
        unit = prediction.record.units.get_unit(channel).replace(" ", "")
        is_measured = prediction.record.present[channel]
        measured, before, after = (
            signals[channel]
            for signals in (
                prediction.record.signals,
                prediction.before.signals,
                prediction.after.signals,
            )
        )
        columns[f"{channel}_{unit}"] = _to_cells(measured, is_measured)[rows]
        columns[f"{channel}_plain_{unit}"] = before[rows]
        columns[f"{channel}_extended_{unit}"] = after[rows]
        columns[f"{channel}_residual_{unit}"] = _to_cells(measured - after, is_measured)[rows]
        columns[f"{channel}_counts"] = prediction.record.valid[channel][rows].astype(np.int64)
    write_table(path, columns)


def _to_cells(values: Array, is_measured: NDArray[np.bool_]) -> Column:
    """Return values as cells of a table, empty where they are not known."""
    cells = values.astype(object)
    cells[~is_measured] = None
    return cells
