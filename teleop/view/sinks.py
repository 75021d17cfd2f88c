"""Destinations of the scene: window, web page, file, or none.

What Rerun encodes comes back into this process, which gives it to the pages that ask and to the
window's standard input: no server of Rerun has the data, as its ports are open to every user.
"""

import contextlib
import ctypes
import http.client
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Self

import rerun as rr
import rerun_cli  # type: ignore[import-untyped]

from teleop.config.options import ViewMode
from teleop.errors import TeleopError, UsageError
from teleop.runtime.child_process import end_process
from teleop.runtime.process import die_with_parent, has_display
from teleop.runtime.scratch_folder import ScratchFolder
from teleop.view.columns import APPLICATION
from teleop.view.config import ViewConfig
from teleop.view.layouts import build_blueprint
from teleop.view.local_server import (
    LOOPBACK,
    WEB_VIEW,
    find_free_port,
    is_own_connection,
    take_held_port,
)
from teleop.view.page import (
    VIEWER_FILES,
    BlockBuffer,
    Page,
    RrdError,
    read_stream_header,
    split_block,
    split_messages,
)

# --- Rerun's viewer program as a child that ends with us: a window, and the files of its web page
# The program opens ports on loopback, through which every user of the machine could show something
# else in a window, or look at it. So a window is fed through its standard input and has a network
# of its own where the system lets it. For the files of its page the program runs without any data,
# and only as long as they are read.
#
# Its usage statistics are switched off in a config folder of its own, so that the user's Rerun
# settings are neither used nor changed.


_START_S = 20.0
_END_S = 1.0
_WRITE_TIMEOUT_S = 1.5  # for which a block is on its way into the window
_NEW_USER, _NEW_NETWORK = 0x10000000, 0x40000000  # namespaces, of unshare(2)
_OPEN_PORT = "; other users of this machine can reach it: --view web keeps them out"


