"""Achieved rates and processor time of each driver for 1, 2, 4 and 8 motors.

  python -m studies.rigs.rates [--drivers DRIVER ...] [--motors 1 2 4 8] [--seconds 5]

The rig is opened without a session and read and written at 1 kHz. On a pty the line itself takes no
time: the bound of the real line is computed from its bits and stands beside the measurement. The
processor time is that of the driver's process alone. Takes 2 minutes.
"""

import time

import numpy as np

from slave.config import SlaveConfig
from slave.drivers.cia402.config import compute_bus_load
from slave.rig import RigFault
from slave.rigs.hardware import HardwareRig
from studies.rigs.bench import Model, build_rig_tree
from studies.testbed.command import parse_options
from studies.testbed.processes import read_processor_s
from teleop.config.loading import load
from teleop.runtime.realtime import request_realtime

DRIVERS = ("microcontroller", "dynamixel", "cia402")
ASKED_HZ = {"microcontroller": 1000.0, "dynamixel": 500.0, "cia402": 500.0}
BAUD = 4e6  # of the servos


def main() -> None:
    args = parse_options(
        __doc__,
        drivers=(DRIVERS, "to measure"),
        motors=((1, 2, 4, 8), "numbers of them"),
        seconds=(5.0, "of each row"),
    )
    request_realtime()
    print("driver           motors  asked Hz  samples Hz  longest gap ms  CPU %  line allows Hz")
    for driver in args.drivers:
        for motors in args.motors:
            try:
                text = measure_rates(driver, motors, args.seconds)
            except RigFault as fault:
                text = f"fault: {fault}"
            print(f"{driver:16} {motors:6}  {text}", flush=True)


def measure_rates(driver: str, motors: int, seconds: float) -> str:
    """Run a rig for a while; return rates and processor time as text."""
    asked = ASKED_HZ[driver] if driver != "cia402" or motors <= 7 else 400.0
    with Model(driver, motors, "springs") as model:
        buses = model.buses
        if driver == "dynamixel":
            buses["motors"]["rate_hz"] = asked
        tree = build_rig_tree(buses, motors, paired=False)
        config = load(None, SlaveConfig, "slave", [f"slave.rig={tree}"])
        rig = HardwareRig(config.rig)
        try:
            run_rig(rig, 1.0)
            before = read_processor_s(rig.buses[0].pid)
            times = run_rig(rig, seconds)
            used = (read_processor_s(rig.buses[0].pid) - before) / seconds
        finally:
            rig.close()
    gaps = np.diff(times)
    return (
        f"{asked:8.0f}  {1.0 / gaps.mean():10.0f}  {gaps.max() * 1e3:14.1f}  {used:5.0%}"
        f"  {compute_line_bound(driver, motors):14.0f}"
    )


def run_rig(rig: HardwareRig, seconds: float) -> np.ndarray:
    """Read and write at 1 kHz where the motors are; return the times of the samples [s]."""
    times, target = [], None
    due_s = time.monotonic()
    until_s = due_s + seconds
    while due_s < until_s:
        for sample in rig.read(0.0):
            times.append(sample.time_s)
            target = sample.proximal_displacement if target is None else target
        if target is not None:
            rig.write(target)
        due_s += 0.001
        time.sleep(max(0.0, due_s - time.monotonic()))
    return np.array(times)


def compute_line_bound(driver: str, motors: int) -> float:
    """Return the highest rate [Hz] that the bits of the line allow."""
    if driver == "cia402":
        loads = [compute_bus_load(1e6, hz, motors, motors, motors, wide=False) for hz in (0.0, 1.0)]
        return (1.0 - loads[0]) / (loads[1] - loads[0])
    if driver == "dynamixel":
        # sync read 14 + n bytes, answers of 11 + 16, sync write of 14 + 5 n, 10 bits a byte
        return BAUD / 10.0 / (14 + motors + 27 * motors + 14 + 5 * motors)
    return 12e6 / 10.0 / (2 * (8 + 7 + 4 + 2) + 12 * motors)  # USB full speed, both directions


if __name__ == "__main__":
    main()
