"""Measure how the friction of an antagonistic pair grows with the bend of its sheath.

  teleop pair bend*.csv                          K of each file, its growth, predictions
  teleop pair bend*.csv --out pair               ... with a report
  teleop pair bend*.csv --validate more/*.csv    ... and validate on further bends
  teleop pair run_*.csv --columns columns.yaml   ... for data with other columns or names

The data: one table for each bend with time, the command, the measured angle of the joint and both
tensions at the housing. One model is fitted to all files; then each file is predicted by
leave-one-out cross-validation (docs/how-to/diagnose.md). Needs at least three bends.
"""

import argparse
import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from estimator.array_types import Array
from estimator.pair import report_text
from estimator.pair.pair_fit import PairError
from estimator.pair.pair_model import PairRecord
from estimator.pair.pair_study import PairStudy, analyse_residuals, compute_offset_share, study_pair
from teleop.cli.html_page import Page, to_json_values
from teleop.config.loading import load
from teleop.config.options import add_options
from teleop.data.file_formats import read_columns
from teleop.data.mapping_file import TableMapping, load_mapping
from teleop.data.measured_table import Source, number_samples, parse_column
from teleop.data.raw_table import RawTable
from teleop.data.read_summary import ReadSummary, format_read_summaries, format_read_summary
from teleop.data.run_splitting import list_runs, split_runs
from teleop.data.sample_checks import check_effort, check_time
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.process import print_warning, write_summary, write_text_file
from teleop.runtime.status_line import Progress

BEND = "{bend}"
_NUMBER = r"(?<![\d.])(-?\d+(?:\.\d+)?)"


@dataclass(frozen=True, slots=True)
class PairColumns:
    """Names of columns."""

    time: str = "time_s"  # [s]
    command: str = "command_angle_deg"  # of the motor, pulling a in and letting b out
    angle: str = "distal_angle_deg"  # of the joint
    tension_a: str = "proximal_tension_a_N"  # [N] at the housing
    tension_b: str = "proximal_tension_b_N"  # [N] at the housing


@dataclass(frozen=True, slots=True)
class FileBend:
    """The bend of one file."""

    file: str = ""  # its name, without the folder
    bend: float = 0.0  # in the unit of the angles


@dataclass(frozen=True, slots=True)
class PairConfig:
    """Format of the files of a pair."""

    columns: PairColumns = field(default_factory=PairColumns)
    unit: Literal["deg", "rad"] = "deg"  # of command, angle and bend
    bend: str = "bend{bend}"  # pattern of file names with the bend
    bends: tuple[FileBend, ...] = ()  # of files without the bend in their name

    def __post_init__(self) -> None:
        """Check the pattern; raises `ValueError`."""
        if self.bend.count(BEND) != 1:
            raise ValueError(f"bend: {self.bend!r}, must have {BEND} once, where the number stands")

    @property
    def radians(self) -> float:
        """One unit of an angle [rad]."""
        return math.radians(1.0) if self.unit == "deg" else 1.0

    def bend_of(self, path: Path) -> float:
        """Return the bend [rad] of a file's sheath, from the list or the file's name.

        Raises `UsageError` if neither has it.
        """
        for file_bend in self.bends:
            if file_bend.file == path.name:
                return self._check_file(path, file_bend.bend)
        prefix, suffix = self.bend.split(BEND)
        lead = re.escape(prefix) + r"(-?\d+(?:\.\d+)?)" if prefix else _NUMBER
        match = re.search(lead + re.escape(suffix), path.name)
        if not path.exists():
            raise UsageError(f"{path}: file not found")
        if match is None:
            raise UsageError(
                f"{path}: the name does not tell the sheath's bend as {self.bend!r} would; rename "
                "the file, or give pattern or list in --columns FILE (bend, bends)"
            )
        return self._check_file(path, float(match[1]))

    def _check_file(self, path: Path, bend: float) -> float:
        if not 0.0 <= bend < math.inf:
            raise UsageError(
                f"{path}: a bend of {bend:g}, must not be negative; if that is a dash, put it into "
                "the pattern in --columns FILE (bend: 'bend-{bend}')"
            )
        return self.radians * bend