class ViewerProcess:
    """A running viewer program; `arguments` are added to those that bind and silence it.

    `prepare` is called in the child before the program; `stdin` is as of `subprocess.Popen`.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        prepare: Callable[[], None] = lambda: None,
        stdin: int = subprocess.DEVNULL,
    ) -> None:
        parent = os.getpid()
        self._folder = ScratchFolder()
        folder = Path(self._folder.name)
        self._log = folder / "viewer.log"
        disable_usage_statistics(folder)

        def begin() -> None:
            die_with_parent(parent, signal.SIGKILL)  # a stopped one would not end otherwise
            prepare()

        try:
            with self._log.open("wb") as log:
                self.process = subprocess.Popen(
                    [str(find_program()), "--bind", LOOPBACK, *arguments],
                    stdin=stdin,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    env=os.environ
                    | {"XDG_CONFIG_HOME": str(folder), "RUST_LOG": "warn", "NO_COLOR": "1"},
                    preexec_fn=begin,  # noqa: PLW1509 - no other thread of ours runs yet
                    start_new_session=True,  # Ctrl-C reaches us alone; we end it
                )
        except BaseException:
            self._folder.cleanup()
            raise

    def is_running(self) -> bool:
        """Return whether it still runs; a window ends when it is closed."""
        return self.process.poll() is None

    def close(self) -> None:
        """End it, kindly and then not, and remove its folder."""
        end_process(self.process, _END_S)
        if self.process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.process.stdin.close()
        self._folder.cleanup()

    def read_failure(self) -> TeleopError:
        """Return why it did not start, by what it wrote last."""
        lines = self._log.read_text(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
        return TeleopError(f"the Rerun viewer did not start: {last}")


class Window:
    """Rerun's window, fed through its standard input.

    Beyond `memory_mb` [MB] it drops the oldest data; `note` is what the user must know of it, empty
    if nothing.
    """

    def __init__(self, memory_mb: int) -> None:
        arguments = ["-", "--port", "auto", "--hide-welcome-screen", "--expect-data-soon"]
        arguments += ["--memory-limit", f"{memory_mb}MB"]
        self.note = ""
        try:
            self._viewer = ViewerProcess(arguments, leave_network, subprocess.PIPE)
        except subprocess.SubprocessError:
            self.note = _OPEN_PORT
            self._viewer = ViewerProcess(arguments, stdin=subprocess.PIPE)
        self._blocks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._since: float | None = None  # [s] when the block on its way was begun
        self._failed = False  # a block was none of Rerun: nothing more is written
        threading.Thread(target=self._feed, name="window", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._viewer.close()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._viewer.process.pid

    def is_running(self) -> bool:
        """Return whether it is open."""
        return self._viewer.is_running()

    def add(self, block: bytes) -> None:
        """Show an encoded block; at once, it is written by a thread."""
        self._blocks.put(block)

    def is_stuck(self) -> bool:
        """Return whether it gets no more data: it stopped accepting it, or a block was damaged."""
        since = self._since
        is_late = since is not None and time.monotonic() - since > _WRITE_TIMEOUT_S
        return self.is_running() and (self._failed or is_late)

    def _feed(self) -> None:
        pipe = self._viewer.process.stdin
        assert pipe is not None  # noqa: S101 - given as PIPE above
        header = b""
        try:
            while True:
                block = self._blocks.get()
                if not header:
                    header = read_stream_header(block)
                    pipe.write(header)
                for message in split_messages(block):
                    self._since = time.monotonic()
                    pipe.write(message.content)
                pipe.flush()
                self._since = None
        except RrdError:  # before ValueError, which it is
            self._failed = True
        except (BrokenPipeError, ValueError):
            return  # it was closed


def leave_network() -> None:
    """Give this process a network without any other process; `OSError` if that cannot be.

    Wayland and a display on this machine are reached by sockets that are files, which stay; a
    display that is reached by TCP (`ssh -X`) would not.
    """
    display = os.environ.get("DISPLAY", "")
    if not os.environ.get("WAYLAND_DISPLAY") and display and not display.startswith((":", "unix:")):
        raise OSError(f"the display {display} is reached by TCP")
    user, group = os.getuid(), os.getgid()
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "unshare"):
        raise OSError("no namespaces")
    if libc.unshare(_NEW_USER | _NEW_NETWORK):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
    Path("/proc/self/gid_map").write_text(f"{group} {group} 1")


def read_viewer_files() -> dict[str, bytes]:
    """Return the files of Rerun's web page, by the keys of `VIEWER_FILES`.

    Raises `TeleopError` if the program does not start, or does not send them.
    """
    port = find_free_port(0)
    arguments = ["--port", "auto", "--serve-web", "--web-viewer-port", str(port)]
    with contextlib.closing(ViewerProcess(arguments)) as viewer:
        end = time.monotonic() + _START_S
        while viewer.is_running() and time.monotonic() < end:
            try:
                return {name: _fetch_file(port, path) for name, (path, _) in VIEWER_FILES.items()}
            except ConnectionRefusedError:
                time.sleep(0.02)
            except (OSError, http.client.HTTPException) as error:
                raise TeleopError(f"the Rerun viewer does not send its page: {error}") from error
        raise viewer.read_failure()


def _fetch_file(port: int, path: str) -> bytes:
    """Return a file that our program serves, and nobody else who took its port."""
    connection = http.client.HTTPConnection(LOOPBACK, port, timeout=_START_S)
    try:
        connection.request("GET", path)
        own = connection.sock.getsockname()
        answer = connection.getresponse()
        if not is_own_connection((LOOPBACK, port), own):
            raise OSError(f"port {port} belongs to another user")
        if answer.status != http.client.OK:
            raise OSError(f"{path}: status {answer.status}")
        return answer.read()
    finally:
        connection.close()


def find_program() -> Path:
    """Return the path of the viewer program that comes with `rerun-sdk`."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).parent / name
    if not path.exists():
        raise TeleopError(f"{path} is missing: install rerun-sdk again, from its wheel")
    return path


def disable_usage_statistics(config_home: Path) -> None:
    """Write a Rerun config into a folder that says: no usage statistics."""
    path = config_home / "rerun" / "analytics.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    settings = {
        "analytics_enabled": False,
        "analytics_id": "",
        "metadata": {},
        "config_file_path": str(path),
        "data_dir_path": str(path.parent / "data"),
    }
    path.write_text(json.dumps(settings))


_FLUSH_S = 3.0
_BLOCK = 1 << 20  # [bytes] of a file that a page is given at once, more or less


