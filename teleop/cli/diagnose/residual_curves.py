"""residuals.rrd: measured and simulated signals of both models, for Rerun."""

from collections.abc import Sequence
from pathlib import Path

from estimator.array_types import Array
from estimator.diagnosis import report_text
from estimator.diagnosis.outcome import Diagnosis
from teleop.view.analysis_curves import PlotCurve, PlotPanel, save

MEASURED, BEFORE, AFTER = 0x808080FF, 0xD55E00FF, 0x0072B2FF


def write_residuals(path: Path, diagnosis: Diagnosis, files: Sequence[str]) -> None:
    """Write the file: for each record a column, for each channel its curves and its residuals."""
    columns = []
    for k, file in enumerate(files):
        record = diagnosis.dataset.records[k]
        panels = []
        for channel in record.compared:
            rows = record.select_drawn_rows(channel)
            measured = record.signals[channel][rows]
            models = {
                ("before", BEFORE): diagnosis.baseline.simulated[k].signals[channel][rows],
                ("after", AFTER): diagnosis.extended.simulated[k].signals[channel][rows],
            }
            title = f"{record.units.name_channel(channel)} [{record.units.get_unit(channel)}]"
            lines = {("measured", MEASURED): measured} | models
            residuals = {key: measured - values for key, values in models.items()}
            panels.append(_build_panel(f"{title}, {file}", record.time[rows], lines))
            panels.append(_build_panel(f"residual of {title}", record.time[rows], residuals))
        columns.append(panels)
    save(path, report_text.format_verdict(diagnosis), columns)


def _build_panel(title: str, time: Array, lines: dict[tuple[str, int], Array]) -> PlotPanel:
    curves = (PlotCurve(name, colour, time, values) for (name, colour), values in lines.items())
    return PlotPanel(title, tuple(curves))
