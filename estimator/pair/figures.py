"""The figures of a study of a pair; measured is black."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from estimator.figure_style import BLACK, BLUE, VERMILION, DrawnFigure, use_style
from estimator.pair.pair_study import PairStudy
from estimator.pair.report_text import format_degrees

COLUMN_COUNT = 3  # loops in a row


def draw_figures(study: PairStudy) -> Iterator[DrawnFigure]:
    """Draw all figures."""
    with use_style():
        yield DrawnFigure(
            "friction",
            draw_friction(study),
            "K of each record with its interval of 95 %, and the line of the model for all.",
        )
        yield DrawnFigure(
            "loops",
            draw_loops(study),
            "Angle over command: measured, and predicted by the model of the other records.",
        )
        yield DrawnFigure(
            "left",
            draw_residuals(study),
            "Residuals over time (predicted less measured), each record held out.",
        )


def draw_friction(study: PairStudy) -> Figure:
    """Draw K over the bend."""
    figure = Figure(figsize=(6.0, 3.6))
    axes = figure.add_subplot()
    bends = np.degrees([record.bend for record in study.records])
    values = np.array(study.record_frictions)
    spread = np.abs(values[:, 1:].T - values[:, 0])
    axes.errorbar(bends, values[:, 0], spread, fmt="o", color=BLACK, capsize=3, label="each record")
    line = np.array([0.0, bends.max()])
    model = study.fit.model
    K = [model.compute_friction(float(bend)) for bend in np.radians(line)]
    axes.plot(line, K, color=BLUE, label="K0 + mu bend")
    axes.set(xlabel="bend of the sheath [deg]", ylabel="K", ylim=(0.0, None))
    axes.legend(loc="upper left")
    return figure


def draw_loops(study: PairStudy) -> Figure:
    """Draw the angle over the command, a record each."""
    rows = -(-len(study.records) // COLUMN_COUNT)
    figure = Figure(figsize=(8.2, 0.5 + 2.6 * rows))
    grid = figure.subplots(rows, COLUMN_COUNT, sharex=True, squeeze=False).ravel()
    for axes in grid[len(study.records) :]:
        axes.set_visible(False)
    for axes, record, angle in zip(grid, study.records, study.predicted, strict=False):
        command = np.degrees(record.command)
        axes.plot(command, np.degrees(record.angle), color=BLACK, label="measured")
        axes.plot(
            command, np.degrees(angle), color=VERMILION, linestyle=(0, (4, 2)), label="predicted"
        )
        axes.set(title=f"bend {format_degrees(record.bend, 0)}", xlabel="command [deg]")
    grid[0].set_ylabel("angle [deg]")
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def draw_residuals(study: PairStudy) -> Figure:
    """Draw the residuals over time, one panel per record."""
    figure = Figure(figsize=(8.2, 0.4 + 1.2 * len(study.records)))
    grid = figure.subplots(len(study.records), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for axes, record, angle in zip(grid, study.records, study.predicted, strict=True):
        axes.plot(record.time, np.degrees(angle - record.angle), color=BLUE, linewidth=0.9)
        axes.axhline(0.0, color=BLACK, linewidth=0.6)
        axes.set_ylabel(f"{format_degrees(record.bend, 0)}: residual [deg]", fontsize=7.5)
    grid[-1].set_xlabel("time [s]")
    return figure
