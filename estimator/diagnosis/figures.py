"""The figures of a diagnosis.

Colours are Okabe and Ito's, safe for any colour vision; measured is black, and line styles differ
with the colours.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis import report_tables
from estimator.diagnosis.curve import describe_curve
from estimator.diagnosis.dataset import Fit, SimulatedRecord
from estimator.diagnosis.outcome import Curve, Diagnosis, PredictedRecord
from estimator.diagnosis.record import Record
from estimator.diagnosis.report_tables import name_judged_samples, name_records
from estimator.effects.effect import DISTAL_TENSION, PROXIMAL_DISPLACEMENT, PROXIMAL_TENSION
from estimator.figure_style import BLACK, BLUE, GREY, STYLE, VERMILION, DrawnFigure
from estimator.units import Units

PALE_BLUE, LIGHT_GREY, SHADE = "#9dc7e6", "#cccccc", "#eaf3f9"
RECORDS_MAX = 4  # that are drawn
BARS_MAX = 14
LINE_POINTS_MAX = 3000  # of a line, at most
MEDIAN_BINS = 24  # of medians
MIN_SAMPLES = 15  # samples in one
SCATTER_POINTS_MAX = 1500  # points
_POINTS: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 1.2, "alpha": 0.35}
_MEDIANS: dict[str, Any] = {"marker": "o", "markersize": 2.5}


def draw_figures(
    diagnosis: Diagnosis, files: Sequence[str] = (), further: Sequence[str] = ()
) -> Iterator[DrawnFigure]:
    """Draw all figures; names of files and of those for validation are numbers by default."""
    names = name_records(diagnosis, files, further)
    count = len(diagnosis.dataset.records)
    with mpl.rc_context(STYLE):
        if (curve := diagnosis.curve) is not None:
            yield DrawnFigure(
                "curve",
                draw_curve(curve, diagnosis.units),
                f"{describe_curve(curve, diagnosis.units)}. The band is the 95 % interval; outside "
                "this range the model stays as at the end.",
            )
        yield from _draw_files(diagnosis, names[:count])
        yield from _draw_predictions(
            diagnosis.validation, names[count:], "validation", "validation"
        )
        if diagnosis.left_out:
            source = "predicted by the fit of the other files"
            yield from _draw_predictions(diagnosis.left_out, names[:count], "left-out", source)
        yield DrawnFigure(
            "structure",
            draw_residual_dependence(diagnosis),
            "Residuals (measured less simulated) before and after, against tension, speed and "
            "time: points and their medians. A correct model leaves noise around zero.",
        )
        if diagnosis.ranking:
            yield DrawnFigure(
                "ranking",
                draw_ranking(diagnosis),
                f"Log-likelihood ratio of {name_judged_samples(diagnosis)} data with and without a "
                "cause, with a penalty for its parameters. Blue are the causes found, pale blue "
                "those that the data do not distinguish from them.",
            )


def draw_curve(curve: Curve, units: Units) -> Figure:
    """Draw the free function of a model over its variable, with its band."""
    figure = Figure(figsize=(8.2, 3.4))
    axes, term = figure.subplots(), curve.effect.function
    if term is None:
        raise ValueError(f"{curve.effect.name}: has no free function")

    def scale(unit: str, *, share: bool = False) -> tuple[float, str]:
        if share:
            return 100.0, "%"
        name = units.name_unit(unit)
        return (1e3, f"m{name}") if name.startswith("m") else (1.0, name)

    (x_scale, x_unit), (y_scale, y_unit) = scale(term.unit), scale(curve.unit, share=term.is_share)
    x, y, band = x_scale * curve.x, y_scale * curve.value, y_scale * curve.half_width
    axes.fill_between(x, y - band, y + band, color=PALE_BLUE, alpha=0.6, linewidth=0.0)
    axes.plot(x, y, color=BLUE)
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    core = y[np.abs(band) < 4.0 * np.median(band)]
    margin = 0.6 * float(np.ptp(core)) + float(np.median(band))
    axes.set(
        xlabel=f"{term.variable} [{x_unit}]".removesuffix(" []"),
        ylim=(core.min() - margin, core.max() + margin),
    )
    axes.set_ylabel(f"{term.target},\nbeside its median [{y_unit}]")
    return figure


def _draw_files(diagnosis: Diagnosis, files: Sequence[str]) -> Iterator[DrawnFigure]:
    shaded = "" if diagnosis.fit_all else " Held-out blocks are shaded."
    for k, file in enumerate(files[:RECORDS_MAX]):
        number = f"-{k + 1}" if len(files) > 1 else ""
        yield DrawnFigure(
            f"over-time{number}",
            draw_over_time(diagnosis, k),
            f"{file}: measured, and simulated before and after; below each channel the residual "
            f"(measured less simulated).{shaded}",
        )
        if _select_loop_axes(diagnosis.dataset.records[k]) is not None:
            yield DrawnFigure(
                f"loop{number}", draw_loop(diagnosis, k), f"{file}: the hysteresis loop."
            )


def _draw_predictions(
    records: Sequence[PredictedRecord], names: Sequence[str], kind: str, source: str
) -> Iterator[DrawnFigure]:
    for k, (name, prediction) in enumerate(zip(names, records, strict=True)):
        if k == RECORDS_MAX:
            return
        yield DrawnFigure(
            f"{kind}-{k + 1}",
            draw_record_over_time(prediction.record, prediction.before, prediction.after),
            f"{name}, {source}: measured, and predicted before and after; below each channel the "
            "residual. Only where the record starts was fitted to it.",
        )


def draw_over_time(diagnosis: Diagnosis, k: int) -> Figure:
    """Draw one fitted record: each channel, and below it the residuals of both models."""
    models = (diagnosis.baseline.simulated[k], diagnosis.extended.simulated[k])
    return draw_record_over_time(diagnosis.dataset.records[k], *models)


def draw_record_over_time(
    record: Record, before: SimulatedRecord, after: SimulatedRecord
) -> Figure:
    """Draw a record and what two models make of it; times are those of the file."""
    channels = record.compared
    figure = Figure(figsize=(8.2, 0.4 + 3.0 * len(channels)))
    grid = figure.subplots(
        2 * len(channels), 1, sharex=True, squeeze=False, height_ratios=[2, 1] * len(channels)
    )[:, 0]
    keep = _subsample_rows(np.flatnonzero(record.measured), LINE_POINTS_MAX)
    time = record.time + record.start
    for channel, upper, lower in zip(channels, grid[::2], grid[1::2], strict=True):
        factor, unit = _get_display_scale(record.units, channel)
        measured = factor * record.signals[channel]
        base_signal, extended_signal = (
            factor * simulated.signals[channel] for simulated in (before, after)
        )
        drawn_signal = np.where(record.select_drawn_rows(channel), measured, np.nan)
        upper.plot(time[keep], drawn_signal[keep], color=BLACK, label="measured")
        dashes, dots = (0, (4, 2)), (0, (1, 1))
        upper.plot(time[keep], base_signal[keep], color=VERMILION, linestyle=dashes, label="before")
        upper.plot(time[keep], extended_signal[keep], color=BLUE, linestyle=dots, label="after")
        upper.set(ylabel=f"[{unit}]", title=record.units.name_channel(channel))
        valid = keep[record.valid[channel][keep]]
        lower.plot(time[valid], (measured - base_signal)[valid], color=VERMILION, linewidth=0.8)
        lower.plot(time[valid], (measured - extended_signal)[valid], color=BLUE, linewidth=0.8)
        lower.set(ylabel=f"residual [{unit}]")
        for axes in (upper, lower):
            _shade_held_out(axes, record)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    grid[-1].set(xlabel="time [s]", xlim=(time[keep][0], time[keep][-1]))
    return figure


def draw_loop(diagnosis: Diagnosis, k: int) -> Figure:
    """Draw T_out over T_in, or T_in over the travel without a load cell at the tip."""
    record = diagnosis.dataset.records[k]
    axes_of = _select_loop_axes(record)
    if axes_of is None:
        raise ValueError("record: has no loop to draw")
    abscissa, ordinate = axes_of
    x_factor, x_unit = _get_display_scale(diagnosis.units, abscissa)
    y_factor, y_unit = _get_display_scale(diagnosis.units, ordinate)
    x, y = x_factor * record.signals[abscissa], y_factor * record.signals[ordinate]
    figure = Figure(figsize=(8.2, 3.8))
    pair = figure.subplots(1, 2, sharex=True, sharey=True)
    drawn_signal = np.where(
        record.select_drawn_rows(abscissa) & record.select_drawn_rows(ordinate), y, np.nan
    )
    titles = (("before", diagnosis.baseline, VERMILION), ("after", diagnosis.extended, BLUE))
    keep = _subsample_rows(np.flatnonzero(record.measured), LINE_POINTS_MAX)
    for axes, (title, fit, colour) in zip(pair, titles, strict=True):
        signals = fit.simulated[k].signals
        simulated_x = x_factor * signals[abscissa] if abscissa in signals else x
        curve = simulated_x[keep], y_factor * signals[ordinate][keep]
        axes.plot(x[keep], drawn_signal[keep], color=GREY, linewidth=0.9, label="measured")
        axes.plot(*curve, color=colour, linewidth=1.0, label="simulated")
        axes.set(xlabel=f"{diagnosis.units.name_channel(abscissa)} [{x_unit}]", title=title)
        axes.legend(loc="lower right")
    pair[0].set_ylabel(f"{diagnosis.units.name_channel(ordinate)} [{y_unit}]")
    return figure


def draw_residual_dependence(diagnosis: Diagnosis) -> Figure:
    """Draw the residuals of both models against tension, speed and time."""
    channels = report_tables.list_compared_channels(diagnosis)
    figure = Figure(figsize=(8.2, 0.4 + 2.1 * len(channels)))
    grid = figure.subplots(len(channels), 3, sharey="row", squeeze=False)
    for row, channel in zip(grid, channels, strict=True):
        for axes, (label, values) in zip(
            row, _collect_variables(diagnosis, channel).items(), strict=True
        ):
            for fit, colour in ((diagnosis.baseline, VERMILION), (diagnosis.extended, BLUE)):
                residual = _concatenate_residuals(diagnosis, fit, channel)
                rows = _subsample_rows(np.arange(len(residual)), SCATTER_POINTS_MAX)
                points = values[rows], residual[rows]
                axes.plot(*points, color=colour, rasterized=True, **_POINTS)
                axes.plot(*_compute_bin_medians(values, residual), color=colour, **_MEDIANS)
            axes.axhline(0.0, color=BLACK, linewidth=0.6)
            if channel == channels[-1]:
                axes.set_xlabel(label)
        _, unit = _get_display_scale(diagnosis.units, channel)
        row[0].set_ylabel(f"{diagnosis.units.name_channel(channel)},\nresidual [{unit}]")
    figure.legend(
        [Line2D([], [], color=VERMILION), Line2D([], [], color=BLUE)],
        ["before", "after"],
        loc="outside upper right",
        ncols=2,
    )
    return figure


def draw_ranking(diagnosis: Diagnosis) -> Figure:
    """Draw the scores of the candidates."""
    candidates = report_tables.select_best_candidates(diagnosis.ranking, BARS_MAX)[::-1]
    figure = Figure(figsize=(8.2, 0.8 + 0.27 * len(candidates)))
    axes = figure.add_subplot()
    colours = dict.fromkeys(diagnosis.ambiguous_with, PALE_BLUE) | dict.fromkeys(
        diagnosis.causes, BLUE
    )
    bars = axes.barh(
        range(len(candidates)),
        [ranked.score for ranked in candidates],
        color=[colours.get(ranked.name, LIGHT_GREY) for ranked in candidates],
    )
    axes.bar_label(bars, fmt="%.0f", padding=3, fontsize=8)
    axes.set_yticks(range(len(candidates)), [ranked.label for ranked in candidates])
    axes.set_xlabel("score")
    axes.axvline(0.0, color=BLACK, linewidth=0.6)
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.12)
    return figure


def _select_loop_axes(record: Record) -> tuple[str, str] | None:
    if DISTAL_TENSION in record.signals:
        return PROXIMAL_TENSION, DISTAL_TENSION
    if PROXIMAL_DISPLACEMENT in record.signals:
        return PROXIMAL_DISPLACEMENT, PROXIMAL_TENSION
    return None


def _get_display_scale(units: Units, channel: str) -> tuple[float, str]:
    """Return the factor by which a channel is drawn, and its unit then."""
    unit = units.get_unit(channel)
    return (1e3, "mm") if unit == "m" else (1.0, unit)


def _concatenate_residuals(diagnosis: Diagnosis, fit: Fit, channel: str) -> Array:
    """Return the residuals of a model in all records, as they are drawn."""
    factor, _ = _get_display_scale(diagnosis.units, channel)
    return np.concatenate(
        [
            (factor * (record.signals[channel] - simulated.signals[channel]))[record.valid[channel]]
            for record, simulated in zip(diagnosis.dataset.records, fit.simulated, strict=True)
        ]
    )


def _collect_variables(diagnosis: Diagnosis, channel: str) -> dict[str, Array]:
    """Return the variables of the residual plots by axis label."""
    records = diagnosis.dataset.records
    units = diagnosis.units
    effort, unit = _get_display_scale(units, PROXIMAL_TENSION)
    factor, drive = _get_display_scale(units, records[0].driver)
    columns = {
        f"{units.name_channel(PROXIMAL_TENSION)} [{unit}]": [
            effort * r.signals[PROXIMAL_TENSION] for r in records
        ],
        f"speed [{drive}/s]": [factor * r.speed for r in records],
        "time [s]": [r.start + r.time for r in records],
    }
    return {
        label: np.concatenate([v[r.valid[channel]] for v, r in zip(parts, records, strict=True)])
        for label, parts in columns.items()
    }


def _compute_bin_medians(values: Array, residual: Array) -> tuple[Array, Array]:
    """Return the medians of `residual` in bins of `values`; NaN with too few samples."""
    edges = np.linspace(values.min(), values.max(), MEDIAN_BINS + 1)
    bins = np.clip(np.digitize(values, edges) - 1, 0, MEDIAN_BINS - 1)
    groups = [residual[bins == i] for i in range(MEDIAN_BINS)]
    medians = [np.median(group) if len(group) >= MIN_SAMPLES else np.nan for group in groups]
    return 0.5 * (edges[:-1] + edges[1:]), np.array(medians)


def _shade_held_out(axes: Axes, record: Record) -> None:
    for block in np.unique(record.block[~record.train]):
        times = record.start + record.time[record.block == block]
        axes.axvspan(times[0], times[-1], color=SHADE, linewidth=0.0)


def _subsample_rows(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Return at most about `count` of the rows, evenly spread."""
    return rows[:: max(1, -(-len(rows) // count))]
