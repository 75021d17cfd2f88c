"""Initial motor positions, from which commands count.

A wrong initial position would be a jump at the first engagement, so it is the newest encoder
reading, or zero for a rig with `starts_at_zero`, and nothing else.
"""

import math
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.small_arrays import copy_values
from estimator.structs import F64, Field, Flag, Struct
from teleop.messages.messages import MAX_TENDONS


class InitialPosition(Struct):
    """The newest reading of all encoders together."""

    position: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [m]
    has_position: Flag = False  # whether there is one yet
    age: F64 = 0.0  # [s] minus infinity if known without encoders


@jit_compile
def init_position(memory: InitialPosition, tendons: int, starts_at_zero: bool) -> None:
    """Initialise `memory` for a rig of `tendons` tendons, before the first sample."""
    memory.position[:] = math.nan
    if starts_at_zero:
        memory.position[:tendons] = 0.0
    memory.has_position = starts_at_zero
    memory.age = -math.inf if starts_at_zero else 0.0


@jit_compile
def increase_age(memory: InitialPosition, dt: float) -> None:
    """Increase the age of the reading by `dt` [s]; once per tick, before its samples."""
    memory.age += dt


@jit_compile
def process_sample(
    memory: InitialPosition, tendons: int, displacement: Array, has_displacement: bool
) -> None:
    """Process the measured motor positions [m] of a sample, shape (tendons,) or longer.

    A reading is valid if every encoder, where the rig `has_displacement`, gives a finite number;
    until the next valid one, its age grows.
    """
    if not has_displacement:
        return
    for k in range(tendons):
        if not math.isfinite(displacement[k]):
            return
    copy_values(displacement[:tendons], memory.position[:])
    memory.has_position = True
    memory.age = 0.0


@jit_compile
def is_known(memory: InitialPosition, age_max: float) -> bool:
    """Return whether the motor positions are known from a reading not older than `age_max` [s].

    The positions are in `memory.position`.
    """
    return memory.has_position and memory.age <= age_max
