"""The main job of each driver: calibrate, run, e-stop, kill, unplug, drive fault.

  python -m benchmarks.rigs.jobs [DRIVER ...] [--motors 1 4] [--skip calibrate]

Commands of the project as processes; the simulated plant is behind the motors, so tensions are
those of sheaths with friction. A line for each: what was expected, what came, in which time.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.rigs.bench import TRUE_K, Model, write_config
from slave.calibration import file
from teleop.app.launch.supervisor import wait_for
from tests.system.processes import START_S, Processes

DRIVERS = ("microcontroller", "dynamixel", "cia402")
MODEL_TENDON = [{"effective_friction": TRUE_K, "tension_noise": 0.01}]
ATTEMPTS = 3
RUN_S = 5.0
TRAVEL = 200.0  # [counts] a motor must have moved in a run
WATCHDOG_S = 0.050


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drivers", nargs="*", default=DRIVERS)
    parser.add_argument("--motors", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--skip", nargs="*", default=[])
    args = parser.parse_args()
    failed = 0
    for driver in args.drivers:
        for motors in args.motors:
            for name, job in JOBS.items():
                if name in args.skip:
                    continue
                text = attempt(job, driver, motors)
                failed += text.startswith("FAILED")
                print(f"{driver:16} {motors} motors  {name:12} {text}", flush=True)
    return 1 if failed else 0


def attempt(job: Callable[[str, int, Path], str], driver: str, motors: int) -> str:
    """Run a job, again if it fails: a busy machine holds up models and loops."""
    reasons = []
    while len(reasons) < ATTEMPTS:
        with tempfile.TemporaryDirectory() as folder:
            try:
                text = job(driver, motors, Path(folder))
            except (AssertionError, OSError, ValueError) as error:
                reasons.append(" ".join(str(error).split())[-200:])
                continue
        return text + (f" (after {len(reasons)} failed: {reasons[-1]})" if reasons else "")
    return f"FAILED: {' | '.join(reasons)}"


def calibrate(driver: str, motors: int, folder: Path) -> str:
    """Find the sheaths by the quick procedure."""
    with Model(driver, motors, "tendons") as model:
        config = write_config(folder / "rig.yaml", model.buses, motors)
        out = folder / "calibration.yaml"
        words = ["calibrate", "--config", str(config), "--quick", "--together", "--out", str(out)]
        began_s = time.monotonic()
        ended = subprocess.run(
            [sys.executable, "-m", "teleop", *words], capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr.splitlines()[-1:]
        found = file.load(out).directions
    worst = max(abs(one.K.value - TRUE_K) for one in found)
    return f"K within {worst / TRUE_K:.1%} of the truth in {time.monotonic() - began_s:.0f} s"


class Session:
    """A model, a slave and a master, engaged."""

    def __init__(self, driver: str, motors: int, folder: Path) -> None:
        self.model = Model(driver, motors, "tendons")
        config = write_config(folder / "rig.yaml", self.model.buses, motors, tendons=MODEL_TENDON)
        self.processes = Processes(folder, config)

    def __enter__(self) -> "Session":
        try:
            self._engage()
        except AssertionError:
            self.__exit__()
            raise
        return self

    def _engage(self) -> None:
        self.slave = self.processes.start("slave", "--json", str(self.processes.folder / "s.json"))
        self.processes.start("master")
        with self.processes.look() as link:

            def over() -> bool:
                return self.slave.poll() is not None

            wait_for(lambda: self.processes.engaged(link) or over(), START_S)
            assert not over(), self.processes.outputs()
        assert wait_for(lambda: all(self.state()["moving"]), 5.0), "the motors are not enabled"

    def __exit__(self, *_: object) -> None:
        self.processes.__exit__()
        self.model.__exit__()

    def state(self) -> dict:
        return self.model.order()

    def stopped_after(self, since_s: float) -> float:
        """Wait until no motor moves; return how long that took [s]."""
        assert wait_for(lambda: not any(self.state()["moving"]), 5.0), "the motors are not stopped"
        return self.state()["stopped_s"] - since_s

    def drivers(self) -> list[int]:
        """Return the process ids of the slave's drivers."""
        children = Path(f"/proc/{self.slave.pid}/task/{self.slave.pid}/children").read_text()
        return [int(word) for word in children.split()]

    def ends_with(self, *said: str) -> str:
        """Wait until the slave has ended in a fault; return its last line."""
        code = self.slave.wait(10.0)
        lines = self.processes.outputs().splitlines()
        faults = [line for line in lines if line.startswith("teleop: rig: ")]
        assert code == 1, f"exit code {code}"
        assert faults, lines[-3:]
        assert any(word in faults[-1] for word in said), faults[-1]
        return faults[-1].removeprefix("teleop: rig: ")


