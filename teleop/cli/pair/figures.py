"""Write the figures of a study of a pair."""

from pathlib import Path

from estimator.drawing import use_style
from estimator.pair.figures import draw_figures
from estimator.pair.pair_study import PairStudy
from teleop.runtime.output_file import save_figure


def write_figures(found: PairStudy, folder: Path) -> dict[str, str]:
    """Write all figures into `folder`; return their captions by file name."""
    captions = {}
    with use_style():
        for drawn in draw_figures(found):
            file = f"pair-{drawn.name}.png"
            save_figure(drawn.figure, folder / file)
            captions[file] = drawn.caption
    return captions
