"""Destinations of the scene: window, web page, file, or none.

What Rerun encodes comes back into this process, which gives it to the pages that ask and to the
window's standard input: no server of Rerun has the data, as its ports are open to every user.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Self

import rerun as rr

from teleop.config.options import ViewMode
from teleop.errors import UsageError
from teleop.runtime.process import has_display
from teleop.runtime.scratch_folder import ScratchFolder
from teleop.view.config import ViewConfig
from teleop.view.layouts import build_blueprint
from teleop.view.page import Page
from teleop.view.ports import WEB_VIEW, take_held_port
from teleop.view.rrd import BlockBuffer, RrdError, split_block
from teleop.view.viewer_process import Window, read_viewer_files

APPLICATION = "teleop"
_FLUSH_S = 3.0
_BLOCK = 1 << 20  # [bytes] of a file that a page is given at once, more or less


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
        self._config = config
        self.file = _build_file_path(config, session) if mode == "rrd" and out is None else out
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

    def alive(self) -> bool:
        """Return whether the window, if any, is open."""
        return self._window is None or self._window.running()

    def lay_out(self, joints: Mapping[int, Sequence[int]]) -> None:
        """Lay the views out for these joints, each with its tendons."""
        if self.stream is not None and joints != self._joints:
            self._joints = joints
            self._layouts += 1
            self.stream.send_blueprint(build_blueprint(self._config, joints))

    def follow(self, newest_ns: Callable[[], int], show_panel: Callable[[], None]) -> None:
        """Let pages compare what they show with the newest stamp [ns] that was sent.

        `show_panel` is called, from any thread, once a page needs what the layout `surgeon` shows.
        """
        if self._page is not None:
            self._page.newest_ns = newest_ns
            self._page.layout = lambda: self._layouts
            self._page.light = self._light_layout
            self._show_panel = show_panel

    @property
    def behind_s(self) -> float:
        """How far [s] the slowest open page is behind what was sent; 0 if none says so."""
        return 0.0 if self._page is None else self._page.behind_s()

    def publish(self) -> None:
        """Give viewers what was sent to the stream."""
        block = None if self._encoded is None else self._encoded.read(flush_timeout_sec=_FLUSH_S)
        if not block:
            return
        if self._blocks is not None:
            self._blocks.add(block)
        if self._window is not None:
            self._window.add(block)

    def stuck(self) -> bool:
        """Return whether the window has stopped accepting data."""
        return self._window is not None and self._window.stuck()

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
        stream.set_sinks(*sinks, default_blueprint=build_blueprint(self._config, {}))
        stream.send_recording_name(session)
        self.stream = stream

    def _light_layout(self) -> bytes:
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


def _build_file_path(config: ViewConfig, session: str) -> Path:
    moment = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    return Path(config.directory) / f"{session}-{moment}.rrd"
