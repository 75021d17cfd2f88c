"""All joints of a rig in numba lists; passing them one by one would cost more than a step.

Make the lists with `join_joints`; do not read items from Python.
"""

from typing import TypeVar

import numpy as np
from numba.typed import List

from estimator.array_types import Array
from estimator.compiled import compiled
from slave.rigs.simulated.plant.joint import Joint, JointState, advance, truth
from slave.rigs.simulated.plant.sensors import CHANNELS

T = TypeVar("T")


def join_joints(items: list[T]) -> list[T]:
    """Return joints, or states of joints, as a compiled list."""
    first, *others = items
    many = only(first)
    for item in others:
        append(many, item)
    return many


@compiled
def only(item: T) -> list[T]:
    """Return a compiled list of one item."""
    many: list[T] = List()
    many.append(item)
    return many


@compiled
def append(many: list[T], item: T) -> None:
    """Add an item to a compiled list."""
    many.append(item)


@compiled
def replace(many: list[T], index: int, item: T) -> None:
    """Replace the item at `index`."""
    many[index] = item


@compiled
def advance_all(
    joints: list[Joint], states: list[JointState], targets: Array, steps: int, dt: float
) -> Array:
    """Advance all joints, changing `states`; return the truth, shape (4, joints, 2).

    `targets` [m] has shape (joints, 2); for the rest see `joint.advance` and `joint.truth`.
    """
    seen = np.empty((len(CHANNELS), len(joints), 2))
    for i in range(len(joints)):
        states[i] = advance(joints[i], states[i], targets[i], steps, dt)
        at_joint = truth(joints[i], states[i])
        for channel in range(len(CHANNELS)):
            for tendon in range(2):
                seen[channel, i, tendon] = at_joint[channel, tendon]
    return seen
