"""One diagnosis: from the files of a bench and the options to the folder of reports."""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from estimator.diagnosis import report_text
from estimator.diagnosis.api import CauseError, RecordError, collect_signals, diagnose
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.settings import ProgressCallback, ignore_progress
from estimator.effects import CATALOGUE, CHANNELS, NAMES, Effect
from estimator.effects.functions import find_function
from teleop.cli import estimate
from teleop.cli.diagnose import json_report
from teleop.cli.diagnose.json_report import ComparedParameter
from teleop.config.suggestions import suggest_spelling
from teleop.data import model_file
from teleop.data.effect_extensions import is_extension, load_effects
from teleop.data.mapping_file import NamedColumns, TableMapping, load_mapping, parse_column_options
from teleop.data.measured_table import MeasuredTable, read_runs
from teleop.data.read_summary import ReadSummary
from teleop.data.standard_columns import TENSIONS, to_channel
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.process import write_summary, write_text_file

# --- parsers of options


def parse_effects(text: str) -> Sequence[Effect]:
    """Return the effects of `--effects`: comma-separated names, or all."""
    if text.strip() == "all":
        return CATALOGUE
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UsageError("--effects: names of effects with commas between them, or all")
    others = tuple(effect for name in names if is_extension(name) for effect in load_effects(name))
    functions = [effect for name in names if (effect := find_function(name)) is not None]
    for name in names:
        is_known = name in (*NAMES, *(effect.name for effect in functions))
        if not is_known and not is_extension(name):
            listed = suggest_spelling(name, NAMES, 3, 0.5) or f"; there are {', '.join(NAMES)}"
            raise UsageError(f"--effects {name}: no such effect{listed}")
    return (*(effect for effect in CATALOGUE if effect.name in names), *functions, *others)


# --- `--noise NAME=SIGMA`: noise of a channel that is known better than the data tell it


def parse_noise(words: Sequence[str]) -> dict[str, float]:
    """Return standard deviations by channel, in its unit; `UsageError` if a word is none."""
    noise = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            sigma = float(text)
        except ValueError:
            sigma = math.nan
        channel = to_channel(name)
        if channel not in CHANNELS or not 0.0 <= sigma < math.inf:
            raise UsageError(
                f"--noise {word}: expected NAME=SIGMA in the unit of the data, NAME one of "
                f"{', '.join(CHANNELS)}"
            )
        noise[channel] = sigma
    return noise


# --- the files, and their diagnosis


