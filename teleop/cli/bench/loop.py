"""Measure timing and CPU time of both loops, compared with idle loops.

  teleop bench loop
  teleop bench loop --joints 4 --json new.json --compare old.json
  teleop bench loop --quick --config configs/demo.yaml

Each run is a session of `teleop run` on a simulated rig, without a view, and then two idle
processes that tick at the same rate and priority. Rates, overruns and the work of a tick are those
of the whole session, its beginning included; the processor time, of all threads, is in per cent of
one core, after both sides have engaged.
"""

import argparse
from pathlib import Path
from typing import Any

from teleop.cli.bench import repeated_runs
from teleop.cli.bench.bare_grid import run_idle_loops
from teleop.cli.bench.metric import Row
from teleop.cli.bench.session import SIDES, run_session
from teleop.session.config import RunConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    repeated_runs.add_config(parser)
    repeated_runs.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    return repeated_runs.repeat_measurement("loop", args, measure)


def measure(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Return the figures of a session and of idle loops after it."""
    session = run_session(config, seconds)
    idle = dict(zip(SIDES, run_idle_loops(shared.rate_hz, seconds, shared.realtime), strict=True))
    row: Row = {}
    for side in SIDES:
        loop: dict[str, Any] = session.summary[side]
        base = idle[side]
        row[f"{side} rate"] = "Hz", loop["rate_hz"], base["rate_hz"], True
        row[f"{side} overruns"] = "", loop["overruns"], base["overruns"], False
        lateness = loop["lateness_max_ms"], base["lateness_max_ms"]
        row[f"{side} latest tick"] = "ms", *lateness, False
        for key, text in repeated_runs.PERCENTILES.items():
            work = loop["work_us"][key], base["work_us"][key]
            row[f"{side} tick {text}"] = "us", *work, False
        row[f"{side} CPU"] = "%", session.cpu.get(side), base["cpu"], False
    for key, text in repeated_runs.PERCENTILES.items():
        answer = session.summary["slave"]["answer_us"]
        own_work = session.summary["slave"]["without_rig_us"]
        row[f"slave answer {text}"] = "us", answer[key], None, False
        row[f"slave tick without rig {text}"] = "us", own_work[key], None, False
    row["run CPU"] = "%", session.cpu.get("run"), None, False
    return row
