"""Benchmarks of this machine, each with a baseline of the same run.

  teleop bench loop --quick
  teleop bench latency --json new.json --compare old.json
  teleop bench scale --joints 1 8

Each run is a session of `teleop run` on a simulated rig with a scripted hand, without a view, and
after it the baseline: two processes that only tick, or that send messages of the same sizes to and
fro over bare Zenoh, at the same rate and priority. `teleop bench NAME --help` describes each.
"""

import argparse
import inspect
from pathlib import Path

from teleop.cli.bench import repeated_runs
from teleop.cli.bench.bare_grid import run_idle_loops
from teleop.cli.bench.metric import Row
from teleop.cli.bench.ping_pong import PERIOD_S, measure_ping_pong
from teleop.cli.bench.session import SIDES, run_session
from teleop.errors import TeleopError
from teleop.messages.messages import STAGE_NAMES, Command, SlaveState
from teleop.session.config import RunConfig

PERCENTILES = {"p50": "p50", "p99": "p99", "p99_9": "p99.9"}  # name in a summary -> in a table
MEDIAN_AND_TAIL = ("p50", "p99")
SCALE_JOINTS = (1, 2, 4, 8)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the benchmarks and their options."""
    benchmarks = parser.add_subparsers(dest="benchmark", metavar="NAME", required=True)
    for measure, summary in (
        (measure_loop, "timing of both loops on this machine, with idle loops as baseline"),
        (measure_latency, "latency from command to force by stages, with bare Zenoh as baseline"),
        (measure_scale, "timing and latency for 1, 2, 4 and 8 joints"),
    ):
        benchmark = benchmarks.add_parser(
            measure.__name__.removeprefix("measure_"),
            help=summary,
            description=inspect.getdoc(measure),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        benchmark.set_defaults(measure=measure)
        if measure is measure_scale:
            benchmark.add_argument(
                "--joints",
                nargs="+",
                type=int,
                default=list(SCALE_JOINTS),
                metavar="N",
                help="numbers of joints to compare, each 1 to 8 "
                f"(default {' '.join(map(str, SCALE_JOINTS))})",
            )
        else:
            repeated_runs.add_config(benchmark)
        repeated_runs.add_arguments(benchmark)


def main(args: argparse.Namespace) -> int:
    """Run the selected benchmark."""
    return repeated_runs.repeat_measurement(args.benchmark, args, args.measure)


def measure_loop(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Measure timing and CPU time of both loops, compared with idle loops.

    Rates, overruns and the work of a tick are those of the whole session, its beginning included;
    the processor time, of all threads, is in per cent of one core, after both sides have engaged.
    """
    session = run_session(config, seconds)
    idle = dict(zip(SIDES, run_idle_loops(shared.rate_hz, seconds, shared.realtime), strict=True))
    row: Row = {}
    for side in SIDES:
        loop, base = session.summary[side], idle[side]
        row[f"{side} rate"] = "Hz", loop["rate_hz"], base["rate_hz"], True
        row[f"{side} overruns"] = "", loop["overruns"], base["overruns"], False
        lateness = loop["lateness_max_ms"], base["lateness_max_ms"]
        row[f"{side} latest tick"] = "ms", *lateness, False
        for key, text in PERCENTILES.items():
            work = loop["work_us"][key], base["work_us"][key]
            row[f"{side} tick {text}"] = "us", *work, False
        row[f"{side} CPU"] = "%", session.cpu.get(side), base["cpu"], False
    for key, text in PERCENTILES.items():
        answer = session.summary["slave"]["answer_us"]
        own_work = session.summary["slave"]["without_rig_us"]
        row[f"slave answer {text}"] = "us", answer[key], None, False
        row[f"slave tick without rig {text}"] = "us", own_work[key], None, False
    row["run CPU"] = "%", session.cpu.get("run"), None, False
    return row


def measure_latency(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Measure the latency from command to force and its stages, compared with bare Zenoh.

    Latency is from the sending of a command to the write of the force that answers it. The stages
    are those of an answer within the tick, from reading the device
    (docs/explanation/coupling.md).
    """
    master = run_session(config, seconds).summary["master"]
    baseline = _measure_bare_latency(seconds, shared)
    row: Row = {}
    for key, text in PERCENTILES.items():
        latency = master["latency_ms"][key]
        row[f"command to force {text}"] = "ms", latency, baseline[f"{key}_ms"], False
    for stage in STAGE_NAMES:
        for key in MEDIAN_AND_TAIL:
            row[f"stage {stage} {key}"] = "us", master["stages_us"][stage][key], None, False
    answered = master["stages_us"]["all"]["n"]
    row["answered within the tick"] = "%", 100.0 * answered / master["ticks"], None, True
    return row


def measure_scale(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Measure sessions of several numbers of joints, two tendons each, as `loop` and `latency` do.

    The hand has as many axes. The slave's tick is given with and without the computation of the
    simulated rig.
    """
    session = run_session(config, seconds)
    idle = dict(zip(SIDES, run_idle_loops(shared.rate_hz, seconds, shared.realtime), strict=True))
    trips = _measure_bare_latency(seconds, shared)
    row: Row = {}
    for side in SIDES:
        loop, base = session.summary[side], idle[side]
        row[f"{side} rate"] = "Hz", loop["rate_hz"], base["rate_hz"], True
        row[f"{side} overruns"] = "", loop["overruns"], base["overruns"], False
        row[f"{side} CPU"] = "%", session.cpu.get(side), base["cpu"], False
        for key in MEDIAN_AND_TAIL:
            work = loop["work_us"][key], base["work_us"][key]
            row[f"{side} tick {key}"] = "us", *work, False
    for key in MEDIAN_AND_TAIL:
        work = session.summary["slave"]["without_rig_us"][key], idle["slave"]["work_us"][key]
        row[f"slave tick without rig {key}"] = "us", *work, False
    for key in MEDIAN_AND_TAIL:
        latency = session.summary["master"]["latency_ms"][key]
        row[f"command to force {key}"] = "ms", latency, trips[f"{key}_ms"], False
    return row


def _measure_bare_latency(seconds: float, shared: RunConfig) -> dict[str, float]:
    """Return percentiles of bare Zenoh over as long a time; `TeleopError` without an answer."""
    sizes = Command.schema.size, SlaveState.schema.size
    baseline = measure_ping_pong(*sizes, round(seconds / PERIOD_S), shared.realtime)
    if not baseline:
        raise TeleopError("no answer in the bare ping-pong")
    return baseline
