"""Common parts of the benchmark commands: options, repetition, report."""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from teleop.cli.bench import figures, machine, rigs, session
from teleop.cli.bench.figures import Metric, Row
from teleop.config import strict_yaml
from teleop.config.loading import load
from teleop.config.options import add_option
from teleop.errors import UsageError
from teleop.runtime.process import parse_seconds, write_summary
from teleop.session.config import RunConfig

RUNS, SECONDS = 5, 10.0
QUICK_RUNS, QUICK_SECONDS = 3, 4.0
SECONDS_LEAST = 3.0  # [s] of a run: shorter ones are mostly start-up
WARM_S = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the common options."""
    parser.add_argument("--runs", type=int, metavar="N", help=f"number of runs (default {RUNS})")
    parser.add_argument(
        "--seconds",
        type=parse_seconds,
        metavar="S",
        help=f"duration of each run [s] (default {SECONDS:g})",
    )
    add_option(parser, "--quick", f"{QUICK_RUNS} runs of {QUICK_SECONDS:g} s")
    add_option(parser, "--json")
    parser.add_argument(
        "--compare", type=Path, metavar="OLD", help="earlier --json file to compare with"
    )


def add_config(parser: argparse.ArgumentParser) -> None:
    """Declare what chooses the session."""
    add_option(parser, "--config", help="config file (YAML) of a session on a simulated rig")
    parser.add_argument(
        "--joints", type=int, default=1, metavar="N", help="joints, without --config (default 1)"
    )


class RepeatedRuns:
    """Repeats a measurement by the options, and reports the result."""

    def __init__(self, name: str, args: argparse.Namespace) -> None:
        self.runs = args.runs or (QUICK_RUNS if args.quick else RUNS)
        self.seconds = args.seconds or (QUICK_SECONDS if args.quick else SECONDS)
        if args.runs is not None and not 1 <= args.runs <= 1000:
            raise UsageError(f"--runs {args.runs}: must be 1 to 1000")
        if self.seconds < SECONDS_LEAST:
            raise UsageError(f"--seconds {self.seconds:g}: must be at least {SECONDS_LEAST:g}")
        self.granted: list[str] = []
        self._name, self._out = name, args.json
        self._old = None if args.compare is None else read_result(args.compare, name)
        self._machine = machine.describe_machine()
        self._begin_s = time.monotonic()

    def say(self, text: str) -> None:
        """Print a line of progress."""
        print(f"{time.monotonic() - self._begin_s:5.0f} s  {text}", file=sys.stderr, flush=True)

    def warm_up(self, config: Path) -> None:
        """Run a session that is not counted, to fill the compile cache."""
        self.say("first run, not counted")
        summary = session.run_session(config, WARM_S).summary
        self.granted = list(summary["slave"]["realtime"])

    def conclude(self, found: Sequence[Metric]) -> int:
        """Print the result, write it, compare it; return the exit code."""
        print("\n".join(machine.format_description(self._machine, self.granted)))
        print(f"medians of {self.runs} runs of {self.seconds:g} s\n")
        print("\n".join(figures.format_table(found)))
        result = {
            "bench": self._name,
            "machine": self._machine | {"realtime": self.granted},
            "runs": self.runs,
            "seconds": self.seconds,
            "figures": figures.to_tree(found),
        }
        write_summary(self._out, result)
        if self._old is not None:
            print("\n" + "\n".join(figures.format_comparison(found, self._old)))
        return 0


def repeat_measurement(
    name: str, args: argparse.Namespace, measure: Callable[[Path, float, RunConfig], Row]
) -> int:
    """Measure one session repeatedly; `measure` takes its config file, seconds and config."""
    repeated = RepeatedRuns(name, args)
    with tempfile.TemporaryDirectory(prefix="teleop-bench-") as folder:
        config = args.config or rigs.write_config(
            Path(folder) / "session.yaml", validate_joints(args.joints)
        )
        shared = load(config, RunConfig, None, ())
        work = Path(folder) / "run.yaml"
        work.write_text(strict_yaml.read_text(Path(config)))
        repeated.warm_up(work)
        rows = []
        for k in range(repeated.runs):
            repeated.say(f"run {k + 1} of {repeated.runs}")
            rows.append(measure(work, repeated.seconds, shared))
    return repeated.conclude(figures.collect_metrics(rows))


def validate_joints(number: int) -> int:
    """Return `number` if it is a valid number of joints."""
    if not 1 <= number <= 8:
        raise UsageError(f"--joints {number}: must be 1 to 8")
    return number


def read_result(path: Path, name: str) -> dict[str, Metric]:
    """Return the figures of a result of the bench `name`; `UsageError` if it is not one."""
    try:
        result: Any = json.loads(path.read_text())
        if result["bench"] != name:
            raise UsageError(f"--compare {path}: is of `teleop bench {result['bench']}`")
        return figures.from_tree(result["figures"])
    except OSError as error:
        raise UsageError(f"--compare {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"--compare {path}: not a result of `teleop bench {name}`") from error
