"""The motions of the experiment: commands of the two motors, and measurements.

Tendon `a` is slackened, then moved at constant speed, reversing whenever the housing's load cell
reads the next tension. Tendon `b` is kept slack by tension control with its own load cell.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from slave.rig import Rig, RigSample
from studies.paper.bench import PERIOD
from teleop.cli.motion import MotionSample, MotionState, Turns

PAPER_TURNS = (20.0, 5.0, 20.0)  # [N] at the housing: the paper's figure 7
NESTED_TURNS = (20.0, 4.0, 16.0, 6.0, 13.0, 8.0, 20.0, 3.0, 12.0, 5.0, 18.0)  # [N]
SPEED = 0.002  # [m/s] of the pulling motor
SLACK = 0.0005  # [m] paid out beyond the first reading of no tension
LOOSE = 0.1  # [N] setpoint of tendon b
LOOSE_BAND = 0.05  # [N] dead band of its control
LOOSE_GAIN = 0.01  # [m/s] of winding per [N] beyond
SMOOTH = 0.01  # [s] over which its reading is averaged
LONGEST = 120.0  # [s]


class MotionStalled(Exception):
    """A tension was not reached."""


class BenchRun(NamedTuple):
    """One motion, shape (n,) each, from slack to the last turn; the last two are the bench's."""

    time: Array  # [s]
    leg: NDArray[np.int64]  # 0 while going to the first turn, 1 to the second, ...
    tension: Array  # [N] at the housing
    travel: Array  # [m] of the motor
    distal_tension: Array  # [N] true
    elongation: Array  # [m] true, of a tendon without tension 0


def perform(rig: Rig, turns: tuple[float, ...], stretch: float) -> BenchRun:
    """Move a bench that rests through `turns` [N] at the housing.

    `stretch` [m] is the elongation of its tendons at rest, from where displacements count.

    Raises
    ------
    MotionStalled
        If a tension is never reached.
    """
    bench = _MotorPair(rig)
    sample = bench.move(0.0)
    while sample.proximal_tension[0] > 0.0:
        sample = bench.move(bench.a - SPEED * PERIOD)
    for _ in range(round(SLACK / (SPEED * PERIOD))):
        sample = bench.move(bench.a - SPEED * PERIOD)
    motion, memory = Turns((*turns, 0.0), SPEED), MotionState(0, bench.a)
    samples: list[RigSample] = []
    legs: list[int] = []
    while True:
        seen = MotionSample(sample.time_s, float(sample.proximal_tension[0]), PERIOD)
        target, memory = motion.step(memory, seen)
        if memory.leg == len(turns):
            return _record(samples, legs, stretch)
        sample = bench.move(target)
        samples.append(sample)
        legs.append(memory.leg)


@dataclass
class _MotorPair:
    """Both motors of a rig: `a` under position control, `b` under slack-side tension control."""

    rig: Rig
    a: float = 0.0  # [m]
    b: float = 0.0  # [m]
    smooth: float = 0.0  # [N] reading of b's load cell, averaged
    ticks: int = 0

    def move(self, a: float) -> RigSample:
        """Move `a` to a position [m]; return the sample of the next tick."""
        self.b -= max(a - self.a, 0.0)
        self.a = a
        short = LOOSE - self.smooth
        self.b += LOOSE_GAIN * PERIOD * (short if abs(short) > LOOSE_BAND else 0.0)
        self.rig.write(np.array([self.a, self.b]))
        (sample,) = self.rig.read(self.ticks * PERIOD)
        self.ticks += 1
        if self.ticks * PERIOD > LONGEST:
            raise MotionStalled(f"the motion was not completed within {LONGEST:g} s")
        self.smooth += (float(sample.proximal_tension[1]) - self.smooth) * PERIOD / SMOOTH
        return sample


def _record(samples: list[RigSample], legs: list[int], stretch: float) -> BenchRun:
    def of_a(name: str) -> Array:
        return np.array([getattr(sample, name)[0] for sample in samples])

    time = np.array([sample.time_s for sample in samples])
    travel = of_a("proximal_displacement")
    return BenchRun(
        time - time[0],
        np.array(legs, dtype=np.int64),
        of_a("proximal_tension"),
        travel,
        of_a("bench_distal_tension"),
        travel - of_a("bench_distal_displacement") + stretch,
    )
