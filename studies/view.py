"""What a viewer does to the loops, and what an hour of viewing needs.

  python studies/view.py [SECONDS [ROUNDS]]     both parts; 8 s of each state, 3 rounds
  python studies/view.py FILE.mcap [MINUTES]    the second part, with a recording; 60 minutes
  python studies/view.py CONFIG.yaml [SECONDS]  processor time and memory of a live view

First one session runs while a viewer is, in turn, absent, there, opened and reloaded in a headless
Chromium (drawn by software, on the same processors, at the lowest priority), stopped (SIGSTOP) and
just killed, several times over; a recorder beside it tells the period of both loops and the way
from command to force in each state. The states take turns in one run, so all meet the same machine.

Then an hour of messages, ten seconds of that run again and again with stamps of their own, goes
through the view as fast as it can: memory of its process and of a page in a headless
Chromium, open from the start, and the size of its file. It is shown on the page and written to a
file at once, at the rates of the config.
"""

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from studies.testbed import browser
from studies.testbed.processes import processor_s, resident_mb
from teleop.config import loading
from teleop.link import Link
from teleop.messages.topics import STATE, TOPICS, Role
from teleop.recording.reader import open_recording, read_columns, read_messages
from teleop.runtime.clock import now_ns
from teleop.runtime.process import STANDBY_VARIABLE
from teleop.session.config import RunConfig
from teleop.session.state_machine import State
from teleop.view.columns import AnyTopic, Rows, decode
from teleop.view.config import ViewConfig
from teleop.view.local_server import WEB_VIEW, find_free_port
from teleop.view.scene import Scene
from teleop.view.sinks import Sink

CONFIG = Path(__file__).parents[1] / "configs" / "demo.yaml"
ENGAGED_S = 180.0  # [s] in which both sides must have compiled and engaged
SETTLE_S = 3.0  # [s] after a change of state that are not counted
LOOPED_S = 10.0
HOUR_S = 3600.0
SAID_MIN = (0, 1, 5, 10, 15, 20, 30, 40, 50, 60)  # [min] of the hour
Spans = dict[str, list[tuple[int, int]]]


def main(*words: str) -> None:
    if words and words[0].endswith(".mcap"):
        hour(Path(words[0]), float(words[1]) if len(words) > 1 else HOUR_S / 60)
        return
    if words and words[0].endswith(".yaml"):
        processes(Path(words[0]), float(words[1]) if len(words) > 1 else 20.0)
        return
    seconds, rounds = (*map(float, words), *(8.0, 3.0)[len(words) :])
    with tempfile.TemporaryDirectory(prefix="view-benchmark-") as folder:
        recording, spans = session(Path(folder), seconds, int(rounds))
        report(recording, spans)
        hour(recording)


def session(folder: Path, seconds: float, rounds: int) -> tuple[Path, Spans]:
    """Run a session, with and without a viewer; return its recording and when was what."""
    shared = ["--config", str(CONFIG), "--set", "session=view-benchmark"]
    for side in ("master", "slave"):
        shared += ["--set", f"link.{side}=127.0.0.1:{find_free_port(0)}"]
    looked = [] if browser.program() is None else ["opened", "reloaded"]
    spans: Spans = {state: [] for state in ("off", "on", *looked, "stopped", "killed")}

    with ExitStack() as stack:

        def start(command: str, *arguments: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [sys.executable, "-m", "teleop", command, *shared, *arguments],
                stdout=subprocess.PIPE if command == "view" else subprocess.DEVNULL,
                stderr=subprocess.STDOUT,
            )
            stack.callback(end, process)
            return process

        def address_of(viewer: subprocess.Popen[bytes]) -> str:
            assert viewer.stdout is not None  # noqa: S101 - a pipe, above
            words = next(line for line in viewer.stdout if line.startswith(WEB_VIEW.encode()))
            return words.decode().removeprefix(WEB_VIEW).strip()

        def measured(state: str, settle_s: float = SETTLE_S) -> None:
            time.sleep(settle_s)
            begin = now_ns()
            time.sleep(seconds)
            spans[state].append((begin, now_ns()))

        start("record", "--out", str(folder))
        start("slave")
        start("master")
        wait_until_engaged(shared[3::2])
        for _ in range(rounds):
            measured("off")
            viewer = start("view", "--view", "web")
            address = address_of(viewer)
            time.sleep(SETTLE_S)
            measured("on")
            if looked:
                look(f"{address}?renderer=webgl", measured)
            viewer.send_signal(signal.SIGSTOP)
            measured("stopped")
            viewer.kill()
            measured("killed")
    (path,) = folder.glob("*.mcap")
    return path, spans


