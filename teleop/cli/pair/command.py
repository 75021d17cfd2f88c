"""Measure how the friction of an antagonistic pair grows with the bend of its sheath.

  teleop pair bend*.csv                          K of each file, its growth, predictions
  teleop pair bend*.csv --out pair               ... with a report
  teleop pair bend*.csv --validate more/*.csv    ... and validate on further bends
  teleop pair run_*.csv --columns columns.yaml   ... for data with other columns or names

The data: one table for each bend with time, the command, the measured angle of the joint and both
tensions at the housing. One model is fitted to all files; then each file is predicted by
leave-one-out cross-validation (docs/endoscope.md). Needs at least three bends.
"""

import argparse
import time
from pathlib import Path

from estimator.pair import report_text
from estimator.pair.pair_fit import PairError
from estimator.pair.pair_study import study_pair
from teleop.cli.pair import report_json
from teleop.cli.pair.config import PairConfig
from teleop.cli.pair.read import read_records
from teleop.config.loading import load
from teleop.config.options import add_options
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.process import write_summary, write_text_file
from teleop.runtime.status_line import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data", nargs="+", type=Path, metavar="DATA", help="measured data, one file for each bend"
    )
    add_options(parser, "--validate", "--out", "--json")
    parser.add_argument(
        "--columns",
        type=Path,
        metavar="FILE",
        help="column names, and the pattern of the bend (see configs/endoscope-pair.yaml)",
    )


def main(args: argparse.Namespace) -> int:
    """Study the pair and report; returns the exit code."""
    config = load(args.columns, PairConfig, None)
    records, further = read_records(args.data, config), read_records(args.validate, config)
    if args.out is not None:
        make_folder(args.out, "report.html")
    progress, begun = Progress(), time.monotonic()
    try:
        found = study_pair(records, validate=further, progress=progress)
    except PairError as error:
        raise UsageError(f"{', '.join(map(str, args.data + args.validate))}: {error}") from error
    finally:
        progress.end()
    tree = report_json.build_report(found, time.monotonic() - begun)
    write_summary(args.json, tree)
    print(report_text.format_report(found), flush=True)
    if args.out is not None:
        from teleop.cli.pair import page

        write_summary(args.out / "report.json", tree)
        write_text_file(args.out / "report.html", page.render(found), "the page")
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0
