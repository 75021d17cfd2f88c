"""Measure how the friction of an antagonistic pair grows with the bend of its sheath.

  teleop pair bend*.csv                          K of each file, its growth, what it predicts
  teleop pair bend*.csv --out pair               ... with a report to read
  teleop pair bend*.csv --validate more/*.csv    ... and test the model on further bends
  teleop pair run_*.csv --columns columns.yaml   ... of data with other columns or names

The data: one table for each bend with time, the command, the measured angle of the joint and both
tensions at the housing. One model is fitted to all files; then each file is predicted by a model
that has not seen it (docs/endoscope.md). Needs at least three bends.
"""

import argparse
import time
from pathlib import Path

from estimator.pair.pair_fit import PairError, check
from estimator.pair.pair_study import study, validate
from teleop.config import load
from teleop.errors import UsageError
from teleop.options import add_options
from teleop.process import make_folder, write_summary, write_whole
from teleop.tools.pair import report_json, report_text
from teleop.tools.pair.config import PairConfig
from teleop.tools.pair.read import read
from teleop.tools.report.progress import Progress


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
        help="what the columns are, and where the bend stands (see configs/endoscope-pair.yaml)",
    )


def main(args: argparse.Namespace) -> int:
    """Study the pair, and say what was found; returns the exit code."""
    config = load(args.columns, PairConfig, None)
    records, further = read(args.data, config), read(args.validate, config)
    if args.out is not None:
        make_folder(args.out, "report.html")
    progress, begun = Progress(), time.monotonic()
    try:
        check(further)
        found = study(records, progress)
    except PairError as error:
        raise UsageError(f"{', '.join(map(str, args.data + args.validate))}: {error}") from error
    finally:
        progress.end()
    kept = validate(found, further)
    tree = report_json.tree(found, kept, time.monotonic() - begun)
    write_summary(args.json, tree)
    print(report_text.format_report(found, kept), flush=True)
    if args.out is not None:
        from teleop.tools.pair import page

        write_summary(args.out / "report.json", tree)
        write_whole(args.out / "report.html", page.render(found, kept), "the page")
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0
