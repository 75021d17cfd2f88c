"""Run a session: start its processes in order, supervise them, end them."""

import signal
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from slave.config import AS_BUILT
from teleop.config.loading import ConfigDocument
from teleop.config.overrides import Override
from teleop.errors import TeleopError, UsageError
from teleop.launch import watch
from teleop.launch.config import SessionConfig
from teleop.launch.console import Console
from teleop.launch.supervisor import Child, Supervisor
from teleop.link import Link
from teleop.messages.topics import EVENT, LATENCY, LINK, REPORT, Role
from teleop.ros.config import check_ports
from teleop.ros.message_types import require_rosbags
from teleop.runtime.process import TERMINATION_SIGNALS, StopCondition
from teleop.runtime.scratch_folder import ScratchFolder
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


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchPlan:
    """What to start: checked, nothing started yet."""

    document: ConfigDocument
    config: SessionConfig
    record: Path | None = None  # folder of the recording; None = no recorder
    view: str = "none"  # as of `--view`
    models: tuple[str, ...] = ()  # as of `--model`
    allow_imports: bool = False
    duration_s: float | None = None  # [s] from when both loops have reported; None for ever
    environment: Mapping[str, str] = field(default_factory=dict)  # added to that of both sides
    master_files: tuple[int, ...] = ()  # file descriptors that the master has too


def plan_session(
    document: ConfigDocument, name: str | None
) -> tuple[ConfigDocument, SessionConfig]:
    """Choose the place of a session and check its config; nothing is started.

    Raises `UsageError` if the config is invalid, or the session's name is taken (`PeerError`).
    """
    document = own_endpoints.choose_place(document, name)
    config = document.load(SessionConfig)
    if config.ros.start:
        require_rosbags()
        check_ports(config.ros.router, config.link)
    if config.impair is not None:
        config.impair.require_direct(config.link)
    return document, config


def build_rig_overrides(
    replay: Path | None,
    calibration: Path | None,
    mapping: Path | None = None,
    run: int | None = None,
) -> list[Override]:
    """Return what measured data to be replayed, and a calibration, override in a config.

    `mapping` and `run` tell how the data are to be read.
    """
    out = []
    if replay:
        rig: dict[str, Any] = {"type": "replayed", "file": str(replay.absolute()), "run": run}
        rig["mapping"] = mapping and str(mapping.absolute())
        # a tip that the hand does not move would do work on it without energy in the ledger
        out += [
            Override.from_value("slave.rig", rig),
            Override.from_value("coupling", {"type": "direct"}),
        ]
    if calibration:
        is_file = str(calibration) != AS_BUILT
        value = str(calibration.absolute()) if is_file else AS_BUILT
        out += [
            Override.from_value("slave.tendons", []),
            Override.from_value("slave.calibration", value),
        ]
    return out


def run_session(
    plan: LaunchPlan,
    console: Console,
    stop: StopCondition,
    poll: Callable[[Link, float], None],
    begin: Callable[[], None] = lambda: None,
) -> SessionSummary:
    """Run a session until it is told to stop or one of its sides ends.

    In any thread; all processes have ended when it returns or raises.

    `poll` is called with the launcher's link and a time [s] that it may wait at most, `begin` once
    both loops have reported. Raises `UsageError` or `TeleopError` if the session could not start.
    """
    config, document = plan.config, plan.document
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(ScratchFolder()))
        shared = ["--config", str(document.save_snapshot(scratch / "session"))]
        sides = ["--allow-imports"] * plan.allow_imports
        supervisor = Supervisor(scratch, console.say)
        stack.callback(supervisor.stop, SHUTDOWN_ORDER)
        # both sides import and compile at once; they touch nothing before they are called
        models = [f"--model={word}" for word in plan.models]
        supervisor.start("slave", [*shared, *sides, *models], plan.environment, standby=True)
        if config.impair is not None:  # the master connects to the proxy
            endpoint = config.impair.build_link_config(config.link).slave
            document = document.override(Override.from_value("link.slave", endpoint))
        snapshot = document.save_snapshot(scratch / "master")
        supervisor.start(
            "master",
            ["--config", str(snapshot), *sides],
            plan.environment,
            plan.master_files,
            standby=True,
        )
        link = stack.enter_context(Link(config.link, config.session, Role.LAUNCHER))
        watch.require_free_session(link)  # before either side is called
        stack.enter_context(
            register_session(own_endpoints.build_entry(config, config.impair, document.path))
        )
        console.status.say(
            f"Session {config.session}. In another terminal: teleop view --session "
            f"{config.session} (or stop, record, set KEY VALUE)"
        )
        listener = link.listen((EVENT, REPORT, LATENCY, LINK))
        if plan.record:
            supervisor.start("record", [*shared, "--out", str(plan.record)])
        if config.impair is not None:
            supervisor.start("impair", shared)
        if not stop():
            supervisor.call("slave")
        if config.ros.start:
            supervisor.start("ros", shared)
        if plan.view != "none":
            reserved, environment = hold_port(config.view.web_port)
            stack.enter_context(reserved)
            supervisor.start(
                "view", [*shared, "--view", plan.view], environment, (reserved.fileno(),)
            )
        watched = watch.SessionWatch(link, listener, supervisor, console, stop, partial(poll, link))
        try:
            ended = watched.wait_for_slave()
            if not ended and not stop():
                supervisor.call("master")
                ended = watched.run(plan.duration_s, begin)
        finally:
            console.status.clear()
            supervisor.stop(SHUTDOWN_ORDER)
            console.finish()
        return _combine_summaries(supervisor, ended, stop.reason)


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
