"""Calibrate a rig: pull each joint against its stops, and read friction and stiffness off that.

  teleop calibrate --config configs/paper-joint.yaml            writes paper-joint-calibration.yaml
  teleop calibrate --config configs/paper-joint.yaml --quick --figure loops.png
  teleop calibrate --config my-arm.yaml --joint 3 --out my-arm-calibration.yaml

Keep the tips free: each joint is pulled to both of its stops, up to slave.initialise.tension. Give
length and stiffness of the sheaths (slave.initialise.sheaths) and the joints' range
(slave.initialise.range) where you know them; then something in the way of a tip is found out.

Give the file to `teleop run --calibration`, or name it in the config (slave.calibration).
Calibrate again when the sheaths have been moved.
How it works, and what each refusal means: docs/calibration.md.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from slave.calibration import file
from slave.calibration.file import Calibration, Direction, Value
from slave.calibration.initialise import Initialised, initialise
from slave.calibration.refusals import tendon_name
from slave.calibration.run import Progress, fast_ticks
from slave.config import SlaveConfig
from slave.rig import Rig
from slave.rigs import open_rig
from slave.rigs.replayed import ReplayedRigConfig
from slave.rigs.simulated.simulated import SimulatedRigConfig
from teleop.clock import Grid, Tick, now_ns
from teleop.config import load
from teleop.errors import UsageError
from teleop.options import add_option, add_options
from teleop.process import Stop, destination
from teleop.realtime import go_realtime
from teleop.run_config import RunConfig

BAR = 24  # characters
SHOWN_EVERY_S = 0.1  # [s] of the rig's time
NOTED_EVERY_S = 10.0  # [s] likewise, where the output is no terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop calibrate`."""
    add_options(parser, "--config", "--set")
    add_option(parser, "--quick", "one loop in place of three, under 20 s a joint")
    parser.add_argument(
        "--joint",
        type=int,
        action="append",
        default=[],
        metavar="N",
        help="only this joint, counted from 1; needs an earlier file for the others",
    )
    parser.add_argument(
        "--together",
        action="store_true",
        help="all joints at once; only where they cannot touch each other or anything else",
    )
    parser.add_argument(
        "--out",
        type=destination,
        metavar="FILE",
        help="the calibration (default <rig name>-calibration.yaml)",
    )
    parser.add_argument(
        "--figure",
        type=destination,
        metavar="FILE.png",
        help="draw tension over motor travel, as in figure 6 of the paper",
    )


def main(args: argparse.Namespace) -> int:
    """Calibrate; returns the exit code."""
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, SlaveConfig, "slave", args.overrides)
    if isinstance(config.rig, ReplayedRigConfig):
        raise UsageError(
            "slave.rig.type: replayed data cannot be moved; fit them instead: "
            "teleop estimate DATA --fit --save FILE"
        )
    stop = Stop()
    with ExitStack() as stack:
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        out = args.out or destination(f"{rig.name}-calibration.yaml")
        joints = chosen(args.joint, len(rig.joints))
        replaced = replaceable(out, args.config)
        require_other(args.figure, (out, args.config))
        earlier = replaced or earlier_file(config, needed=bool(joints))
        start_ns, ticks = pace(config, shared)
        found = initialise(
            rig,
            config,
            ticks,
            start_ns,
            quick=args.quick,
            joints=joints,
            together=args.together,
            earlier=earlier,
            stopped=lambda: f"{stop.reason}: stopped, nothing is written" if stop() else "",
            progress=shown(rig) if sys.stderr.isatty() else noted(rig),
        )
        if sys.stderr.isatty():
            print(file=sys.stderr)
    file.save(out, found.calibration)
    if args.figure is not None:
        draw(args.figure, found)
    print("\n".join(format_report(found, out, replaced)))
    return 0


def chosen(numbers: list[int], count: int) -> tuple[int, ...]:
    """Return the joints asked for, counted from 0."""
    for number in numbers:
        if not 1 <= number <= count:
            raise UsageError(f"--joint {number}: the rig has joints 1 to {count}")
    return tuple(sorted({number - 1 for number in numbers}))


def replaceable(out: Path, config: Path | None) -> Calibration | None:
    """Return the calibration that `out` holds, which is to be replaced; None if there is no file.

    Anything else that stands there is a `UsageError`, before the work and not after it.
    """
    if config is not None and out.resolve() == config.resolve():
        raise UsageError(f"{out}: is the config; name another file with --out")
    if not out.is_file():
        return None
    try:
        return file.load(out)
    except UsageError as error:
        raise UsageError(
            f"{out}: is there already and is no calibration, which alone is replaced; name another "
            "file with --out, or move this one away"
        ) from error


