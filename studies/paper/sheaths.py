"""Random sheaths to repeat the experiment on."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slave.rigs.simulated.plant.tendon import SectionConfig, SheathConfig

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
        return self.sheath.friction * bend_angle(self.sheath.sections)

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


def random_sheaths(count: int, seed: int) -> tuple[Specimen, ...]:
    """Return `count` sheaths, K spread evenly from 0.4 to 1.8, a quarter of each kind.

    Lengths, radii, stiffness and friction are drawn until mu times the bend angle is the K wanted
    with a mu that steel in a coil can have.
    """
    order = np.random.default_rng(seed).permutation(count)
    return tuple(_draw(i, order[i], count, seed) for i in range(count))


def bend_angle(sections: Sections) -> float:
    """Return the angle all bends add up to [rad]."""
    return math.fsum(section.length / section.radius for section in sections)


def _draw(index: int, stratum: int, count: int, seed: int) -> Specimen:
    random = np.random.default_rng((seed, index))
    K = LEAST_K + (LARGEST_K - LEAST_K) * (stratum + random.uniform()) / count
    kind = tuple(KINDS)[index % len(KINDS)]
    while True:
        length = random.uniform(*LENGTHS)
        sections = KINDS[kind](random, length)
        bend = bend_angle(sections)
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


def _uniform(random: np.random.Generator, length: float) -> Sections:
    return (SectionConfig(length, _radius(random)),)


def _mixed(random: np.random.Generator, length: float) -> Sections:
    count = int(random.integers(SECTIONS[0], SECTIONS[1], endpoint=True))
    shares = LEAST_SHARE + (1.0 - LEAST_SHARE * count) * random.dirichlet(np.ones(count))
    return tuple(
        SectionConfig(length * float(share), _radius(random))
        if random.uniform() >= STRAIGHT
        else SectionConfig(length * float(share))
        for share in shares
    )


def _tightest_first(random: np.random.Generator, length: float) -> Sections:
    return tuple(sorted(_mixed(random, length), key=lambda section: section.radius))


def _tightest_last(random: np.random.Generator, length: float) -> Sections:
    return _tightest_first(random, length)[::-1]


def _radius(random: np.random.Generator) -> float:
    return float(np.exp(random.uniform(*np.log(RADII))))


KINDS: dict[str, Callable[[np.random.Generator, float], Sections]] = {
    "uniform": _uniform,
    "bends at the motor": _tightest_first,
    "bends at the tip": _tightest_last,
    "bends anywhere": _mixed,
}
