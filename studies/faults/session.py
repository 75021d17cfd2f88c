"""Session to inject faults into: its remote-controlled processes, and the faults."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from studies.testbed.processes import OURS, START_S, Processes, find_free_ports, pause, tell_proxy
from teleop.launch.supervisor import wait_for_condition
from teleop.link import Link
from teleop.messages.topics import HAND, STATE
from teleop.runtime.clock import now_ns

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


# --- a memory cgroup whose processes the kernel kills when they want more (root only)

ROOT = Path("/sys/fs/cgroup")
ROOM_BYTES = 32_000_000  # that a process may allocate before it is killed


class MemoryGroup:
    """A context with a group of its own, of cgroup v1 or v2; `add` a process to it."""

    def __init__(self) -> None:
        first = ROOT / "memory"
        self._folder = (first if first.is_dir() else ROOT) / f"teleop-faults-{os.getpid()}"
        self._limit = "memory.limit_in_bytes" if first.is_dir() else "memory.max"

    def __enter__(self) -> "MemoryGroup":
        self._folder.mkdir(exist_ok=True)
        (self._folder / self._limit).write_text(str(ROOM_BYTES))
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.rmdir()

    def add(self, process: int) -> None:
        """Count what a process allocates from now on."""
        (self._folder / "cgroup.procs").write_text(str(process))

    @property
    def kills(self) -> int:
        """Number of processes that the kernel has killed for want of memory."""
        for name in ("memory.events", "memory.oom_control"):
            if (self._folder / name).exists():
                counts = dict(map(str.split, (self._folder / name).read_text().splitlines()))
                return int(counts["oom_kill"])
        return 0


# --- the faults: what each does, for how long, and which side has to react to it

SILENCING = ("kill", "stop", "freeze", "oom")  # what ends the messages of a process


class Fault(NamedTuple):
    """One fault, as it was injected."""

    kind: str
    target: str
    seconds: float  # it lasted; nan where something ended for good
    begin_ns: int  # on our clock
    end_ns: int
    jump_s: float = 0.0  # of the target's clock

    @property
    def name(self) -> str:
        return f"{self.kind} {self.target}"

    def concerns(self, side: str) -> bool:
        """Whether `side` was cut off from its peer by this, and lived to react."""
        other = {"master": "slave", "slave": "master"}[side]
        if self.kind == "cut":
            return self.target in ("both", f"to_{side}")
        return self.kind in SILENCING and self.target in (other, "impair")

    @property
    def disturbs(self) -> bool:
        """Whether an engagement may end by this."""
        return may_end_engagement(self.kind, self.target)


def may_end_engagement(kind: str, target: str) -> bool:
    """Return whether an engagement may end by a fault of this kind."""
    return kind not in ("descriptors", "wall") and target not in ("record", "view")


PLAN = (
    ("kill", "slave"),
    ("kill", "master"),
    ("kill", "impair"),
    ("kill", "record"),
    ("stop", "slave"),
    ("stop", "master"),
    ("stop", "impair"),
    ("stop", "record"),
    ("cut", "both"),
    ("cut", "to_slave"),
    ("cut", "to_master"),
    ("unplug", "master"),
    ("clock", "master"),
    ("clock", "slave"),
    ("freeze", "slave"),
    ("freeze", "master"),
    ("freeze", "record"),
    ("oom", "slave"),
    ("oom", "master"),
    ("oom", "record"),
    ("oom", "view"),
    ("descriptors", "slave"),
    ("descriptors", "master"),
    ("descriptors", "record"),
    ("wall", "slave"),
    ("wall", "master"),
)


def inject_fault(bench: FaultSession, kind: str, target: str, rng: np.random.Generator) -> Fault:
    """Do it, and undo it after a while."""
    seconds = float(rng.choice([0.08, 0.2, 0.5, 1.0]))
    if kind == "kill":
        begin = now_ns()
        bench.kill(target)
        seconds = np.nan
        pause(0.3)
        begin_again(bench, target)
    elif kind == "oom":
        begin = run_out_of_memory(bench, target)
        seconds = np.nan
        begin_again(bench, target)
    elif kind == "descriptors":
        begin = now_ns()
        bench.pull(target, "descriptors")
        with bench.look():  # somebody wants to join
            pause(1.0)
        seconds = 1e-9 * (now_ns() - begin)
        bench.pull(target, "free")
    elif kind == "wall":
        step = float(rng.choice([-86400.0, -3600.0, -1.0, 1.0, 3600.0, 86400.0]))
        begin, seconds = now_ns(), 1.0
        bench.pull(target, f"wall {step}")
        pause(seconds)
        bench.pull(target, f"wall {-step}")
        pause(0.5)
    elif kind == "clock":
        jump = float(rng.choice([-0.5, 0.5, 2.0]))
        begin = now_ns()
        bench.pull(target, f"clock {jump}")
        pause(max(-jump, 0.0) + 0.5)
        fault = Fault(kind, target, np.nan, begin, now_ns(), jump)
        pause(0.1)
        bench.kill(target)  # whose clock is set back is not believed again
        bench.begin(target)
        return fault
    elif kind in ("stop", "freeze"):
        if kind == "freeze":  # for longer than a connection is kept without a sign of life
            seconds = float(rng.choice([3.0, 12.0]))
        begin = now_ns()
        bench.signal(target, signal.SIGSTOP)
        pause(seconds)
        bench.signal(target, signal.SIGCONT)
    elif kind == "cut":
        begin = now_ns()
        bench.tell("cut", *(() if target == "both" else (target,)))
        pause(seconds)
        bench.tell("mend")
    elif kind == "unplug":
        begin = now_ns()
        bench.pull(target, "unplug")
        pause(seconds)
        bench.pull(target, "plug")
    else:
        raise ValueError(kind)
    return Fault(kind, target, seconds, begin, now_ns())


def begin_again(bench: FaultSession, target: str) -> None:
    """Start a process in the place of one that has ended."""
    files = len(bench.recordings())
    bench.begin(target)
    if target == "record":
        assert wait_for_condition(lambda: len(bench.recordings()) > files, 30.0), bench.outputs()


def run_out_of_memory(bench: FaultSession, target: str) -> int:
    """Have the kernel kill a process for want of memory; return when its last message was sent."""
    process = bench.running[target]
    with MemoryGroup() as group:
        group.add(process.pid)
        bench.pull(target, "hog")
        process.wait(60.0)
        assert process.returncode == -signal.SIGKILL, bench.outputs()
        assert group.kills == 1, "it was killed, but not for want of memory"
    return bench.last_stamp_ns(target) if target in ("master", "slave") else now_ns()
