"""Rerun's viewer program as a child that ends with us: a window, and the files of its web page.

The program opens ports on loopback, through which every user of the machine could show something
else in a window, or look at it. So a window is fed through its standard input and has a network of
its own where the system lets it. For the files of its page the program runs without any data, and
only as long as they are read.

Its usage statistics are switched off in a config folder of its own, so that the user's Rerun
settings are neither used nor changed.
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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

import rerun_cli  # type: ignore[import-untyped]

from teleop.errors import TeleopError
from teleop.runtime.child_process import end_process
from teleop.runtime.process import die_with_parent
from teleop.runtime.scratch_folder import ScratchFolder
from teleop.view.local_server import is_own_connection
from teleop.view.page import VIEWER_FILES
from teleop.view.ports import LOOPBACK, find_free_port
from teleop.view.rrd import RrdError, read_stream_header, split_messages

_START_S = 20.0
_END_S = 1.0
_WRITE_TIMEOUT_S = 1.5  # for which a block is on its way into the window
_NEW_USER, _NEW_NETWORK = 0x10000000, 0x40000000  # namespaces, of unshare(2)
_OPEN_PORT = "; other users of this machine can reach it: --view web keeps them out"


class ViewerProcess:
    """A running viewer program; `arguments` are added to those that bind and silence it.

    Parameters
    ----------
    arguments : sequence of str
        Further arguments of the `rerun` program.
    prepare : callable
        Called in the child before the program.
    stdin : int
        As of `subprocess.Popen`.
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def running(self) -> bool:
        """Return whether it still runs; a window ends when it is closed."""
        return self.process.poll() is None

    def close(self) -> None:
        """End it, kindly and then not, and remove its folder."""
        end_process(self.process, _END_S)
        if self.process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.process.stdin.close()
        self._folder.cleanup()

    def failure(self) -> TeleopError:
        """Return why it did not start, by what it wrote last."""
        lines = self._log.read_text(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
        return TeleopError(f"the Rerun viewer did not start: {last}")


class Window:
    """Rerun's window, fed through its standard input.

    Parameters
    ----------
    memory_mb : int
        [MB] beyond which it drops the oldest data.

    Attributes
    ----------
    note : str
        What the user must know of it; empty if nothing.
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

    def running(self) -> bool:
        """Return whether it is open."""
        return self._viewer.running()

    def add(self, block: bytes) -> None:
        """Show an encoded block; at once, it is written by a thread."""
        self._blocks.put(block)

    def stuck(self) -> bool:
        """Return whether it gets no more data: it stopped accepting it, or a block was damaged."""
        since = self._since
        is_late = since is not None and time.monotonic() - since > _WRITE_TIMEOUT_S
        return self.running() and (self._failed or is_late)

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

    Raises
    ------
    TeleopError
        The program does not start, or does not send them.
    """
    port = find_free_port(0)
    arguments = ["--port", "auto", "--serve-web", "--web-viewer-port", str(port)]
    with ViewerProcess(arguments) as viewer:
        end = time.monotonic() + _START_S
        while viewer.running() and time.monotonic() < end:
            try:
                return {name: _fetch_file(port, path) for name, (path, _) in VIEWER_FILES.items()}
            except ConnectionRefusedError:
                time.sleep(0.02)
            except (OSError, http.client.HTTPException) as error:
                raise TeleopError(f"the Rerun viewer does not send its page: {error}") from error
        raise viewer.failure()


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
