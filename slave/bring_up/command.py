"""Bring up a rig of real hardware, step by step (docs/how-to/rigs.md).

  teleop rig scan                          list serial ports and CAN interfaces
  teleop rig scan --config my-rig.yaml     list what answers on the buses of a config
  teleop rig check --config my-rig.yaml    read rates, noise and signs; then, after a typed
                                           confirmation, move one motor at a time, a little
  teleop rig reset --config my-rig.yaml    reset the faults of the drives, their cause removed

Then calibrate: teleop calibrate --config my-rig.yaml
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np

from slave.bring_up.rig_check import (
    GatedRig,
    MotorMove,
    RestMeasurement,
    evaluate_move,
    find_outside,
    format_rest_measurement,
    measure_at_rest,
    move_motor,
    warm_up,
)
from slave.config import SlaveConfig
from slave.drivers import driver_table
from slave.drivers.driver import DriverFault
from slave.drivers.ports import describe_interfaces, explain_missing
from slave.gate import GateConfig
from slave.rig import Rig, RigFault
from slave.rigs import open_rig
from slave.rigs.hardware import HardwareRig, HardwareRigConfig
from slave.rigs.replayed_data import ReplayedRigConfig
from teleop.config.loading import ConfigDocument, load
from teleop.config.options import add_options
from teleop.errors import TeleopError, UsageError
from teleop.runtime.clock import Grid, Tick, now_ns, pause_garbage_collection
from teleop.runtime.compiling import announce_compilation
from teleop.runtime.process import parse_seconds
from teleop.runtime.realtime import request_realtime
from teleop.session.config import RunConfig

READ_S = 2.0  # [s]
COMPILE_S = 3.0  # [s] of a processor, without a cache
TRAVEL_MM, FORCE_N = 0.5, 2.0
TRAVEL_MAX_MM, FORCE_MAX_N = 5.0, 20.0
CONFIRMATION = "move"
CONVERTER_ENDS = {sign * (1 << bits) - (sign > 0) for bits in (15, 23) for sign in (1, -1)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `teleop rig`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    scan = actions.add_parser("scan", help="list what is on the buses; moves nothing")
    check = actions.add_parser("check", help="read, then move one motor at a time, a little")
    reset = actions.add_parser("reset", help="reset the faults of the drives")
    for action in (scan, check, reset):
        add_options(action, "--config", "--set", "--allow-imports")
    check.add_argument("--duration", type=parse_seconds, default=READ_S, help="of reading [s]")
    check.add_argument(
        "--travel", type=float, default=TRAVEL_MM, metavar="MM", help="of each motor (0.5)"
    )
    check.add_argument(
        "--force", type=float, default=FORCE_N, metavar="N", help="above rest; then it stops (2)"
    )
    check.add_argument("--read-only", action="store_true", help="do not ask, move nothing")


def main(args: argparse.Namespace) -> int:
    """Run a subcommand; returns the exit code."""
    if args.action == "check":
        return check_rig(args, input)
    if args.action == "scan" and args.config is None and not args.overrides:
        none = f"no serial port and no CAN interface{explain_missing()}"
        print("\n".join(list(describe_interfaces()) or [none]))
        return 0
    rig = require_hardware_config(load(args.config, SlaveConfig, "slave", args.overrides))
    buses = [rig.motors] if rig.cells is None else [rig.motors, rig.cells]
    silent = []
    try:
        for bus in buses:
            is_scan, count = args.action == "scan", 0
            motors = rig.motor_ids if bus is rig.motors else ()
            for line in driver_table.scan(bus) if is_scan else driver_table.reset(bus, motors):
                print(line, flush=True)
                count += 1
            if is_scan and not count:
                silent.append(bus.type)
    except DriverFault as fault:
        raise TeleopError(f"rig: {fault}") from fault
    if silent:
        raise TeleopError(
            f"rig: {' and '.join(silent)}: nothing answers: power, cable, numbers and baud or bit "
            "rate? (docs/how-to/rigs.md)"
        )
    return 0


def check_rig(args: argparse.Namespace, prompt: Callable[[str], str]) -> int:
    """Check the rig of a config; 1 if a motor or a cell does not answer as it should."""
    document = ConfigDocument.read(args.config, args.overrides)
    shared, config = document.load(RunConfig), document.load(SlaveConfig, "slave")
    if isinstance(config.rig, ReplayedRigConfig):
        raise UsageError("slave.rig.type: a replayed rig has no motors and sensors to check")
    move = parse_requested_move(args)
    if not args.read_only:
        with announce_compilation("the check", COMPILE_S):
            warm_up()  # else it would compile between a reading and the first target
    with ExitStack() as stack:
        if isinstance(config.rig, HardwareRigConfig):
            request_realtime(shared.realtime)  # before the rig: its processes inherit the priority
        rig = open_rig(config.rig, args.read_only)
        stack.callback(rig.close)
        start_ns, ticks = now_ns(), iter(Grid(shared.rate_hz, lambda: False))
        try:
            rest = measure_at_rest(rig, ticks, start_ns, args.duration)
            print(
                "\n".join(
                    [
                        *format_rest_measurement(rest, config.gate),
                        *format_counts(rig),
                        *(f"{key}: {value}" for key, value in rig.summarise().items()),
                    ]
                )
            )
            if args.read_only:
                return 0
            require_readings(rest, config.gate)
            if saturated := find_saturated(rig):
                raise TeleopError(
                    f"rig: the cell of tendon {saturated[0] + 1} is saturated (see above), so "
                    "nothing is moved: no tension could stop it"
                )
            print(
                f"Next, each motor pulls by {args.travel:g} mm and returns, at most "
                f"{args.force:g} N above its tension now. Keep clear of the rig."
            )
            if prompt(f"Type '{CONFIRMATION}' to go on: ").strip() != CONFIRMATION:
                print("nothing was moved")
                return 0
            with pause_garbage_collection():  # a collection takes 0.1 to 0.6 s; drivers wait 0.2 s
                rest = measure_at_rest(rig, ticks, start_ns, args.duration)  # nobody read meanwhile
                require_readings(rest, config.gate)
                return move_all_motors(rig, config, ticks, start_ns, rest, move)
        except RigFault as fault:
            raise TeleopError(f"rig: {fault}") from fault


def move_all_motors(
    rig: Rig,
    config: SlaveConfig,
    ticks: Iterator[Tick],
    start_ns: int,
    rest: RestMeasurement,
    move: MotorMove,
) -> int:
    """Move one motor after the other; stops at the first that does not answer as it should."""
    mover = GatedRig(rig, config.gate, ticks, start_ns, rest)
    mover.enable()
    for tendon in range(rig.tendons):
        result = move_motor(mover, rest, tendon, move)
        is_right, text = evaluate_move(result, rest)
        print(text, flush=True)
        if not is_right:
            return 1
    print("all motors and cells answer; next: teleop calibrate")
    return 0


def require_readings(rest: RestMeasurement, limits: GateConfig) -> None:
    """Raise `TeleopError` unless every tendon gives its tension, and its place within the gate."""
    if not np.all(np.isfinite([rest.displacement, rest.tension])):
        raise TeleopError("rig: a tendon gives no reading, so nothing is moved")
    if find_outside(rest, limits):
        raise TeleopError("rig: a tendon is outside slave.gate (see above), so nothing is moved")


def parse_requested_move(args: argparse.Namespace) -> MotorMove:
    """Return the move that was asked for; `UsageError` if it is not a small one."""
    if not 0.0 < args.travel <= TRAVEL_MAX_MM:
        raise UsageError(f"--travel {args.travel:g}: must be above 0, at most {TRAVEL_MAX_MM:g} mm")
    if not 0.0 < args.force <= FORCE_MAX_N:
        raise UsageError(f"--force {args.force:g}: must be above 0, at most {FORCE_MAX_N:g} N")
    return MotorMove(args.travel * 1e-3, args.force)


def require_hardware_config(config: SlaveConfig) -> HardwareRigConfig:
    """Return the rig's config; `UsageError` if it has no buses."""
    if not isinstance(config.rig, HardwareRigConfig):
        raise UsageError(
            f"slave.rig.type: {config.rig.type} has no buses; {{type: hardware, ...}} is needed "
            "(docs/how-to/rigs.md, and configs/ to start from)"
        )
    return config.rig


def format_counts(rig: Rig) -> list[str]:
    """Return what the buses of a hardware rig gave last, for `zero`, `offset` and `scale`."""
    if not isinstance(rig, HardwareRig) or rig.counts is None:
        return []
    saturated = find_saturated(rig)
    return [
        f"tendon {k + 1}: motor at {position:.0f}, cell at {cell:.7g} counts"
        + ", the end of its converter's range: overloaded, or a wire is off?" * (k in saturated)
        for k, (position, cell) in enumerate(zip(*map(np.ndarray.tolist, rig.counts), strict=True))
    ]


def find_saturated(rig: Rig) -> list[int]:
    """Return the tendons, from 0, whose cell is at an end of a converter of 16 or 24 bits."""
    if not isinstance(rig, HardwareRig) or rig.counts is None:
        return []
    return [k for k, count in enumerate(rig.counts[1].tolist()) if count in CONVERTER_ENDS]
