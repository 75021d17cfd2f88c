"""Curves over time as a Rerun file of their own: results of an analysis, not of a session."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from estimator.array_types import Array
from teleop.errors import UsageError
from teleop.runtime.output_file import replace_file
from teleop.view.columns import APPLICATION, TIMELINE

WIDTH = 1.5  # [points]


class PlotCurve(NamedTuple):
    """One line of a panel."""

    name: str
    colour: int  # 0xRRGGBBAA
    time: Array  # [s], shape (n,)
    values: Array  # shape (n,)


class PlotPanel(NamedTuple):
    """Curves with one axis."""

    title: str  # with its unit
    curves: tuple[PlotCurve, ...]


def save(path: Path, name: str, columns: Sequence[Sequence[PlotPanel]]) -> None:
    """Write panels, side by side in columns, as a Rerun file.

    `columns` are from left to right, and in each from top to bottom. Raises `UsageError` if the
    file cannot be written.
    """
    try:
        with replace_file(path) as partial:
            with partial.open("wb"):
                pass
            _write_panels(partial, name, columns)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error


def _write_panels(path: Path, name: str, columns: Sequence[Sequence[PlotPanel]]) -> None:
    views = []
    with rr.RecordingStream(APPLICATION) as stream:
        stream.set_sinks(rr.FileSink(path))
        stream.send_recording_name(name)
        for i, panels in enumerate(columns):
            for j, panel in enumerate(panels):
                views.append((i, rrb.TimeSeriesView(origin=f"{i}/{j}", name=panel.title)))
                for k, curve in enumerate(panel.curves):
                    entity = f"{i}/{j}/{k}"
                    line = rr.SeriesLines(colors=curve.colour, widths=WIDTH, names=curve.name)
                    stream.log(entity, line, static=True)
                    times = rr.TimeColumn(TIMELINE, duration=curve.time)
                    values = rr.Scalars.columns(scalars=curve.values)
                    stream.send_columns(entity, [times], values)
        stream.send_blueprint(_build_layout(views, len(columns)))
        stream.flush()
        stream.disconnect()


def _build_layout(views: list[tuple[int, rrb.TimeSeriesView]], columns: int) -> rrb.Blueprint:
    stacks = [rrb.Vertical(*(view for i, view in views if i == n)) for n in range(columns)]
    return rrb.Blueprint(
        rrb.Horizontal(*stacks),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        auto_views=False,
    )
