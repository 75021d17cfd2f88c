"""Experiments, and measurements of this machine, with something to stand beside.

  teleop bench loop --quick
  teleop bench latency --json new.json --compare old.json
  teleop bench paper
  teleop bench paper --sheaths 12 --out results
  teleop bench transparency --quick

`teleop bench NAME --help` says what an experiment does and takes.
"""

import argparse
import importlib

from teleop.app.cli import Parser

# name -> (module with add_arguments and main, what it does); only the one that runs is imported
BENCHES = {
    "paper": (
        "teleop.tools.paper.command",
        "repeat the experiment of Phee et al. 2009 over random sheaths",
    ),
    "transparency": (
        "teleop.tools.transparency.command",
        "how transparent and how stable each coupling is, over each delay",
    ),
    "loop": (
        "teleop.tools.bench.loop",
        "how both loops keep their time here, beside loops that only tick",
    ),
    "latency": (
        "teleop.tools.bench.latency",
        "from command to force in stages, beside bare Zenoh",
    ),
    "scale": (
        "teleop.tools.bench.scale",
        "the same for 1, 2, 4 and 8 joints",
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(
        ["experiments:", *(f"  {name:12} {summary}" for name, (_, summary) in BENCHES.items())]
    )
    parser.add_argument("experiment", choices=BENCHES, metavar="NAME", help="see below")
    parser.add_argument("words", nargs=argparse.REMAINDER, metavar="...", help="its own options")


def main(args: argparse.Namespace) -> int:
    """Run the experiment named."""
    implementation = importlib.import_module(BENCHES[args.experiment][0])
    parser = Parser(
        prog=f"teleop bench {args.experiment}",
        description=implementation.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    implementation.add_arguments(parser)
    return int(implementation.main(parser.parse_args(args.words)))
