"""The bench of the paper's figure 5, simulated: its random sheaths, its joint, its motions.

One joint has two tendons, and a load motor. Both tendons run in sheaths of the same shape, as in
one overtube. During initialisation the joint is free. In the experiment the load motor, which is
torque-controlled, acts as a spring: its torque is proportional to the joint's travel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from slave.rig import Rig, RigSample
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.rigs.virtual_bench import MotionSample, MotionState, Turns
from slave.sheath_section import SectionConfig
from slave.simulation.environment import FreeConfig, LoadMotorConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import LoadCellConfig
from slave.simulation.tendon import SheathConfig

# --- random sheaths to repeat the experiment on

LEAST_K, LARGEST_K = 0.4, 1.8
LENGTHS = (1.0, 2.0)  # [m]
STIFFNESSES = (5e3, 15e3)  # EA [N]
FRICTIONS = (0.05, 0.3)
RADII = (0.03, 1.0)  # [m] of a bend
SECTIONS = (2, 5)  # of a sheath that is not uniform
STRAIGHT = 0.25  # of the sections of a sheath that is not uniform
LEAST_SHARE = 0.05  # of the length that a section has
NOISES = (0.01, 0.03)  # [N] of the load cells
LARGEST_STEP = 0.05  # of friction in one cell of the simulated sheath
NODES = (60, 1000)

Sections = tuple[SectionConfig, ...]


@dataclass(frozen=True, slots=True)
class Specimen:
    """One sheath of the experiment, and how noisy its load cell is."""

    number: int  # from 1
    kind: str
    sheath: SheathConfig
    tension_noise: float  # [N] standard deviation

    @property
    def K(self) -> float:  # noqa: N802 (the paper's symbol)
        """Friction coordinate of the tip, mu times the bend angle: the paper's eq. (4)."""
        return self.sheath.friction * compute_bend_angle(self.sheath.sections)

    @property
    def length(self) -> float:
        """Length of the sheath [m]."""
        return math.fsum(section.length for section in self.sheath.sections)

    def describe(self) -> str:
        """Return K and the sections, housing first."""
        sections = ", ".join(
            f"{section.length * 1e3:.0f} mm "
            + ("straight" if math.isinf(section.radius) else f"at R {section.radius * 1e3:.0f}")
            for section in self.sheath.sections
        )
        return f"K {self.K:.2f}, {self.kind}, {sections}"

    def __str__(self) -> str:
        """Return which one it is, and what it is like."""
        return f"sheath {self.number}: {self.describe()}"


def draw_sheaths(count: int, seed: int) -> tuple[Specimen, ...]:
    """Return `count` sheaths, K spread evenly from 0.4 to 1.8, a quarter of each kind.

    Lengths, radii, stiffness and friction are drawn until mu times the bend angle is the K wanted
    with a mu that steel in a coil can have.
    """
    order = np.random.default_rng(seed).permutation(count)
    return tuple(_draw_specimen(i, order[i], count, seed) for i in range(count))


def compute_bend_angle(sections: Sections) -> float:
    """Return the angle all bends add up to [rad]."""
    return math.fsum(section.length / section.radius for section in sections)


def _draw_specimen(index: int, stratum: int, count: int, seed: int) -> Specimen:
    random = np.random.default_rng((seed, index))
    K = LEAST_K + (LARGEST_K - LEAST_K) * (stratum + random.uniform()) / count
    kind = tuple(KINDS)[index % len(KINDS)]
    while True:
        length = random.uniform(*LENGTHS)
        sections = KINDS[kind](random, length)
        bend = compute_bend_angle(sections)
        if bend > 0.0 and FRICTIONS[0] <= K / bend <= FRICTIONS[1]:
            break
    friction = K / bend
    tightest = min(section.radius for section in sections)
    cells = math.ceil(friction * length / tightest / LARGEST_STEP)
    sheath = SheathConfig(
        sections,
        friction=friction,
        axial_stiffness=random.uniform(*STIFFNESSES),
        nodes=min(max(cells, NODES[0]), NODES[1]),
    )
    return Specimen(index + 1, kind, sheath, random.uniform(*NOISES))


def _draw_uniform(random: np.random.Generator, length: float) -> Sections:
    return (SectionConfig(length, _draw_radius(random)),)


def _draw_mixed(random: np.random.Generator, length: float) -> Sections:
    count = int(random.integers(SECTIONS[0], SECTIONS[1], endpoint=True))
    shares = LEAST_SHARE + (1.0 - LEAST_SHARE * count) * random.dirichlet(np.ones(count))
    return tuple(
        SectionConfig(length * float(share), _draw_radius(random))
        if random.uniform() >= STRAIGHT
        else SectionConfig(length * float(share))
        for share in shares
    )


def _draw_tightest_first(random: np.random.Generator, length: float) -> Sections:
    return tuple(sorted(_draw_mixed(random, length), key=lambda section: section.radius))


def _draw_tightest_last(random: np.random.Generator, length: float) -> Sections:
    return _draw_tightest_first(random, length)[::-1]


def _draw_radius(random: np.random.Generator) -> float:
    return float(np.exp(random.uniform(*np.log(RADII))))


KINDS: dict[str, Callable[[np.random.Generator, float], Sections]] = {
    "uniform": _draw_uniform,
    "bends at the motor": _draw_tightest_first,
    "bends at the tip": _draw_tightest_last,
    "bends anywhere": _draw_mixed,
}

PERIOD = 0.001  # [s] of the plant and of every sensor
PRETENSION = 0.5  # [N] of both tendons when the motors start
LOAD_STIFFNESS = 3000.0  # [N/m] of the spring rendered by the load motor
BODY = BodyConfig(
    mass=0.02,
    damping=2.0,
    friction=0.1,
    spring=0.0,
    pretension=PRETENSION,
    stops=(-0.008, 0.008),  # [m]
)


def build_bench(specimen: Specimen, seed: int, loaded: bool) -> SimulatedRig:
    """Return the bench at rest in the middle of its travel; noise of the sensors by `seed`."""
    cell = LoadCellConfig(noise=specimen.tension_noise)
    tendon = TendonPlantConfig(sheath=specimen.sheath, load_cell=cell)
    load = LoadMotorConfig(mode="position", stiffness=LOAD_STIFFNESS) if loaded else FreeConfig()
    joint = JointConfig((tendon, tendon), BODY, load)
    return SimulatedRig(
        SimulatedRigConfig(name="paper's bench", joints=(joint,), period=PERIOD, seed=seed)
    )


def compute_rest_stretch(specimen: Specimen) -> float:
    """Return the elongation [m] of a tendon while the bench is at rest."""
    return PRETENSION * specimen.length / specimen.sheath.axial_stiffness


# --- the motions of the experiment: commands of the two motors, and measurements
# Tendon `a` is slackened, then moved at constant speed, reversing whenever the housing's load cell
# reads the next tension. Tendon `b` is kept slack by tension control with its own load cell.


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


def perform_motion(rig: Rig, turns: tuple[float, ...], stretch: float) -> BenchRun:
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
            return _build_run(samples, legs, stretch)
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


def _build_run(samples: list[RigSample], legs: list[int], stretch: float) -> BenchRun:
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
