"""Record a session to a file: every message of every topic, as it crossed the link.

  teleop record                                      the session of the defaults, until Ctrl-C
  teleop record --config configs/demo.yaml --out /data/bench --duration 60

The recorder only listens: it may start at any time, be slow, or be killed, without effect on the
loops. The file (MCAP) opens in Foxglove, PlotJuggler, Rerun and Python: see
docs/how-to/record-and-view.md.
"""

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from estimator.kinematics.urdf import URDF_BYTES_MAX
from teleop.config.loading import ConfigDocument
from teleop.config.options import add_options
from teleop.errors import TeleopError, UsageError
from teleop.link import Link
from teleop.messages.topics import TOPICS, Role
from teleop.recording.recorder import BATCH, GRACE_NS, Recorder
from teleop.recording.scan import describe_losses
from teleop.recording.writer import RecordConfig, RecordingWriter
from teleop.runtime.clock import now_ns
from teleop.runtime.files import read_small_file
from teleop.runtime.output_file import SharedFolder
from teleop.runtime.process import STATUS, StopCondition, is_supervised, write_summary
from teleop.runtime.realtime import limit_computing_time, share_heaps
from teleop.runtime.status_line import StatusLine
from teleop.session.config import RunConfig, read_config

# --- processor time for the recorder: enough on a loaded machine, and after the loops

FALLBACK_NICE = -5  # where real-time scheduling is not allowed, but this is


def request_priority(priority: int) -> list[str]:
    """Let this process go before ordinary programs; return what was granted.

    Called before the link is opened: its threads inherit the priority. At SCHED_RR below that of
    the loops the recorder waits for them, and for nothing else: four programs computing at nice 0
    on two cores otherwise leave it a seventh of one, and messages are lost that it had no time to
    receive. Where nothing is allowed, the loops run at ordinary priority too, and go first.

    `priority` is of SCHED_RR, from 1; 0 = ordinary scheduling, after the loops.
    """
    share_heaps()
    if priority:
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
            return [f"SCHED_RR {priority}"]
        with suppress(OSError):
            os.nice(FALLBACK_NICE - os.nice(0))
            return [f"nice {os.nice(0)}"]
    os.nice(5)
    return ["no priority (see `teleop doctor`)"] if priority else []


# --- what a recorder tells while it runs: how far it is behind, and what is missing

STATUS_PERIOD_NS = 500_000_000  # between two messages to the launcher
# lag that is told, and when it is over
LAG_WARNING_NS, LAG_RECOVERED_NS = 1_000_000_000, 200_000_000
DRAINING_NS = 1_000_000_000  # between two lines at the end


class RecordingProgress:
    """Shows a recorder's status: in its terminal, or through the launcher.

    A lag above `LAG_WARNING_NS`, its end, and the first missing message are lines that stay.
    """

    def __init__(self, status: StatusLine) -> None:
        self._status = status
        self._shown_ns = self._told_ns = 0
        self._is_behind, self._is_missing = False, False

    def show(self, now_ns: int, lag_ns: int, missing: int, draining: bool) -> None:
        """Show the present status, at intervals."""
        text = format_status(lag_ns, missing)
        if now_ns - self._shown_ns >= STATUS_PERIOD_NS:
            self._shown_ns = now_ns
            if is_supervised():
                print(f"{STATUS}{text}", flush=True)
            else:
                self._status.show(text)
        if draining and lag_ns and now_ns - self._told_ns >= DRAINING_NS:
            self._told_ns = now_ns
            self._say(f"writing what has come: {lag_ns * 1e-9:.1f} s behind")
        if lag_ns > LAG_WARNING_NS and not self._is_behind and not draining:
            self._is_behind = True
            self._say(f"{text}: the disk or the processor is too slow; it keeps at most 10 s")
        elif lag_ns < LAG_RECOVERED_NS and self._is_behind:
            self._is_behind = False
            self._say("caught up")
        if missing and not self._is_missing:
            self._is_missing = True
            self._say(f"{missing} messages missing so far; the summary counts them by topic")

    def clear(self) -> None:
        """Remove the status line."""
        self._status.clear()

    def _say(self, text: str) -> None:
        self._status.say(text if is_supervised() else f"recorder: {text}")


def format_status(lag_ns: int, missing: int) -> str:
    """Return the status of a recorder in words."""
    lack = f", {missing} missing" if missing else ""
    return f"recorder {lag_ns * 1e-9:.1f} s behind{lack}"


