"""Measure the latency from command to force and its stages, compared with bare Zenoh.

  teleop bench latency
  teleop bench latency --joints 4 --json new.json --compare old.json
  teleop bench latency --quick --config configs/demo.yaml

Each run is a session of `teleop run` on a simulated rig, without a view, and then two processes
that send messages of the same sizes to and fro, with the same way of waiting and the same priority.
Latency is from the sending of a command to the write of the force that answers it. The stages are
those of an answer within the tick, from reading the device (docs/explanation/coupling.md).
"""

import argparse
from pathlib import Path

from teleop.cli.bench import repeated_runs
from teleop.cli.bench.metric import Row
from teleop.cli.bench.ping_pong import PERIOD_S, measure_ping_pong
from teleop.cli.bench.session import run_session
from teleop.errors import TeleopError
from teleop.messages.messages import STAGE_NAMES, Command, SlaveState
from teleop.session.config import RunConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    repeated_runs.add_config(parser)
    repeated_runs.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    return repeated_runs.repeat_measurement("latency", args, measure)


def measure(config: Path, seconds: float, shared: RunConfig) -> Row:
    """Return the figures of a session and of a ping-pong after it."""
    summary = run_session(config, seconds).summary
    baseline = measure_baseline_latency(seconds, shared)
    master = summary["master"]
    row: Row = {}
    for key, text in repeated_runs.PERCENTILES.items():
        latency = master["latency_ms"][key]
        row[f"command to force {text}"] = "ms", latency, baseline[f"{key}_ms"], False
    for stage in STAGE_NAMES:
        for key, text in list(repeated_runs.PERCENTILES.items())[:2]:
            row[f"stage {stage} {text}"] = "us", master["stages_us"][stage][key], None, False
    answered = master["stages_us"]["all"]["n"]
    row["answered within the tick"] = "%", 100.0 * answered / master["ticks"], None, True
    return row


def measure_baseline_latency(seconds: float, shared: RunConfig) -> dict[str, float]:
    """Return percentiles of bare Zenoh over as long a time; `TeleopError` without an answer."""
    sizes = Command.schema.size, SlaveState.schema.size
    baseline = measure_ping_pong(*sizes, round(seconds / PERIOD_S), shared.realtime)
    if not baseline:
        raise TeleopError("no answer in the bare ping-pong")
    return baseline
