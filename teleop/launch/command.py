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
import signal
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from teleop.config.loading import ConfigDocument
from teleop.config.options import add_option, add_options
from teleop.config.overrides import Override
from teleop.errors import TeleopError, UsageError
from teleop.launch import watch
from teleop.launch.console import KEY_HELP, Console, KeyReader
from teleop.launch.supervisor import Child, Supervisor
from teleop.link import Link
from teleop.messages.topics import EVENT, LATENCY, LINK, REPORT, Role
from teleop.ros.config import check_ports
from teleop.ros.message_types import require_rosbags
from teleop.runtime.compiling import compile_in_parallel
from teleop.runtime.output_file import SharedFolder
from teleop.runtime.process import (
    TERMINATION_SIGNALS,
    StopCondition,
    has_display,
    to_exit_code,
    write_summary,
)
from teleop.runtime.scratch_folder import ScratchFolder
from teleop.runtime.status_line import StatusLine
from teleop.session import own_endpoints
from teleop.session.running_sessions import register_session
from teleop.session.summary import SessionSummary, find_fault, read_child_summary
from teleop.view.local_server import hold_port

SHUTDOWN_ORDER = (
    "master",
    "slave",
    "impair",
    "ros",
    "view",
    "record",
)  # the recorder stops last, to capture the final messages
# exit codes of a child told to end while it started
_STARTUP_EXIT_CODES = (*(128 + number for number in TERMINATION_SIGNALS), -signal.SIGTERM)


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


def main(args: argparse.Namespace) -> int:
    """Run a session; returns the exit code."""
    from teleop.launch.config import SessionConfig  # slow to import, and not needed for --help

    stop = StopCondition()
    document = ConfigDocument.read(args.config, args.overrides).override(*build_rig_overrides(args))
    document = own_endpoints.choose_place(document, args.session)
    config = document.load(SessionConfig)
    if config.ros.start:
        require_rosbags()
        check_ports(config.ros.router, config.link)
    impair, of_master = config.impair, document
    if impair is not None:
        impair.require_direct(config.link)
        endpoint = impair.link(config.link).slave
        of_master = document.override(Override.of("link.slave", endpoint))
    view = args.view or ("native" if has_display() else "web")

    console = Console(StatusLine())
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(ScratchFolder()))
        shared = ["--config", str(document.save_snapshot(scratch / "session"))]
        sides = ["--allow-imports"] * args.allow_imports
        supervisor = Supervisor(scratch, console.say)
        stack.callback(supervisor.stop, SHUTDOWN_ORDER)
        link = stack.enter_context(Link(config.link, config.session, Role.LAUNCHER))
        watch.require_free_session(link)  # before anything is started
        stack.enter_context(
            register_session(own_endpoints.build_entry(config, impair, args.config))
        )
        console.status.say(_format_join_hint(config.session))
        listener, monitor = link.listen((EVENT, REPORT, LATENCY, LINK)), watch.SessionMonitor()
        if args.record:
            supervisor.start("record", [*shared, "--out", str(args.record)])
        if impair is not None:
            supervisor.start("impair", shared)
        supervisor.start("slave", [*shared, *sides, *(f"--model={word}" for word in args.model)])
        if config.ros.start:
            supervisor.start("ros", shared)
        if view != "none":
            reserved, environment = hold_port(config.view.web_port)
            stack.enter_context(reserved)
            supervisor.start(
                "view", [*shared, "--view", str(view)], environment, (reserved.fileno(),)
            )
        stack.enter_context(compile_in_parallel(_compile_master))
        keys = stack.enter_context(KeyReader())
        keyboard = watch.Keyboard(keys, link)
        if keys.there:
            console.status.say(KEY_HELP)
        try:
            ended = watch.wait_for_slave(
                link, listener, monitor, supervisor, console, stop, keyboard
            )
            if not ended and not stop():
                snapshot = of_master.save_snapshot(scratch / "master")
                supervisor.start("master", ["--config", str(snapshot), *sides])
                ended = watch.watch(
                    link, listener, monitor, supervisor, console, stop, args.duration, keyboard
                )
        finally:
            console.status.clear()
            supervisor.stop(SHUTDOWN_ORDER)
            console.finish()
        summary = _combine_summaries(supervisor, ended, stop.reason)
    return _report_outcome(summary, args.json, console)


def _format_join_hint(session: str) -> str:
    return (
        f"Session {session}. In another terminal: teleop view --session {session} (or stop, "
        "record, set KEY VALUE)"
    )


def _compile_master() -> None:
    import_module("master.process").warm_up()


def _report_outcome(summary: SessionSummary, path: Path | None, console: Console) -> int:
    """Write and print the summary; return the exit code, or raise what ended the session."""
    write_summary(path, summary.to_json())
    console.summarise(summary)
    if summary.exit_code:
        raise TeleopError(summary.reason)
    began = any(loop.role is Role.MASTER for loop in summary.loops)
    return 0 if began else to_exit_code(summary.reason)


def build_rig_overrides(args: argparse.Namespace) -> list[Override]:
    """Return what `--replay` and `--calibration` override in the config."""
    from slave.config import AS_BUILT  # slow to import, and not needed for --help

    out = []
    if args.replay:
        rig = {"type": "replayed", "file": str(args.replay.absolute())}
        # a tip that the hand does not move would do work on it without energy in the ledger
        out += [Override.of("slave.rig", rig), Override.of("coupling", {"type": "direct"})]
    if args.calibration:
        is_file = str(args.calibration) != AS_BUILT
        calibration = str(args.calibration.absolute()) if is_file else AS_BUILT
        out += [Override.of("slave.tendons", []), Override.of("slave.calibration", calibration)]
    return out


def _describe_recorder_fault(supervisor: Supervisor) -> str:
    """Return why the recording is not whole; empty if it is, or if there is none."""
    child = supervisor.children.get("record")
    if child is None or child.exit_code in (0, *_STARTUP_EXIT_CODES):
        return ""
    missing = f"ended {child.describe_end()}; its last messages are missing"
    return f"recorder: {child.complaint or missing}"


def _combine_summaries(supervisor: Supervisor, ended: Child | None, reason: str) -> SessionSummary:
    """Combine the children's summaries and decide the exit code."""
    summary = SessionSummary(
        {
            name: read_child_summary(name, child.summary)
            for name, child in supervisor.children.items()
            if child.exit_code not in _STARTUP_EXIT_CODES
        },
        reason,
    )
    if ended is not None:
        reason = ended.complaint or f"{ended.name} ended {ended.describe_end()}"
        if ended.exit_code == UsageError.exit_code:
            raise UsageError(reason)
        summary = replace(summary, reason=reason)
        if ended.exit_code:
            return replace(summary, exit_code=TeleopError.exit_code)
    fault = find_fault(summary.loops) or _describe_recorder_fault(supervisor)
    if fault:
        return replace(summary, reason=fault, exit_code=TeleopError.exit_code)
    return summary
