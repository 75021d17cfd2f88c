"""Discretised tendon: springs, nodes and their state.

The friction of a cell of sheath acts in its middle, on a node of the tendon; the tendon between two
nodes is a spring that can only pull. Displacements are positive towards the housing.
"""

from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rigs.simulated.plant.knobs import NEUTRAL, Knobs
from slave.rigs.simulated.plant.sheath import SheathConfig, divide_sheath

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
