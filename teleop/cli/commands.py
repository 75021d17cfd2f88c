"""The `teleop` program: finds the command, imports it, and turns our errors into one line."""

import argparse
import errno
import importlib
import io
import os
import select
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TextIO

from teleop.config.suggestions import suggest_spelling
from teleop.errors import TeleopError, UsageError
from teleop.runtime import output_file
from teleop.runtime.process import die_with_launcher, interrupt_handler, limit_numeric_threads

# name -> (module with add_arguments and main, what it does); only the one that runs is imported
COMMANDS = {
    "run": (
        "teleop.launch.command",
        "start and supervise a whole session: slave, master, recorder, viewer",
    ),
    "master": ("master.process", "run the operator's side (master) alone"),
    "slave": ("slave.process", "run the robot's side (slave) alone"),
    "sessions": ("teleop.cli.sessions", "list your sessions that run on this machine"),
    "stop": ("teleop.remote.stop", "emergency stop of a session; --reset takes it back"),
    "set": ("teleop.remote.set", "change a setting of a running session"),
    "record": ("teleop.recording.command", "record a session to a file"),
    "view": ("teleop.view.command", "see the tension along the sheath, live or from a recording"),
    "ros": ("teleop.ros.command", "show a session to ROS 2 nodes"),
    "impair": (
        "teleop.impair.command",
        "put delay, loss, corruption or a cut between master and slave",
    ),
    "router": ("teleop.link.router", "connect the two sides of many sessions at one place"),
    "replay": ("teleop.recording.replay_to_link", "play a recording back onto the link"),
    "recordings": (
        "teleop.cli.recordings",
        "convert recordings to tables, datasets for learning, or bags of ROS 2",
    ),
    "devices": (
        "master.devices.hid.command",
        "list, probe, dump and test haptic devices; print udev rules",
    ),
    "rig": ("slave.bring_up.command", "bring up real motors and load cells: scan, check, reset"),
    "calibrate": ("slave.calibration.command", "measure a rig's sheaths: friction and stiffness"),
    "estimate": ("teleop.cli.estimate", "estimate the distal tension in measured data"),
    "data": ("teleop.cli.data", "show how a file of measured data is understood"),
    "diagnose": (
        "teleop.cli.diagnose.command",
        "find what the model of a bench gets wrong, and why",
    ),
    "pair": ("teleop.cli.pair", "measure a pair's friction against the bend of its sheath"),
    "simulate": ("teleop.cli.simulate", "write data as a simulated rig would measure it"),
    "keys": ("teleop.security.command", "make and manage the keys of sessions across machines"),
    "bench": ("teleop.cli.bench.command", "measure the loops and the latency on this machine"),
    "config": (
        "teleop.cli.config.command",
        "show a config with the source of each value, and all keys",
    ),
    "completion": ("teleop.cli.completion", "print a script for completion in bash, zsh or fish"),
    "doctor": ("teleop.cli.doctor", "check this machine and name what is missing"),
}


class Parser(argparse.ArgumentParser):
    """A parser whose complaints are one line, like all our others; no path is empty."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.register("type", Path, _parse_path)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            allowed = [str(choice) for choice in action.choices]
            hint = suggest_spelling(str(value), allowed) or f" (allowed: {', '.join(allowed)})"
            raise argparse.ArgumentError(action, f"{value!r} is unknown{hint}")

    def error(self, message: str) -> NoReturn:
        """Say what is wrong with the words given, and where to read on."""
        raise UsageError(f"{message} (see `{self.prog} --help`)")


def _parse_path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("the name is empty")
    return Path(text)


def _reject_unknown_words(
    parser: argparse.ArgumentParser, words: Sequence[str], unknown: Sequence[str]
) -> NoReturn:
    """Raise `UsageError` about words that no argument takes, with what they may have meant."""
    word = unknown[0]
    for name in words:
        below = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        if not below or name not in below[0].choices:
            break
        parser = below[0].choices[name]
    options = parser._option_string_actions
    before = words[: words.index(word)]
    hint = ""
    if word.startswith("-"):
        hint = suggest_spelling(word.partition("=")[0], options, cutoff=0.7)
    elif before[-2:-1] == ["--set"]:
        hint = f"; did you mean --set {before[-1]}={word}?"
    elif word.endswith((".yaml", ".yml")) and "--config" in options:
        hint = f"; did you mean --config {word}?"
    raise UsageError(
        f"unrecognized arguments: {' '.join(unknown)}{hint} (see `{parser.prog} --help`)"
    )


class _VersionAction(argparse.Action):
    """Prints the version; the module that finds it out is slow to import."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        print(f"teleop {version('tendon-teleop')}")
        parser.exit()


