"""One joint of the simulated robot: a motor, its tendon in the sheath, and the load at the tip."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from slave.plant.chain import Chain, settle, tensions
from slave.plant.load import Load
from slave.plant.motor import Motor, follow

Array = NDArray[np.float64]


class Joint(NamedTuple):
    """A joint's constants."""

    motor: Motor
    chain: Chain
    load: Load


class Truth(NamedTuple):
    """What sensors at both ends would see if they were perfect."""

    proximal_tension: float  # [N]
    proximal_displacement: float  # [m]
    distal_tension: float  # [N]
    distal_displacement: float  # [m]


def at_rest(joint: Joint) -> Array:
    """Return the state of a joint that nothing has moved yet: `settle`'s positions, all zero."""
    return np.zeros(len(joint.chain.friction) + 2)


@compiled
def advance(
    joint: Joint, state: Array, target: float, steps: int, dt: float
) -> tuple[Array, Truth]:
    """Take `steps` of `dt` [s] with the motor sent to `target` [m]; return state and truth."""
    chain = joint.chain
    for _ in range(steps):
        state = settle(chain, joint.load, state, follow(joint.motor, state[0], target, dt))
    tension = tensions(chain, state)
    return state, Truth(tension[0], state[0], tension[-1], state[-1])
