"""The `teleop` program: finds the command, imports it, and turns our errors into one line."""

import argparse
import importlib
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from teleop import output_file
from teleop.errors import TeleopError, UsageError
from teleop.process import INTERRUPTED, die_with_launcher, interruption
from teleop.realtime import limit_numeric_threads

# name -> (module with add_arguments and main, what it does); only the one that runs is imported
COMMANDS = {
    "run": (
        "teleop.app.launch.command",
        "start and supervise a whole session: slave, master, recorder, viewer",
    ),
    "master": ("master.process", "run the operator's side (master) alone"),
    "slave": ("slave.process", "run the robot's side (slave) alone"),
    "sessions": ("teleop.app.sessions", "list your sessions that run on this machine"),
    "stop": ("teleop.remote.stop", "emergency stop of a session; --reset takes it back"),
    "set": ("teleop.remote.set", "change a setting of a running session"),
    "record": ("teleop.recording.command", "record a session to a file"),
    "view": ("teleop.view.command", "see the tension along the sheath, live or from a recording"),
    "ros": ("teleop.ros.command", "show a session to ROS 2 nodes"),
    "impair": (
        "teleop.impair.command",
        "put delay, loss, corruption or a cut between master and slave",
    ),
    "router": ("teleop.router.command", "connect the two sides of many sessions at one place"),
    "replay": ("teleop.recording.replay", "play a recording back onto the link"),
    "recordings": ("teleop.ros.recordings_command", "convert a recording to a rosbag2"),
    "devices": (
        "master.devices.hid.command",
        "list, probe, dump and test haptic devices; print udev rules",
    ),
    "rig": ("slave.bring_up.command", "bring up real motors and load cells: scan, check, reset"),
    "calibrate": ("slave.calibration.command", "measure a rig's sheaths: friction and stiffness"),
    "estimate": ("teleop.tools.estimate", "estimate the distal tension in measured data"),
    "diagnose": (
        "teleop.tools.diagnose.command",
        "find what the model of a bench gets wrong, and why",
    ),
    "pair": (
        "teleop.tools.pair.command",
        "measure a pair's friction against the bend of its sheath",
    ),
    "simulate": ("teleop.tools.simulate", "write data as a simulated rig would measure it"),
    "keys": ("teleop.keys.command", "make and manage the keys of sessions across machines"),
    "bench": (
        "teleop.tools.bench.command",
        "measure the loops here, or repeat a published experiment",
    ),
    "doctor": ("teleop.app.doctor", "check this machine and name what is missing"),
}


# commands that import the estimator


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line, like all our others."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the words given, and where to read on."""
        raise UsageError(f"{message} (see `{self.prog} --help`)")


class _Version(argparse.Action):
    """Prints the version; the module that finds it out is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        print(f"teleop {version('tendon-teleop')}")
        parser.exit()


def build_parser(command: str | None) -> argparse.ArgumentParser:
    """Return the parser; the sub-parser of `command` is complete, the others are names only."""
    parser = Parser(
        prog="teleop",
        description="Haptic teleoperation for robots driven through tendon sheaths.",
        epilog="Start with: teleop run --config configs/demo.yaml",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        sub = commands.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name == command:
            implementation = importlib.import_module(module)
            sub.description = implementation.__doc__
            implementation.add_arguments(sub)
            output_file.add_force(sub)
            sub.set_defaults(main=implementation.main)
    return parser


def main(argv: Sequence[str] | None = None, begin: Callable[[], object] = lambda: None) -> int:
    """Run the program; returns its exit code (0 fine, 1 a fault, 2 wrong usage or input).

    `begin` is called when all is imported and understood, and the command is about to run.
    """
    open_missing_streams()
    limit_numeric_threads()
    words = list(sys.argv[1:] if argv is None else argv)
    command = words[0] if words and words[0] in COMMANDS else None
    try:
        die_with_launcher()
        parser = build_parser(command)
        args = parser.parse_args(words)
        output_file.check(parser, args)
        args.command_line = shlex.join(["teleop", *words])
        begin()
        return int(args.main(args))
    except TeleopError as error:
        print(f"teleop: {_quoted(str(error), words)}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:  # before there was a loop to stop
        return interrupted()
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output left; nothing more to say
        return 0
    except Exception:
        if not interruption.came:
            raise
        return interrupted()  # a compiler makes an error of its own of what a signal raised


def _quoted(text: str, words: Sequence[str]) -> str:
    """Return a message with the words in it quoted that would break its line."""
    for word in words:
        if not word.isprintable() and word.strip():
            text = text.replace(word, repr(word))
    return text


def interrupted() -> int:
    """Say that the user ended it; return the exit code."""
    print("teleop: interrupted", file=sys.stderr)
    return INTERRUPTED


def open_missing_streams() -> None:
    """Replace standard streams that were closed at the start, which Python gives as None.

    In the order of their numbers: a file takes the lowest number that is free, and a socket or a
    recording must not become standard output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - open until the end


if __name__ == "__main__":
    sys.exit(main())
