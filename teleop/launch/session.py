"""A session from Python: `teleop run` as an object.

with Session("configs/demo.yaml") as session:
    session.wait_for("engaged")
    for state in session.states(duration=10):
        print(state.time, state.force)
"""

import dataclasses
import io
import os
import re
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from rich.console import RenderableType

from master.devices.program import SOCKET_VARIABLE, ProgramConfig, ProgramOperator
from teleop.config import strict_yaml
from teleop.config.loading import ConfigDocument, as_tree
from teleop.config.overrides import Override
from teleop.errors import TeleopError, UsageError
from teleop.launch.config import SessionConfig
from teleop.launch.console import Console
from teleop.launch.launcher import LaunchPlan, build_rig_overrides, plan_session, run_session
from teleop.link import Link
from teleop.remote.client import SessionClient
from teleop.runtime.output_file import SharedFolder, parse_output
from teleop.runtime.process import StopCondition, defer_interrupt
from teleop.runtime.status_line import StatusLine
from teleop.session.config import ENDPOINT_KEYS
from teleop.session.summary import SessionSummary

_ENDED = "the session has ended"


def print_line(line: str) -> None:
    """Print what a session says, on standard error: the output is the program's."""
    print(line, file=sys.stderr, flush=True)


class Session(SessionClient):
    """Slave, master, recorder and view of one session, started on entering, ended on leaving.

    A context manager, used once and from one thread. Entering returns when both loops run; the
    first start on a machine compiles for about half a minute. Leaving ends all processes, also
    after an exception or Ctrl-C: the master first, then the slave, which lowers the tensions, and
    the recorder last.

    Parameters
    ----------
    config : path or SessionConfig, optional
        Config file, recording, or config; without it the built-in values. What a `SessionConfig`
        has of your own (`slave.rigs.RigExtension`, `master.devices.DeviceExtension` and others)
        may be objects of classes that are defined in a file.
    overrides : mapping, optional
        Values of the config by dotted key, as of `--set`: `{"master.force.scale": 0.3}`.
    name : str, optional
        Name of the session; by default one of its own.
    operator : bool
        Whether this program is the operator: `Session.operator` moves the hand in place of
        `master.device`, with as many axes.
    record : path, optional
        Folder for a recording.
    view : str
        "none", "web", "native", "rrd", or the name of a Rerun file.
    calibration : path, optional
        Calibration of the sheaths; "as-built" is the true one of a simulated rig.
    replay : path, optional
        Measured data in place of the rig.
    models : sequence of str
        Files of models, as of `--model`.
    say : callable
        Called with each line that the session says, from any thread; by default it is printed on
        standard error.

    Attributes
    ----------
    config : SessionConfig
        The config that the processes have.
    summary : SessionSummary or None
        Figures of the whole session, once it has ended; `summary.slave` and `summary.master` are
        those of the loops.

    Raises
    ------
    UsageError
        The config is invalid (from here, or on entering what only the processes can check).
    TeleopError
        On entering: a process could not start. On leaving: a fault had ended the session.
    """

    def __init__(
        self,
        config: str | Path | SessionConfig | None = None,
        overrides: Mapping[str, Any] | None = None,
        *,
        name: str | None = None,
        operator: bool = False,
        record: str | Path | None = None,
        view: str = "none",
        calibration: str | Path | None = None,
        replay: str | Path | None = None,
        models: tuple[str, ...] = (),
        say: Callable[[str], None] = print_line,
    ) -> None:
        is_object = isinstance(config, SessionConfig)  # classes that it names are imported already
        document = _read_document(config, overrides or {}).override(
            *build_rig_overrides(_to_path(replay), _to_path(calibration))
        )
        if operator:
            axes = document.load(SessionConfig).master.device.axis_count
            device = {"type": "program", "axes": axes}
            document = document.override(Override.from_value("master.device", device))
        document, self.config = plan_session(document, name)
        super().__init__(self.config)
        self.summary: SessionSummary | None = None
        self._operator: ProgramOperator | None = None
        self._plan = LaunchPlan(
            document=document,
            config=self.config,
            record=None if record is None else parse_output(SharedFolder(), "record", str(record)),
            view=view,
            models=tuple(models),
            allow_imports=is_object,
            # where this program finds its modules, for the processes of its rigs and devices
            environment={"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
            if is_object
            else {},
        )
        self._console = Console(_LineStatus(say))
        self._stop = StopCondition(catches_signals=False)
        self._wake = threading.Event()
        self._has_begun, self._has_ended = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.end()
        if exception[0] is None:
            self._raise_failure()

    def start(self) -> None:
        """Start it, as entering does; for notebooks, where `end` has a cell of its own."""
        if self._thread is not None:
            raise UsageError("a Session is used once; make another one")
        plan = self._plan
        if isinstance(self.config.master.device, ProgramConfig):
            self._operator = ProgramOperator(self.config.master.device)
            descriptor = self._operator.theirs.fileno()
            environment = {**plan.environment, SOCKET_VARIABLE: str(descriptor)}
            plan = dataclasses.replace(plan, environment=environment, master_files=(descriptor,))
        try:
            self._thread = threading.Thread(
                target=self._run, args=(plan,), name="teleop session", daemon=True
            )
            self._thread.start()
            # not `atexit`: that comes after Python has waited for Zenoh's thread of callbacks,
            # which ends with the link only
            threading._register_atexit(self.end)  # type: ignore[attr-defined]
            self._has_begun.wait()
            self._require_running()
            self._connect()
        except BaseException:
            self.end()
            raise

    def end(self) -> None:
        """End all processes and wait for it, whatever interrupts; the interruption follows.

        May be called again.
        """
        with defer_interrupt():  # the motors come first
            self._stop.request("the program has ended it")
            self._wake.set()
            if self._thread is not None and self._thread.ident:  # it was started
                self._has_ended.wait()
            self._disconnect()
            if self._operator is not None:
                self._operator.close()

    @property
    def operator(self) -> ProgramOperator:
        """The hand of this session, if this program is the operator; `UsageError` otherwise."""
        if self._operator is None:
            device = self.config.master.device.type
            raise UsageError(
                f"session {self.name!r}: the hand is that of master.device {device!r}; "
                "Session(..., operator=True) gives it to this program, from entering on"
            )
        return self._operator

    @property
    def recording(self) -> Path | None:
        """The file of the recording; None without one, or before it is begun."""
        folder = self._plan.record
        pattern = re.compile(re.escape(self.name) + r"-\d{8}T\d{6}Z(-\d+)?\.mcap")
        files = (
            [] if folder is None else filter(lambda p: pattern.fullmatch(p.name), folder.glob("*"))
        )
        return max(files, key=lambda path: path.stat().st_mtime_ns, default=None)

    def _require_running(self) -> None:
        if self._thread is None or self._has_ended.is_set() or self._wake.is_set():
            self._raise_failure()
            raise TeleopError(f"session {self.name!r}: {self._stop.reason or _ENDED}")

    def _run(self, plan: LaunchPlan) -> None:
        """Run the session; in a thread of its own, which Ctrl-C does not reach."""
        try:
            self.summary = run_session(plan, self._console, self._stop, self._wait, self._begin)
        except BaseException as error:  # raised where the program is
            self._error = error
        finally:
            self._has_ended.set()
            self._begin()

    def _wait(self, _link: Link, seconds: float) -> None:
        self._wake.wait(seconds)

    def _begin(self) -> None:
        """Let the program go on: both loops run, or the session has ended."""
        if self._operator is not None:
            self._operator.leave_master_end()
        self._has_begun.set()

    def _raise_failure(self) -> None:
        """Raise what has ended the session, if that was a fault."""
        if self._error is not None:
            raise self._error
        if self.summary is not None and self.summary.exit_code:
            raise TeleopError(f"session {self.name!r}: {self.summary.reason}")


class _LineStatus(StatusLine):
    """In place of the status line of a terminal: only ordinary lines, for a callable."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__(io.StringIO())
        self._say, self._has_failed = say, False

    def say(self, text: str | RenderableType) -> None:
        """Pass an ordinary line on; what the callable raises must not end the reading of lines."""
        try:
            self._say(str(text))
        except Exception as error:
            if not self._has_failed:
                print_line(f"{text}\nWARNING: say fails: {type(error).__name__}: {error}")
            self._has_failed = True


def _to_path(text: str | Path | None) -> Path | None:
    return None if text is None else Path(text)


def _read_document(
    config: str | Path | SessionConfig | None, overrides: Mapping[str, Any]
) -> ConfigDocument:
    """Return a config, from wherever it comes, as a document."""
    if isinstance(config, SessionConfig):
        document = ConfigDocument(
            text=strict_yaml.format_document(_drop_default_place(as_tree(config)))
        )
    else:
        document = ConfigDocument.read(None if config is None else Path(config))
    return document.override(*(Override.from_value(key, value) for key, value in overrides.items()))


def _drop_default_place(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a config without a name and endpoints that are the defaults: it gets its own."""
    defaults = as_tree(SessionConfig())
    kept = dict(tree["link"])
    if all(kept[key] == defaults["link"][key] for key in ENDPOINT_KEYS):
        kept = {key: value for key, value in kept.items() if key not in ENDPOINT_KEYS}
    name = {} if tree["session"] == defaults["session"] else {"session": tree["session"]}
    rest = {key: value for key, value in tree.items() if key not in ("session", "link")}
    return {**rest, **name, "link": kept}


def load_config(
    path: str | Path | None = None, overrides: Mapping[str, Any] | None = None
) -> SessionConfig:
    """Read a config file as an object with the same names, to be edited by `dataclasses.replace`.

    Parameters
    ----------
    path : path, optional
        Config file or recording; without it the built-in values.
    overrides : mapping, optional
        Values by dotted key.

    Raises
    ------
    UsageError
        It is invalid; one line with file, key and remedy.
    """
    return _read_document(path, overrides or {}).load(SessionConfig)
