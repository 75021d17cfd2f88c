"""Simulate measured data of a rig, faster than real time.

  teleop simulate configs/demo.yaml --out bench.csv
  teleop simulate configs/demo.yaml --out nested.parquet --profile nested --duration 60 --seed 7

The rig is slave.rig of the config file, defaults without one. In every joint one motor makes the
motion; that of the other tendon, if any, keeps it taut. The table has the housing's sensors and, as
on a calibration bench, those at the tip (docs/reference/data-format.md). The same command writes
the same file.
"""

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from slave.rigs.simulated import (
    SimulatedRig,
    SimulatedRigConfig,
    describe_effect,
    format_late_effects,
)
from slave.rigs.virtual_bench import (
    DEFAULT_PROFILE,
    DEFAULT_SCALE,
    HOLD_TENSION,
    MOTIONS,
    BenchRun,
    MotionScale,
    check_sampling,
    load_rig_config,
    simulate,
)
from teleop.config.options import add_options
from teleop.errors import UsageError
from teleop.runtime.output_file import TABLE_SUFFIXES, OutputFile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    scale = DEFAULT_SCALE
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG", help="config file (YAML)")
    parser.add_argument(
        "--out",
        type=OutputFile(*TABLE_SUFFIXES),
        required=True,
        metavar="FILE",
        help=".csv, .csv.gz or .parquet",
    )
    parser.add_argument(
        "--duration", type=float, default=30.0, metavar="S", help="duration [s] (default 30)"
    )
    parser.add_argument(
        "--profile",
        choices=MOTIONS,
        default=DEFAULT_PROFILE,
        help="pull-release-pull as in the paper's experiment, loop as for a calibration, "
        "nested reversals, or a sine (default pull-release-pull)",
    )
    parser.add_argument(
        "--rate", type=float, default=1000.0, metavar="HZ", help="sample rate [Hz] (default 1000)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of the sensor noise (default the config's)"
    )
    for name, default, metavar, text in (
        ("peak", scale.peak, "N", "housing tension at which the motor turns [N]"),
        ("speed", scale.speed, "M/S", "speed of the motor between turns [m/s]"),
        ("stroke", scale.stroke, "M", "stroke of the sine [m]"),
        ("period", scale.period, "S", "period of the sine [s]"),
        ("keep", HOLD_TENSION, "N", "housing tension of the other tendon of a pair [N]"),
    ):
        parser.add_argument(
            f"--{name}",
            type=float,
            default=default,
            metavar=metavar,
            help=f"{text} (default {default:g})",
        )
    parser.add_argument(
        "--side",
        choices=("a", "b"),
        default="a",
        help="which tendon of a pair makes the motion (default a)",
    )
    add_options(parser, "--set", "--allow-imports")


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    config = load_rig_config(args.config, args.overrides)
    scale = MotionScale(args.peak, args.speed, args.stroke, args.period)
    values = {"duration": args.duration, "keep": args.keep, **dataclasses.asdict(scale)}
    try:
        config = check_sampling(config, rate=args.rate, seed=args.seed, **values)
    except ValueError as error:
        raise UsageError(f"--{error}") from error
    SimulatedRig(config)  # compiles, outside the timed part
    began = time.perf_counter()
    run = simulate(
        config,
        args.profile,
        duration=args.duration,
        rate=args.rate,
        scale=scale,
        side=args.side,
        keep=args.keep,
        progress=sys.stderr.isatty(),
    )
    took = time.perf_counter() - began
    run.save(args.out)
    _print_summary(args, config, run, took)
    return 0


def _print_summary(
    args: argparse.Namespace, config: SimulatedRigConfig, run: BenchRun, took: float
) -> None:
    span = float(run.time[-1])
    print(f"{args.out}: {len(run.time)} rows, {span:g} s, simulated {span / took:.3g} x real time")
    tendons = [tendon for joint in config.joints for tendon in joint.tendons]
    for i, tendon in enumerate(tendons):
        sheath = tendon.sheath
        bend = sum(section.length / section.radius for section in sheath.sections)
        print(
            f"tendon {i + 1}: K = {sheath.friction * bend:.4g}, EA = {sheath.axial_stiffness:g} N; "
            f"peaks {run.proximal_tension[:, i].max():.3g} N at the housing, "
            f"{run.distal_tension[:, i].max():.3g} N at the tip; "
            f"the motor moved {1e3 * np.ptp(run.proximal_displacement[:, i]):.3g} mm, "
            f"the tip {1e3 * np.ptp(run.distal_displacement[:, i]):.3g} mm"
        )
        range_max = tendon.load_cell.range
        if run.proximal_tension[:, i].max() >= range_max:
            hint = f", --peak {args.peak:g} N is never read" if args.peak >= range_max else ""
            print(
                f"WARNING: tendon {i + 1}: its load cell's readings end at {range_max:g} N "
                f"(load_cell.range){hint}"
            )
    for effect in config.effects:
        print(f"effect {describe_effect(effect)}")
    for line in format_late_effects(config.effects, args.duration):
        print(line)
