"""Where the motors stand before they were ever commanded: the start of all motion.

A command is a travel from there. A wrong start would be a jump at the first engagement, so it is
the newest reading of the encoders, or zero for a rig that promises to start there, and nothing
else.
"""

import math
from typing import Annotated

from estimator.array_types import Array
from estimator.arrays import copy
from estimator.compiled import compiled
from estimator.records import F64, Field, Flag, Record
from teleop.messages import MAX_TENDONS


class InitialPosition(Record):
    """The newest reading of all encoders together."""

    position: Annotated[Array, Field("f8", MAX_TENDONS, fill=math.nan)]  # [m]
    has_position: Flag = False  # whether there is one yet
    age: F64 = 0.0  # [s] minus infinity where it is known without encoders


@compiled
def start(memory: InitialPosition, tendons: int, starts_at_zero: bool) -> None:
    """Set `memory` to what is known before the first sample of a rig of so many tendons."""
    memory.position[:] = math.nan
    if starts_at_zero:
        memory.position[:tendons] = 0.0
    memory.has_position = starts_at_zero
    memory.age = -math.inf if starts_at_zero else 0.0


@compiled
def age(memory: InitialPosition, dt: float) -> None:
    """Let the reading grow older by `dt` [s]; once a tick, before its samples are taken."""
    memory.age += dt


@compiled
def take(
    memory: InitialPosition, tendons: int, displacement: Array, has_displacement: bool
) -> None:
    """Take in a sample.

    A reading counts when every encoder gives a finite number; between such readings the last one
    grows older.

    Parameters
    ----------
    memory : InitialPosition
        Changed in place.
    tendons : int
        How many tendons the rig has.
    displacement : array, shape (tendons,) or longer
        Measured motor positions [m].
    has_displacement : bool
        Whether the rig has encoders at all.
    """
    if not has_displacement:
        return
    for k in range(tendons):
        if not math.isfinite(displacement[k]):
            return
    copy(displacement[:tendons], memory.position[:])
    memory.has_position = True
    memory.age = 0.0


@compiled
def known(memory: InitialPosition, age_max: float) -> bool:
    """Return whether it is known where the motors stand, by a reading no older than `age_max` [s].

    They stand at `memory.position` then.
    """
    return memory.has_position and memory.age <= age_max
