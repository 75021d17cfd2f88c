"""Common parts of the benchmarks: their rig, their machine, options, repetition, report."""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from teleop.cli.bench import metric, session
from teleop.cli.bench.metric import Metric, Row
from teleop.config.loading import ConfigDocument
from teleop.config.options import add_option
from teleop.errors import UsageError
from teleop.runtime.machine import count_processors
from teleop.runtime.process import parse_seconds, write_summary
from teleop.session.config import RunConfig

# --- config of a session to measure: a simulated arm of a number of joints, a hand for each


def write_config(path: Path, joints: int) -> Path:
    """Write the config of an arm of `joints` joints, two tendons each; return `path`.

    The sheaths are those of configs/arm.yaml, one bend longer for each joint further out; the last
    joint closes on tissue.
    """
    path.write_text(json.dumps(_build_config(joints)))  # which is YAML, too
    return path


def _build_config(joints: int) -> dict[str, Any]:
    environments: list[dict[str, Any]] = [{"type": "free"} for _ in range(joints - 1)]
    environments.append({"type": "tissue", "position": 0.003, "stiffness": 10000, "exponent": 1.5})
    body = {
        "mass": 0.02, "damping": 2.0, "friction": 0.1, "spring": 0.0,
        "pretension": 0.5, "stops": [-0.008, 0.008],
    }  # fmt: skip
    rig = {
        "type": "simulated",
        "name": f"bench-{joints}",
        "joints": [
            {
                "tendons": [_build_tendon(k), _build_tendon(k)],
                "body": body,
                "environment": environment,
            }
            for k, environment in enumerate(environments)
        ],
    }
    gate = {
        "displacement_min": -0.025, "displacement_max": 0.025, "speed_max": 0.05, "tension_max": 25,
    }  # fmt: skip
    reference = {
        "type": "reaches", "targets": [0.0, 0.02, -0.01, 0.025, -0.02], "reach": 0.8, "rest": 0.3,
    }  # fmt: skip
    device = {
        "type": "virtual", "axes": joints, "reference": reference, "engage": [[0.2, 1e6]],
    }  # fmt: skip
    return {
        "slave": {"rig": rig, "calibration": "as-built", "gate": gate},
        "master": {"device": device, "operator": {"position_scale": 0.25}, "force": {"scale": 0.2}},
    }


def _build_tendon(joint: int) -> dict[str, Any]:
    sections: list[dict[str, float]] = [
        {"length": 0.4},
        {"length": 0.5, "radius": 0.15},
        {"length": 0.4, "radius": 0.40},
    ]
    if joint:
        sections.append({"length": 0.06 * joint, "radius": 0.05})
    return {"sheath": {"sections": sections, "friction": 0.1, "axial_stiffness": 9000}}


# --- description of the machine of a measurement

PACKAGES = ("tendon-teleop", "eclipse-zenoh", "numpy", "numba", "scipy")


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, kernel, versions, commit and the load before the measurement."""
    return {
        "cpu": _read_cpu_model(),
        "cores": count_processors(),
        "kernel": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "packages": {name: _find_version(name) for name in PACKAGES},
        "commit": _find_commit(),
        "load_average": [round(load, 2) for load in os.getloadavg()],
    }


def format_description(machine: dict[str, Any], realtime: Sequence[str]) -> list[str]:
    """Return the description as text; `realtime` is the scheduling granted to the loops."""
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items())
    return [
        f"machine   {machine['cpu']}, {machine['cores']} cores, {machine['kernel']}, "
        f"load {machine['load_average'][0]:.1f} at the start",
        f"software  Python {machine['python']}, {packages}, "
        f"commit {machine['commit'] or 'unknown'}",
        f"granted   {', '.join(realtime) or 'nothing'}",
    ]


def _read_cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()


def _find_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _find_commit() -> str | None:
    """Return the commit of the sources; None outside a repository, `+` if they were changed."""
    root = Path(__file__).parents[3]
    if not (root / ".git").exists():
        return None
    try:
        words = ["git", "-C", str(root), "describe", "--always", "--dirty=+", "--exclude=*"]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


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


def repeat_measurement(
    bench: str, args: argparse.Namespace, measure: Callable[[Path, float, RunConfig], Row]
) -> int:
    """Measure sessions repeatedly, print the result, write it, compare it; return the exit code.

    `measure` takes a session's config file, its seconds and its config. With a list of `--joints`
    there is a session for each number in it, with which the names of its figures begin.
    """
    runs = args.runs or (QUICK_RUNS if args.quick else RUNS)
    seconds = args.seconds or (QUICK_SECONDS if args.quick else SECONDS)
    if args.runs is not None and not 1 <= args.runs <= 1000:
        raise UsageError(f"--runs {args.runs}: must be 1 to 1000")
    if seconds < SECONDS_LEAST:
        raise UsageError(f"--seconds {seconds:g}: must be at least {SECONDS_LEAST:g}")
    old = None if args.compare is None else read_result(args.compare, bench)
    machine = describe_machine()
    begin_s = time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - begin_s:5.0f} s  {text}", file=sys.stderr, flush=True)

    rows: list[Row] = [{} for _ in range(runs)]
    with tempfile.TemporaryDirectory(prefix="teleop-bench-") as folder:
        configs = _save_configs(args, Path(folder))
        say("first run, not counted")  # it fills the compile cache
        first, _ = next(iter(configs.values()))
        granted = list(session.run_session(first, WARM_S).summary["slave"]["realtime"])
        for k, row in enumerate(rows):
            for prefix, (config, shared) in configs.items():
                say(f"{prefix}run {k + 1} of {runs}")
                figures = measure(config, seconds, shared)
                row |= {f"{prefix}{name}": figure for name, figure in figures.items()}
    metrics = metric.collect_metrics(rows)
    print("\n".join(format_description(machine, granted)))
    print(f"medians of {runs} runs of {seconds:g} s\n")
    print("\n".join(metric.format_table(metrics)))
    result = {
        "bench": bench,
        "machine": machine | {"realtime": granted},
        "runs": runs,
        "seconds": seconds,
        "figures": metric.to_tree(metrics),
    }
    write_summary(args.json, result)
    if old is not None:
        print("\n" + "\n".join(metric.format_comparison(metrics, old)))
    return 0


def _save_configs(args: argparse.Namespace, folder: Path) -> dict[str, tuple[Path, RunConfig]]:
    """Return the config of each session by the prefix of its figures, saved in `folder`."""
    is_compared = isinstance(args.joints, list)
    configs = {}
    for number in sorted(set(args.joints)) if is_compared else [args.joints]:
        if not 1 <= number <= 8:
            raise UsageError(f"--joints {number}: must be 1 to 8")
        given = None if is_compared else args.config
        document = ConfigDocument.read(given or write_config(folder / f"{number}.yaml", number))
        config = document.save_snapshot(folder / f"run-{number}"), document.load(RunConfig)
        configs[f"{number}: " if is_compared else ""] = config
    return configs


def read_result(path: Path, name: str) -> dict[str, Metric]:
    """Return the figures of a result of the bench `name`; `UsageError` if it is not one."""
    try:
        result: Any = json.loads(path.read_text())
        if result["bench"] != name:
            raise UsageError(f"--compare {path}: is of `teleop bench {result['bench']}`")
        return metric.from_tree(result["figures"])
    except OSError as error:
        raise UsageError(f"--compare {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"--compare {path}: not a result of `teleop bench {name}`") from error
