"""report.html: a diagnosis on one self-contained page."""

from collections.abc import Mapping, Sequence
from datetime import date
from importlib.metadata import version
from typing import Any

from estimator.diagnosis import report_tables, report_text
from estimator.diagnosis.figures import RECORDS_MAX, draw_figures
from estimator.diagnosis.outcome import Diagnosis
from estimator.figure_style import use_style
from estimator.report_table import Table
from teleop.cli.diagnose import json_report
from teleop.cli.diagnose.json_report import ComparedParameter
from teleop.cli.html_page import Page
from teleop.data.read_summary import format_read_summary

GLOSSARY = Table(
    ("word", "meaning"),
    (
        ("K", "friction coordinate: over the sheath tension falls to e^-K of itself"),
        ("L/EA", "by how much the tendon is longer per newton"),
        ("tip compliance", "by how much what the tip pulls at gives per newton"),
        ("held-out", "of samples that the model was not fitted to"),
        ("RMSE", "root mean square error"),
        ("95 % interval", "where the value is, as surely as 19 in 20"),
        ("before, after", "the plain law, and the law with what was found"),
        ("score", "log-likelihood of held-out samples, less a penalty for each parameter"),
    ),
)


def render(
    diagnosis: Diagnosis,
    files: Sequence[str],
    calibrated: Mapping[str, ComparedParameter],
    further: Sequence[str] = (),
    readings: Sequence[Mapping[str, Any]] = (),
) -> str:
    """Return the page; `calibrated` is the comparison with a calibration, by parameter.

    `files` and `further` are the names of the fitted files and of those for validation, `readings`
    how they were read.
    """
    names = report_tables.name_records(diagnosis, files, further)
    page = Page(report_text.format_headline(diagnosis))
    page.add_text(report_text.format_verdict(diagnosis))
    page.add_text(
        f"{date.today():%Y-%m-%d}, tendon-teleop {version('tendon-teleop')}. "
        f"Data: {', '.join(files)}."
    )
    for sentence in report_text.list_model_warnings(diagnosis):
        page.add_text(f"WARNING: {sentence}")
    for step in diagnosis.steps:
        rivals = "; ".join(report_text.list_rivals(step)) or "none in these data"
        size = report_text.describe_size(diagnosis, step)
        rows = [("Size (95 % interval)", size), ("As good", rivals), ("Do", step.effect.advice)]
        page.add_card(step.effect.cause, rows)
    with use_style():
        first, *others = draw_figures(diagnosis, files, further)
    page.add_figure(first.figure, first.caption)
    page.add_table(report_tables.build_parameter_table(diagnosis))
    page.add_heading("Next steps")
    page.add_points(report_text.list_next_steps(diagnosis))
    page.fold("What the words mean")
    page.add_table(GLOSSARY)
    page.fold("All tables and figures")
    page.add_heading("Before and after")
    if len(files) > RECORDS_MAX:
        page.add_text(f"The first {RECORDS_MAX} of {len(files)} files are drawn.")
    for drawn in others:
        page.add_figure(drawn.figure, drawn.caption)
    if diagnosis.steps:
        page.add_section("Gain", report_tables.build_gain_table(diagnosis))
    page.add_section(
        "Beside models that know no sheath", report_tables.build_model_table(diagnosis)
    )
    page.add_table(report_tables.build_simple_gain_table(diagnosis))
    page.add_points(report_text.compare_with_learned(diagnosis))
    for table in (
        report_tables.build_law_table(diagnosis),
        report_tables.build_load_table(diagnosis),
    ):
        if table is not None:
            page.add_table(table, mark="chosen")
    if calibrated:
        page.add_table(json_report.build_comparison_table(calibrated), mark="NO")
    _add_file_tables(page, diagnosis, names)
    page.add_heading("Residuals")
    page.add_points(report_text.describe_residuals(diagnosis))
    text = "Largest and mean error in % of the channel's range."
    page.add_section("Errors", report_tables.build_error_table(diagnosis), text)
    for i, step in enumerate(diagnosis.steps, start=1):
        table = report_tables.build_ranking_table(diagnosis, step.ranking)
        page.add_section(f"Candidates for cause {i}", table, mark=step.effect.label)
    if not diagnosis.steps and diagnosis.ranking:
        table = report_tables.build_ranking_table(diagnosis, diagnosis.ranking)
        page.add_section("Candidates", table)
    if diagnosis.detection_limits:
        page.add_section("Detection limits", report_tables.build_detection_limit_table(diagnosis))
    if remarks := report_text.list_sample_remarks(diagnosis, files):
        page.add_heading("Samples")
        page.add_points(remarks)
    if readings:
        page.add_heading("How the data were read")
        page.add_points([f"{each['file']}: {format_read_summary(each)}" for each in readings])
    return page.render()


def _add_file_tables(page: Page, diagnosis: Diagnosis, names: Sequence[str]) -> None:
    """Add the tables by file: validation, leave-one-file-out, the force, and its rivals."""
    fitted = len(diagnosis.dataset.records)
    if diagnosis.validation:
        table = report_tables.build_prediction_table(diagnosis.validation, names[fitted:])
        page.add_section("Validation", table)
    if diagnosis.left_out:
        table = report_tables.build_prediction_table(diagnosis.left_out, names[:fitted])
        text = "Each file is predicted with parameters fitted to the other files."
        page.add_section("Leave-one-file-out", table, text)
    if diagnosis.forces:
        text = (
            "Estimated from the housing alone, as by teleop estimate and teleop run --replay with "
            "this model, and compared with what the load cell at the tip reads."
        )
        table = report_tables.build_force_table(diagnosis, names)
        page.add_section("Force at the tip", table, text)
    if diagnosis.rivals:
        text = "Causes that fit as well, and what each would do to the estimated force."
        page.add_section("Rivals", report_tables.build_rival_parameter_table(diagnosis), text)
    if diagnosis.rival_forces:
        page.add_table(report_tables.build_rival_table(diagnosis))
