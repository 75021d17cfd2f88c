"""Show how a file of measured data is understood, before anything is fitted to it.

  teleop data show bench.csv                          columns, roles, units, rate, gaps, ranges
  teleop data show bench.csv --column 'time=t[ms]'    ... with the options of estimate and diagnose
  teleop data show bench.csv --figure bench.png       ... and a figure of the channels
  teleop data show bench.csv --column proximal_tension=T_in --write-mapping lab.yaml
  teleop diagnose monday.csv tuesday.csv --mapping lab.yaml    read all files of a lab that way

What a file leaves open is asked in one line, with the option that answers it, and its columns are
listed. Formats and units: docs/reference/data-format.md.
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from estimator.array_types import Array
from estimator.plausibility import find_channel_faults
from estimator.report_table import Table
from teleop.config import strict_yaml
from teleop.config.loading import as_tree
from teleop.config.options import TABLE_OPTIONS, add_options
from teleop.data.column_search import format_proposals
from teleop.data.column_units import split_scale
from teleop.data.file_formats import read_columns
from teleop.data.mapping_file import (
    MappedColumn,
    MappedColumns,
    TableMapping,
    load_mapping,
    parse_column_options,
)
from teleop.data.measured_table import MeasuredTable, read_runs
from teleop.data.read_summary import GAP_PERIODS, ReadSummary
from teleop.data.standard_columns import TENSIONS
from teleop.errors import UsageError
from teleop.runtime.output_file import FIGURE_SUFFIXES, OutputFile, save_figure
from teleop.runtime.process import write_summary, write_text_file

PLOT_WIDTH = 60  # characters
_BARS = "▁▂▃▄▅▆▇█"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sub-command and its options."""
    works = parser.add_subparsers(dest="work", metavar="WORK", required=True)
    show = works.add_parser("show", help="show how a file is understood")
    show.add_argument("data", type=Path, metavar="DATA", help="measured data, or a recording")
    add_options(show, *TABLE_OPTIONS, "--json")
    show.add_argument(
        "--figure",
        type=OutputFile(*FIGURE_SUFFIXES),
        metavar="FILE",
        help="write a figure of the channels: .png, .pdf or .svg",
    )
    show.add_argument(
        "--write-mapping",
        type=OutputFile(),
        metavar="FILE",
        help="write what was understood, for the --mapping of other commands",
    )


def main(args: argparse.Namespace) -> int:
    """Show the file; returns the exit code."""
    mapping = load_mapping(args)
    columns = parse_column_options([*mapping.format_options(), *args.column])
    options: dict[str, Any] = {"zero_errors": TENSIONS, "diagnosed": True, "mapping": mapping}
    try:
        options["units"] = columns.units
        read = read_runs(args.data, [columns.names], args.drop_nonfinite, **options)
    except UsageError:
        raw = read_columns(args.data, mapping)  # if this fails, the same error comes again
        rows = [
            (name, raw.units.get(name, ""), *_describe_values(values))
            for name, values in raw.columns.items()
        ]
        print(Table(("column", "unit", "range", "missing"), tuple(rows)).to_markdown())
        raise
    runs = [run[0] for run in read]
    table, reading = runs[0], ReadSummary.from_table(runs[0])
    summary = reading.to_json() | {"further": list(table.extra)}
    summary["doubts"] = list(find_channel_faults(table, table.units))
    summary["runs"] = [
        {"run": each.run or 1, "first": each.first, "samples": len(each.time)}
        | {"duration_s": float(np.ptp(each.time))}
        for each in runs
    ]
    write_summary(args.json, summary)
    if len(runs) > 1:
        rows = [
            (str(run["run"]), run["first"], str(run["samples"]), f"{run['duration_s']:.6g}")
            for run in summary["runs"]
        ]
        print(Table(("run", "from", "samples", "duration [s]"), tuple(rows)).to_markdown())
        print("\nof another one: --run N; `teleop diagnose` takes all\n")
    print(format_summary(table, summary))
    if args.figure is not None:
        draw(table, args.figure)
    if args.write_mapping is not None:
        write_text_file(args.write_mapping, format_mapping(table, mapping), "the mapping")
    return 0


