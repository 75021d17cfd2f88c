"""report.html: a diagnosis on one self-contained page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.diagnosis import report_text
from estimator.diagnosis.outcome import Diagnosis
from teleop.tools.diagnose import acceptance, figures
from teleop.tools.diagnose.acceptance import ComparedParameter
from teleop.tools.report.page import Page


def render(
    found: Diagnosis, files: Sequence[str], calibrated: Mapping[str, ComparedParameter]
) -> str:
    """Return the page; `calibrated` is the comparison with a calibration, by parameter."""
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
    if calibrated:
        page.table(acceptance.table(calibrated), mark="NO")
    with TemporaryDirectory() as folder:
        captions = figures.draw(found, files, Path(folder))
        page.heading("Before and after")
        if len(files) > figures.MOST_RECORDS:
            page.text(f"The first {figures.MOST_RECORDS} of {len(files)} files are drawn.")
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