# --- reading the records of a pair

ANGLE_SPAN = 7.0  # [rad] of a joint: above a full turn the unit is wrong
SAMPLES_MIN = 20  # in which a sensor that works changes


def read_records(
    paths: Sequence[Path], config: PairConfig, mapping: TableMapping
) -> list[tuple[PairRecord, ReadSummary]]:
    """Return the records of some files, in the order of their bends, and how each was read.

    Raises `UsageError` if a file cannot be read, lacks a column or its bend, or has invalid values.
    """
    read = [_read_record(path, config, mapping) for path in paths]
    return sorted(read, key=lambda each: each[0].bend)


def _read_record(
    path: Path, config: PairConfig, mapping: TableMapping
) -> tuple[PairRecord, ReadSummary]:
    bend = config.bend_of(path)
    raw = read_columns(path, mapping)
    named = {f.name: getattr(config.columns, f.name) for f in fields(PairColumns)}
    columns = {item: _parse_column(raw, config, item, mapping) for item in named}
    if raw.remarks:
        print_warning(f"{path}: {'; '.join(raw.remarks)}")
    if not len(columns["time"]):
        raise UsageError(f"{path}: has a header but no rows")
    starts = split_runs(raw, columns["time"], named.values(), mapping)
    runs = list_runs(path, starts, len(columns["time"]), mapping)
    if len(runs) > 1:
        places = ", ".join(map(raw.place, starts))
        raise UsageError(f"{path}: has {len(runs)} runs, from {places}; one is read here: --run N")
    ((number, rows),) = runs
    columns = {item: column[rows.start : rows.stop] for item, column in columns.items()}
    raw, time = raw.select(rows), columns["time"]
    check_time(raw, config.columns.time, time, "convert it to seconds")
    for item in ("tension_a", "tension_b"):
        check_effort(raw, named[item], columns[item], may_err=True)
    _check_columns(path, columns, config)
    columns |= {item: config.radians * columns[item] for item in ("command", "angle")}
    channels = {item: (Source(named[item], "", 1.0), values) for item, values in columns.items()}
    name = f"{path}, run {number}" if number else str(path)
    return PairRecord(bend, **columns), ReadSummary(name, time, channels, remarks=raw.remarks)


def _check_columns(path: Path, columns: Mapping[str, Array], config: PairConfig) -> None:
    """Refuse a sensor that never changes, and angles that are plainly in degrees."""
    for item, column in columns.items():
        span = float(np.ptp(column))
        name = getattr(config.columns, item)
        if len(column) >= SAMPLES_MIN and span == 0.0:
            raise UsageError(
                f"{path}: column {name!r} never changes ({column[0]:g}): the sensor is stuck or "
                "not connected, or nothing moved; check it, and move the joint while you record"
            )
        if item in ("command", "angle") and config.radians * span > ANGLE_SPAN:
            raise UsageError(
                f"{path}: column {name!r} spans {config.radians * span:.4g} rad; if it is in "
                "degrees, set unit: deg in --columns FILE"
            )


def _parse_column(raw: RawTable, config: PairConfig, item: str, mapping: TableMapping) -> Array:
    name = getattr(config.columns, item)
    rate = mapping.rate_hz if item == "time" else None
    if rate and name not in raw.columns:
        return np.arange(len(next(iter(raw.columns.values())))) / rate
    if name not in raw.columns:
        raise UsageError(
            f"{raw.path}: there is no column {name!r} (it has {', '.join(raw.columns)}); "
            f"--columns FILE says what {item} is called"
        )
    expected = {"time": "s", "command": config.unit, "angle": config.unit}.get(item, "N")
    if (unit := raw.units.get(name, expected)) != expected:
        raise UsageError(
            f"{raw.path}: column {name!r}: the row below its name says {unit}, and {expected} is "
            "read: convert it"
        )
    column = parse_column(raw, name, mapping, is_time=item == "time")
    if rate:
        numbers = {name: column}
        number_samples(raw, name, numbers, rate)
        column = numbers[name] / rate
    if (missing := np.flatnonzero(~np.isfinite(column))).size:
        raise UsageError(f"{raw.locate(name, int(missing[0]))}: is blank or not finite")
    return column


