"""Discretised tendon: springs, nodes and their state.

The friction of a cell of sheath acts in its middle, on a node of the tendon; the tendon between two
nodes is a spring that can only pull. Displacements are positive towards the housing.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rigs.simulated.plant.knobs import NEUTRAL, Knobs
from teleop.config.loading import MAY_BE_INFINITE

# --- sheath config and its discretisation into cells

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


# Rows of a state. Entry i of a row of nodes belongs to node i = 1 ... n, beside POSITION.
POSITION = 0  # [m] of the motor's end, the nodes and the tip
TENSION = 1  # [N] of spring i = 0 ... n, between positions i and i + 1
FRICTION = 2  # [N] dry friction on each node, positive towards the tip
CREEP = 3  # [N] of each spring: its creep as an equivalent tension
SPEED = 4  # [m/s] of each node, filtered for its friction
CONTACT_GROWTH = 5  # growth of each contact at rest: 0 just slid, 1 rested long
STATE_ROWS = 6


class Chain(NamedTuple):
    """One tendon in one sheath: n nodes and n + 1 springs, from the housing to the tip."""

    compliance: Array  # c_i [m/N] shape (n + 1,)
    friction: Array  # phi_i [-] shape (n,): friction coefficient times bend angle of a cell
    cell: Array  # [m] shape (n,): its length
    pretension: float  # [N] in every spring while all displacements are zero
    knobs: Knobs
    parted: Array  # [m] shape (n + 1,): gap in a broken spring; 0 = not broken


def build_chain(config: SheathConfig, pretension: float) -> Chain:
    """Return the chain of a sheath, its knobs neutral.

    `pretension` [N] is the tension all along the tendon while all displacements are zero.
    """
    cell, bend = divide_sheath(config)
    half = 0.5 * cell / config.axial_stiffness
    compliance = np.concatenate([half, [0.0]]) + np.concatenate([[0.0], half])
    parted = np.zeros(len(compliance))
    return Chain(compliance, config.friction * bend, cell, pretension, NEUTRAL, parted)


@jit_compile
def init_chain_state(chain: Chain) -> Array:
    """Return the initial state of a tendon, shape (6, n + 2).

    Row 0 holds the displacements [m] of motor end, nodes and tip; the others are this plant's own.
    """
    n = len(chain.friction)
    state = np.zeros((STATE_ROWS, n + 2))
    state[TENSION, : n + 1] = chain.pretension
    state[CONTACT_GROWTH, 1 : n + 1] = 1.0
    return state


@jit_compile
def get_tensions(chain: Chain, state: Array) -> Array:
    """Return the tension of each spring [N], housing to tip, shape (n + 1,)."""
    return state[TENSION, : len(chain.compliance)].copy()
