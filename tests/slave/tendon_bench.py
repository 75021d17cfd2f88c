"""A test bench for one tendon: a motor that goes where it is told, and something at the tip."""

from typing import NamedTuple

import numpy as np

from estimator.compiled import jit_compile
from estimator.small_arrays import copy_values
from slave.sheath_section import SectionConfig
from slave.simulation.chain_step import compute_response, recover_state
from slave.simulation.friction_nodes import interpolate_curve
from slave.simulation.tendon import POSITION, TENSION, SheathConfig, build_chain, init_chain_state

L, EA = 1.5, 9000.0


class Load(NamedTuple):
    """A tip that pulls with force + stiffness * travel, never less than nothing."""

    force: float  # [N] at travel 0
    stiffness: float  # [N/m] > 0


BLOCKED = Load(0.0, 1e9)
SPRING = Load(0.0, 500.0)


def uniform(K, nodes=60, pretension=0.0, axial_stiffness=EA, **deviations):
    """Return a chain of one bend."""
    sheath = SheathConfig((SectionConfig(L, 0.2),), K * 0.2 / L, axial_stiffness, nodes)
    chain = build_chain(sheath, pretension)
    return chain._replace(deviations=chain.deviations._replace(**deviations))


def turned(chain, **deviations):
    """Return the chain with some of its deviations turned."""
    return chain._replace(deviations=chain.deviations._replace(**deviations))


def drive(chain, load, motor, state=None, dt=1e-3):
    """Move the motor along a path against a load; return all states, the one before it first."""
    motor = np.asarray(motor, float)
    return _run(chain, motor, np.empty(0), load, _begin(chain, state), dt)


def stretch(chain, motor, tip, state=None, dt=1e-3):
    """Move both ends along paths of one length; return all states, the one before it first."""
    motor, tip = np.broadcast_arrays(np.asarray(motor, float), np.asarray(tip, float))
    return _run(chain, motor.copy(), tip.copy(), SPRING, _begin(chain, state), dt)


def proximal(state):
    """Return where the motor's end is [m]."""
    return state[POSITION, 0]


def distal(state):
    """Return where the tip is [m]."""
    return state[POSITION, -1]


def ends(states):
    """Return the tensions [N] at housing and tip of states, each of shape (states,)."""
    return states[:, TENSION, 0], states[:, TENSION, -2]


def travels(states):
    """Return the displacements [m] of motor and tip of states, each of shape (states,)."""
    return states[:, POSITION, 0], states[:, POSITION, -1]


def _begin(chain, state):
    return init_chain_state(chain) if state is None else state


@jit_compile
def _run(chain, motor, tip, load, state, dt):
    states = np.empty((len(motor) + 1, *state.shape))
    copy_values(state.ravel(), states[0].ravel())
    for k in range(len(motor)):
        response = compute_response(chain, state, motor[k], dt)
        place = tip[k] if len(tip) > 0 else meet(response, load)
        tension = interpolate_curve(response.tip, place)
        state = recover_state(chain, state, response, motor[k], place, tension, dt)
        copy_values(state.ravel(), states[k + 1].ravel())
    return states


@jit_compile
def meet(response, load):
    """Return where tendon and load pull alike, by halving an interval until it has no inside."""
    low, high = -1.0, 1.0
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        if interpolate_curve(response.tip, middle) > load.force + load.stiffness * middle:
            low = middle
        else:
            high = middle
