"""Benchmarks of this machine, each with a baseline of the same run.

  teleop bench loop --quick
  teleop bench latency --json new.json --compare old.json
  teleop bench scale

`teleop bench NAME --help` describes a benchmark and its options.
"""

import argparse
import importlib

from teleop.cli.commands import parse_words

# name -> (module with add_arguments and main, summary); imported when run
BENCHES = {
    "loop": (
        "teleop.cli.bench.loop",
        "timing of both loops on this machine, with idle loops as baseline",
    ),
    "latency": (
        "teleop.cli.bench.latency",
        "latency from command to force by stages, with bare Zenoh as baseline",
    ),
    "scale": ("teleop.cli.bench.scale", "timing and latency for 1, 2, 4 and 8 joints"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(
        ["benchmarks:", *(f"  {name:12} {summary}" for name, (_, summary) in BENCHES.items())]
    )
    parser.add_argument(
        "benchmark", choices=BENCHES, metavar="NAME", help="one of those listed below"
    )
    parser.add_argument(
        "words", nargs=argparse.REMAINDER, metavar="...", help="options of the benchmark"
    )


def main(args: argparse.Namespace) -> int:
    """Run the selected benchmark."""
    module, _ = BENCHES[args.benchmark]
    benchmark = importlib.import_module(module)
    return int(benchmark.main(parse_words(f"teleop bench {args.benchmark}", benchmark, args.words)))