def format_summary(table: MeasuredTable, summary: dict[str, Any]) -> str:
    """Return the summary as text, with a plot of each channel."""
    si = {k: "s" if k == "time" else table.units.get_unit(k) for k in table.sources}
    channels = ReadSummary.from_table(table).channels
    rows = [
        (name, source.column, source.unit or "?", unit, *_describe_values(values))
        for (name, (source, values)), unit in zip(channels.items(), si.values(), strict=True)
    ]
    head = ("channel", "column", "its unit", "read in", "range", "missing")
    rate = summary["rate_hz"]
    lines = [
        f"{table.name}: {summary['samples']} samples, {summary['duration_s']:.6g} s"
        + (f", {rate:.6g} Hz" if rate else ""),
        *(f"read as: {remark}" for remark in table.remarks),
        "",
        Table(head, tuple(rows)).to_markdown(),
        "",
        *(
            f"{name:>22}  {plot_text(values)}"
            for name, (_, values) in channels.items()
            if name != "time"
        ),
        "",
    ]
    if table.extra:
        options = format_proposals({}, list(table.extra), table.sources)
        lines.append(f"not used: {', '.join(table.extra)}{f'; perhaps {options}' * bool(options)}")
    if summary["gaps"]:
        longest = f"the longest {summary['longest_gap_s']:.4g} s"
        lines.append(f"gaps: {summary['gaps']} of more than {GAP_PERIODS} periods, {longest}")
    if table.dropped:
        lines.append(f"left out: {table.dropped} rows that are not finite")
    return "\n".join([*lines, *(f"DOUBT: {text}" for text in summary["doubts"])]).rstrip()


def _describe_values(values: Any) -> tuple[str, str]:
    """Return range and number of missing values of a column."""
    if values.dtype == object:
        return f"text, such as {str(values[0])[:20]!r}", ""
    finite = values[np.isfinite(values)]
    span = f"{finite.min():.6g} to {finite.max():.6g}" if finite.size else "nothing"
    return span, str(len(values) - len(finite))


def plot_text(values: Array) -> str:
    """Return a line of bars: the mean of each part of a signal, blank where all is missing."""
    finite = values[np.isfinite(values)]
    low, span = float(finite.min()), float(np.ptp(finite)) or 1.0
    bars = []
    for part in np.array_split(values, min(PLOT_WIDTH, len(values))):
        known = part[np.isfinite(part)]
        level = (float(known.mean()) - low) / span if known.size else None
        bars.append(" " if level is None else _BARS[min(int(8.0 * level), 7)])
    return "".join(bars)


def format_mapping(table: MeasuredTable, mapping: TableMapping) -> str:
    """Return a mapping file with the columns and units that were found."""
    columns = {}
    for name, (source, _) in ReadSummary.from_table(table).channels.items():
        by_rate = name == "time" and mapping.rate_hz is not None
        scale, unit = split_scale("" if by_rate else source.unit)
        columns[name] = MappedColumn(column=source.column, unit=unit, scale=scale)
    given = dataclasses.replace(mapping, columns=MappedColumns(**columns))
    tree = as_tree(given)
    text = strict_yaml.format_document(_drop_defaults(tree))
    return f"# how {table.path.name} was read by `teleop data show`; for --mapping\n{text}"


def _drop_defaults(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a tree without what is empty, null, or a scale of 1."""
    nested = {k: _drop_defaults(v) if isinstance(v, dict) else v for k, v in tree.items()}
    return {k: v for k, v in nested.items() if v not in ("", None) and (k, v) != ("scale", 1.0)}


def draw(table: MeasuredTable, path: Path) -> None:
    """Write a figure with an axis for each channel."""
    from matplotlib.figure import Figure

    from estimator.figure_style import use_style

    channels = {k: v for k, (_, v) in ReadSummary.from_table(table).channels.items() if k != "time"}
    with use_style():
        figure = Figure(figsize=(8.0, 1.0 + 1.6 * len(channels)), layout="constrained")
        panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (name, values) in zip(panels, channels.items(), strict=True):
            panel.plot(table.time, values, linewidth=0.8)
            unit = table.units.travel if "displ" in name or "angle" in name else table.units.effort
            panel.set_ylabel(f"{name.replace('_', ' ')}\n[{unit}]")
        panels[-1].set_xlabel("time [s]")
        save_figure(figure, path)
