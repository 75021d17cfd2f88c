"""Sheath config and its discretisation into cells."""

import math
from dataclasses import dataclass, field

import numpy as np

from estimator.array_types import Array
from teleop.config.loading import MAY_BE_INFINITE

TOTAL_MAX = 10.0  # K of a whole sheath; transmits 1/20000 of the tension
FRICTION_MAX = 1.0  # of one cell: above it cells are too coarse, and at 2 a chain would jam


@dataclass(frozen=True, slots=True)
class SectionConfig:
    """A stretch of sheath of constant bend radius."""

    length: float  # [m]
    radius: float = field(default=math.inf, metadata=MAY_BE_INFINITE)  # [m] .inf = straight

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 < self.length <= 100.0:
            raise ValueError("length: must be above 0 and at most 100 m")
        if not self.radius > 0.0:
            raise ValueError("radius: must be above 0 m")


@dataclass(frozen=True, slots=True)
class SheathConfig:
    """A tendon in its sheath; the one of Phee et al. 2009 as far as it is known, K about 1."""

    sections: tuple[SectionConfig, ...] = (SectionConfig(1.5, 0.225),)  # housing to tip
    friction: float = 0.15  # mu, dimensionless, of tendon on sheath
    axial_stiffness: float = 9000.0  # EA [N] of tendon and sheath in series
    nodes: int = 60  # number of cells

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not self.sections:
            raise ValueError("sections: at least one is needed")
        if not 0.0 <= self.friction <= 2.0:
            raise ValueError("friction: must be 0 to 2")
        if not 1.0 <= self.axial_stiffness <= 1e7:
            raise ValueError("axial_stiffness: must be 1 to 1e7 N")
        if not 1 <= self.nodes <= 1000:
            raise ValueError("nodes: must be 1 to 1000")
        bend = divide_sheath(self)[1]
        if self.friction * bend.sum() > TOTAL_MAX:
            raise ValueError(
                f"friction: must be at most {TOTAL_MAX / bend.sum():.3g} with these bends, or no "
                "tension is transmitted"
            )
        most = self.friction * bend.max()
        if most >= FRICTION_MAX:
            needed = math.ceil(self.nodes * most / FRICTION_MAX) + 1
            raise ValueError(f"nodes: must be at least about {needed} to resolve this friction")


def divide_sheath(config: SheathConfig) -> tuple[Array, Array]:
    """Divide a sheath into cells of similar length, at least one per section.

    Returns
    -------
    length, bend : array, shape (n,)
        Length [m] and bend angle [rad] of each cell, housing to tip.
    """
    length = np.array([section.length for section in config.sections])
    radius = np.array([section.radius for section in config.sections])
    count = np.maximum(1, np.round(config.nodes * length / length.sum())).astype(np.int64)
    cell = np.repeat(length / count, count)
    return cell, cell / np.repeat(radius, count)
