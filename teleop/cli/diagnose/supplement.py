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
from estimator.diagnosis.scoring import Autocorrelation, autocorrelate_channel
from estimator.drawing import BLACK, BLUE, STYLE, to_svg
from estimator.text_table import Table
from estimator.units import Units
from teleop.cli.diagnose import formulas
from teleop.cli.report.page import Page
from teleop.data.table import write_table
from teleop.data.table_files import Column
from teleop.runtime.output_file import replace_file
from teleop.runtime.process import write_text_file

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
    path = next((place for place in CITATION_PATHS if place.is_file()), None)
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
    return (software, *(_format_reference(one) for one in tree.get("references", ())))


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


def write_supplement(folder: Path, found: Diagnosis, sources: Sources) -> Path:
    """Write the page, its figures and its tables into a folder; return the page's path."""
    page = Page(build_title(found, sources.files))
    page.points(
        [
            f"Date: {datetime.now(UTC).date().isoformat()}",
            f"Software: tendon-teleop {version('tendon-teleop')}",
            f"Command: {sources.command}",
        ]
    )
    page.text(report_text.format_verdict(found))
    _add_data(page, found, sources)
    _add_law(page, found, folder)
    _add_table(page, folder, "parameters", report_tables.build_parameter_table(found))
    if found.rivals:
        page.heading("Rivals")
        page.text("Causes that explain the data equally well, each fitted to all samples.")
        _add_table(page, folder, "rivals", report_tables.build_rival_parameter_table(found))
    if found.rival_forces:
        _add_table(page, folder, "rival-forces", report_tables.build_rival_table(found))
    _add_errors(page, found, folder, sources)
    _add_residuals(page, found, folder)
    page.heading("How to cite")
    page.points(load_citations())
    _write_records(folder, found)
    path = folder / "supplement.html"
    write_text_file(path, page.render(), "the supplement")
    return path


def build_title(found: Diagnosis, files: Sequence[str]) -> str:
    """Return a short title."""
    names = [Path(file).name for file in files]
    what = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    causes = " and ".join(step.effect.label for step in found.steps)
    return f"Model of {what}: {causes}" if causes else f"Model of {what}: {found.verdict.value}"


def _add_data(page: Page, found: Diagnosis, sources: Sources) -> None:
    rows = []
    for file, record in zip(sources.files, found.dataset.records, strict=True):
        count, time = int(record.measured.sum()), record.time[record.measured]
        excluded = sum(trouble.samples for trouble in record.issues if trouble.excluded)
        rows.append(
            (
                Path(file).name,
                f"{record.start:.6g} to {record.start + float(time[-1]):.6g} s",
                str(count),
                f"{1.0 / float(np.median(np.diff(time))):.4g} Hz",
                str(excluded),
                ", ".join(map(record.units.word, record.signals)),
            )
        )
    page.heading("Data")
    head = ("file", "time", "samples", "rate", "samples excluded", "channels")
    page.table(Table(head, tuple(rows)), mark="")
    driver = found.dataset.records[0].driver
    judged = (
        "All samples were fitted; errors are in-sample."
        if found.fit_all
        else "Held-out errors are those of two-fold cross-validation on alternating blocks of time."
    )
    page.text(f"The {found.units.word(driver)} drives the simulation. {judged}")


def _add_law(page: Page, found: Diagnosis, folder: Path) -> None:
    page.heading("Extended law")
    lines = formulas.get_law_formulas(len(found.dataset.base.shared) > 1)
    lines += formulas.get_effect_formulas([effect for effect, _ in found.extended.model.effects])
    for k, line in enumerate(lines, start=1):
        drawing = to_svg(formulas.draw_formula(line), cut=True)
        write_text_file(folder / f"equation-{k}.svg", drawing, "an equation")
        page.drawing(drawing, f"({k})")
    page.text(SYMBOLS)


