"""Simulate measured data of a rig, faster than real time.

  teleop simulate configs/demo.yaml --out bench.csv
  teleop simulate configs/demo.yaml --out nested.parquet --profile nested --duration 60 --seed 7

The rig is slave.rig of the config file, defaults without one. In every joint one motor makes the
motion; that of the other tendon, if any, keeps it taut. The table has the housing's sensors and, as
on a calibration bench, those at the tip (docs/data-format.md). The same command writes the same
file.
"""

import argparse
import dataclasses
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from estimator.array_types import Array
from slave.config import SlaveConfig
from slave.rigs.simulated import (
    SimulatedRig,
    SimulatedRigConfig,
    describe_effect,
    format_late_effects,
)
from teleop.config.loading import load
from teleop.config.options import add_options
from teleop.data.table import Columns, write_table
from teleop.errors import UsageError
from teleop.runtime.output_file import TABLE_SUFFIXES, OutputFile

# --- motor motions for simulated measurements: pure functions of time, tension and state


class MotionState(NamedTuple):
    """State of a motion between samples."""

    leg: int = 0  # index of the next turning tension
    target: float = 0.0  # [m] last motor command


class MotionSample(NamedTuple):
    """Input of a motion: one sample."""

    time_s: float  # [s] since the start
    tension: float  # [N] measured at the housing
    dt: float  # [s] until the next