def require_other(figure: Path | None, used: tuple[Path | None, ...]) -> None:
    """Refuse to draw over the config or the calibration."""
    if figure is not None and figure.resolve() in [one.resolve() for one in used if one]:
        raise UsageError(f"{figure}: is the config or the calibration; name another by --figure")


def earlier_file(config: SlaveConfig, needed: bool) -> Calibration | None:
    """Return the calibration that the config names, if there is one that can be read.

    Where it is `needed`, for what is not renewed, one that cannot be read is a `UsageError`.
    """
    path = config.calibration
    if not isinstance(path, Path) or not (needed or path.is_file()):
        return None
    try:
        return file.load(path)
    except UsageError:
        if needed:
            raise
        return None


def pace(config: SlaveConfig, shared: RunConfig) -> tuple[int, Iterator[Tick]]:
    """Return where session time begins [ns] and the ticks: real time, but for simulated rigs."""
    if isinstance(config.rig, SimulatedRigConfig):
        return 0, fast_ticks(shared.rate_hz)
    go_realtime(shared.realtime)
    return now_ns(), iter(Grid(shared.rate_hz, lambda: False))


def shown(rig: Rig) -> Callable[[Progress], None]:
    """Return what keeps a line on the terminal up to date."""
    next_s = 0.0

    def show(progress: Progress) -> None:
        nonlocal next_s
        if progress.time_s < next_s:
            return
        next_s = progress.time_s + SHOWN_EVERY_S
        where = _name(rig, progress)
        bar = "#" * round(BAR * progress.done)
        tension = " ".join(f"{t:5.1f}" for t in progress.tension)
        line = (
            f"[{bar:<{BAR}}] {progress.time_s:5.1f} s  {where}: {progress.phase.text}  {tension} N"
        )
        print(f"\r{line:<100.100}", end="", file=sys.stderr, flush=True)

    return show


def noted(rig: Rig) -> Callable[[Progress], None]:
    """Return what prints a line for each tendon, and one every few seconds: for a log."""
    next_s, at = 0.0, (0, 0)

    def note(progress: Progress) -> None:
        nonlocal next_s, at
        place = (progress.joint, progress.side)
        if place == at and progress.time_s < next_s:
            return
        next_s, at = progress.time_s + NOTED_EVERY_S, place
        where = _name(rig, progress)
        print(
            f"{progress.time_s:6.1f} s  {progress.done:4.0%}  {where}: {progress.phase.text}",
            file=sys.stderr,
            flush=True,
        )

    return note


def _name(rig: Rig, progress: Progress) -> str:
    count = len(rig.joints[progress.joint - 1])
    return tendon_name(progress.joint, count, progress.side % count)


def draw(path: Path, found: Initialised) -> None:
    """Draw what was measured."""
    try:
        from slave.calibration.figure import figure
    except ImportError as error:
        raise UsageError(f"--figure: {error}; install matplotlib") from error
    figure(found.record, found.calibration).savefig(path, dpi=150)


def format_report(found: Initialised, out: Path, replaced: Calibration | None = None) -> list[str]:
    """Return the result as lines to read; `replaced` is the calibration that was in `out`."""
    calibration = found.calibration
    took = float(found.record.time[-1] - found.record.time[0])
    lines = [
        f"{calibration.rig}: {calibration.method}, {took:.1f} s of rig time",
        f"{'':16}{'K':>15}{'by the slopes':>16}{'by the paper':>16}"
        f"{'M_pull mm/N':>20}{'M_rel mm/N':>20}{'EA/L N/mm':>16}",
    ]
    for direction in calibration.directions:
        lines += _row(direction)
    for number, travel in enumerate(calibration.ranges, start=1):
        if travel is not None:
            lines.append(f"joint {number} travels {travel * 1e3:.2f} mm between its stops")
    if replaced is not None:
        lines.append(f"{out}: replaces the calibration of {replaced.time or 'an unknown time'}")
    lines += [f"{out}: use it by `teleop run --calibration {out}`, or as the config's calibration"]
    return lines


def _row(direction: Direction) -> list[str]:
    paper = direction.K_paper
    row = (
        f"joint {direction.joint} tendon {direction.tendon:2}"
        f"{_pm(direction.K, 4):>15}{_pm(direction.K_slopes, 4):>16}"
        f"{_pm(paper, 4) if paper else 'needs EA and L':>16}"
        f"{_pm(direction.M_pull, 5, 1e3):>20}{_pm(direction.M_rel, 5, 1e3):>20}"
        f"{_pm(direction.stiffness_per_length, 3, 1e-3):>16}"
    )
    return [row, f"  {direction.remark}"] if direction.remark else [row]


def _pm(value: Value, digits: int, scale: float = 1.0) -> str:
    return f"{value.value * scale:.{digits}f}±{value.uncertainty * scale:.{digits}f}"
