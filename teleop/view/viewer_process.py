"""Rerun's viewer program as a child that listens on loopback only and ends with us.

Rerun's Python server (`rerun.serve_grpc`) listens on all interfaces and cannot be told otherwise;
the program can. Its usage statistics are switched off in a config folder of its own, so that the
user's Rerun settings are neither used nor changed.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Self

import rerun_cli  # type: ignore[import-untyped]

from teleop.errors import TeleopError
from teleop.process import die_with_parent
from teleop.view.ports import LOOPBACK

_START_S = 20.0
_END_S = 1.0


class ViewerProcess:
    """A running viewer program; `arguments` are added to those that bind and silence it.

    Parameters
    ----------
    arguments : sequence of str
        Further arguments of the `rerun` program.
    grpc_port : int
        Where it takes data; `url` names it.
    """

    def __init__(self, arguments: Sequence[str], grpc_port: int) -> None:
        self.url = f"rerun+http://{LOOPBACK}:{grpc_port}/proxy"
        self._folder = tempfile.TemporaryDirectory(prefix="teleop-view-")
        folder = Path(self._folder.name)
        self._log = folder / "viewer.log"
        silence(folder)
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [str(program()), "--bind", LOOPBACK, "--port", str(grpc_port), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ
                | {"XDG_CONFIG_HOME": str(folder), "RUST_LOG": "warn", "NO_COLOR": "1"},
                # killed, as a stopped one would keep the ports
                preexec_fn=partial(die_with_parent, os.getpid(), signal.SIGKILL),  # noqa: PLW1509 - no other thread of ours runs yet
                start_new_session=True,  # Ctrl-C reaches us alone; we end it after the last data
            )
        self._wait_for(grpc_port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def running(self) -> bool:
        """Return whether it still runs; a native viewer ends when its window is closed."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End it at once; from any thread."""
        self._process.kill()

    def close(self) -> None:
        """End it, kindly and then not, and remove its folder."""
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def _wait_for(self, port: int) -> None:
        end = time.monotonic() + _START_S
        while self.running() and time.monotonic() < end:
            try:
                socket.create_connection((LOOPBACK, port), timeout=1.0).close()
            except OSError:
                time.sleep(0.02)
            else:
                return
        lines = self._log.read_text(errors="replace").split("\n")
        self.close()
        last = next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")
        raise TeleopError(f"the Rerun viewer did not start: {last}")


def program() -> Path:
    """Return the path of the viewer program that comes with `rerun-sdk`."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).parent / name
    if not path.exists():
        raise TeleopError(f"{path} is missing: install rerun-sdk again, from its wheel")
    return path


def silence(config_home: Path) -> None:
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