# --- report.json, everything in SI units and radians


def build_report(study: PairStudy, seconds: float) -> dict[str, Any]:
    """Return the report; `seconds` is what the study took."""
    report = {
        "sentence": report_text.format_sentence(study),
        "bends": [record.bend for record in study.records],
        "friction": study.record_frictions,
        "friction_straight": study.friction,
        "growth": study.growth,
        "model": study.fit.model,
        "neutral": study.fit.neutrals,
        "best_simple": study.best_simple,
        "better_model": report_text.format_model_warning(study),
        "left_out": study.left_out,
        "validation": [
            {"bend": kept.bend, "ours": kept.model_error, "baselines": kept.baselines}
            for kept in study.validation
        ],
        "structure": analyse_residuals(study.records, study.predicted),
        "offset_share": compute_offset_share(study.records, study.predicted),
        "wrong": report_text.describe_errors(study),
        "seconds": seconds,
        "version": version("tendon-teleop"),
    }
    values: dict[str, Any] = to_json_values(report)
    return values


# --- report.html, on one self-contained page


def render(study: PairStudy, readings: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the page; `readings` are how the files were read."""
    from estimator.pair.figures import draw_figures  # with matplotlib, which takes long

    friction, loops, residuals = draw_figures(study)
    page = Page(report_text.format_sentence(study))
    for sentence in report_text.format_model_warning(study):
        page.add_text(sentence)
    page.add_section("Friction against bend", report_text.build_friction_table(study))
    page.add_figure(friction.figure, friction.caption)
    page.add_section("The model for all bends", report_text.build_parameter_table(study))
    text = "Root mean square of the angle's error, and its share of the span."
    table = report_text.build_held_out_table(study)
    page.add_section("Bends that were not fitted", table, text, mark=report_text.OWN_METHOD)
    page.add_figure(loops.figure, loops.caption)
    if study.validation:
        table = report_text.build_validation_table(study.validation)
        page.add_section("Bends kept apart", table)
    page.add_heading("What is wrong")
    page.add_points(report_text.describe_errors(study))
    page.add_table(report_text.build_residual_table(study))
    page.add_figure(residuals.figure, residuals.caption)
    page.add_heading("How the data were read")
    page.add_points([f"{each['file']}: {format_read_summary(each)}" for each in readings])
    return page.render()


# --- the command


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data", nargs="+", type=Path, metavar="DATA", help="measured data, one file for each bend"
    )
    add_options(
        parser, "--mapping", "--rate", "--decimal", "--run", "--validate", "--out", "--json"
    )
    parser.add_argument(
        "--columns",
        type=Path,
        metavar="FILE",
        help="column names, and the pattern of the bend (see configs/endoscope-pair.yaml)",
    )


def main(args: argparse.Namespace) -> int:
    """Study the pair and report; returns the exit code."""
    config, mapping = load(args.columns, PairConfig, None), load_mapping(args)
    if mapping.format_options():
        raise UsageError(f"{args.mapping}: columns: those of a pair are named in --columns FILE")
    (records, read), (further, validated) = (
        tuple(zip(*read_records(paths, config, mapping), strict=True)) or ((), ())
        for paths in (args.data, args.validate)
    )
    if args.out is not None:
        make_folder(args.out, "report.html")
    progress, begin_s = Progress(), time.monotonic()
    try:
        study = study_pair(records, validate=further, progress=progress)
    except PairError as error:
        raise UsageError(f"{', '.join(map(str, args.data + args.validate))}: {error}") from error
    finally:
        progress.end()
    tree = build_report(study, time.monotonic() - begin_s)
    tree["read_as"] = [reading.to_json() for reading in (*read, *validated)]
    write_summary(args.json, tree)
    print(report_text.format_report(study))
    print(format_read_summaries(tree["read_as"]), flush=True)
    if args.out is not None:
        write_summary(args.out / "report.json", tree)
        write_text_file(args.out / "report.html", render(study, tree["read_as"]), "the page")
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0
