"""A slave and a master on a model of a bus: engaged, watched from both ends, engaged anew."""

import os
import subprocess
import sys
import time
from pathlib import Path

from studies.rigs.bench import BUS, Model
from studies.testbed.processes import START_S, Processes, wait_for_condition
from teleop.messages.messages import Hand
from teleop.messages.topics import HAND
from teleop.session.state_machine import State

# --- a network namespace of this process's own, in which CAN runs over UDP multicast

GROUP = "239.74.163.2"
_INSIDE = "TELEOP_CAN_NAMESPACE"
_COMMANDS = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo"


def enter_namespace() -> None:
    """Start this command again in a namespace of its own, unless it runs in one.

    Its loopback carries multicast; nothing leaves the machine, and nothing of it comes in. It is
    gone when the command ends.
    """
    os.environ[BUS] = f"udp_multicast,{GROUP}"
    if _INSIDE in os.environ:
        return
    command = f'{_COMMANDS} && exec "$@"'
    ended = subprocess.run(
        ["unshare", "--net", "sh", "-c", command, "sh", *sys.orig_argv],
        env=os.environ | {_INSIDE: "1"},
        check=False,
    )
    sys.exit(ended.returncode)


MOVING_S = 5.0  # [s] in which motors must move, or stop
END_S = 10.0  # [s] in which a slave with a fault must end


class Session:
    """A slave and a master on a model; `engage` starts them."""

    def __init__(self, model: Model, config: Path) -> None:
        self.model = model
        self.config = config
        self.processes: Processes | None = None
        self._sessions = 0

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        if self.processes is not None:
            self.processes.__exit__()

    def engage(self) -> None:
        """Start slave and master, until forces are felt and the motors move."""
        self.__exit__()
        self._sessions += 1
        folder = self.config.parent / str(self._sessions)
        folder.mkdir()
        self.processes = Processes(folder, self.config)
        self.slave = self.processes.start("slave", "--json", str(folder / "s.json"))
        self.processes.start("master")
        with self.processes.look() as link:

            def over() -> bool:
                return self.slave.poll() is not None

            wait_for_condition(lambda: self.processes.engaged(link) or over(), START_S)
            assert not over(), self.read_fault() or self.processes.outputs()[-300:]
        assert wait_for_condition(self.all_move, MOVING_S), "the motors are not enabled"

    def all_move(self) -> bool:
        """Return whether every motor is enabled."""
        return all(self.model.order()["moving"])

    def follow(self, duration_s: float) -> tuple[float, float]:
        """Watch for a while; return the travel of motor 1 [counts], the greatest force felt [N]."""
        positions, forces = [], [0.0]
        until_s = time.monotonic() + duration_s
        with self.processes.look() as link:
            while time.monotonic() < until_s:
                positions.append(self.model.order()["position"][0])
                hand = link.take_latest(HAND).message
                if isinstance(hand, Hand):
                    forces.append(max(map(abs, hand.force)))
                time.sleep(0.02)
        return max(positions) - min(positions), max(forces)

    def await_stop(self) -> float:
        """Wait until the master says that the session is stopped; return when it said so [s]."""
        with self.processes.look() as link:

            def stopped() -> bool:
                hand = link.take_latest(HAND).message
                return isinstance(hand, Hand) and hand.state == State.STOPPED

            assert wait_for_condition(stopped, START_S, poll_s=0.001), "the session is not stopped"
            return time.monotonic()

    def measure_stop(self, since_s: float) -> float:
        """Wait until no motor moves; return how long that took [s]."""
        stopped = wait_for_condition(lambda: not any(self.model.order()["moving"]), MOVING_S)
        assert stopped, "the motors are not stopped"
        return self.model.order()["stopped_s"] - since_s

    def list_drivers(self) -> list[int]:
        """Return the process ids of the slave's drivers."""
        found = []
        for entry in Path("/proc").glob("[0-9]*/stat"):
            try:
                parent = int(entry.read_text().rpartition(")")[2].split()[1])
                command = (entry.parent / "cmdline").read_bytes()
            except OSError:  # it has ended
                continue
            if parent == self.slave.pid and b"slave.drivers.worker" in command:
                found.append(int(entry.parent.name))
        return found

    def read_fault(self) -> str:
        """Return the last fault of the rig that the slave has printed, without its prefix."""
        lines = self.processes.outputs().splitlines()
        faults = [line for line in lines if line.startswith("teleop: ")]
        return faults[-1].removeprefix("teleop: ").removeprefix("rig: ") if faults else ""

    def await_fault(self, *words: str) -> str:
        """Wait until the slave has ended in a fault that says one of the words; return it."""
        code = self.slave.wait(END_S)
        assert code in (1, 2), f"exit code {code}"
        said = self.read_fault()
        assert any(word in said for word in words), said
        return said

    def require_refusal(self, *words: str) -> str:
        """Start a slave alone; it must refuse the rig with one of the words."""
        folder = self.config.parent / f"{self._sessions}-refused"
        folder.mkdir()
        with Processes(folder, self.config) as processes:
            slave = processes.start("slave")
            assert slave.wait(START_S) in (1, 2)
            said = processes.outputs()
        assert any(word in said for word in words), said[-300:]
        return said

    def run_command(self, *words: str) -> str:
        """Run a command of the project on the config; return what it prints."""
        with self.start(*words) as process:
            said, complaint = process.communicate()
        assert process.returncode == 0, (complaint or said).splitlines()[-1:]
        return said.strip()

    def start(self, *words: str) -> "subprocess.Popen[str]":
        """Start a command of the project on the config."""
        return subprocess.Popen(
            [sys.executable, "-m", "teleop", *words, "--config", str(self.config)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
