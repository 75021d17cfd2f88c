"""Show the tension along the sheath, live or from a recording.

Without FILE it listens to a running session, in a window, or in a browser where there is no screen:

    teleop view                                    the session on this machine
    teleop view --view web                         in a browser, address on the first line
    teleop view recordings/demo.mcap               a recording
    teleop view recordings/demo.mcap --view rrd --out demo.rrd

It only listens: neither loop ever waits for it. See docs/viewing.md.
"""

import argparse
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from teleop.errors import TeleopError
from teleop.link import Link
from teleop.options import ViewMode, add_options
from teleop.process import Stop, has_display, let_loops_first, supervised, write_summary
from teleop.recording.reader import open_recording
from teleop.recording.replay import require_playable
from teleop.run_config import load_section
from teleop.topics import TOPICS, Role
from teleop.view.config import LAYOUTS, ViewConfig
from teleop.view.feed import Discard, FeedCounts, Show, from_link, from_recording
from teleop.view.scene import Scene
from teleop.view.sinks import Sink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("file", nargs="?", metavar="FILE", help="a recording (.mcap); none = live")
    add_options(parser, "--config", "--set", "--view", "--duration", "--json")
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        help="surgeon, experiment or presentation layout (default view.layout of the config)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.rrd", help="write a Rerun file, beside any other view"
    )


def main(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code."""
    run, config = load_section(args, ViewConfig, "view")
    config = replace(config, layout=args.layout or config.layout)
    mode: ViewMode = args.view or ("native" if has_display() else "web")
    if args.file is not None:
        require_playable(open_recording(args.file))
    let_loops_first()
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
