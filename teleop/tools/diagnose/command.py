"""Find out what a model of measured data gets wrong, why, and what mending it is worth.

  teleop diagnose bench.csv                                say what is wrong, and what to do
  teleop diagnose monday.csv tuesday.csv --out diagnosis   ... of one bench, with a report to read
  teleop diagnose monday.csv --validate tuesday.csv        ... and test it on a day of its own
  teleop diagnose bench.csv --effects creep,slack          ... among these causes only

The data: tables with time_s and proximal_tension_N, and a travel or the tension at the tip beside
them, or recordings (docs/data-format.md). Several files are taken to be of one bench and fitted
together. With --out a folder gets report.html, report.json, model.yaml and residuals.rrd
(docs/diagnosis.md). The exit code is 0 whatever is found.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from estimator.diagnosis import report_text
from estimator.diagnosis.api import diagnose, signals_of
from estimator.diagnosis.outcome import Diagnosis, Verdict
from estimator.diagnosis.record import Record, RecordError, prepare
from teleop.data import model_file
from teleop.data.table import Columns, MeasuredTable, read_table
from teleop.errors import UsageError
from teleop.options import add_option, add_options
from teleop.parallel import processors
from teleop.process import make_folder, write_summary, write_whole
from teleop.tools import estimate
from teleop.tools.diagnose import acceptance, effect_choice, report_json
from teleop.tools.diagnose.acceptance import Compared
from teleop.tools.report.progress import Progress


class Data(NamedTuple):
    """The records of a diagnosis, and what they were called."""

    files: tuple[str, ...]
    records: tuple[Record, ...]
    validation: tuple[Record, ...]


class Report(NamedTuple):
    """All that is to be said."""

    found: Diagnosis
    data: Data
    accepted: dict[str, Compared]  # of the calibration that was given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data", nargs="+", type=Path, metavar="DATA", help="measured data, or recordings"
    )
    parser.add_argument(
        "--effects",
        default="all",
        metavar="NAME,NAME",
        help="causes to look among (default all; their names are in docs/diagnosis.md)",
    )
    add_option(parser, "--calibration", "to be compared with what the data say")
    add_options(parser, "--column", "--drop-nonfinite", "--validate", "--out", "--json")
    parser.add_argument(
        "--tendon", metavar="N", help="which one, 1, 2, ..., of data that have several (default 1)"
    )


def main(args: argparse.Namespace) -> int:
    """Diagnose, and say what was found; returns the exit code."""
    effects = effect_choice.chosen(args.effects)
    if args.out is not None:
        make_folder(args.out, "report.html")
    tendon = estimate.chosen(args.tendon, (), 1)
    sheath = None if args.calibration is None else acceptance.load(args.calibration, tendon)
    columns = estimate.named(args.column, tendon)
    data = read(args.data, args.validate, columns, args.drop_nonfinite)
    progress, begun = Progress(), time.monotonic()
    try:
        found = diagnose(
            data.records, effects, validate=data.validation, progress=progress, workers=processors()
        )
    except RecordError as error:
        raise UsageError(f"{', '.join(data.files)}: {error}") from error
    finally:
        progress.end()
    seconds = time.monotonic() - begun
    report = Report(found, data, {} if sheath is None else acceptance.compared(found, sheath))
    tree = report_json.tree(found, data.files, seconds, report.accepted)
    write_summary(args.json, tree)
    beside = acceptance.table(report.accepted) if report.accepted else None
    print(report_text.summary(found, data.files, beside), flush=True)
    if args.out is not None:
        write_summary(args.out / "report.json", tree)
        _write_folder(report, args.out)
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0


def read(
    paths: Sequence[Path], validate: Sequence[Path], columns: Columns, drop_nonfinite: bool
) -> Data:
    """Return the records of some files, all with the same channels.

    Raises
    ------
    UsageError
        If a file cannot be right, cannot be diagnosed, or lacks a channel that another has.
    """
    tables = [
        read_table(path, columns, drop_nonfinite, diagnosed=True) for path in (*paths, *validate)
    ]
    first = tables[0]
    for table in tables[1:]:
        if set(signals_of(table)) != set(signals_of(first)):
            raise UsageError(
                f"{table.path}: has {', '.join(signals_of(table))}, but {first.path} has "
                f"{', '.join(signals_of(first))}; data that are diagnosed together need the same "
                "channels"
            )
    records = [_record(table) for table in tables]
    return Data(tuple(map(str, paths)), tuple(records[: len(paths)]), tuple(records[len(paths) :]))


def _record(table: MeasuredTable) -> Record:
    try:
        return prepare(table.time, signals_of(table))
    except RecordError as error:
        raise UsageError(f"{table.path}: {error}") from error


def _write_folder(report: Report, folder: Path) -> None:
    from teleop.tools.diagnose import page, residuals

    found, files = report.found, report.data.files
    remark = f"Fitted by teleop diagnose to {', '.join(files)}.\n{report_text.sentence(found)}"
    duration = max(float(record.time[-1]) for record in found.dataset.records)
    unexplained = found.verdict is Verdict.UNEXPLAINED
    saved = model_file.Saved(found.extended.model, duration, found.ambiguous_with, unexplained)
    model_file.save(folder / "model.yaml", saved, remark)
    text = page.render(found, files, report.accepted)
    write_whole(folder / "report.html", text, "the page")
    residuals.write(folder / "residuals.rrd", found, files)