def run(driver: str, motors: int, folder: Path) -> str:
    """Follow the hand."""
    with Session(driver, motors, folder) as session:
        positions = []
        until_s = time.monotonic() + RUN_S
        while time.monotonic() < until_s:
            positions.append(session.state()["position"][0])
            time.sleep(0.02)
        assert session.processes.stop("slave") == 0, session.processes.outputs()
        summary = session.processes.summary("s")
    moved = max(positions) - min(positions)
    assert moved > TRAVEL, f"motor 1 moved by {moved:.0f} counts"
    told = ", ".join(f"{key} {value}" for key, value in summary["rig"].items())
    return f"motor 1 moved by {moved:.0f} counts; {told}"


def e_stop(driver: str, motors: int, folder: Path) -> str:
    """Stop by `teleop stop`, reset, engage again."""
    with Session(driver, motors, folder) as session:
        called_s = time.monotonic()
        session.processes.start("stop").wait(20.0)
        took_s = session.stopped_after(called_s)
        session.processes.start("stop", "--reset").wait(20.0)
        again = wait_for(lambda: all(session.state()["moving"]), 8.0)
        alive = session.slave.poll() is None
    assert alive, "the slave has ended"
    assert again, "the motors do not move after the reset"
    return f"motors off {took_s * 1e3:.0f} ms after the command began, moving again after the reset"


def kill(driver: str, motors: int, folder: Path) -> str:
    """Kill the slave: its drivers notice and stop the motors."""
    with Session(driver, motors, folder) as session:
        killed_s = time.monotonic()
        os.kill(session.slave.pid, signal.SIGKILL)
        return f"motors stopped {session.stopped_after(killed_s) * 1e3:.0f} ms after SIGKILL"


def kill_all(driver: str, motors: int, folder: Path) -> str:
    """Kill the slave and its drivers: the motors' own watchdogs stop them."""
    with Session(driver, motors, folder) as session:
        processes = [*session.drivers(), session.slave.pid]
        killed_s = time.monotonic()
        for process in processes:
            os.kill(process, signal.SIGKILL)
        took_s = session.stopped_after(killed_s)
    assert took_s < WATCHDOG_S, f"motors stopped only {took_s * 1e3:.0f} ms after SIGKILL"
    return f"motors stopped by their watchdog {took_s * 1e3:.0f} ms after SIGKILL"


def unplug(driver: str, motors: int, folder: Path) -> str:
    """Unplug the adapter."""
    with Session(driver, motors, folder) as session:
        session.model.order("unplug")
        return session.ends_with("unplugged", "silent", "no answer")


def fault(driver: str, motors: int, folder: Path) -> str:
    """Have the first drive fail."""
    with Session(driver, motors, folder) as session:
        session.model.order("fault")
        return session.ends_with("fault", "hardware error")


JOBS = {
    "calibrate": calibrate,
    "run": run,
    "e-stop": e_stop,
    "kill": kill,
    "kill all": kill_all,
    "unplug": unplug,
    "fault": fault,
}

if __name__ == "__main__":
    sys.exit(main())
