"""report.html: a study of a pair on one self-contained page."""

from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.drawing import use_style
from estimator.pair import report_text
from estimator.pair.figures import draw_figures
from estimator.pair.pair_study import PairStudy
from teleop.cli.report.page import Page
from teleop.runtime.output_file import save_figure

# --- write the figures of a study of a pair


def write_figures(found: PairStudy, folder: Path) -> dict[str, str]:
    """Write all figures into `folder`; return their captions by file name."""
    captions = {}
    with use_style():
        for drawn in draw_figures(found):
            file = f"pair-{drawn.name}.png"
            save_figure(drawn.figure, folder / file)
            captions[file] = drawn.caption
    return captions


def render(found: PairStudy) -> str:
    """Return the page."""
    page = Page(report_text.format_sentence(found))
    for what in report_text.format_model_warning(found):
        page.text(what)
    page.heading("Friction against bend")
    page.table(report_text.build_friction_table(found), mark="")
    with TemporaryDirectory() as folder:
        captions = write_figures(found, Path(folder))
        paths = {name: Path(folder) / name for name in captions}
        page.figure(paths["pair-friction.png"], captions["pair-friction.png"])
        page.heading("The model for all bends")
        page.table(report_text.build_parameter_table(found), mark="")
        page.heading("Bends that were not fitted")
        page.text("Root mean square of the angle's error, and its share of the span.")
        page.table(report_text.build_held_out_table(found), mark=report_text.OWN_METHOD)
        page.figure(paths["pair-loops.png"], captions["pair-loops.png"])
        if found.validation:
            page.heading("Bends kept apart")
            page.table(report_text.build_validation_table(found.validation), mark="")
        page.heading("What is wrong")
        page.points(report_text.describe_errors(found))
        page.table(report_text.build_residual_table(found), mark="")
        page.figure(paths["pair-left.png"], captions["pair-left.png"])
    return page.render()
