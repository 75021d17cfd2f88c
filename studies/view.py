"""What a viewer does to the loops, and what an hour of viewing needs.

  python -m studies.view [--seconds 8] [--rounds 3]         both parts
  python -m studies.view --recording FILE [--minutes 60]    the second part, with a recording
  python -m studies.view --live CONFIG [--seconds 20]       processor time, memory of a live view

First one session runs while a viewer is, in turn, absent, there, opened and reloaded in a headless
Chromium (drawn by software, on the same processors, at the lowest priority), stopped (SIGSTOP) and
just killed, several times over; a recorder beside it tells the period of both loops and the way
from command to force in each state.

Then an hour of messages, ten seconds of that run again and again with stamps of their own, goes
through the view as fast as it can: memory of its process and of a page in a headless
Chromium, open from the start, and the size of its file. It is shown on the page and written to a
file at once, at the rates of the config. The first part takes 4 minutes, the second up to an hour.
"""

import math
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np

from studies.testbed import browser
from studies.testbed.command import parse_options
from studies.testbed.observed import ObservedSession
from studies.testbed.processes import (
    DEMO_CONFIG,
    START_S,
    Processes,
    read_memory_mb,
    read_processor_s,
    wait_for_condition,
)
from teleop.config import loading
from teleop.messages.topics import TOPICS
from teleop.recording.reader import open_recording, read_messages
from teleop.runtime.process import STANDBY_VARIABLE
from teleop.view.columns import AnyTopic, Rows, decode
from teleop.view.config import ViewConfig
from teleop.view.local_server import WEB_VIEW
from teleop.view.scene import Scene
from teleop.view.sinks import Sink

SETTLE_S = 3.0  # [s] after a change of state that are not counted
LOOPED_S = 10.0
HOUR_S = 3600.0
SAID_MIN = (0, 1, 5, 10, 15, 20, 30, 40, 50, 60)  # [min] of the hour


def main() -> None:
    options = parse_options(
        __doc__,
        seconds=(8.0, "of each state, or of the live view"),
        rounds=(3, "of all states"),
        recording=(Path, "measure the second part alone, with this recording"),
        minutes=(HOUR_S / 60, "of the second part"),
        live=(Path, "measure the view that `teleop run` starts with this config"),
    )
    if options.recording:
        measure_hour(options.recording, options.minutes)
        return
    with tempfile.TemporaryDirectory(prefix="view-benchmark-") as folder:
        if options.live:
            measure_live(Path(folder), options.live, options.seconds)
            return
        session = measure_states(Path(folder), options.seconds, options.rounds)
        session.report("viewer")
        measure_hour(session.recording(), options.minutes)


def measure_states(folder: Path, seconds: float, rounds: int) -> ObservedSession:
    """Run a session, with and without a viewer, and return it."""
    with ObservedSession(folder, seconds) as session:
        session.start_all()
        for _ in range(rounds):
            session.measure("off", SETTLE_S)
            viewer = session.start("view", "--view", "web")
            address = session.wait_for_line("view", WEB_VIEW).removeprefix(WEB_VIEW)
            session.measure("on", 2 * SETTLE_S)
            if browser.find_program() is not None:
                measure_page(f"{address}?renderer=webgl", session)
            viewer.send_signal(signal.SIGSTOP)
            session.measure("stopped", SETTLE_S)
            viewer.kill()
            session.measure("killed", SETTLE_S)
        session.stop("record", 60.0)
    return session


def measure_page(address: str, session: ObservedSession) -> None:
    """Open the page and load it again; each is measured from its first moment on."""
    with browser.Browser() as page:
        os.setpriority(os.PRIO_PGRP, page.pid, 19)
        for state in ("opened", "reloaded"):
            page.open(address)
            session.measure(state, 0.0)


def measure_hour(recording: Path, minutes: float) -> None:
    """Print memory and file size over an hour of messages."""
    view = loading.load(DEMO_CONFIG, ViewConfig, "view")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hour.rrd"
        with Sink("web", view, "hour", file, live=True) as sink, ExitStack() as stack:
            if sink.stream is None:
                raise RuntimeError("a web view has a stream")
            page = (
                None if browser.find_program() is None else stack.enter_context(browser.Browser())
            )
            if page is not None:
                os.setpriority(os.PRIO_PGRP, page.pid, 19)
                page.open(sink.lines[0].removeprefix(WEB_VIEW) + "?renderer=webgl")
            scene = Scene(view, sink.stream, sink.lay_out)
            begin, moments = time.monotonic(), list(SAID_MIN)
            print(f"view.server_memory_mb {view.server_memory_mb}; resident memory:")
            for passed_s, batch in repeat_recording(recording, 1 / view.curves_hz):
                if passed_s > 60 * minutes:
                    break
                scene.draw_pictures(batch)
                scene.draw_curves(batch)
                sink.publish()
                if moments and passed_s >= 60 * moments[0] - 1e-6:
                    minute, size = moments.pop(0), file.stat().st_size / 1e6
                    speed = passed_s / (time.monotonic() - begin)
                    print(
                        f"{minute:3} min: view {read_memory_mb(os.getpid()):4.0f} MB, "
                        f"page {read_page_mb(page):4.0f} MB; "
                        f"file {size:6.1f} MB, "
                        f"{size / max(minute, 1):.1f} MB a minute; {speed:.1f} times real time",
                        flush=True,
                    )
        measure_file_size(recording, view, Path(folder) / "minute.rrd")


