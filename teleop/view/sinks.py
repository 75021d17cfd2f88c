"""Destinations of the scene: window, web page, file, or none."""

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Self

import rerun as rr

from teleop.errors import UsageError
from teleop.options import ViewMode
from teleop.process import has_display, supervised
from teleop.view.config import ViewConfig
from teleop.view.layouts import blueprint
from teleop.view.page import Page
from teleop.view.ports import WEB_VIEW, free_port
from teleop.view.viewer_process import ViewerProcess

APPLICATION = "teleop"
_FLUSH_S = 3.0
_PROBE_S = 0.75
_LET_GO_S = 0.5
_SAME_PORT_S = 3.0  # to wait for the port of a view that was killed


class Sink:
    """An open destination; `stream` takes the data (None = nowhere), `lines` are for the user.

    Parameters
    ----------
    mode : {"native", "web", "rrd", "none"}
    config : ViewConfig
    session : str
        Names the recording in the viewer.
    out : Path or None
        Also write this file; with mode `rrd` None makes a name in the configured folder.
    live : bool
        Whether the data come as they happen.
    saved : Path, optional
        A Rerun file that the viewer shows instead of a stream.
    """

    def __init__(
        self,
        mode: ViewMode,
        config: ViewConfig,
        session: str,
        out: Path | None,
        live: bool,
        saved: Path | None = None,
    ) -> None:
        self.lines: list[str] = []
        self._saved = [] if saved is None else [str(saved)]
        self._mode = mode
        self._config = config
        self.file = _new_file(config, session) if mode == "rrd" and out is None else out
        self._viewer: ViewerProcess | None = None
        self._page: Page | None = None
        self._joints: Mapping[int, Sequence[int]] = {}  # as laid out
        self._sinks: list[rr.GrpcSink | rr.FileSink] = []
        self._slow_probes = 0
        with ExitStack() as stack:  # the programs first: a child is best started before any thread
            if mode == "native":
                self._open_window(stack, config)
            elif mode == "web":
                self._open_page(stack, config, live)
            if self.file is not None:
                self._open_file(self.file)
            # no stream without a sink: it would buffer everything
            self.stream: rr.RecordingStream | None = None
            if self._sinks and saved is None:
                self.stream = rr.RecordingStream(APPLICATION)
                stack.callback(self.stream.disconnect)
                self.stream.set_sinks(*self._sinks, default_blueprint=blueprint(config, {}))
                self.stream.send_recording_name(session)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def watched(self) -> bool:
        """Whether it is a viewer."""
        return self._viewer is not None

    @property
    def window(self) -> bool:
        """Whether it is a window, which the user may close."""
        return self._mode == "native"

    @property
    def pid(self) -> int | None:
        """The process id of the viewer program, if there is one."""
        return None if self._viewer is None else self._viewer.pid

    def alive(self) -> bool:
        """Return whether the viewer program, if any, still runs."""
        return self._viewer is None or self._viewer.running()

    def lay_out(self, joints: Mapping[int, Sequence[int]]) -> None:
        """Lay the views out for these joints, each with its tendons."""
        if self.stream is not None and joints != self._joints:
            self._joints = joints
            self.stream.send_blueprint(blueprint(self._config, joints))

    def follow(self, newest_ns: Callable[[], int]) -> None:
        """Let a page compare what it shows with the newest stamp [ns] that was sent."""
        if self._page is not None:
            self._page.newest_ns = newest_ns

    @property
    def behind_s(self) -> float:
        """How far [s] the slowest open page is behind what was sent; 0 if none says so."""
        return 0.0 if self._page is None else self._page.behind_s()

    def stuck(self) -> bool:
        """Return whether the viewer has stopped accepting data: two probes in a row failed."""
        if self.stream is None or not self.alive():
            return False
        try:
            self.stream.flush(timeout_sec=_PROBE_S)
        except RuntimeError:
            self._slow_probes += 1
        else:
            self._slow_probes = 0
        return self._slow_probes > 1

    def close(self) -> None:
        """Flush for a few seconds at most, and end the viewer program."""
        if self.stream is not None and self.alive() and not self._slow_probes:
            try:
                self.stream.flush(timeout_sec=_FLUSH_S)
            except RuntimeError as error:
                print(f"view: the last data did not get there: {error}", file=sys.stderr)
        # letting go of a viewer that hangs waits until it is gone, also where all was flushed into
        # the kernel's buffers
        patience = threading.Timer(_LET_GO_S, self._viewer.kill if self._viewer else lambda: None)
        patience.daemon = True
        patience.start()
        self._stack.close()
        patience.cancel()

    def _open_window(self, stack: ExitStack, config: ViewConfig) -> None:
        if not has_display():
            raise UsageError("--view native: there is no display here; use --view web")
        port = free_port(config.grpc_port)
        memory = f"{config.page_memory_mb}MB"
        arguments = [*self._saved, "--hide-welcome-screen", "--memory-limit", memory]
        arguments.append("--expect-data-soon")
        self._viewer = stack.enter_context(ViewerProcess(arguments, port))
        self._sinks.append(rr.GrpcSink(self._viewer.url))
        self.lines.append("Native view: opened")

    def _open_page(self, stack: ExitStack, config: ViewConfig, live: bool) -> None:
        # after a restart the page that is open in a browser looks for us where we were
        patience_s = _SAME_PORT_S if supervised() else 0.0
        port, inner = free_port(config.grpc_port, patience_s), free_port(0)
        arguments = [*self._saved, "--serve-web", "--web-viewer-port", str(inner)]
        arguments += ["--server-memory-limit", f"{config.server_memory_mb}MB"]
        if live:
            arguments.append(
                "--newest-first"
            )  # a browser that connects later starts with the newest data
        self._viewer = stack.enter_context(ViewerProcess(arguments, port))
        web_port = free_port(config.web_port, patience_s)
        page = stack.enter_context(Page(web_port, inner, self._viewer.url, config.page_memory_mb))
        self._page = page
        self._sinks.append(rr.GrpcSink(self._viewer.url))
        self.lines.append(f"{WEB_VIEW}{page.address}")

    def _open_file(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab"):
                pass
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
        # a footer names every chunk, and all of them are kept in memory until the file is closed
        self._sinks.append(rr.FileSink(path, write_footer=False))
        self.lines.append(f"View file: {path}")


def _new_file(config: ViewConfig, session: str) -> Path:
    moment = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    return Path(config.directory) / f"{session}-{moment}.rrd"
