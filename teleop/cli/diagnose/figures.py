"""Write the figures of a diagnosis."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from estimator.diagnosis.figures import draw_figures
from estimator.diagnosis.outcome import Diagnosis
from estimator.drawing import STYLE
from teleop.runtime.output_file import save_figure


def write_figures(
    found: Diagnosis,
    files: Sequence[str],
    folder: Path,
    further: Sequence[str] = (),
    kind: str = "png",
) -> dict[str, str]:
    """Write all figures into `folder` as PNG or SVG; return their captions by file name."""
    captions = {}
    with mpl.rc_context(STYLE | {"svg.hashsalt": "tendon-teleop"}):
        for drawn in draw_figures(found, files, further):
            file = f"diagnosis-{drawn.name}.{kind}"
            metadata = {"Date": None} if kind == "svg" else None
            save_figure(drawn.figure, folder / file, metadata=metadata)
            captions[file] = drawn.caption
    return captions
