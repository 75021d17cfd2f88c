"""The main job of each driver, from its calibration to every way in which it can fail.

  python -m studies.rigs.jobs [--drivers DRIVER ...] [--motors 1 4] [--only JOB ...]
  python -m studies.rigs.jobs --drivers cia402 --multicast      CAN in UDP, in a network namespace

Commands of the project as processes; the simulated plant is behind the motors, so tensions are
those of sheaths with friction. Prints a line for each job: pass or fail, and figures. The exit code
is 1 if one fails. Takes 20 minutes.
"""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from slave.calibration import calibration_file
from slave.tendon_config import TendonConfig
from studies.rigs import session
from studies.rigs.bench import TRUE_K, Model, write_config
from studies.rigs.session import Session
from studies.testbed.command import parse_options
from studies.testbed.processes import START_S, wait_for_condition

DRIVERS = ("microcontroller", "dynamixel", "cia402")
RUN_S = 5.0
TRAVEL_MIN = 200.0  # [counts] a motor must have moved in a run
FORCE_MIN = 0.1  # [N] the hand must have felt
K_ERROR_MAX = 0.05  # relative, of the calibration
RATE_MIN = 0.95  # of the rate that was asked for
RATE_HZ = {"microcontroller": 1000.0, "dynamixel": 250.0, "cia402": 500.0}
WATCHDOG_S = 0.050
ENGAGE_S = 30.0  # of a command to start, and of the hand to engage again
CALIBRATING_S = (0.3, 3.0, 8.0)  # after the motors were enabled
IN_MOTION_S = 0.050  # since a motor last moved by a count; a slow pull takes 10 ms for one
STILL_S = 1.0  # in which nothing may move by itself

FAULTS = {
    "microcontroller": ("fault of its motors",),
    "dynamixel": ("hardware error: overload",),
    "cia402": ("following error",),
}
SILENT = ("unplugged", "silent", "no answer")


def main() -> int:
    """Return the exit code."""
    args = parse_options(
        __doc__,
        drivers=(DRIVERS, "to try"),
        motors=((1, 4), "numbers of them"),
        only=(tuple(JOBS), "jobs"),
        attempts=(1, "of each job, on a busy machine"),
        multicast=(False, "CAN over UDP multicast"),
    )
    if args.multicast:
        session.enter_namespace()
    print(f"{'driver':16} {'motors':>6}  {'job':14} result")
    failed = 0
    for driver in args.drivers:
        for motors in args.motors:
            for name in args.only:
                passed, text = attempt_job(JOBS[name], driver, motors, args.attempts)
                failed += not passed
                word = "pass" if passed else "FAIL"
                print(f"{driver:16} {motors:6}  {name:14} {word}  {text}", flush=True)
    print(f"{failed} failed" if failed else "all passed")
    return 1 if failed else 0


def attempt_job(job: "Job", driver: str, motors: int, attempts: int) -> tuple[bool, str]:
    """Run a job, again if it fails; return whether it passed, and its figures or the reasons."""
    reasons: list[str] = []
    while len(reasons) < attempts:
        try:
            text = perform_job(job, driver, motors)
        except (AssertionError, OSError, ValueError) as error:
            reasons.append(" ".join(str(error).split())[-250:])
            continue
        return True, text + "".join(f" (attempt {k + 1}: {r})" for k, r in enumerate(reasons))
    return False, " | ".join(reasons)


def perform_job(job: "Job", driver: str, motors: int) -> str:
    """Run a job on a model of its own; return its figures."""
    with tempfile.TemporaryDirectory() as folder, Model(driver, motors, "tendons") as model:
        config = write_config(Path(folder) / "rig.yaml", model.buses, motors)
        with Session(model, config) as session:
            return job(session, driver)


def calibrate_sheaths(session: Session, driver: str) -> str:
    """Find the sheaths by the quick procedure, and run with what was found."""
    out = session.config.parent / "calibration.yaml"
    began_s = time.monotonic()
    session.run_command("calibrate", "--quick", "--together", "--out", str(out))
    took_s = time.monotonic() - began_s
    found = calibration_file.load(out).directions
    worst = max(abs(one.K.value - TRUE_K) for one in found) / TRUE_K
    assert worst < K_ERROR_MAX, f"K is {worst:.1%} off the truth"
    return f"K within {worst:.1%} of the truth, {took_s:.0f} s"


def follow_hand(session: Session, driver: str) -> str:
    """Follow the hand, which feels forces."""
    session.engage()
    moved, force = session.follow(RUN_S)
    assert session.processes.stop("slave") == 0, session.processes.outputs()[-300:]
    rig = session.processes.summary("s")["rig"]
    assert moved > TRAVEL_MIN, f"motor 1 moved by {moved:.0f} counts"
    assert force > FORCE_MIN, f"the hand felt {force:.2f} N"
    rate_hz = rig["motors_rate_hz"]
    assert rate_hz > RATE_MIN * RATE_HZ[driver], f"{rate_hz:g} Hz of {RATE_HZ[driver]:g}"
    losses = ", ".join(f"{k} {v}" for k, v in rig.items() if "lost" in k or "bad" in k)
    return f"{rate_hz:g} Hz, {losses}, late {rig['late']}; {moved:.0f} counts, {force:.1f} N felt"


def stop_session(session: Session, driver: str) -> str:
    """Stop by `teleop stop`, reset, engage again."""
    session.engage()
    session.processes.start("stop")
    took_s = session.measure_stop(session.await_stop())
    assert took_s <= WATCHDOG_S, f"stopped only {took_s * 1e3:.0f} ms after the master was"
    require_still(session)
    session.processes.start("stop", "--reset")
    assert wait_for_condition(session.all_move, ENGAGE_S), "the motors do not move after the reset"
    assert session.slave.poll() is None, session.read_fault()
    return f"stopped {took_s * 1e3:.0f} ms after the master was; engaged again after the reset"


