"""Measure sessions of 1, 2, 4 and 8 joints, two tendons each, compared with idle loops.

  teleop bench scale
  teleop bench scale --joints 1 8 --quick
  teleop bench scale --json new.json --compare old.json

Each run has a session of `teleop run` for every number of joints, on a simulated rig with a
scripted hand of as many axes, and after each of them its idle: two processes that only tick,
and a bare ping-pong over Zenoh. The slave's tick is given with and without the computation of the
simulated rig.
"""

import argparse
from pathlib import Path

from teleop.cli.bench import repeated_runs
from teleop.cli.bench.bare_grid import run_idle_loops
from teleop.cli.bench.latency import measure_baseline_latency
from teleop.cli.bench.metric import Row
from teleop.cli.bench.session import SIDES, run_session
from teleop.session.config import RunConfig

JOINTS = (1, 2, 4, 8)
PERCENTILES = ("p50", "p99")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--joints",
        nargs="+",
        type=int,
        default=list(JOINTS),
        metavar="N",
        help=f"numbers of joints to compare, each 1 to 8 (default {' '.join(map(str, JOINTS))})",
    )
    repeated_runs.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    return repeated_runs.repeat_measurement("scale", args, measure)


def measure(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Return the figures of one session and of its idle after it."""
    session = run_session(config, seconds)
    idle = dict(zip(SIDES, run_idle_loops(shared.rate_hz, seconds, shared.realtime), strict=True))
    trips = measure_baseline_latency(seconds, shared)
    row: Row = {}
    for side in SIDES:
        loop, base = session.summary[side], idle[side]
        row[f"{side} rate"] = "Hz", loop["rate_hz"], base["rate_hz"], True
        row[f"{side} overruns"] = "", loop["overruns"], base["overruns"], False
        row[f"{side} CPU"] = "%", session.cpu.get(side), base["cpu"], False
        for key in PERCENTILES:
            work = loop["work_us"][key], base["work_us"][key]
            row[f"{side} tick {key}"] = "us", *work, False
    for key in PERCENTILES:
        work = session.summary["slave"]["without_rig_us"][key], idle["slave"]["work_us"][key]
        row[f"slave tick without rig {key}"] = "us", *work, False
    for key in PERCENTILES:
        latency = session.summary["master"]["latency_ms"][key]
        row[f"command to force {key}"] = "ms", latency, trips[f"{key}_ms"], False
    return row