def look(address: str, measured: Callable[[str, float], None]) -> None:
    """Open the page and load it again; each is measured from its first moment on."""
    with browser.Browser() as page:
        os.setpriority(os.PRIO_PGRP, page.pid, 19)
        for state in ("opened", "reloaded"):
            page.open(address)
            measured(state, 0.0)


def wait_until_engaged(overrides: list[str], file: Path = CONFIG) -> None:
    run = loading.load(file, RunConfig, None, overrides)
    patience = time.monotonic() + ENGAGED_S
    with Link(run.link, run.session, Role.VIEWER) as link:
        listener = link.listen([STATE])
        while time.monotonic() < patience:
            time.sleep(0.1)
            states = [STATE.message.unpack(heard.data).state for heard in listener.drain()]
            if State.ENGAGED in states:
                return
    raise SystemExit("the session did not engage")


def end(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(15)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def report(recording: Path, spans: Spans, listener: str = "viewer") -> None:
    """Print period and latency in each state of a listener; NaN where there were none."""
    hand = read_columns(recording, "hand", ["stamp_ns", "round_trip_ns"])
    slave = read_columns(recording, "state", ["stamp_ns"])
    table: list[tuple[str, NDArray[np.int64], Callable[[NDArray[np.bool_]], NDArray[np.int64]]]]
    table = [
        ("master, period", hand["stamp_ns"], lambda inside: np.diff(hand["stamp_ns"][inside])),
        ("slave, period", slave["stamp_ns"], lambda inside: np.diff(slave["stamp_ns"][inside])),
        ("command to force", hand["stamp_ns"], lambda inside: hand["round_trip_ns"][inside]),
    ]
    print(f"{'[ms]':18}{listener:>9}{'p50':>8}{'p99':>8}{'p99.9':>8}   each round's p99")
    for name, stamps, values in table:
        for state, times in spans.items():
            rounds = [values((stamps >= begin) & (stamps < end)) for begin, end in times]
            rounds = [some[some > 0] for some in rounds]
            p50, p99, p999 = percentiles_ms(np.concatenate(rounds))
            each = "  ".join(f"{percentiles_ms(some)[1]:.2f}" for some in rounds)
            print(f"{name:18}{state:>9}{p50:8.3f}{p99:8.3f}{p999:8.3f}   {each}")


def percentiles_ms(values_ns: NDArray[np.int64]) -> tuple[float, float, float]:
    if not len(values_ns):  # as no command comes back in a session that is held up
        return math.nan, math.nan, math.nan
    p50, p99, p999 = np.percentile(values_ns, [50, 99, 99.9]) * 1e-6
    return float(p50), float(p99), float(p999)


def hour(recording: Path, minutes: float = HOUR_S / 60) -> None:
    """Print memory and file size over an hour of messages."""
    view = loading.load(CONFIG, ViewConfig, "view")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hour.rrd"
        with Sink("web", view, "hour", file, live=True) as sink, ExitStack() as stack:
            if sink.stream is None:
                raise RuntimeError("a web view has a stream")
            page = None if browser.program() is None else stack.enter_context(browser.Browser())
            if page is not None:
                os.setpriority(os.PRIO_PGRP, page.pid, 19)
                page.open(sink.lines[0].removeprefix(WEB_VIEW) + "?renderer=webgl")
            scene = Scene(view, sink.stream, sink.lay_out)
            begin, moments = time.monotonic(), list(SAID_MIN)
            print(f"view.server_memory_mb {view.server_memory_mb}; resident memory:")
            for passed_s, batch in looped(recording, 1 / view.curves_hz):
                if passed_s > 60 * minutes:
                    break
                scene.pictures(batch)
                scene.curves(batch)
                sink.publish()
                if moments and passed_s >= 60 * moments[0] - 1e-6:
                    minute, size = moments.pop(0), file.stat().st_size / 1e6
                    speed = passed_s / (time.monotonic() - begin)
                    print(
                        f"{minute:3} min: view {resident_mb(os.getpid()):4.0f} MB, "
                        f"page {page_memory_mb(page):4.0f} MB; "
                        f"file {size:6.1f} MB, "
                        f"{size / max(minute, 1):.1f} MB a minute; {speed:.1f} times real time",
                        flush=True,
                    )
        size_of_blocks(recording, view, Path(folder) / "minute.rrd")


def size_of_blocks(recording: Path, view: ViewConfig, file: Path) -> None:
    """Print the size of a minute when only a file is written."""
    with Sink("rrd", view, "minute", file, live=True) as sink:
        if sink.stream is None:
            raise RuntimeError("a file has a stream")
        scene = Scene(view, sink.stream, sink.lay_out)
        for passed_s, batch in looped(recording, view.file_period_s):
            scene.send(batch)
            if passed_s >= 60:
                break
    print(f"--view rrd: {file.stat().st_size / 1e6:.1f} MB a minute")


def looped(recording: Path, period_s: float) -> Iterator[tuple[float, dict[AnyTopic, Rows]]]:
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


def processes(file: Path, seconds: float) -> None:
    """Print processor time and memory of the view that `teleop run` starts, and of its spare."""
    shared = ["--config", str(file), "--set", "session=view-benchmark"]
    for side in ("master", "slave"):
        shared += ["--set", f"link.{side}=127.0.0.1:{find_free_port(0)}"]
    command = [sys.executable, "-m", "teleop", "run", *shared, "--view", "web"]
    with ExitStack() as stack:
        launcher = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        stack.callback(end, launcher)
        wait_until_engaged(shared[3::2], file)
        time.sleep(5 * SETTLE_S)  # the periods settle
        views = [pid for pid in children(launcher.pid) if b"\0view\0" in command_of(pid)]
        before, begin = [processor_s(pid) for pid in views], time.monotonic()
        time.sleep(seconds)
        passed = time.monotonic() - begin
        load = os.getloadavg()[0]
        print(f"{file.name}, {seconds:g} s, load {load:.1f}: share of a core, resident and own MB")
        for pid, earlier in zip(views, before, strict=True):
            spare = STANDBY_VARIABLE.encode() in Path(f"/proc/{pid}/environ").read_bytes()
            name = "its spare" if spare else "view"
            share = (processor_s(pid) - earlier) / passed
            print(f"{name:14} {share:5.2f} {resident_mb(pid):6.0f} {own_memory_mb(pid):6.0f}")


def children(parent: int) -> list[int]:
    """Return the process ids of a process's children."""
    files = Path(f"/proc/{parent}/task").glob("*/children")
    return [int(pid) for file in files for pid in file.read_text().split()]


def command_of(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


def own_memory_mb(pid: int) -> float:
    """Return the memory that a process shares with no other [MB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Private_")) / 1e3


def page_memory_mb(page: browser.Browser | None) -> float:
    """Return the resident memory of the largest process that draws pages [MB]; NaN if none."""
    if page is None:
        return math.nan
    drawing = [pid for pid in descendants(page.pid) if b"--type=renderer" in command_of(pid)]
    return max(map(resident_mb, drawing), default=math.nan)


def descendants(parent: int) -> list[int]:
    """Return the process ids of a process's children, of theirs, and so on."""
    return [pid for child in children(parent) for pid in (child, *descendants(child))]


if __name__ == "__main__":
    main(*sys.argv[1:])
