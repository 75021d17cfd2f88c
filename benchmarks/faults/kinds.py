"""The faults: what each does, for how long, and which side has to react to it."""

import signal
from typing import NamedTuple

import numpy as np

from benchmarks.faults.bench import FaultSession
from teleop.app.launch.supervisor import wait_for
from teleop.clock import now_ns
from tests.system.processes import pause


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
        return self.kind in ("kill", "stop") and self.target in (other, "impair")


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
)


def inject(bench: FaultSession, kind: str, target: str, rng: np.random.Generator) -> Fault:
    """Do it, and undo it after a while."""
    seconds = float(rng.choice([0.08, 0.2, 0.5, 1.0]))
    if kind == "kill":
        begin = now_ns()
        bench.kill(target)
        seconds = np.nan
        pause(0.3)
        files = len(bench.recordings())
        bench.begin(target)
        if target == "record":
            assert wait_for(lambda: len(bench.recordings()) > files, 30.0), bench.outputs()
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
    else:
        back = seconds
        begin = now_ns()
        if kind == "stop":
            bench.signal(target, signal.SIGSTOP)
            pause(back)
            bench.signal(target, signal.SIGCONT)
        elif kind == "cut":
            ways = () if target == "both" else (target,)
            bench.tell("cut", *ways)
            pause(back)
            bench.tell("mend")
        elif kind == "unplug":
            bench.pull(target, "unplug")
            pause(back)
            bench.pull(target, "plug")
        else:
            raise ValueError(kind)
    return Fault(kind, target, seconds, begin, now_ns())
