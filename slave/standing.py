"""Where the motors stand before they were ever commanded: the start of all motion.

A command is a travel from there. A wrong start would be a jump at the first engagement, so it is
what the encoders said last, or zero for a rig that promises to start there, and nothing else.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from slave.rig import RigSample


class Standing(NamedTuple):
    """The newest reading of all encoders together."""

    position: tuple[float, ...] = ()  # [m] one for each tendon; empty = none yet
    age: float = 0.0  # [s] minus infinity where it is known without encoders


def start(tendons: int, starts_at_zero: bool) -> Standing:
    """Return what is known before the first sample."""
    return Standing((0.0,) * tendons, -math.inf) if starts_at_zero else Standing()


def step(memory: Standing, samples: Sequence[RigSample], dt: float) -> Standing:
    """Take in the samples of a tick, `dt` [s] after the last.

    A reading counts when every encoder gives a finite number; between such readings the last one
    grows older.
    """
    after = Standing(memory.position, memory.age + dt)
    for sample in samples:
        if sample.proximal_displacement is not None:
            reading = tuple(sample.proximal_displacement.tolist())
            if all(map(math.isfinite, reading)):
                after = Standing(reading)
    return after


def known(memory: Standing, age_max: float) -> tuple[float, ...]:
    """Return where the motors stand [m], or nothing if that is not known or older than `age_max`.

    `age_max` is in seconds.
    """
    return memory.position if memory.age <= age_max else ()
