"""Show the tension along the sheath, live or from a recording.

Without FILE it listens to a running session, in a window, or in a browser where there is no screen:

    teleop view                                    the session on this machine
    teleop view --view web                         in a browser, address on the first line
    teleop view recordings/demo.mcap               a recording
    teleop view recordings/demo.mcap --view rrd --out demo.rrd

It only listens: neither loop ever waits for it. See docs/viewing.md.
"""

import argparse
import os
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from teleop import config as configuration
from teleop.errors import TeleopError
from teleop.link import Link
from teleop.process import (
    Stop,
    destination,
    has_display,
    seconds,
    supervised,
    write_summary,
)
from teleop.recording.reader import open_recording
from teleop.recording.replay import require_playable
from teleop.run_config import RunConfig
from teleop.topics import TOPICS, Role
from teleop.view.config import LAYOUTS, ViewConfig
from teleop.view.feed import Discard, FeedCounts, Show, from_link, from_recording
from teleop.view.scene import Scene
from teleop.view.sinks import MODES, Mode, Sink

_NICENESS = 5  # on a shared processor the loops have priority


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("file", nargs="?", metavar="FILE", help="a recording (.mcap); none = live")
    configuration.add_arguments(parser)
    parser.add_argument(
        "--view",
        choices=MODES,
        help=(
            "window, web page on this machine, Rerun file, or nothing (default: native with a "
            "screen, web without)"
        ),
    )
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        help="surgeon, experiment or presentation layout (default: view.layout of the config)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.rrd", help="write a Rerun file, beside any other view"
    )
    parser.add_argument("--duration", type=seconds, metavar="S", help="stop after S seconds")
    parser.add_argument(
        "--json", type=destination, metavar="FILE", help="write the summary to FILE"
    )


def main(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code."""
    config = configuration.load(args.config, ViewConfig, "view", args.overrides)
    config = replace(config, layout=args.layout or config.layout)
    run = configuration.load(args.config, RunConfig, None, args.overrides)
    mode: Mode = args.view or ("native" if has_display() else "web")
    if args.file is not None:
        require_playable(open_recording(args.file))
    os.nice(_NICENESS)
    stop = Stop(args.duration)
    name = Path(args.file).stem if args.file else run.session
    summary: dict[str, Any] = {"session": run.session, "view": mode, "source": args.file or "link"}
    with ExitStack() as stack:
        sink = stack.enter_context(Sink(mode, config, name, args.out, live=args.file is None))
        show: Show = Discard()
        if sink.stream is not None:
            show = Scene(config, sink.stream, sink.lay_out)
        for line in sink.lines:
            print(line, flush=True)
        if args.file is not None:
            fed = _show_recording(args.file, config, show, sink, stop)
        else:
            link = stack.enter_context(Link(run.link, run.session, Role.VIEWER))
            listener = link.listen(TOPICS)
            fed = from_link(listener, show, sink, stop, config.drain_hz, periods(sink, config))
            counts = {topic.name: listener.counts(topic) for topic in TOPICS}
            summary["lost"] = {topic: c.lost + c.overwritten for topic, c in counts.items()}
            summary["rejected"] = {topic: c.rejected for topic, c in counts.items()}
    summary |= {"received": fed.received, "shown": fed.shown, "reason": stop.reason}
    summary["file"] = None if sink.file is None else str(sink.file)
    write_summary(args.json, summary)
    if fed.fault:
        raise TeleopError(fed.fault)
    if not supervised():
        print(f"View ended ({stop.reason}): {fed.received} messages, {fed.shown} shown", flush=True)
    return 0


def _show_recording(
    path: str, config: ViewConfig, show: Show, sink: Sink, stop: Stop
) -> FeedCounts:
    """Show a recording, and wait until the viewer is closed."""
    fed = from_recording(path, show, stop, config.file_period_s)
    if sink.watched:
        print("recording loaded; Ctrl-C ends the view", flush=True)
        while not stop() and sink.alive():
            time.sleep(0.1)
    stop.request("the recording is shown")
    return fed


def periods(sink: Sink, config: ViewConfig) -> tuple[float, float]:
    """Return the periods [s] of scene updates and of curves."""
    if sink.watched:
        return 0.0, 1.0 / config.curves_hz
    return config.file_period_s, config.file_period_s