class Sink:
    """An open destination; `stream` takes the data (None = nowhere), `lines` are for the user.

    `session` names the recording in the viewer; `out` is a file to write too, with mode `rrd` None
    makes a name in the configured folder; `live` data come as they happen; `saved` is a Rerun file
    that the viewer shows instead of a stream, `arms` the number of arms in space.
    """

    def __init__(
        self,
        mode: ViewMode,
        config: ViewConfig,
        session: str,
        out: Path | None,
        live: bool,
        saved: Path | None = None,
        arms: int = 0,
    ) -> None:
        self._arms = arms
        self.lines: list[str] = []
        self._config = config
        self.file = out
        if mode == "rrd" and out is None:
            moment = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
            self.file = Path(config.directory) / f"{session}-{moment}.rrd"
        self._window: Window | None = None
        self._page: Page | None = None
        self._blocks: BlockBuffer | None = None
        self._encoded: rr.BinaryStream | None = None
        self._joints: Mapping[int, Sequence[int]] = {}  # as laid out
        self._layouts = 0  # sent
        self._show_panel: Callable[[], None] = lambda: None
        self.ended = "The view was closed."  # what open pages are told at the end
        with ExitStack() as stack:  # the programs first: a child is best started before any thread
            if mode == "native":
                self._open_window(stack, saved)
            elif mode == "web":
                self._open_page(stack, live, saved)
            # no stream without a sink: it would buffer everything
            self.stream: rr.RecordingStream | None = None
            if saved is None and (self.watched or self.file is not None):
                self._open_stream(stack, session)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def watched(self) -> bool:
        """Whether it is a viewer."""
        return self._window is not None or self._page is not None

    def is_alive(self) -> bool:
        """Return whether the window, if any, is open."""
        return self._window is None or self._window.is_running()

    def lay_out(self, joints: Mapping[int, Sequence[int]]) -> None:
        """Lay the views out for these joints, each with its tendons."""
        if self.stream is not None and joints != self._joints:
            self._joints = joints
            self._layouts += 1
            self.stream.send_blueprint(build_blueprint(self._config, joints, self._arms))

    def follow(self, newest_ns: Callable[[], int], show_panel: Callable[[], None]) -> None:
        """Let pages compare what they show with the newest stamp [ns] that was sent.

        `show_panel` is called, from any thread, once a page needs what the layout `surgeon` shows.
        """
        if self._page is not None:
            self._page.newest_ns = newest_ns
            self._page.layout = lambda: self._layouts
            self._page.light = self._build_light_layout
            self._show_panel = show_panel

    @property
    def behind_s(self) -> float:
        """How far [s] the slowest open page is behind what was sent; 0 if none says so."""
        return 0.0 if self._page is None else self._page.get_delay_s()

    def publish(self) -> None:
        """Give viewers what was sent to the stream."""
        block = None if self._encoded is None else self._encoded.read(flush_timeout_sec=_FLUSH_S)
        if not block:
            return
        if self._blocks is not None:
            self._blocks.add(block)
        if self._window is not None:
            self._window.add(block)

    def is_stuck(self) -> bool:
        """Return whether the window has stopped accepting data."""
        return self._window is not None and self._window.is_stuck()

    def close(self) -> None:
        """Publish the rest, tell open pages why it ends, and end a window."""
        try:
            self.publish()
        except RuntimeError as error:
            print(f"view: the last data did not get there: {error}", file=sys.stderr)
        self._stack.close()

    def _open_stream(self, stack: ExitStack, session: str) -> None:
        stream = rr.RecordingStream(APPLICATION)
        stack.callback(stream.disconnect)
        sinks: list[rr.BinaryStream | rr.FileSink] = []
        if self.watched:
            self._encoded = rr.binary_stream(stream)
            sinks.append(self._encoded)
        if self.file is not None:
            sinks.append(self._open_file(self.file))
        stream.set_sinks(*sinks, default_blueprint=build_blueprint(self._config, {}, self._arms))
        stream.send_recording_name(session)
        self.stream = stream

    def _build_light_layout(self) -> bytes:
        """Return the layout `surgeon`, encoded, and let what it shows be sent."""
        self._show_panel()
        light = build_blueprint(replace(self._config, layout="surgeon"), self._joints)
        with ScratchFolder() as folder:
            path = Path(folder) / "light.rbl"
            light.save(APPLICATION, path)
            return path.read_bytes()

    def _open_window(self, stack: ExitStack, saved: Path | None) -> None:
        if not has_display():
            raise UsageError("--view native: there is no display here; use --view web")
        self._window = stack.enter_context(Window(self._config.page_memory_mb))
        if saved is not None:
            self._window.add(saved.read_bytes())
        self.lines.append(f"Native view: opened{self._window.note}")

    def _open_page(self, stack: ExitStack, live: bool, saved: Path | None) -> None:
        config = self._config
        # a recording is kept as far as a page can
        limit_mb = config.server_memory_mb if live else config.page_memory_mb
        self._blocks = blocks = BlockBuffer(limit_mb * 1_000_000)
        if saved is not None:
            try:
                for block in split_block(saved.read_bytes(), _BLOCK):
                    blocks.add(block)
            except RrdError as error:
                raise UsageError(f"{saved}: is no Rerun file that can be shown: {error}") from error
        port, secret = take_held_port() or (config.web_port, "")
        page = Page(port, secret, read_viewer_files(), blocks, config.page_memory_mb)
        stack.callback(lambda: page.close(self.ended))
        self._page = page
        self.lines.append(f"{WEB_VIEW}{page.address}")

    def _open_file(self, path: Path) -> rr.FileSink:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab"):
                pass
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
        # a footer names every chunk, and all of them are kept in memory until the file is closed
        self.lines.append(f"View file: {path}")
        return rr.FileSink(path, write_footer=False)
