"""Start and supervise a whole session: slave, master, recorder and viewer.

  teleop run --config configs/demo.yaml                 the simulated rig, until Ctrl-C
  teleop run --config configs/demo.yaml --duration 30 --record recordings --json run.json
  teleop run --replay bench.csv --calibration sheath.yaml     replayed data as the rig
  teleop run --config rig.yaml --model diagnosis/model.yaml   with the model of a diagnosis
  teleop run --set impair.to_slave.delay=0.02           with a network impairment: `teleop impair`

It takes free endpoints and a session name of its own, which the first line shows, unless config or
options state them (`--session`, `link.master`, `link.slave`): any number of sessions run side by
side on one machine. `teleop sessions` lists yours.

Slave, master, recorder (`teleop record`) and viewer (`teleop view`) can also run alone, each on its
own machine: see `teleop slave --help` etc.
"""

import argparse
from pathlib import Path

from teleop.config.loading import ConfigDocument
from teleop.config.options import add_option, add_options
from teleop.errors import TeleopError, UsageError
from teleop.launch.console import KEY_HELP, Console, KeyReader
from teleop.launch.watch import Keyboard
from teleop.messages.topics import Role
from teleop.runtime.output_file import SharedFolder
from teleop.runtime.process import StopCondition, has_display, to_exit_code, write_summary
from teleop.runtime.status_line import StatusLine
from teleop.session.summary import SessionSummary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop run`."""
    add_options(
        parser,
        "--config",
        "--set",
        "--allow-imports",
        "--insecure",
        "--duration",
        "--view",
        "--model",
        "--json",
    )
    add_option(parser, "--calibration", "as-built is the true one of a simulated rig")
    add_option(parser, "--session", help="name of the session (default one of its own)")
    parser.add_argument(
        "--record", type=SharedFolder(), metavar="DIR", help="record the session into DIR"
    )
    parser.add_argument(
        "--replay", type=Path, metavar="DATA", help="measured data in place of the rig"
    )
    for name in ("--mapping", "--run"):
        add_option(parser, name, "of --replay")


def main(args: argparse.Namespace) -> int:
    """Run a session; returns the exit code."""
    from teleop.launch import launcher  # slow to import, and not needed for --help

    stop = StopCondition()
    if args.replay is None and (args.mapping is not None or args.run is not None):
        raise UsageError("--mapping, --run: require --replay")
    changes = launcher.build_rig_overrides(args.replay, args.calibration, args.mapping, args.run)
    document = ConfigDocument.read(args.config, args.overrides).override(*changes)
    document, config = launcher.plan_session(document, args.session)
    plan = launcher.LaunchPlan(
        document=document,
        config=config,
        record=args.record,
        view=str(args.view or ("native" if has_display() else "web")),
        models=tuple(args.model),
        allow_imports=args.allow_imports,
        duration_s=args.duration,
    )
    console = Console(StatusLine())
    with KeyReader() as keys:
        if keys.there:
            console.status.say(KEY_HELP)
        summary = launcher.run_session(plan, console, stop, Keyboard(keys).look)
    return _report_outcome(summary, args.json, console)


def _report_outcome(summary: SessionSummary, path: Path | None, console: Console) -> int:
    """Write and print the summary; return the exit code, or raise what ended the session."""
    write_summary(path, summary.to_json())
    console.summarise(summary)
    if summary.exit_code:
        raise TeleopError(summary.reason)
    began = any(loop.role is Role.MASTER for loop in summary.loops)
    return 0 if began else to_exit_code(summary.reason)
