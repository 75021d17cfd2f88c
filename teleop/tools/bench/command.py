"""Experiments and benchmarks with baselines.

  teleop bench loop --quick
  teleop bench latency --json new.json --compare old.json
  teleop bench paper
  teleop bench paper --sheaths 12 --out results
  teleop bench transparency --quick

`teleop bench NAME --help` describes an experiment and its options.
"""

import argparse
import importlib

from teleop import output_file
from teleop.app.cli import Parser

# name -> (module with add_arguments and main, summary); imported when run
BENCHES = {
    "paper": (
        "teleop.tools.paper.command",
        "repeat the experiment of Phee et al. 2009 over random sheaths",
    ),
    "transparency": (
        "teleop.tools.transparency.command",
        "transparency and stability of each coupling for each delay",
    ),
    "loop": (
        "teleop.tools.bench.loop",
        "timing of both loops on this machine, with idle loops as baseline",
    ),
    "latency": (
        "teleop.tools.bench.latency",
        "latency from command to force by stages, with bare Zenoh as baseline",
    ),
    "scale": (
        "teleop.tools.bench.scale",
        "timing and latency for 1, 2, 4 and 8 joints",
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(
        ["experiments:", *(f"  {name:12} {summary}" for name, (_, summary) in BENCHES.items())]
    )
    parser.add_argument(
        "experiment", choices=BENCHES, metavar="NAME", help="experiment, one of those listed below"
    )
    parser.add_argument(
        "words", nargs=argparse.REMAINDER, metavar="...", help="options of the experiment"
    )


def main(args: argparse.Namespace) -> int:
    """Run the selected experiment."""
    implementation = importlib.import_module(BENCHES[args.experiment][0])
    parser = Parser(
        prog=f"teleop bench {args.experiment}",
        description=implementation.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    implementation.add_arguments(parser)
    output_file.add_force(parser)
    chosen = parser.parse_args(args.words)
    output_file.check(parser, chosen)
    return int(implementation.main(chosen))
