"""Session to inject faults into, of remote-controlled processes."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from studies.testbed.processes import (
    OURS,
    START_S,
    Processes,
    find_free_ports,
    tell_proxy,
    wait_for_condition,
)
from teleop.link import Link
from teleop.messages.topics import HAND, STATE

HELD = (0.3, 2.6)  # [s] the scripted hand holds the engage switch, of every
PERIOD = 3.0  # [s]
MOTION = (
    f"master.device.engage=[[{HELD[0]}, {HELD[1]}]]",
    f"master.device.engage_period={PERIOD}",
    "master.device.reference={type: sine, amplitude: 0.02, frequency: 0.5, offset: 0.03}",
)
NAMES = ("record", "impair", "slave", "master")
WALL_CLOCK = Path(__file__).with_name("wall_clock.c")


class FaultSession(Processes):
    """A session whose hand is always in motion and engages every `PERIOD`.

    `extra` are further processes of it: `view`.
    """

    def __init__(
        self, folder: Path, config: Path, *overrides: str, extra: Sequence[str] = ()
    ) -> None:
        self._names = (*NAMES, *extra)
        self._environment = OURS | build_wall_clock(folder)
        (port,) = find_free_ports(1)
        self.proxy = f"127.0.0.1:{port}"
        super().__init__(folder, config, f"impair.endpoint={self.proxy}", *MOTION, *overrides)
        self.link: Link | None = None
        self._begun: list[str] = []

    def __enter__(self) -> "FaultSession":
        try:
            for name in self._names:
                self.begin(name)
            self.link = self.look()
            self.link.__enter__()
            self.await_engaged()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if self.link is not None:
            self.link.__exit__(None, None, None)
        super().__exit__(*error)
        for process in self._all:
            process.stdin.close()

    def begin(self, name: str) -> None:
        """Start a process, or one in the place of another that has ended."""
        number = self._begun.count(name)
        self._begun.append(name)
        words = ["--json", str(self.folder / f"{name}-{number}.json")]
        if name == "record":
            words = ["--out", str(self.folder)]
        if name == "view":
            words += ["--view", str(self.folder / f"view-{number}.rrd")]
        if name == "master":
            words += ["--set", f"link.slave={self.proxy}"]
        self.running[name] = process = subprocess.Popen(
            [sys.executable, "-m", "studies.faults.faulty_process", name, *self.shared, *words],
            stdin=subprocess.PIPE,
            stdout=self._log(name),
            stderr=subprocess.STDOUT,
            env=self._environment,
        )
        self._all.append(process)

    def await_engaged(self) -> None:
        """Wait until the hand feels a force again."""
        alive = self.running.values
        assert wait_for_condition(
            lambda: self.engaged(self.link) or any(p.poll() is not None for p in alive()), START_S
        ), self.outputs()
        ended = [name for name, process in self.running.items() if process.poll() is not None]
        assert not ended, f"{ended} ended:\n{self.outputs()}"

    def pull(self, name: str, words: str) -> None:
        """Pull a string of a process."""
        stdin = self.running[name].stdin
        stdin.write(f"{words}\n".encode())
        stdin.flush()

    def signal(self, name: str, number: signal.Signals) -> None:
        os.kill(self.running[name].pid, number)

    def tell(self, *words: str) -> dict:
        """Tell the proxy something; it may be coming up."""
        return tell_proxy(self.link_config, self.session, self.proxy, *words)

    def end(self) -> None:
        """End everything in order."""
        for name in reversed(self._names):
            self.stop(name)

    def last_stamp_ns(self, name: str) -> int:
        """Return when the newest message of a side that reached us was sent."""
        return self.link.take_latest(HAND if name == "master" else STATE).stamp_ns

    def recordings(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"), key=lambda path: path.stat().st_ctime)


def build_wall_clock(folder: Path) -> dict[str, str]:
    """Return the environment of processes whose wall clock can be set; empty without a compiler."""
    library = folder.absolute() / "wall_clock.so"
    compiler = shutil.which("cc")
    if compiler is None:
        return {}
    subprocess.run([compiler, "-shared", "-fPIC", "-O2", "-o", library, WALL_CLOCK], check=True)
    return {"LD_PRELOAD": str(library)}
