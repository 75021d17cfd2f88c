"""Faults of a session: what each does, for how long, and which side has to react to it."""

import os
import signal
from pathlib import Path
from typing import NamedTuple

import numpy as np

from studies.faults.session import FaultSession
from studies.testbed.processes import pause, wait_for_condition
from teleop.runtime.clock import now_ns

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
    """Inject a fault of a kind into a process, and undo it after a while."""
    seconds = float(rng.choice([0.08, 0.2, 0.5, 1.0]))
    if kind == "kill":
        begin = now_ns()
        bench.kill(target)
        seconds = np.nan
        pause(0.3)
        restart_process(bench, target)
    elif kind == "oom":
        begin = run_out_of_memory(bench, target)
        seconds = np.nan
        restart_process(bench, target)
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


def restart_process(bench: FaultSession, target: str) -> None:
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
