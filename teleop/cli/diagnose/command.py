"""Diagnose model errors in measured data: causes, their size, and the gain of correcting them.

  teleop diagnose bench.csv                                print causes and remedies
  teleop diagnose monday.csv tuesday.csv --out diagnosis   ... several files of one bench, a report
  teleop diagnose monday.csv --validate tuesday.csv        ... and validate on other data
  teleop diagnose bench.csv --effects creep,slack          ... consider only these causes
  teleop diagnose bench.csv --noise proximal_displacement=1e-6    noise that is known, in m or N
  teleop diagnose joint.csv --column proximal_torque=tau_motor    torques and angles
  teleop diagnose mon.csv tue.csv wed.csv --leave-one-file-out    each file by the fit of the others
  teleop diagnose bench.csv --cause distal_tension_gain    which of equally good causes is modelled
  teleop diagnose bench.csv --supplement supplement    pages, figures and tables for a paper
  teleop diagnose records --jobs 2    each file of a folder by itself, two side by side
  teleop diagnose arm.csv --config arm.yaml    all tendons of an arm, with its joints' angles

The data: tables with time_s and proximal_tension_N, and also a travel or the tip tension; with
proximal_torque_Nm and proximal_angle_rad, also of a closed loop of two cables with pretension;
or recordings; or the travels of motor and tip alone, which tell what travel is lost, and no force
(docs/reference/data-format.md). Several files, or runs in one file, must be of one
bench and are fitted together. With --out a folder gets report.html, report.json, model.yaml and
residuals.rrd (docs/how-to/diagnose.md). The exit code is 0 for any diagnosis.
"""

import argparse
from pathlib import Path

from estimator.diagnosis.settings import SETTINGS
from teleop.config.options import TABLE_OPTIONS, add_option, add_options
from teleop.runtime.machine import count_processors
from teleop.runtime.output_file import OutputFolder, make_folder
from teleop.runtime.process import write_summary
from teleop.runtime.status_line import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "data", nargs="+", type=Path, metavar="DATA", help="measured data, or recordings"
    )
    parser.add_argument(
        "--effects",
        default="all",
        metavar="NAME,NAME",
        help="causes to consider (default all; names in docs/how-to/diagnose.md)",
    )
    add_option(parser, "--calibration", "compared with the result")
    add_option(
        parser, "--config", "of the arm whose tendons the data have (default that of a recording)"
    )
    add_options(parser, *TABLE_OPTIONS, "--validate", "--out", "--json")
    add_option(
        parser,
        "--jobs",
        help="diagnose each file, or each one of a folder, by itself: so many side by side",
    )
    add_options(parser, "--allow-imports")
    parser.add_argument(
        "--cause",
        default="",
        metavar="NAME",
        help="cause to be modelled, of several that explain the data equally well",
    )
    parser.add_argument(
        "--fit-all", action="store_true", help="fit and judge all samples; hold none out"
    )
    parser.add_argument(
        "--leave-one-file-out",
        action="store_true",
        help="also predict each file by the fit of the others",
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        default=SETTINGS.search_time_max,
        metavar="S",
        help="seconds for each record, after which no further search begins, counted as simulated "
        "samples: 300 000 are a second on any machine (default 100)",
    )
    parser.add_argument(
        "--supplement",
        type=OutputFolder(),
        metavar="DIR",
        help="folder for a supplement to a paper: a page with equations, figures as SVG, tables as "
        "CSV",
    )
    parser.add_argument(
        "--noise",
        action="append",
        default=[],
        metavar="NAME=SIGMA",
        help="standard deviation of a channel's noise in its unit, e.g. --noise "
        "proximal_displacement=1e-6 (default estimated from the data)",
    )
    parser.add_argument(
        "--variable",
        action="append",
        default=[],
        metavar="COLUMN",
        help="further column that friction or a sensor may depend on, such as a temperature",
    )
    parser.add_argument(
        "--transmission",
        choices=("auto", "tendon", "loop"),
        default="auto",
        help="one tendon, or a closed loop of two cables (default auto: a loop where torque or "
        "force changes its sign)",
    )
    parser.add_argument(
        "--tendon",
        metavar="N",
        help="tendon to diagnose, if the data have several (default all of an arm, else the first)",
    )


def main(args: argparse.Namespace) -> int:
    """Diagnose and report; returns the exit code."""
    # here: they take a second to load, which the command's help does not need
    from estimator.diagnosis import report_text
    from estimator.diagnosis.travel_diagnosis import is_travel_pair
    from teleop.cli.diagnose import arm, batch, diagnosis_run, json_report, travels
    from teleop.data.read_summary import format_read_summaries, format_read_summary

    effects = diagnosis_run.parse_effects(args.effects)
    diagnosis_run.check_options(args, effects)
    if args.jobs is not None:
        return batch.run(args)
    if arm.is_of_arm(args):
        return arm.run(args, diagnosis_run.parse_noise(args.noise))
    if args.supplement is not None:
        make_folder(args.supplement, "supplement.html")
    data = diagnosis_run.read_files(args)
    if is_travel_pair(data.fitted[0]):
        return travels.run(args, data.fitted)
    with Progress() as progress:
        report, tree = diagnosis_run.diagnose_files(args, data, progress, count_processors())
    diagnosis, files, further = report.found, report.data.files, report.data.further
    write_summary(args.json, tree)
    comparison = json_report.build_comparison_table(report.accepted) if report.accepted else None
    print(report_text.format_summary(diagnosis, files, comparison, further))
    print(format_read_summaries(tree["read_as"]), flush=True)
    diagnosis_run.write_report(args, report, tree)
    if args.out is not None:
        print(f"\nwritten: {args.out / 'report.html'}")
    if args.supplement is not None:
        from teleop.cli.diagnose import supplement

        read_as = [f"{each['file']}: {format_read_summary(each)}" for each in tree["read_as"]]
        sources = supplement.Sources(args.command_line, files, further, read_as)
        print(f"\nwritten: {supplement.write_supplement(args.supplement, diagnosis, sources)}")
    return 0
