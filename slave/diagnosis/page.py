"""report.html: a diagnosis on one page, which needs no network and no scripts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.diagnosis.outcome import Diagnosis
from slave.diagnosis import believed, figures, words
from slave.diagnosis.believed import Compared
from slave.experiment.page import Page


def render(found: Diagnosis, files: Sequence[str], calibrated: Mapping[str, Compared]) -> str:
    """Return the page; `calibrated` is what a calibration says of the sheath, by name."""
    page = Page(words.sentence(found))
    page.text(f"Data: {', '.join(files)}.")
    page.heading("What to do next")
    page.points(words.next_steps(found))
    if found.steps:
        page.heading("What it is worth")
        page.table(words.gains(found), mark="")
    page.heading("Parameters of the model")
    page.table(words.parameters(found), mark="")
    if calibrated:
        page.table(believed.table(calibrated), mark="NO")
    with TemporaryDirectory() as folder:
        captions = figures.draw(found, files, Path(folder))
        page.heading("Before and after")
        if len(files) > figures.MOST_RECORDS:
            page.text(f"The first {figures.MOST_RECORDS} of {len(files)} files are drawn.")
        for file, caption in captions.items():
            page.figure(Path(folder) / file, caption)
    page.heading("What is left")
    page.points(words.remains(found))
    page.heading("Errors")
    page.text("Largest and mean error in % of the channel's range.")
    page.table(words.fitness(found), mark="")
    for i, step in enumerate(found.steps, start=1):
        page.heading(f"Candidates for cause {i}")
        page.table(words.ranked(found, step.ranking), mark=step.effect.label)
    if not found.steps and found.ranking:
        page.heading("Candidates")
        page.table(words.candidates(found), mark="")
    if found.visible:
        page.heading("What would have been seen")
        page.table(words.visible(found), mark="")
    if remarks := words.remarks(found, files):
        page.heading("Samples")
        page.points(remarks)
    return page.render()
