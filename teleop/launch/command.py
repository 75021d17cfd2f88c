"""Start and supervise a whole session: slave, master, recorder and viewer.

  teleop run --config configs/demo.yaml                 the simulated rig, until Ctrl-C
  teleop run --config configs/demo.yaml --duration 30 --record recordings --json run.json
  teleop run --replay bench.csv --calibration sheath.yaml     measured data as the rig

Each of the four also starts alone, on a machine of its own: see `teleop slave --help` and so on.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

from teleop.config import add_arguments as add_config_arguments
from teleop.config import load
from teleop.errors import TeleopError, UsageError
from teleop.launch import summary as summaries
from teleop.launch.status import StatusLine, status_text
from teleop.launch.supervisor import Child, Supervisor, wait_for
from teleop.link import Link
from teleop.link.ping_pong import ping_pong
from teleop.messages import Command, Event, LoopReport, SlaveState, text_of
from teleop.process import Stop, write_summary
from teleop.run_config import RunConfig
from teleop.topics import EVENT, REPORT, STATE, TENDONS, Role

# the sections of a config file and who checks them; imported by name, as the command line does
SECTIONS = {
    "master": ("master.config", "MasterConfig"),
    "slave": ("slave.config", "SlaveConfig"),
    "record": ("teleop.recording.config", "RecordConfig"),
    "view": ("teleop.view.config", "ViewConfig"),
}
ENDING = ("master", "slave", "view", "record")  # the recorder last: it hears the others out
VITAL = ("master", "slave")
_START_S = 120.0  # the first start compiles the estimator and the plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop run`."""
    add_config_arguments(parser)
    parser.add_argument(
        "--duration", type=float, metavar="S", help="end after S seconds of running"
    )
    parser.add_argument("--record", type=Path, metavar="DIR", help="record the session into DIR")
    parser.add_argument(
        "--view",
        choices=("native", "web", "rrd", "none"),
        help="where to show it; native with a screen, web without",
    )
    parser.add_argument(
        "--replay", type=Path, metavar="DATA", help="measured data in place of the rig"
    )
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="the sheath's calibration")
    parser.add_argument("--json", metavar="FILE", help="write the summary to FILE")


def main(args: argparse.Namespace) -> int:
    """Run a session; returns the exit code."""
    overrides = [*args.overrides, *_rig_overrides(args)]
    config = load(args.config, RunConfig, None, overrides)
    for section, (module, name) in SECTIONS.items():
        load(args.config, getattr(import_module(module), name), section, overrides)
    shared = [f"--set={text}" for text in overrides]
    if args.config:
        shared = ["--config", str(args.config), *shared]
    view = args.view or ("native" if _has_screen() else "web")

    status = StatusLine()
    stop = Stop()
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="teleop-")))
        family = Supervisor(scratch, lambda name, line: status.say(f"[{name}] {line}"))
        stack.callback(family.stop, ENDING)
        link = stack.enter_context(Link(config.link, config.session, Role.LAUNCHER))
        if args.record:
            family.start("record", [*shared, "--out", str(args.record)])
        family.start("slave", shared)
        if view != "none":
            family.start("view", [*shared, "--view", view])
        try:
            ended = _wait_for_slave(link, family, stop)
            if not ended and not stop():
                family.start("master", shared)
                ended = _watch(link, family, status, stop, args.duration)
        finally:
            status.clear()
            family.stop(ENDING)
        summary = _summary(family, ended, stop.reason)
    summary["ping_pong"] = ping_pong(Command.schema.size, SlaveState.schema.size)
    write_summary(args.json, summary)
    print("\n".join(summaries.lines(summary)))
    if summary["exit_code"]:
        raise TeleopError(summary["reason"])
    return 0


def _rig_overrides(args: argparse.Namespace) -> list[str]:
    out = []
    if args.replay:
        out.append(
            "slave.rig=" + json.dumps({"type": "replayed", "file": str(args.replay.absolute())})
        )
    if args.calibration:
        out += [
            "slave.tendons=[]",
            f"slave.calibration={json.dumps(str(args.calibration.absolute()))}",
        ]
    return out


def _has_screen() -> bool:
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def _wait_for_slave(link: Link, family: Supervisor, stop: Stop) -> Child | None:
    """Wait for the slave to answer; the first start compiles. Return a child that ended instead."""
    link.subscribe_latest(STATE)
    if not wait_for(
        lambda: link.latest(STATE).message is not None or bool(family.ended()) or stop(), _START_S
    ):
        raise TeleopError(f"the slave did not start within {_START_S:g} s")
    return next(iter(family.ended()), None)


def _watch(
    link: Link, family: Supervisor, status: StatusLine, stop: Stop, duration_s: float | None
) -> Child | None:
    """Look after a session until it is to end; return the vital child that ended it, if one did."""
    listener = link.listen((EVENT, REPORT))
    link.subscribe_latest(TENDONS)
    reports: dict[Role, LoopReport] = {}
    buried: set[str] = set()
    patience = time.monotonic() + _START_S
    end = float("inf")
    while not stop():
        for heard in listener.drain():
            if heard.topic is EVENT:
                event = Event.unpack(heard.data)
                status.say(f"[{Role(event.role).name.lower()}] {text_of(event.text)}")
            else:
                report = LoopReport.unpack(heard.data)
                reports[Role(report.role)] = report
        for child in family.ended():
            if child.name in VITAL or child.exit_code == UsageError.exit_code:
                return child
            if child.name not in buried:
                buried.add(child.name)
                status.say(
                    f"[{child.name}] ended (exit code {child.exit_code}); the session goes on"
                )
        running = Role.MASTER in reports and Role.SLAVE in reports
        if running and end == float("inf") and duration_s is not None:
            end = time.monotonic() + duration_s
        if time.monotonic() >= end:
            stop.request("duration reached")
        if not running and time.monotonic() > patience:
            raise TeleopError(f"the loops did not start within {_START_S:g} s")
        status.show(status_text(reports, link.latest(STATE).message, link.latest(TENDONS).message))
        time.sleep(0.1)
    return None


def _summary(family: Supervisor, ended: Child | None, reason: str) -> dict[str, Any]:
    """Put the children's summaries together and decide the exit code."""
    out: dict[str, Any] = {
        name: summaries.read_child(child.summary) for name, child in family.children.items()
    }
    out["reason"] = reason
    out["exit_code"] = 0
    if ended is not None:
        out["reason"] = ended.complaint or f"{ended.name} ended {how(ended)}"
        if ended.exit_code == UsageError.exit_code:
            raise UsageError(out["reason"])
        out["exit_code"] = TeleopError.exit_code if ended.exit_code else 0
    return out


def how(child: Child) -> str:
    """Return in what way a child ended."""
    code = child.exit_code or 0
    return f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