def kill_session_slave(session: Session, driver: str) -> str:
    """Kill the slave: its drivers notice and stop the motors."""
    return kill_slave(session, [])


def kill_with_drivers(session: Session, driver: str) -> str:
    """Kill the slave and its drivers: the motors' own watchdogs stop them."""
    return kill_slave(session, ["drivers"])


def kill_slave(session: Session, also: list[str]) -> str:
    """Kill the slave, perhaps its drivers first; then start anew."""
    session.engage()
    processes = [*(session.list_drivers() if also else []), session.slave.pid]
    assert len(processes) > len(also), "no driver's process"
    killed_s = time.monotonic()
    for process in processes:
        os.kill(process, signal.SIGKILL)
    took_s = session.measure_stop(killed_s)
    moved_s = session.model.order()["moved_s"] - killed_s
    said = f"last motion {moved_s * 1e3:.0f} ms, stopped {took_s * 1e3:.0f} ms after SIGKILL"
    # a driver that lives on holds the motors by a last target, and leaves them to their watchdogs
    assert took_s >= 0.0, said
    assert (took_s if also else moved_s) <= WATCHDOG_S, said
    require_still(session)
    session.engage()
    return f"{said}; engaged anew"


def kill_calibration(session: Session, driver: str) -> str:
    """Kill a calibration at several moments: the motors stop, and the earlier file stays."""
    out = session.config.parent / "calibration.yaml"
    calibration_file.save(
        out, calibration_file.Calibration(tendons=(TendonConfig(effective_friction=TRUE_K),))
    )
    earlier, times = out.read_bytes(), []
    for moment_s in CALIBRATING_S:
        process = session.start("calibrate", "--quick", "--together", "--out", str(out))
        try:
            assert wait_for_condition(session.all_move, START_S), "the motors are not enabled"
            time.sleep(moment_s)
            assert process.poll() is None, "the calibration has ended by itself"
        finally:
            killed_s = time.monotonic()
            process.kill()
            process.wait()
        session.measure_stop(killed_s)
        times.append(session.model.order()["moved_s"] - killed_s)
        require_still(session)
        assert out.read_bytes() == earlier, "the earlier calibration has changed"
    return f"{require_stopped(times)}; the earlier file is as it was"


def require_stopped(last_motions_s: Sequence[float]) -> str:
    """Fail unless motors stopped soon after each SIGKILL, and at one of them were in motion.

    Parameters
    ----------
    last_motions_s : sequence of float
        Time of the last motion after each SIGKILL [s]; negative before it.
    """
    times = ", ".join(f"{1e3 * time_s:.0f}" for time_s in last_motions_s)
    said = f"last motion {times} ms after SIGKILL"
    assert max(last_motions_s) <= WATCHDOG_S, said
    assert max(last_motions_s) > -IN_MOTION_S, f"{said}: no motor was in motion at any of them"
    return said


def kill_driver(session: Session, driver: str) -> str:
    """Kill the drivers alone: the motors stop, the slave says so and ends."""
    session.engage()
    processes = session.list_drivers()
    killed_s = time.monotonic()
    for process in processes:
        os.kill(process, signal.SIGKILL)
    took_s = session.measure_stop(killed_s)
    assert 0.0 <= took_s <= WATCHDOG_S, f"stopped only {took_s * 1e3:.0f} ms after SIGKILL"
    return f"stopped {took_s * 1e3:.0f} ms after SIGKILL: {session.await_fault('has ended')}"


def unplug_adapter(session: Session, driver: str) -> str:
    """Unplug the adapter, and plug it in again: nothing moves until a new session engages."""
    session.engage()
    unplugged_s = time.monotonic()
    session.model.order("unplug")
    took_s = session.measure_stop(unplugged_s)
    said = session.await_fault(*SILENT)
    assert 0.0 <= took_s <= WATCHDOG_S, f"stopped only {took_s * 1e3:.0f} ms after"
    session.model.order("plug")
    require_still(session)
    session.engage()
    return f"stopped {took_s * 1e3:.0f} ms after: {said}; engaged anew"


def fail_motor(session: Session, driver: str) -> str:
    """Have the first motor fail: refused until the operator resets it, then engaged anew."""
    session.engage()
    failed_s = time.monotonic()
    session.model.order("fault")
    said = session.await_fault(*FAULTS[driver])
    took_s = session.measure_stop(failed_s)
    session.require_refusal(*FAULTS[driver], "has a fault")
    require_still(session)
    session.model.order("repair")
    session.run_command("rig", "reset")
    require_still(session)
    session.engage()
    return f"all stopped {took_s * 1e3:.0f} ms after: {said}; refused, reset, engaged anew"


def require_still(session: Session) -> None:
    """Fail if a motor moves by itself."""
    moved = wait_for_condition(lambda: any(session.model.order()["moving"]), STILL_S)
    assert not moved, "a motor moves by itself"


Job = Callable[[Session, str], str]
JOBS: dict[str, Job] = {
    "calibrate": calibrate_sheaths,
    "run": follow_hand,
    "e-stop": stop_session,
    "kill": kill_session_slave,
    "kill all": kill_with_drivers,
    "kill driver": kill_driver,
    "kill calibrate": kill_calibration,
    "unplug": unplug_adapter,
    "fault": fail_motor,
}

if __name__ == "__main__":
    sys.exit(main())
