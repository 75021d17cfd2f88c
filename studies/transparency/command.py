"""Measure how transparent and how stable each coupling is, over each delay.

  python -m studies.transparency
  python -m studies.transparency --couplings passivity --round-trips 0 100 --quick
  python -m studies.transparency --jitter 50 --loss 0.1 --out over-a-bad-network

The live code of master and slave, with a simulated hand, network and rig: rendered against true
stiffness, Z-width, hybrid parameters over frequency, and Llewellyn's margin where it applies; how
each is measured is in studies/results/coupling.md. Takes 6 minutes on two cores, a minute with
--quick. In --out, `transparency.md` has the tables, `transparency.json` all numbers.
"""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from studies.transparency import report, study
from studies.transparency.study import COUPLINGS, Case, Study, Task
from teleop.config.options import add_option
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.parallel import count_processors, map_in_parallel
from teleop.runtime.process import write_summary, write_text_file
from teleop.runtime.status_line import Progress

ROUND_TRIP_MAX = 400.0  # [ms] beyond it the sessions' watchdogs would have to be set slower
QUICK = (0.0, 200.0)  # [ms] if no others are asked for


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    default = Study()
    parser.add_argument(
        "--couplings",
        nargs="+",
        choices=COUPLINGS,
        default=list(COUPLINGS),
        metavar="NAME",
        help=f"couplings to measure (default {' '.join(COUPLINGS)})",
    )
    parser.add_argument(
        "--round-trips",
        nargs="+",
        type=float,
        metavar="MS",
        help="round-trip delays [ms] (default 0 20 100 200 300; with --quick 0 200)",
    )
    for name, value, unit, text in (
        ("jitter", 0.0, "MS", "the round trip varies by +- MS [ms]"),
        ("loss", 0.0, "SHARE", "share of messages lost each way, 0 to 1"),
        ("encoder", 1e6 * default.device.resolution, "UM", "resolution of the device [um]"),
        ("force-scale", default.force_scale, "X", "force on the hand per force at the tip"),
        ("position-scale", default.position_scale, "X", "tip travel per hand travel"),
    ):
        parser.add_argument(f"--{name}", type=float, default=value, metavar=unit,
                            help=f"{text} (default {value:g})")  # fmt: skip
    add_option(parser, "--quick", "two round trips, in a minute")
    add_option(
        parser,
        "--out",
        default=Path("transparency"),
        help="folder for the report (default transparency)",
    )
    add_option(parser, "--jobs", default=count_processors())


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    study_config = parse_study(args)
    if not 1 <= args.jobs <= 256:
        raise UsageError(f"--jobs {args.jobs}: must be 1 to 256")
    make_folder(args.out, "transparency.md")
    cases = run_study(study_config, args.jobs)
    print(report.build_summary_table(study_config, cases).to_markdown(), flush=True)
    write_summary(args.out / "transparency.json", report.build_tree(study_config, cases))
    text = report.format_tables(study_config, cases) + "\n"
    write_text_file(args.out / "transparency.md", text, "the tables")
    print(f"\nwritten: {args.out / 'transparency.md'}")
    return 0


def parse_study(args: argparse.Namespace) -> Study:
    """Return the study that is asked for."""
    delays = args.round_trips or (QUICK if args.quick else None)
    for name, values, least, most in (
        ("round-trips", delays or (), 0.0, ROUND_TRIP_MAX),
        ("jitter", (args.jitter,), 0.0, 100.0),
        ("loss", (args.loss,), 0.0, 0.5),
        ("encoder", (args.encoder,), 0.0, 1000.0),
        ("force-scale", (args.force_scale,), 0.01, 0.5),
        ("position-scale", (args.position_scale,), 0.05, 2.0),
    ):
        for value in values:
            if not least <= value <= most:  # nor NaN
                raise UsageError(f"--{name} {value:g}: must be {least:g} to {most:g}")
    study_config = Study(
        couplings=tuple(dict.fromkeys(args.couplings)),
        jitter=1e-3 * args.jitter,
        loss=args.loss,
        device=replace(Study().device, resolution=args.encoder / 1e6),
        force_scale=args.force_scale,
        position_scale=args.position_scale,
    )
    if delays:
        study_config = replace(study_config, round_trips=tuple(sorted({1e-3 * d for d in delays})))
    return study.shorten_study(study_config) if args.quick else study_config


def run_study(study_config: Study, workers: int) -> list[Case]:
    """Return what was measured, in so many processes."""
    tasks, progress = study.list_tasks(study_config), Progress()
    done: dict[Task, Any] = {}
    try:
        results = map_in_parallel(partial(study.measure_task, study_config), tasks, workers)
        for task in tasks:
            progress(f"{task.kind}, {task.coupling}", len(done) / len(tasks))
            done[task] = next(results)
    finally:
        progress.end()
    return study.gather_cases(study_config, done)