class DiagnosisData(NamedTuple):
    """The data of a diagnosis."""

    fitted: tuple[MeasuredTable, ...]
    validation: tuple[MeasuredTable, ...]

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the fitted files."""
        return tuple(table.name for table in self.fitted)

    @property
    def further(self) -> tuple[str, ...]:
        """Names of the files for validation."""
        return tuple(table.name for table in self.validation)


class ReportContent(NamedTuple):
    """Content of the report."""

    found: Diagnosis
    data: DiagnosisData
    accepted: dict[str, ComparedParameter]  # comparison with the given calibration


def read_files(args: argparse.Namespace) -> DiagnosisData:
    """Return the records of the files of one bench; raises `UsageError`, also for `--out`."""
    if args.out is not None:
        make_folder(args.out, "report.html")
    tendon = estimate.select_tendon(args.tendon, estimate.read_recorded_joints(args.data[0]), 1)
    mapping = load_mapping(args)
    columns = parse_column_options([*mapping.format_options(), *args.column], tendon)
    data = read_data(args.data, args.validate, columns, args.drop_nonfinite, mapping)
    if args.leave_one_file_out and len(data.fitted) < 2:
        raise UsageError("--leave-one-file-out: give at least two files of one bench")
    return data


def diagnose_files(
    args: argparse.Namespace,
    data: DiagnosisData,
    progress: ProgressCallback = ignore_progress,
    workers: int = 1,
) -> tuple[ReportContent, dict[str, Any]]:
    """Return the diagnosis of `data`, and the tree of `report.json`; raises `UsageError`."""
    tendon = estimate.select_tendon(args.tendon, estimate.read_recorded_joints(args.data[0]), 1)
    sheath = None if args.calibration is None else json_report.load_sheath(args.calibration, tendon)
    loop = None if args.transmission == "auto" else args.transmission == "loop"
    begin_s = time.monotonic()
    try:
        diagnosis = diagnose(
            data.fitted,
            parse_effects(args.effects),
            validate=data.validation,
            noise=parse_noise(args.noise),
            loop=loop,
            cause=args.cause,
            variables=args.variable,
            fit_all=args.fit_all,
            leave_one_file_out=args.leave_one_file_out,
            time_limit=args.time_limit,
            progress=progress,
            workers=workers,
        )
    except RecordError as error:
        raise UsageError(str(error)) from error
    except CauseError as error:
        raise UsageError(f"--cause {error}") from error
    seconds = time.monotonic() - begin_s
    accepted = {} if sheath is None else json_report.compare_parameters(diagnosis, sheath)
    tree = json_report.build_report(diagnosis, data.files, seconds, accepted, data.further)
    tree["read_as"] = [
        ReadSummary.from_table(table).to_json() for table in (*data.fitted, *data.validation)
    ]
    return ReportContent(diagnosis, data, accepted), tree


def check_options(args: argparse.Namespace, effects: Sequence[Effect]) -> None:
    """Raise `UsageError` for conflicting options, before anything is read."""
    names = tuple(dict.fromkeys(effect.name for effect in effects))
    if args.cause and args.cause not in names:
        hint = suggest_spelling(args.cause, names, 3, 0.5) or "; it must be one of --effects"
        raise UsageError(f"--cause {args.cause}: is not among the effects considered{hint}")


def read_data(
    paths: Sequence[Path],
    validate: Sequence[Path],
    columns: NamedColumns,
    drop_nonfinite: bool,
    mapping: TableMapping,
) -> DiagnosisData:
    """Return the data of some files, all with the same channels; each run is a record.

    Raises `UsageError` if a file is invalid, or lacks a channel of another.
    """
    options: dict[str, Any] = {"zero_errors": TENSIONS, "diagnosed": True, "mapping": mapping}
    fitted, validation = (
        [
            run[0]
            for path in files
            for run in read_runs(
                path, [columns.names], drop_nonfinite, units=columns.units, **options
            )
        ]
        for files in (paths, validate)
    )
    tables = [*fitted, *validation]
    first = tables[0]
    for table in tables[1:]:
        if table.units != first.units:
            raise UsageError(
                f"{table.name}: is in {table.units.effort} and {table.units.travel}, but "
                f"{first.name} in {first.units.effort} and {first.units.travel}"
            )
        if set(collect_signals(table)) != set(collect_signals(first)):
            raise UsageError(
                f"{table.name}: has {', '.join(collect_signals(table))}, but {first.name} has "
                f"{', '.join(collect_signals(first))}; data that are diagnosed together need "
                f"the same "
                "channels"
            )
    return DiagnosisData(tuple(fitted), tuple(validation))


def write_report(args: argparse.Namespace, report: ReportContent, tree: Mapping[str, Any]) -> None:
    """Write the folder of `--out`, if there is one."""
    if (folder := args.out) is None:
        return
    from teleop.cli.diagnose import html_report, residual_curves  # with what draws: it takes long

    diagnosis, data = report.found, report.data
    write_summary(folder / "report.json", dict(tree))
    remark = (
        f"Fitted by teleop diagnose to {', '.join(data.files)}.\n"
        f"{report_text.format_verdict(diagnosis)}"
    )
    model_file.save(folder / "model.yaml", model_file.from_diagnosis(diagnosis), remark)
    text = html_report.render(diagnosis, data.files, report.accepted, data.further, tree["read_as"])
    write_text_file(folder / "report.html", text, "the page")
    residual_curves.write_residuals(folder / "residuals.rrd", diagnosis, data.files)