def measure_file_size(recording: Path, view: ViewConfig, file: Path) -> None:
    """Print the size of a minute when only a file is written."""
    with Sink("rrd", view, "minute", file, live=True) as sink:
        if sink.stream is None:
            raise RuntimeError("a file has a stream")
        scene = Scene(view, sink.stream, sink.lay_out)
        for passed_s, batch in repeat_recording(recording, view.file_period_s):
            scene.send(batch)
            if passed_s >= 60:
                break
    print(f"--view rrd: {file.stat().st_size / 1e6:.1f} MB a minute")


def repeat_recording(
    recording: Path, period_s: float
) -> Iterator[tuple[float, dict[AnyTopic, Rows]]]:
    """Yield an hour in batches of `period_s`: ten seconds of a recording again and again."""
    by_name = {topic.name: topic for topic in TOPICS}
    end_ns = open_recording(recording).last_ns
    begin_ns = end_ns - round(2 * LOOPED_S * 1e9)  # with the sheaths, which come once a second
    messages = [
        (by_name[m.topic], m.data)
        for m in read_messages(str(recording), by_name.keys())
        if m.log_time_ns >= begin_ns
    ]
    whole = decode(messages)
    last = max(int(rows["stamp_ns"][-1]) for rows in whole.values())
    period_ns = round(period_s * 1e9)
    edges = last - round(LOOPED_S * 1e9) + np.arange(round(LOOPED_S / period_s) + 1) * period_ns
    pieces = [
        {
            topic: rows[(rows["stamp_ns"] >= low) & (rows["stamp_ns"] < high)]
            for topic, rows in whole.items()
        }
        for low, high in pairwise(edges)
    ]
    for turn in range(round(HOUR_S / LOOPED_S)):
        for k, piece in enumerate(pieces):
            batch = {topic: rows.copy() for topic, rows in piece.items() if len(rows)}
            for rows in batch.values():
                rows["stamp_ns"] += round(turn * LOOPED_S * 1e9)
            yield turn * LOOPED_S + (k + 1) * period_s, batch


def measure_live(folder: Path, file: Path, seconds: float) -> None:
    """Print processor time and memory of the view that `teleop run` starts, and of its spare."""
    with Processes(folder, file) as session:
        launcher = session.start("run", "--view", "web")
        with session.look() as link:
            if not wait_for_condition(lambda: session.engaged(link), START_S):
                raise SystemExit("the session did not engage")
        time.sleep(5 * SETTLE_S)  # the periods settle
        views = [pid for pid in list_children(launcher.pid) if b"\0view\0" in read_words(pid)]
        before, begin = [read_processor_s(pid) for pid in views], time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - begin
        load = os.getloadavg()[0]
        print(f"{file.name}, {seconds:g} s, load {load:.1f}: share of a core, resident and own MB")
        for pid, earlier in zip(views, before, strict=True):
            spare = STANDBY_VARIABLE.encode() in Path(f"/proc/{pid}/environ").read_bytes()
            name = "its spare" if spare else "view"
            share = (read_processor_s(pid) - earlier) / passed
            print(f"{name:14} {share:5.2f} {read_memory_mb(pid):6.0f} {read_private_mb(pid):6.0f}")
        session.stop("run")


def list_children(parent: int) -> list[int]:
    """Return the process ids of a process's children."""
    files = Path(f"/proc/{parent}/task").glob("*/children")
    return [int(pid) for file in files for pid in file.read_text().split()]


def read_words(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def read_private_mb(pid: int) -> float:
    """Return the memory that a process shares with no other [MB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) / 1e3


def read_page_mb(page: browser.Browser | None) -> float:
    """Return the resident memory of the largest process that draws pages [MB]; NaN if none."""
    if page is None:
        return math.nan
    drawing = [pid for pid in list_descendants(page.pid) if b"--type=renderer" in read_words(pid)]
    return max(map(read_memory_mb, drawing), default=math.nan)


def list_descendants(parent: int) -> list[int]:
    """Return the process ids of a process's children, of theirs, and so on."""
    return [pid for child in list_children(parent) for pid in (child, *list_descendants(child))]


if __name__ == "__main__":
    main()
