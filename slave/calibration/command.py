"""Calibrate a rig: pull each joint against its stops and identify friction and stiffness.

  teleop calibrate --config configs/paper-joint.yaml            writes paper-joint-calibration.yaml
  teleop calibrate --config configs/paper-joint.yaml --quick --figure loops.png
  teleop calibrate --config my-arm.yaml --joint 3 --out my-arm-calibration.yaml

Keep the tips free: each joint is pulled to both of its stops, up to slave.initialise.tension. What
a simulated rig touches is taken away. Set length and stiffness of the sheaths
(slave.initialise.sheaths) and the joints' range (slave.initialise.range) if they are known; then an
obstacle at a tip is detected.

Of an arm (`arms` in the config) the passed joints are held at their stops meanwhile, and their
friction is found by drags in several postures: the arm needs all of its workspace free.

Pass the file to `teleop run --calibration`, or set slave.calibration in the config. Calibrate again
when the sheaths have been moved. Method and error messages: docs/how-to/calibrate.md.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from slave.calibration import calibration_file
from slave.calibration.calibration_file import Calibration, TendonCalibration, ValueWithUncertainty
from slave.calibration.initialisation import InitialiseResult, initialise
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_run import (
    CalibrationInterrupted,
    ProcedureProgress,
    generate_fast_ticks,
    warm_up,
)
from slave.config import SlaveConfig
from slave.rig import Rig
from slave.rigs import open_rig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import SimulatedRigConfig, remove_obstacles
from slave.telemetry import build_progress_printer
from teleop.config.loading import ConfigDocument
from teleop.config.options import add_option, add_options
from teleop.errors import UsageError
from teleop.runtime.clock import Grid, now_ns
from teleop.runtime.compiling import announce_compilation
from teleop.runtime.output_file import (
    FIGURE_SUFFIXES,
    OutputFile,
    UpdatedFile,
    is_same_file,
    parse_output,
    save_figure,
)
from teleop.runtime.process import StopCondition
from teleop.runtime.realtime import request_realtime
from teleop.session.config import RunConfig

COMPILE_S = 10.0  # [s] of a processor, without a cache
BAR_WIDTH = 24  # characters
BAR_PERIOD_S = 0.1  # [s] of the rig's time
LINE_PERIOD_S = 5.0  # [s] likewise, if the output is not a terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop calibrate`."""
    add_options(parser, "--config", "--set", "--allow-imports")
    add_option(parser, "--quick", "one loop in place of three, under 20 s a joint")
    parser.add_argument(
        "--joint",
        type=int,
        action="append",
        default=[],
        metavar="N",
        help="calibrate only this joint, counted from 1; the others are taken from an earlier file",
    )
    parser.add_argument(
        "--together",
        action="store_true",
        help="all joints at once; only if they cannot touch each other or anything else",
    )
    parser.add_argument(
        "--out",
        type=UpdatedFile(),
        metavar="FILE",
        help="the calibration (default <rig name>-calibration.yaml)",
    )
    parser.add_argument(
        "--figure",
        type=OutputFile(*FIGURE_SUFFIXES),
        metavar="FILE.png",
        help="draw tension over motor travel, as in figure 6 of the paper",
    )


def main(args: argparse.Namespace) -> int:
    """Calibrate; returns the exit code."""
    document = ConfigDocument.read(args.config, args.overrides)
    shared, config = document.load(RunConfig), document.load(SlaveConfig, "slave")
    if isinstance(config.rig, ReplayedRigConfig):
        raise UsageError(
            "slave.rig.type: a replayed rig cannot be calibrated; fit the data instead: teleop "
            "estimate DATA --fit --save FILE"
        )
    figure = None if args.figure is None else import_draw_figure()
    is_real = not isinstance(config.rig, SimulatedRigConfig)
    if isinstance(config.rig, SimulatedRigConfig):
        free = remove_obstacles(config.rig)
        if free != config.rig:
            print(
                "simulated rig: calibrated without what its joints and tips touch", file=sys.stderr
            )
        config = replace(config, rig=free)
    else:
        with announce_compilation("the calibration", COMPILE_S):
            warm_up()  # else it would compile while the motors wait for targets
        request_realtime(shared.realtime)  # before the rig: its processes inherit the priority
    with ExitStack() as stack:
        rig = open_rig(config.rig)
        stack.callback(rig.close)
        stop = StopCondition()
        out = args.out or parse_output(UpdatedFile(), "--out", f"{rig.name}-calibration.yaml")
        joints = select_joints(args.joint, len(rig.joints))
        replaced = load_replaced_calibration(out, args.config, args.force)
        if args.figure is not None and args.figure.resolve() == out.resolve():
            raise UsageError(
                f"{args.figure}: this is the calibration; choose another file with --figure"
            )
        earlier = replaced or load_earlier_calibration(config, required=bool(joints))
        start_ns, ticks = 0, generate_fast_ticks(shared.rate_hz)
        if is_real:
            start_ns, ticks = now_ns(), iter(Grid(shared.rate_hz, lambda: False))
        try:
            result = initialise(
                rig,
                config,
                ticks,
                start_ns,
                quick=args.quick,
                joints=joints,
                together=args.together,
                earlier=earlier,
                stopped=lambda: f"{stop.reason}: stopped, no file written" if stop() else "",
                progress=build_progress_bar(rig)
                if sys.stderr.isatty()
                else build_progress_printer(rig, sys.stderr, LINE_PERIOD_S),
                analysing=partial(_announce_analysis, stop),
                arms=shared.arms,
            )
        except CalibrationInterrupted as error:
            error.exit_code = stop.exit_code or error.exit_code
            raise
    calibration_file.save(out, result.calibration)
    if figure is not None:
        save_figure(figure(result.record, result.calibration), args.figure, dpi=150)
    print("\n".join(format_report(result, out, replaced)))
    return 0