class Motion(Protocol):
    """Interface of a motion of one motor."""

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """Return the motor command [m] for the next sample, and the new state."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Constant speed, reversing whenever the housing tension reaches the next of `levels`, cyclic.

    With (20 N, 5 N) this is the pull, release and pull of Phee et al. 2009, Fig. 7; with shrinking
    swings it is nested reversals.
    """

    levels: tuple[float, ...]  # [N] no two neighbours alike, last and first included
    speed: float  # [m/s]

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        leg = memory.leg
        if self._direction(leg) * (sample.tension - self._level(leg)) >= 0.0:
            leg += 1
        target = memory.target + self._direction(leg) * self.speed * sample.dt
        return target, MotionState(leg, target)

    def _level(self, leg: int) -> float:
        return self.levels[leg % len(self.levels)]

    def _direction(self, leg: int) -> float:
        return 1.0 if leg == 0 or self._level(leg) > self._level(leg - 1) else -1.0


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine between the start and `stroke`."""

    stroke: float  # [m]
    period: float  # [s]

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        turn = 2.0 * math.pi * (sample.time_s + sample.dt) / self.period
        target = 0.5 * self.stroke * (1.0 - math.cos(turn))
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class TensionHold:
    """Keep the tension near `tension` by admittance control: the other tendon of a pair.

    Motor speed `admittance` (tension - measured), with a dead band, limited to `speed`.
    """

    tension: float  # [N]
    speed: float  # [m/s]
    admittance: float = 0.03  # [m/(s N)]
    band: float = 0.1  # [N] to either side, against limit cycles: a short piece of tendon is stiff

    def step(self, memory: MotionState, sample: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        error = self.tension - sample.tension
        error -= min(max(error, -self.band), self.band)
        speed = min(max(self.admittance * error, -self.speed), self.speed)
        target = memory.target + speed * sample.dt
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class MotionScale:
    """Amplitudes and speeds of the motions."""

    peak: float = 20.0  # [N] highest housing tension, of the motions that turn at tensions
    speed: float = 0.004  # [m/s] of those
    stroke: float = 0.010  # [m] of the sine
    period: float = 4.0  # [s] of the sine


def _build_turns(*shares: float) -> Callable[[MotionScale], Motion]:
    return lambda scale: Turns(tuple(share * scale.peak for share in shares), scale.speed)


MOTIONS: dict[str, Callable[[MotionScale], Motion]] = {
    "pull-release-pull": _build_turns(1.0, 0.25),
    "loop": _build_turns(1.0, 0.01),  # for a calibration: to slack and back
    "nested": _build_turns(1.0, 0.2, 0.8, 0.3, 0.65, 0.4),
    "sine": lambda scale: Sine(scale.stroke, scale.period),
}

HOLD_TENSION = 0.5  # [N] enough for a tendon not to go slack
FOLLOW_SPEED = 0.04  # [m/s] most that the loose tendon's motor goes


class Run(NamedTuple):
    """Measurements: times [s], shape (samples,), others of shape (samples, tendons)."""

    time: Array
    proximal_tension: Array  # [N]
    proximal_displacement: Array  # [m]
    distal_tension: Array  # [N]
    distal_displacement: Array  # [m]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    scale = MotionScale()
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG", help="config file (YAML)")
    parser.add_argument(
        "--out",
        type=OutputFile(*TABLE_SUFFIXES),
        required=True,
        metavar="FILE",
        help=".csv, .csv.gz or .parquet",
    )
    parser.add_argument(
        "--duration", type=float, default=30.0, metavar="S", help="duration [s] (default 30)"
    )
    parser.add_argument(
        "--profile",
        choices=MOTIONS,
        default="pull-release-pull",
        help="pull-release-pull as in the paper's experiment, loop as for a calibration, "
        "nested reversals, or a sine (default pull-release-pull)",
    )
    parser.add_argument(
        "--rate", type=float, default=1000.0, metavar="HZ", help="sample rate [Hz] (default 1000)"
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="seed of the sensor noise (default the config's)"
    )
    for name, default, metavar, text in (
        ("peak", scale.peak, "N", "housing tension at which the motor turns [N]"),
        ("speed", scale.speed, "M/S", "speed of the motor between turns [m/s]"),
        ("stroke", scale.stroke, "M", "stroke of the sine [m]"),
        ("period", scale.period, "S", "period of the sine [s]"),
        ("keep", HOLD_TENSION, "N", "housing tension of the other tendon of a pair [N]"),
    ):
        parser.add_argument(
            f"--{name}",
            type=float,
            default=default,
            metavar=metavar,
            help=f"{text} (default {default:g})",
        )
    parser.add_argument(
        "--side",
        choices=("a", "b"),
        default="a",
        help="which tendon of a pair makes the motion (default a)",
    )
    add_options(parser, "--set", "--allow-imports")


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    for name in ("duration", "rate", "peak", "speed", "stroke", "period", "keep"):
        if not 0.0 < getattr(args, name) <= 1e5:
            raise UsageError(f"--{name} {getattr(args, name)}: must be above 0 and at most 100 000")
    config = _load_rig_config(args)
    if args.rate * config.period > 1.0 + 1e-9:
        raise UsageError(
            f"--rate {args.rate:g}: the rig's slave.rig.period allows 1/period at most"
        )
    scale = MotionScale(args.peak, args.speed, args.stroke, args.period)
    motion = MOTIONS[args.profile](scale)
    SimulatedRig(config)  # compiles, outside the timed part
    began = time.perf_counter()
    run = simulate(
        config,
        motion,
        args.duration,
        args.rate,
        side=args.side,
        keep=args.keep,
        progress=sys.stderr.isatty(),
    )
    took = time.perf_counter() - began
    write_table(args.out, to_columns(run))
    _print_summary(args, config, run, took)
    return 0


def simulate(
    config: SimulatedRigConfig,
    motion: Motion,
    duration: float,
    rate: float,
    *,
    side: Literal["a", "b"] = "a",
    keep: float = HOLD_TENSION,
    progress: bool = False,
) -> Run:
    """Move all joints of a simulated rig by `motion` for `duration` [s], sampled at `rate` [Hz].

    In a pair tendon `side` makes the motion, and the other one is kept at `keep` [N]. Motors are
    commanded at every step of the plant, for any output rate.
    """
    rig = SimulatedRig(config)
    loose = TensionHold(keep, FOLLOW_SPEED)
    pair = (motion, loose) if side == "a" else (loose, motion)
    motions = [m for tendons in rig.joints for m in (pair if len(tendons) == 2 else (motion,))]
    memories = [MotionState()] * rig.tendons
    period, rows = config.period, []
    due = [round(k / rate / period) for k in range(int(duration * rate + 1e-9) + 1)]
    kept_rows, last = set(due), due[-1]
    for step in range(last + 1):
        for sample in rig.read(step * period):
            tensions = sample.proximal_tension.tolist()
            moves = [
                move.step(memory, MotionSample(sample.time_s, tension, period))
                for move, memory, tension in zip(motions, memories, tensions, strict=True)
            ]
            memories = [memory for _, memory in moves]
            rig.write(np.array([target for target, _ in moves]))
            if step in kept_rows:
                rows.append(sample)
        if progress and (step % 2000 == 0 or step == last):
            _show_progress((step + 1) / (last + 1))
    rig.close()
    if not rows:
        raise UsageError("slave.rig.effects: all samples were lost")
    return Run(
        np.array([row.time_s for row in rows]),
        np.array([row.proximal_tension for row in rows]),
        np.array([row.proximal_displacement for row in rows]),
        np.array([row.bench_distal_tension for row in rows]),
        np.array([row.bench_distal_displacement for row in rows]),
    )


def to_columns(run: Run) -> dict[str, Array]:
    """Return a run as the columns of a measured-data file; tendons 2, 3, ... are numbered."""
    columns = {"time_s": run.time}
    for tendon in range(run.proximal_tension.shape[1]):
        names = Columns.of_tendon(tendon + 1).names()
        del names["time"]
        columns |= {name: getattr(run, item)[:, tendon] for item, name in names.items()}
    return columns


def _load_rig_config(args: argparse.Namespace) -> SimulatedRigConfig:
    config = load(args.config, SlaveConfig, "slave", args.overrides).rig
    origin = args.config or "defaults"
    if not isinstance(config, SimulatedRigConfig):
        raise UsageError(f"{origin}: slave.rig.type: must be simulated, not {config.type}")
    if args.seed is None:
        return config
    try:
        return dataclasses.replace(config, seed=args.seed)
    except ValueError as error:
        raise UsageError(f"--{error}") from error


def _show_progress(share: float) -> None:
    bar = "#" * round(40 * share)
    print(f"\r[{bar:<40}] {share:4.0%}", end="\n" if share == 1.0 else "", file=sys.stderr)


def _print_summary(
    args: argparse.Namespace, config: SimulatedRigConfig, run: Run, took: float
) -> None:
    span = float(run.time[-1])
    print(f"{args.out}: {len(run.time)} rows, {span:g} s, simulated {span / took:.3g} x real time")
    tendons = [tendon for joint in config.joints for tendon in joint.tendons]
    for i, tendon in enumerate(tendons):
        sheath = tendon.sheath
        bend = sum(section.length / section.radius for section in sheath.sections)
        print(
            f"tendon {i + 1}: K = {sheath.friction * bend:.4g}, EA = {sheath.axial_stiffness:g} N; "
            f"peaks {run.proximal_tension[:, i].max():.3g} N at the housing, "
            f"{run.distal_tension[:, i].max():.3g} N at the tip; "
            f"the motor moved {1e3 * np.ptp(run.proximal_displacement[:, i]):.3g} mm, "
            f"the tip {1e3 * np.ptp(run.distal_displacement[:, i]):.3g} mm"
        )
        range_max = tendon.load_cell.range
        if run.proximal_tension[:, i].max() >= range_max:
            hint = f", --peak {args.peak:g} N is never read" if args.peak >= range_max else ""
            print(
                f"WARNING: tendon {i + 1}: its load cell's readings end at {range_max:g} N "
                f"(load_cell.range){hint}"
            )
    for effect in config.effects:
        print(f"effect {describe_effect(effect)}")
    for line in format_late_effects(config.effects, args.duration):
        print(line)
