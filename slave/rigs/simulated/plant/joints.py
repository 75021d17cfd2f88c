"""All joints of a rig in numba lists; passing them one by one would cost more than a step.

Make the lists with `to_compiled_list`; do not read items from Python.
"""

from typing import TypeVar

import numpy as np
from numba.typed import List

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rigs.simulated.plant.joint import Joint, JointState, advance_joint, compute_truth
from slave.rigs.simulated.plant.sensors import CHANNELS

T = TypeVar("T")


def to_compiled_list(items: list[T]) -> list[T]:
    """Return joints, or states of joints, as a compiled list."""
    first, *others = items
    many = build_single_list(first)
    for item in others:
        append_item(many, item)
    return many


@jit_compile
def build_single_list(item: T) -> list[T]:
    """Return a compiled list of one item."""
    many: list[T] = List()
    many.append(item)
    return many


@jit_compile
def append_item(many: list[T], item: T) -> None:
    """Add an item to a compiled list."""
    many.append(item)


@jit_compile
def replace_item(many: list[T], index: int, item: T) -> None:
    """Replace the item at `index`."""
    many[index] = item


@jit_compile
def advance_joints(
    joints: list[Joint], states: list[JointState], targets: Array, steps: int, dt: float
) -> Array:
    """Advance all joints, changing `states`; return the truth, shape (4, joints, 2).

    `targets` [m] has shape (joints, 2); for the rest see `joint.advance` and `joint.truth`.
    """
    seen = np.empty((len(CHANNELS), len(joints), 2))
    for i in range(len(joints)):
        states[i] = advance_joint(joints[i], states[i], targets[i], steps, dt)
        at_joint = compute_truth(joints[i], states[i])
        for channel in range(len(CHANNELS)):
            for tendon in range(2):
                seen[channel, i, tendon] = at_joint[channel, tendon]
    return seen