def select_joints(numbers: list[int], count: int) -> tuple[int, ...]:
    """Return the joints of `--joint`, counted from 0."""
    for number in numbers:
        if not 1 <= number <= count:
            raise UsageError(f"--joint {number}: the rig has joints 1 to {count}")
    return tuple(sorted({number - 1 for number in numbers}))


def load_replaced_calibration(out: Path, config: Path | None, force: bool) -> Calibration | None:
    """Return the calibration in `out` that will be replaced; None if there is no file.

    Raises `UsageError` before the procedure starts if `out` is any other file, and not `force`.
    """
    if config is not None and is_same_file(out, config):
        raise UsageError(f"{out}: this is the config file; choose another file with --out")
    if not out.is_file():
        return None
    try:
        return calibration_file.load(out)
    except UsageError as error:
        if force:
            return None
        raise UsageError(
            f"{out}: exists and is not a calibration; choose another file with --out, or replace "
            "it with --force"
        ) from error


def load_earlier_calibration(config: SlaveConfig, required: bool) -> Calibration | None:
    """Return the calibration that the config names, None if it cannot be read.

    Raises `UsageError` instead if it is `required`, for the joints that are not calibrated now.
    """
    path = config.calibration
    if not isinstance(path, Path) or not (required or path.is_file()):
        return None
    try:
        return calibration_file.load(path)
    except UsageError:
        if required:
            raise
        return None


@contextmanager
def _announce_analysis(stop: StopCondition) -> Iterator[None]:
    """Say that the motors have been driven, and let a signal end the computation."""
    with suppress(OSError):  # what cannot be printed costs no calibration
        print(
            "\n" * sys.stderr.isatty() + "computing friction and stiffness of each tendon ...",
            file=sys.stderr,
        )
    with stop.allow_interrupt():
        yield


def build_progress_bar(rig: Rig) -> Callable[[ProcedureProgress], None]:
    """Return a callback that updates a progress bar on the terminal."""
    next_s = 0.0

    def show(progress: ProcedureProgress) -> None:
        nonlocal next_s
        if progress.time_s < next_s:
            return
        next_s = progress.time_s + BAR_PERIOD_S
        tendon = progress.format_tendon(rig)
        bar = "#" * round(BAR_WIDTH * progress.done)
        tension = " ".join(f"{t:5.1f}" for t in progress.tension)
        line = (
            f"[{bar:<{BAR_WIDTH}}] {progress.time_s:5.1f} s  {tendon}: {progress.phase.text}  "
            f"{tension} N"
        )
        print(f"\r{line:<100.100}", end="", file=sys.stderr, flush=True)

    return show


def import_draw_figure() -> Callable[[ProcedureData, Calibration], Any]:
    """Return what draws the measured loops; found out before any motor moves."""
    try:
        from slave.calibration.figure import draw_figure
    except ImportError as error:
        raise UsageError(f"--figure: {error}; install matplotlib") from error
    return draw_figure


def format_report(
    result: InitialiseResult, out: Path, replaced: Calibration | None = None
) -> list[str]:
    """Return the report as lines; `replaced` is the calibration that was in `out`."""
    calibration = result.calibration
    took = float(result.record.time[-1] - result.record.time[0])
    lines = [
        f"{calibration.rig}: {calibration.method}, {took:.1f} s of rig time",
        f"{'':16}{'K':>15}{'by the slopes':>16}{'by the paper':>16}"
        f"{'M_pull mm/N':>20}{'M_rel mm/N':>20}{'EA/L N/mm':>16}",
    ]
    for direction in calibration.directions:
        lines += _format_direction_rows(direction)
    for number, travel in enumerate(calibration.ranges, start=1):
        if travel is not None:
            lines.append(f"joint {number} travels {travel * 1e3:.2f} mm between its stops")
    for guide in calibration.guides:
        mu = _format_uncertain_value(guide.friction, 4)
        lines.append(f"joint {guide.joint}: friction of the tendons that pass it {mu}")
    if replaced is not None:
        lines.append(f"{out}: replaces the calibration of {replaced.time or 'an unknown time'}")
    lines += [f"{out}: use it by `teleop run --calibration {out}`, or as the config's calibration"]
    return lines


def _format_direction_rows(direction: TendonCalibration) -> list[str]:
    paper = direction.K_paper
    row = (
        f"joint {direction.joint} tendon {direction.tendon:2}"
        f"{_format_uncertain_value(direction.K, 4):>15}"
        f"{_format_uncertain_value(direction.K_slopes, 4):>16}"
        f"{_format_uncertain_value(paper, 4) if paper else 'needs EA and L':>16}"
        f"{_format_uncertain_value(direction.M_pull, 5, 1e3):>20}"
        f"{_format_uncertain_value(direction.M_rel, 5, 1e3):>20}"
        f"{_format_uncertain_value(direction.stiffness_per_length, 3, 1e-3):>16}"
    )
    return [row, f"  {direction.remark}"] if direction.remark else [row]


def _format_uncertain_value(value: ValueWithUncertainty, digits: int, scale: float = 1.0) -> str:
    return f"{value.value * scale:.{digits}f}±{value.uncertainty * scale:.{digits}f}"