def build_parser(command: str | None, described: bool = False) -> argparse.ArgumentParser:
    """Return the parser with the sub-parser of `command`; without one the names of all.

    All are imported if they are to be `described`, with their arguments.
    """
    parser = Parser(
        prog="teleop",
        description="Haptic teleoperation for robots driven through tendon sheaths.",
        epilog="Start with: teleop run --config configs/demo.yaml",
    )
    parser.add_argument(
        "--version", action=_VersionAction, nargs=0, help="show the version and exit"
    )
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, prog="teleop"
    )
    for name in COMMANDS if command is None else (command,):
        module, summary = COMMANDS[name]
        sub = commands.add_parser(
            name, help=summary, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        if name == command or described:
            implementation = importlib.import_module(module)
            sub.description = implementation.__doc__
            implementation.add_arguments(sub)
            output_file.add_force_option(sub)
            sub.set_defaults(main=implementation.main)
    return parser


def main(argv: Sequence[str] | None = None, begin: Callable[[], object] = lambda: None) -> int:
    """Run the program; returns its exit code (0 fine, 1 a fault, 2 wrong usage or input).

    `begin` is called when all is imported and understood, and the command is about to run.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    return _run_guarded(lambda: _run_command(words, begin))


def _run_command(words: list[str], begin: Callable[[], object]) -> int:
    """Run the command of these words; returns its exit code."""
    command = words[0] if words and words[0] in COMMANDS else None
    die_with_launcher()
    parser = build_parser(command)
    args, unknown = parser.parse_known_args(words)
    if unknown:
        _reject_unknown_words(parser, words, unknown)
    output_file.check_outputs(parser, args)
    if getattr(args, "allow_imports", False):
        from teleop.config.extensions import allow_imports

        allow_imports()
    args.command_line = shlex.join(["teleop", *words])
    begin()
    return int(args.main(args))


def _run_guarded(run: Callable[[], int]) -> int:
    """Return the exit code of a program; an error that is not a defect of ours is one line."""
    prepare_streams()
    limit_numeric_threads()
    try:
        code = run()
    except TeleopError as error:
        code = print_error(str(error), error.exit_code)
    except KeyboardInterrupt:  # before there was a loop to stop
        code = report_interruption()
    except Exception as error:
        if interrupt_handler.number:  # a compiler makes an error of its own of what a signal raised
            code = report_interruption()
        elif isinstance(error, OSError) and find_output_error() is not None:
            code = 0
        elif complaint := _describe_environment_error(error):
            code = print_error(complaint, TeleopError.exit_code)
        else:
            raise
    return finish_output(code)


def print_error(text: str, code: int) -> int:
    """Print the line of an error, control characters escaped; return the exit code."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    try:
        print(f"teleop: {line}", file=sys.stderr)
    except OSError:  # nobody can be told
        _discard_output(sys.stderr)
    return code


def _discard_output(stream: TextIO) -> None:
    """Let the rest of a stream go nowhere, or the flush at the exit would fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_REMEDIES = {
    errno.EMFILE: "; raise the limit (ulimit -n)",
    errno.EROFS: "; write elsewhere, or give a volume there (docker run --tmpfs, --volume)",
    errno.ENOSPC: "; free some space, or write elsewhere",
}


def _describe_environment_error(error: Exception) -> str:
    """Return what a system refuses to any program, in a line; empty for a defect of ours."""
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename is not None else ""
        remedy = _REMEDIES.get(error.errno or 0, "")
        if "temporary directory" in str(error):
            remedy = ": set TMPDIR to a folder that can be written (docker run --tmpfs /tmp)"
        return f"{place}{error.strerror or error}{remedy}"
    if isinstance(error, MemoryError):
        detail = f" ({error})" if str(error) else ""
        return f"not enough memory{detail}: close other programs, or give fewer data at once"
    if isinstance(error, EOFError):
        return "the input ended before a question was answered; start it in a terminal"
    return ""


def find_output_error() -> OSError | None:
    """Return why standard output cannot be written, None if it can."""
    poll = select.poll()
    try:
        sys.stdout.flush()
        poll.register(sys.stdout, 0)  # unbuffered, nothing is left to be flushed
    except OSError as error:  # also of a stream that is no file
        return None if isinstance(error, io.UnsupportedOperation) else error
    broken = any(event & select.POLLERR for _, event in poll.poll(0))
    return BrokenPipeError() if broken else None


def finish_output(code: int) -> int:
    """Write what is left of the output; return the exit code, 1 if it cannot be written.

    A reader that left (`| head`) has what it wanted.
    """
    error = find_output_error()
    if error is None:
        return code
    _discard_output(sys.stdout)
    if isinstance(error, BrokenPipeError):
        return code
    return print_error(f"standard output: {error.strerror}", code or TeleopError.exit_code)


def report_interruption() -> int:
    """Say that a signal ended it; return the exit code."""
    return print_error("interrupted", interrupt_handler.exit_code)


def prepare_streams() -> None:
    """Replace standard streams that were closed at the start, which Python gives as None.

    In the order of their numbers: a file takes the lowest number that is free, and a socket or a
    recording must not become standard output.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - open until the end
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="replace")  # ASCII, and names of files that are not text


if __name__ == "__main__":
    sys.exit(main())