def _add_errors(page: Page, found: Diagnosis, folder: Path, sources: Sources) -> None:
    names = report_tables.name_records(found, sources.files, sources.further)
    fitted = len(found.dataset.records)
    page.heading("Cross-validation" if not found.fit_all else "Errors")
    _add_table(page, folder, "errors", report_tables.build_error_table(found))
    _add_table(page, folder, "models", report_tables.build_model_table(found))
    if found.validation:
        page.heading("Validation")
        _add_table(
            page,
            folder,
            "validation",
            report_tables.build_prediction_table(found.validation, names[fitted:]),
        )
    if found.left_out:
        page.heading("Leave-one-file-out cross-validation")
        _add_table(
            page,
            folder,
            "left-out",
            report_tables.build_prediction_table(found.left_out, names[:fitted]),
        )
    if found.forces:
        page.heading("Estimated force")
        _add_table(page, folder, "forces", report_tables.build_force_table(found, names))
    page.heading("Figures")
    with mpl.rc_context(STYLE):
        for drawn in draw_figures(found, sources.files, sources.further):
            drawing = to_svg(drawn.figure)
            write_text_file(folder / f"{drawn.name}.svg", drawing, "a figure")
            page.drawing(drawing, drawn.caption)


def _add_residuals(page: Page, found: Diagnosis, folder: Path) -> None:
    page.heading("Residual")
    page.points(
        [
            f"{found.units.word(one.channel)}: the residual correlates with {one.what}, which "
            f"explains {one.share:.0%} of its variance"
            for one in found.residual_dependences
        ]
        or ["The residual correlates with no tension, speed, direction, travel or time."]
    )
    channels = report_tables.list_compared_channels(found)
    parts = {
        channel: autocorrelate_channel(found.dataset, found.extended, channel)
        for channel in channels
    }
    drawing = to_svg(draw_autocorrelations(parts, found.units))
    write_text_file(folder / "autocorrelation.svg", drawing, "a figure")
    page.drawing(
        drawing,
        "Autocorrelation of the residual of the extended law; 95 % of white noise lie in the band.",
    )
    for channel, one in parts.items():
        write_table(
            folder / f"autocorrelation-{channel}.csv",
            {"lag_s": one.lag, "autocorrelation": one.value},
        )


def draw_autocorrelations(parts: dict[str, Autocorrelation], units: Units) -> Figure:
    """Draw the autocorrelation of the residual of each channel."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, 0.4 + 1.8 * len(parts)))
        grid = figure.subplots(len(parts), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (channel, one) in zip(grid, parts.items(), strict=True):
            axes.axhspan(-one.band, one.band, color="#e6e6e6", linewidth=0.0)
            axes.plot(one.lag, one.value, color=BLUE)
            axes.axhline(0.0, color=BLACK, linewidth=0.6)
            axes.set(title=units.word(channel), ylabel="autocorrelation")
        grid[-1].set_xlabel("lag [s]")
        return figure


def _add_table(page: Page, folder: Path, name: str, table: Table) -> None:
    """Add a table to the page, and write it beside it."""
    page.table(table, mark="")
    with (
        replace_file(folder / f"{name}.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        csv.writer(file).writerows([table.head, *table.rows])


def _write_records(folder: Path, found: Diagnosis) -> None:
    """Write what was measured and simulated, a file for each record."""
    fits = (found.baseline.simulated, found.extended.simulated)
    for k, record in enumerate(found.dataset.records):
        one = PredictedRecord(record, *(fit[k] for fit in fits))
        _write_record(folder / f"residuals-{k + 1}.csv", one)
    for kind, records in (("validation", found.validation), ("left-out", found.left_out)):
        for k, one in enumerate(records):
            _write_record(folder / f"residuals-{kind}-{k + 1}.csv", one)


def _write_record(path: Path, one: PredictedRecord) -> None:
    rows = one.record.measured
    columns = {"time_s": (one.record.time + one.record.start)[rows]}
    for channel in one.record.compared:
        unit = one.record.units.of(channel).replace(" ", "")
        known = one.record.known[channel]
        measured, before, after = (
            signals[channel]
            for signals in (one.record.signals, one.before.signals, one.after.signals)
        )
        columns[f"{channel}_{unit}"] = _to_cells(measured, known)[rows]
        columns[f"{channel}_plain_{unit}"] = before[rows]
        columns[f"{channel}_extended_{unit}"] = after[rows]
        columns[f"{channel}_residual_{unit}"] = _to_cells(measured - after, known)[rows]
        columns[f"{channel}_counts"] = one.record.good[channel][rows].astype(np.int64)
    write_table(path, columns)


def _to_cells(values: Array, known: NDArray[np.bool_]) -> Column:
    """Return values as cells of a table, empty where they are not known."""
    cells = values.astype(object)
    cells[~known] = None
    return cells
