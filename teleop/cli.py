"""The `teleop` program: finds the command, imports it, and turns our errors into one line."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import NoReturn

from teleop import compile_cache
from teleop.errors import TeleopError, UsageError
from teleop.process import die_with_parent, supervised

# name -> (module with add_arguments and main, what it does); only the one that runs is imported
COMMANDS = {
    "run": (
        "teleop.launch.command",
        "start and supervise a whole session: slave, master, recorder, viewer",
    ),
    "master": ("master.process", "run the operator's side alone"),
    "slave": ("slave.process", "run the tendon side alone"),
    "record": ("teleop.recording.command", "record a session to a file"),
    "view": ("teleop.view.command", "see the tension along the sheath, live or from a recording"),
    "replay": ("teleop.recording.replay", "play a recording back onto the link"),
    "estimate": ("slave.estimate", "estimate the distal tension in measured data"),
    "simulate": ("slave.simulate", "write data as a simulated rig would measure it"),
    "doctor": ("teleop.doctor", "check this machine and name what is missing"),
}


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line, like all our others."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the words given, and where to read on."""
        raise UsageError(f"{message} (see `{self.prog} --help`)")


def build_parser(command: str | None) -> argparse.ArgumentParser:
    """Return the parser; the sub-parser of `command` is complete, the others are names only."""
    parser = Parser(
        prog="teleop",
        description="Haptic teleoperation for robots driven through tendon sheaths.",
        epilog="Start with: teleop run --config configs/demo.yaml",
    )
    parser.add_argument("--version", action="version", version=f"teleop {version('tendon-teleop')}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        sub = commands.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name == command:
            implementation = importlib.import_module(module)
            sub.description = implementation.__doc__
            implementation.add_arguments(sub)
            sub.set_defaults(main=implementation.main)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code (0 fine, 1 a fault, 2 wrong usage or input)."""
    words = list(sys.argv[1:] if argv is None else argv)
    command = words[0] if words and words[0] in COMMANDS else None
    if supervised():
        die_with_parent()
    compile_cache.choose()
    try:
        args = build_parser(command).parse_args(words)
        return int(args.main(args))
    except TeleopError as error:
        print(f"teleop: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:  # before there was a loop to stop
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output left; nothing more to say
        return 0


if __name__ == "__main__":
    sys.exit(main())
