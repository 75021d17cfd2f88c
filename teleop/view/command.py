"""Show the tension along the sheath, live or from a recording.

Without FILE it listens to a running session, in a window, or in a browser where there is no screen:

    teleop view                                    the session on this machine
    teleop view --view web                         in a browser, address on the first line
    teleop view recordings/demo.mcap               a recording
    teleop view recordings/demo.mcap --view demo.rrd    into a Rerun file
    teleop view demo.rrd                           a Rerun file
    teleop view recordings/demo.mcap --out clip.mp4 --from 3 --to 9     a video, for slides
    teleop view recordings/demo.mcap --out clip.gif --theme dark        an animation
    teleop view recordings/demo.mcap --out moment.png --to 4.2          a picture of a moment
    teleop view --foxglove --view none             for the Foxglove app: docs/how-to/ros.md

It only listens: neither loop ever waits for it. See docs/how-to/record-and-view.md.
"""

import argparse
import contextlib
import math
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from teleop.config.loading import RECORDING_SUFFIX
from teleop.config.options import ViewMode, add_options
from teleop.errors import TeleopError, UsageError
from teleop.link import Link, ReceivedMessage
from teleop.messages.topics import TOPICS, Role
from teleop.recording.reader import open_recording
from teleop.recording.replay_to_link import adopt_config, print_doubts, require_present_layout
from teleop.runtime.files import find_state_folder
from teleop.runtime.output_file import OutputFile
from teleop.runtime.process import (
    StopCondition,
    has_display,
    is_supervised,
    lower_priority,
    print_warning,
    wait_in_standby,
    write_summary,
)
from teleop.session.config import RunConfig, read_config
from teleop.view import clip
from teleop.view.config import LAYOUTS, ViewConfig
from teleop.view.feed import BatchDisplay, FeedCounts, show_recording, show_session
from teleop.view.foxglove_server import FoxgloveServer
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from teleop.view.space_arm import SpaceArm, load_arms

# --- what Rerun's runtime writes to the standard error stream goes to a file, not to the terminal
# Its lines (a dropped connection, a slow flush) come from native code, straight to file descriptor
# 2, and tell a user of the session nothing that our own messages do not say.


_STDERR = 2
_SIZE_MAX = 1_000_000  # [bytes] after which the file begins anew


def find_log_path(session: str) -> Path:
    """Return the file for a session: in the user's state folder (XDG base directories)."""
    return find_state_folder() / "tendon-teleop" / f"view-{session}.log"


