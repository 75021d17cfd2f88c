"""report.html: a diagnosis on one self-contained page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.diagnosis import file_tables, report_text
from estimator.diagnosis.figures import MOST_RECORDS
from estimator.diagnosis.outcome import Diagnosis
from teleop.cli.diagnose import acceptance, figures
from teleop.cli.diagnose.acceptance import ComparedParameter
from teleop.cli.report.page import Page


def render(
    found: Diagnosis,
    files: Sequence[str],
    calibrated: Mapping[str, ComparedParameter],
    further: Sequence[str] = (),
) -> str:
    """Return the page; `calibrated` is the comparison with a calibration, by parameter.

    `files` and `further` are the names of the fitted files and of those for validation.
    """
    names = file_tables.names_of(found, files, further)
    page = Page(report_text.sentence(found))
    page.text(f"Data: {', '.join(files)}.")
    for what in report_text.better_models(found):
        page.text(f"WARNING: {what}")
    page.heading("Next steps")
    page.points(report_text.next_steps(found))
    if found.steps:
        page.heading("Gain")
        page.table(report_text.gains(found), mark="")
    page.heading("Beside models that know no sheath")
    page.table(report_text.models(found), mark="")
    page.table(report_text.over_simple(found), mark="")
    page.heading("Parameters of the model")
    page.table(report_text.parameters(found), mark="")
    for table in (report_text.laws(found), report_text.loads(found)):
        if table is not None:
            page.table(table, mark="chosen")
    if calibrated:
        page.table(acceptance.table(calibrated), mark="NO")
    _add_files(page, found, names)
    with TemporaryDirectory() as folder:
        captions = figures.draw(found, files, Path(folder), further)
        page.heading("Before and after")
        if len(files) > MOST_RECORDS:
            page.text(f"The first {MOST_RECORDS} of {len(files)} files are drawn.")
        for file, caption in captions.items():
            page.figure(Path(folder) / file, caption)
    page.heading("Residuals")
    page.points(report_text.remains(found))
    page.heading("Errors")
    page.text("Largest and mean error in % of the channel's range.")
    page.table(report_text.fitness(found), mark="")
    for i, step in enumerate(found.steps, start=1):
        page.heading(f"Candidates for cause {i}")
        page.table(report_text.ranked(found, step.ranking), mark=step.effect.label)
    if not found.steps and found.ranking:
        page.heading("Candidates")
        page.table(report_text.candidates(found), mark="")
    if found.detection_limits:
        page.heading("Detection limits")
        page.table(report_text.detection_limits(found), mark="")
    if remarks := report_text.remarks(found, files):
        page.heading("Samples")
        page.points(remarks)
    return page.render()


def _add_files(page: Page, found: Diagnosis, names: Sequence[str]) -> None:
    """Add the tables by file: validation, leave-one-file-out, the force, and its rivals."""
    fitted = len(found.dataset.records)
    if found.validation:
        page.heading("Validation")
        page.table(file_tables.predicted(found.validation, names[fitted:]), mark="")
    if found.left_out:
        page.heading("Leave-one-file-out")
        page.text("Each file is predicted with parameters fitted to the other files.")
        page.table(file_tables.predicted(found.left_out, names[:fitted]), mark="")
    if found.forces:
        page.heading("Force at the tip")
        page.text(
            "Estimated from the housing alone, as by teleop estimate and teleop run --replay with "
            "this model, and compared with what the load cell at the tip reads."
        )
        page.table(file_tables.forces(found, names), mark="")
    if found.rivals:
        page.heading("Rivals")
        page.text("Causes that fit as well, and what each would do to the estimated force.")
        page.table(file_tables.rival_parameters(found), mark="")
    if found.rival_forces:
        page.table(file_tables.rivals(found), mark="")
