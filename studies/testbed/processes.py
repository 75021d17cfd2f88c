"""Our processes, started for a test on free loopback ports and ended with it."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

from teleop.errors import TeleopError
from teleop.link import Link, LinkConfig
from teleop.link.bridge import send_request
from teleop.messages.messages import Hand, SlaveState
from teleop.messages.topics import HAND, STATE, Role
from teleop.runtime.process import SUPERVISED_VARIABLE
from teleop.session.state_machine import State

DEMO_CONFIG = Path(__file__).parents[2] / "configs" / "demo.yaml"
START_S = 120.0  # the first start of all compiles
# environment of processes that end with us
OURS = os.environ | {SUPERVISED_VARIABLE: str(os.getpid())}


def has_ended_well(code: int, said: str) -> bool:
    """Whether a session ended as it should; its recording may lack what a busy machine dropped."""
    return code == 0 or (code == 1 and "messages are missing" in said)


def wait_for_condition(
    condition: Callable[[], bool], timeout_s: float, poll_s: float = 0.02
) -> bool:
    """Wait until `condition` holds; return whether it does in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= end:
            return False
        time.sleep(poll_s)
    return True


def find_free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]


def read_processor_s(pid: int) -> float:
    """Return the processor time that a process has used [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def read_memory_mb(pid: int | str = "self") -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def tell_proxy(link: LinkConfig, session: str, endpoint: str, *words: str) -> dict:
    """Send a request to the proxy of `teleop impair`, which may be coming up; return its answer."""
    end = time.monotonic() + START_S
    while True:
        try:
            return send_request(link, session, endpoint, "\n".join(words))
        except TeleopError:
            if time.monotonic() > end:
                raise


class Processes:
    """A session of its own: `start` commands in it, look at it through `link`."""

    def __init__(self, folder: Path, config: Path, *overrides: str) -> None:
        master, slave = find_free_ports(2)
        self.folder = folder
        self.session = f"test-{uuid.uuid4().hex[:8]}"
        self.link_config = LinkConfig(master=f"127.0.0.1:{master}", slave=f"127.0.0.1:{slave}")
        self.shared = ["--config", str(config)]
        for text in (
            f"session={self.session}",
            f"link.master={self.link_config.master}",
            f"link.slave={self.link_config.slave}",
            *overrides,
        ):
            self.shared += ["--set", text]
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self._all: list[subprocess.Popen[bytes]] = []
        self._logs = ExitStack()

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._all:
            if process.poll() is None:
                process.kill()
            process.wait()
        self._logs.close()

    def start(
        self, command: str, *arguments: str, prefix: Sequence[str] = ()
    ) -> subprocess.Popen[bytes]:
        """Start a command; `prefix` are words before it that run it."""
        process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "teleop", command, *self.shared, *arguments],
            stdout=self._log(command),
            stderr=subprocess.STDOUT,
            env=OURS,
        )
        self.running[command] = process
        self._all.append(process)
        return process

    def start_all(self, prefix: Sequence[str] = ()) -> None:
        """Start recorder, slave and master, and wait until a force is felt."""
        self.start("record", "--out", str(self.folder), prefix=prefix)
        self.start("slave", "--json", str(self.folder / "slave.json"), prefix=prefix)
        self.start("master", "--json", str(self.folder / "master.json"), prefix=prefix)
        with self.look() as link:
            assert wait_for_condition(lambda: self.engaged(link), START_S), self.outputs()

    def look(self) -> Link:
        return Link(self.link_config, self.session, Role.LAUNCHER)

    def engaged(self, link: Link) -> bool:
        state, hand = link.take_latest(STATE).message, link.take_latest(HAND).message
        return (
            isinstance(state, SlaveState)
            and isinstance(hand, Hand)
            and state.state == State.ENGAGED
            and hand.state == State.ENGAGED
            and any(hand.force)
        )

    def _log(self, command: str) -> BinaryIO:
        return self._logs.enter_context(
            (self.folder / f"{len(self._all)}-{command}.log").open("wb")
        )

    def stop(self, command: str, patience_s: float = 10.0) -> int:
        process = self.running[command]
        process.send_signal(signal.SIGINT)
        return process.wait(patience_s)

    def kill(self, command: str) -> None:
        self.running[command].kill()
        self.running[command].wait()

    def wait_for_line(self, command: str, begin: str) -> str:
        """Return the line that begins so, of the newest process of a command."""
        log = max(self.folder.glob(f"*-{command}.log"), key=lambda p: int(p.name.partition("-")[0]))

        def found() -> list[str]:
            return [line for line in log.read_text().splitlines() if line.startswith(begin)]

        assert wait_for_condition(lambda: bool(found()), START_S), self.outputs()
        return found()[0]

    def outputs(self) -> str:
        """Return what all processes printed."""
        return "\n".join(f"--- {p.name}\n{p.read_text()}" for p in self.folder.glob("*.log"))

    def recording(self) -> Path:
        (path,) = self.folder.glob("*.mcap")
        return path

    def summary(self, command: str) -> dict:
        return json.loads((self.folder / f"{command}.json").read_text())


def pause(seconds: float) -> None:
    time.sleep(seconds)