@contextlib.contextmanager
def divert_stderr(path: Path) -> Iterator[Path]:
    """Send file descriptor 2 to the end of `path` in this context; yields the file in use.

    `sys.stderr` keeps writing to where it did. Where no folder can be made, the file is in that of
    temporary files.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError:
        path = Path(tempfile.gettempdir()) / f"{os.getuid()}-{path.name}"
    if path.exists() and path.stat().st_size > _SIZE_MAX:
        path.unlink()
    sys.stderr.flush()
    terminal, python_stream = os.dup(_STDERR), sys.stderr
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
    try:
        os.dup2(log, _STDERR)
        if python_stream is sys.__stderr__:
            sys.stderr = os.fdopen(os.dup(terminal), "w", buffering=1)
        yield path
    finally:
        if sys.stderr is not python_stream:
            sys.stderr.close()
            sys.stderr = python_stream
        os.dup2(terminal, _STDERR)
        os.close(terminal)
        os.close(log)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "file",
        nargs="?",
        metavar="FILE",
        help="a recording (.mcap) or a Rerun file (.rrd); none = live",
    )
    add_options(
        parser, "--session", "--config", "--set", "--insecure", "--view", "--duration", "--json"
    )
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        help="surgeon, experiment or presentation layout (default view.layout of the config)",
    )
    parser.add_argument(
        "--out",
        type=OutputFile(".rrd", *clip.SUFFIXES),
        metavar="FILE",
        help="write a Rerun file (.rrd), beside any other view; or draw a recording, without a "
        "screen, as a video (.mp4), an animation (.gif) or a picture (.png)",
    )
    parser.add_argument(
        "--foxglove", action="store_true", help="serve the live messages to the Foxglove app too"
    )
    clip.add_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code."""
    if args.file is not None and Path(args.file).suffix == RECORDING_SUFFIX:
        adopt_config(args, Path(args.file))
    document = read_config(args, join=args.file is None)
    run, config = document.load(RunConfig), document.load(ViewConfig, "view")
    foxglove = args.foxglove or config.foxglove
    if args.out is not None and args.out.suffix.lower() in clip.SUFFIXES:
        arms = load_arms(document, run.arms)
        return _write_clip(args, replace(config, layout=args.layout or config.layout), arms)
    clip.refuse_options(args)
    config = replace(config, layout=args.layout or config.layout, foxglove=foxglove)
    mode, out = choose_destination(args.view, args.out)
    saved = args.file is not None and Path(args.file).suffix == ".rrd"
    if saved:
        require_viewer(args.file, mode, out)
    elif args.file is not None:
        if Path(args.file).suffix in (".yaml", ".yml"):
            raise UsageError(f"{args.file}: is a config; teleop view --config {args.file}")
        info = open_recording(args.file)
        require_present_layout(info)
        print_doubts(info)
    arms = () if saved else load_arms(document, run.arms)
    if not wait_in_standby():
        return 0
    stop = StopCondition(args.duration)
    name = Path(args.file).stem if args.file else run.session
    with divert_stderr(find_log_path(run.session)) as log:
        if saved:
            with Sink(mode, config, name, None, live=False, saved=Path(args.file)) as sink:
                _print_lines(sink)
                _wait_for_viewer(sink, stop)
            return 0
        summary: dict[str, Any] = {
            "session": run.session,
            "view": mode,
            "source": args.file or "link",
        }
        with Sink(mode, config, name, out, live=args.file is None, arms=len(arms)) as sink:
            fed = _feed_sink(args.file, run, config, arms, sink, stop, summary)
            if fed.fault and is_supervised():
                _exit_with_error(f"{fed.fault} (what its runtime wrote: {log})")
    summary |= {"received": fed.received, "shown": fed.shown, "reason": stop.reason}
    summary["file"] = None if sink.file is None else str(sink.file)
    write_summary(args.json, summary)
    if fed.fault:
        raise TeleopError(f"{fed.fault} (what its runtime wrote: {log})")
    if not is_supervised():
        print(f"View ended ({stop.reason}): {fed.received} messages, {fed.shown} shown", flush=True)
    return 0


def _write_clip(args: argparse.Namespace, config: ViewConfig, arms: tuple[SpaceArm, ...]) -> int:
    """Draw a recording into a file; returns the exit code."""
    if args.file is None or Path(args.file).suffix != RECORDING_SUFFIX:
        raise UsageError(
            f"--out {args.out}: is drawn from a recording: teleop view RECORDING.mcap --out ..."
        )
    if args.view not in (None, "none") or args.foxglove:
        raise UsageError(f"--out {args.out}: is drawn without a view; leave out --view, --foxglove")
    options = clip.get_options(args)
    info = open_recording(args.file)
    require_present_layout(info)
    print_doubts(info)
    lower_priority()
    written = clip.write_clip(args.out, info, config, options, arms)
    write_summary(args.json, {"source": args.file, "view": "clip", "file": str(args.out)})
    print(f"wrote {written}")
    return 0


def _exit_with_error(complaint: str) -> None:
    """End without closing what does not answer, which takes seconds: the launcher starts anew."""
    print(f"teleop: {complaint}", file=sys.stderr, flush=True)
    os._exit(TeleopError.exit_code)


def choose_destination(
    view: ViewMode | Path | None, out: Path | None
) -> tuple[ViewMode, Path | None]:
    """Return the mode and the file to write from `--view` and `--out`."""
    if isinstance(view, Path):
        if out is not None:
            raise UsageError(f"--view {view} and --out {out}: name the file once")
        return "rrd", view
    return view or ("native" if has_display() else "web"), out


