"""report.html: a study of a pair on one page, which needs no network and no scripts."""

from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.pair_study import PairStudy, Validation
from slave.experiment.page import Page
from slave.pair import figures, words


def render(found: PairStudy, kept: tuple[Validation, ...]) -> str:
    """Return the page; `kept` are the errors of records kept apart."""
    page = Page(words.sentence(found))
    page.heading("Friction against bend")
    page.table(words.frictions(found), mark="")
    with TemporaryDirectory() as folder:
        captions = figures.draw(found, Path(folder))
        paths = {name: Path(folder) / name for name in captions}
        page.figure(paths["pair-friction.png"], captions["pair-friction.png"])
        page.heading("The model for all bends")
        page.table(words.parameters(found), mark="")
        page.heading("Bends that were not fitted")
        page.text("Root mean square of the angle's error, and its share of the span.")
        page.table(words.left_out(found), mark=words.OURS)
        page.figure(paths["pair-loops.png"], captions["pair-loops.png"])
        if kept:
            page.heading("Bends kept apart")
            page.table(words.validation(kept), mark="")
        page.heading("What is wrong")
        page.points(words.wrong(found))
        page.table(words.parts(found), mark="")
        page.figure(paths["pair-left.png"], captions["pair-left.png"])
    return page.render()