SUPERVISED_GRACE_NS = 3_000_000_000  # the launcher stops us last: the sides have left, or soon will
# Each message that arrives needs the interpreter. While a batch is written, 180 a second get it at
# Python's 5 ms, 880 at this (measured on a loaded machine); so between two batches of a backlog
# there is a pause in which as many arrive as are written.
_SWITCH_S = 0.0001
_YIELD_S = 0.005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop record`."""
    add_options(parser, "--session", "--config", "--set", "--insecure", "--duration", "--json")
    parser.add_argument(
        "--out", type=SharedFolder(), metavar="DIR", help="record into DIR (default recordings)"
    )


def collect_files(document: ConfigDocument) -> dict[str, bytes]:
    """Return the descriptions of arms that a config names, by key, as far as they can be read."""
    files: dict[str, bytes] = {}

    def visit(node: Any, keys: tuple[str, ...]) -> None:
        if keys[-1:] == ("urdf",) and isinstance(node, str) and node:
            with suppress(OSError, UsageError):  # which the processes that need it say
                path = document.resolve_path(node, keys)
                files[".".join(keys)] = read_small_file(path, URDF_BYTES_MAX)
        pairs = enumerate(node) if isinstance(node, list) else node
        pairs = node.items() if isinstance(node, dict) else pairs
        for key, item in pairs if isinstance(node, dict | list) else ():
            visit(item, (*keys, str(key)))

    visit(document.tree, ())
    return files


def main(args: argparse.Namespace) -> int:
    """Record until told to stop; returns the exit code."""
    document = read_config(args)
    run, config = document.load(RunConfig), document.load(RecordConfig, "record")
    if args.out:
        config = dataclasses.replace(config, directory=str(args.out))
    overrides = [each.text for each in (*document.recorded, *document.overrides)]
    granted = request_priority(config.priority)
    sys.setswitchinterval(_SWITCH_S)
    stop = StopCondition(args.duration)
    with Link(run.link, run.session, Role.RECORDER) as link:
        listener = link.listen(TOPICS)
        writer = RecordingWriter(
            *(config, run.session, now_ns(), document.text, overrides, link.insecure),
            files=collect_files(document),
        )
        if link.warning:
            print(link.warning, flush=True)
        print(f"recording session {run.session!r} to {writer.path}", flush=True)
        limit_computing_time(granted)
        recorder = Recorder(listener, writer, link.is_present)
        progress = RecordingProgress(StatusLine())
        missing = 0
        try:
            with writer:
                _record_until_stopped(recorder, writer, progress, stop, config.drain_s)
                missing = recorder.finish()
        finally:
            progress.clear()
            summary = build_summary(writer) | {"scheduling": granted}
            write_summary(args.json, summary)
            if not is_supervised():
                print("\n".join(format_summary(summary)))
    if missing or writer.unfinished:
        raise TeleopError(f"{writer.path}: {_join_losses(summary)}")
    return 0


def _record_until_stopped(
    recorder: Recorder,
    writer: RecordingWriter,
    progress: RecordingProgress,
    stop: StopCondition,
    pause_s: float,
) -> None:
    """Record until told to stop, then until everything that counts is written, however long."""
    grace_ns = SUPERVISED_GRACE_NS if is_supervised() else GRACE_NS
    stop_ns = 0
    while not stop_ns or not recorder.is_done(stop_ns, now_ns(), grace_ns):
        if stop() and not stop_ns:
            stop_ns = now_ns()
        written = recorder.step(now_ns)
        progress.show(now_ns(), recorder.lag_ns, writer.gaps.total, draining=stop_ns > 0)
        time.sleep(_YIELD_S if written == BATCH else pause_s)


def build_summary(writer: RecordingWriter) -> dict[str, Any]:
    """Return the summary as a tree."""
    return {
        "file": str(writer.path),
        "seconds": (writer.last_ns - writer.first_ns) * 1e-9,
        "messages": dict(writer.messages),
        "gaps": writer.gaps.count_by_topic(),
        "dropped": dict(writer.dropped),
        "missing": writer.gaps.total,
        "unfinished": list(writer.unfinished),
        "lag_max_s": writer.lag_max_s,
        "bytes": writer.bytes_written,
    }


def _join_losses(summary: Mapping[str, Any]) -> str:
    return "; ".join(describe_losses(summary["gaps"], summary["unfinished"]))


def format_summary(summary: dict[str, Any]) -> list[str]:
    """Return the summary as text."""
    size_MB, seconds = summary["bytes"] / 1e6, summary["seconds"]
    out = [f"recorded {Path(summary['file'])}: {seconds:.1f} s, {size_MB:.1f} MB"]
    for topic, count in summary["messages"].items():
        lost = summary["gaps"][topic]
        rate = f"{(count - 1) / seconds:7.1f}/s" if seconds > 0 else ""
        out.append(f"  {topic:10} {count:9} messages {rate}" + (f", {lost} lost" if lost else ""))
    if summary["dropped"]:
        dropped = ", ".join(f"{count} {topic}" for topic, count in summary["dropped"].items())
        out.append(f"  dropped because the recorder was too slow: {dropped}; use a faster disk")
    if lack := _join_losses(summary):
        out.append(f"  {lack}")
    if not summary["messages"]:
        out.append("  no messages in this session")
    return out