def require_viewer(file: str, mode: ViewMode, out: Path | None) -> None:
    """Check that a Rerun file is to be looked at, and holds a recording, cut off or not."""
    if mode not in ("native", "web") or out is not None:
        raise UsageError(f"{file}: is a Rerun file already; --view native or web shows it")
    if Path(file).exists() and not Path(file).is_file():
        raise UsageError(f"{file}: is not a file")
    try:
        with Path(file).open("rb") as content:
            begin = content.read(4)
    except OSError as error:
        raise UsageError(f"{file}: cannot be read: {error.strerror}") from error
    if begin[:2] != b"RR":
        raise UsageError(
            f"{file}: is no Rerun file; `teleop view RECORDING.mcap` shows a recording"
        )
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings(action="ignore"):  # files of a view have no footer
            recordings = RrdReader(file).recordings()
    except RuntimeError as error:
        reason = " ".join(str(error).split()).rpartition(f"{file}: ")[2]
        if "exceeds file size" not in reason:  # the view was killed: what is whole is shown
            raise UsageError(f"{file}: is damaged: {reason}") from error
        print_warning(f"{file}: is truncated; what is whole is shown")
    else:
        if not recordings:
            raise UsageError(f"{file}: holds no recording")


def _print_lines(sink: Sink) -> None:
    for line in sink.lines:
        print(line, flush=True)


def _wait_for_viewer(sink: Sink, stop: StopCondition) -> None:
    """Wait until the viewer is closed, or we are told to stop."""
    print("recording loaded; Ctrl-C ends the view", flush=True)
    while not stop() and sink.is_alive():
        time.sleep(0.1)


def _feed_sink(
    file: str | None,
    run: RunConfig,
    config: ViewConfig,
    arms: tuple[SpaceArm, ...],
    sink: Sink,
    stop: StopCondition,
    summary: dict[str, Any],
) -> FeedCounts:
    """Feed an open sink from a recording or the link; adds the link's losses to `summary`."""
    show = BatchDisplay()
    if sink.stream is not None:
        whole = sink.file is not None
        live = file is None and not whole
        scene = Scene(config, sink.stream, sink.lay_out, everything=whole, live=live, arms=arms)
        show = scene
        if file is None:
            sink.follow(lambda: scene.newest_ns, scene.show_panel)
    _print_lines(sink)
    lower_priority()  # not before: after a failure the view must be back soon
    if file is not None:
        fed = show_recording(file, show, stop, config.file_period_s, sink.publish)
        if sink.watched:
            _wait_for_viewer(sink, stop)
        stop.request("the recording is shown")
        return fed

    def has_ended() -> bool:
        return not any(map(link.is_present, (Role.MASTER, Role.SLAVE)))

    with ExitStack() as stack:
        sampled = frozenset() if config.foxglove else config.list_sampled_topics()
        link = stack.enter_context(Link(run.link, run.session, Role.VIEWER))
        listener = link.listen(TOPICS, sampled)
        if not is_supervised() and has_ended():
            print(f"Waiting for session {run.session!r} (`teleop sessions` lists those that run)")
        drain: Callable[[], list[ReceivedMessage]] = listener.drain
        if config.foxglove:
            server = stack.enter_context(FoxgloveServer(run.session, config.foxglove_port))
            print(f"Foxglove view: {server.url}", flush=True)
            drain = partial(server.forward, listener.drain)
        share = config.processor_share if sink.watched else math.inf
        periods_s = (config.file_period_s,) * 2
        if sink.watched:
            periods_s = 1.0 / config.drain_hz, 1.0 / config.curves_hz
        fed = show_session(drain, show, sink, stop, config.drain_hz, periods_s, share, has_ended)
        counts = {topic: listener.count_messages(topic) for topic in TOPICS}
        summary["lost"] = {
            topic.name: c.lost + (0 if topic in sampled else c.overwritten)
            for topic, c in counts.items()
        }
        summary["rejected"] = {topic.name: c.rejected for topic, c in counts.items()}
    return fed
