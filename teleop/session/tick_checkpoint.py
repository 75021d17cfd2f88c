"""Undo of a tick: both sides compute one in place, and some do not stand.

The process may stall while it computes, so that the result is of the past; an actuator may fail, so
that what was computed is not what it does; and what was computed in advance may be for a sample
that does not come.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from estimator.structs import StructArray, as_bytes
from teleop.runtime.clock import STALL_NS, now_ns

R = TypeVar("R")


class Checkpoint:
    """A copy of the state that ticks change, from which it is restored.

    The ticks change `state` in place, and so does `restore`; `saved` are the copies of what was
    there at the last `save`, or at first.
    """

    def __init__(self, *state: StructArray) -> None:
        self.saved = tuple(np.empty_like(records) for records in state)
        self._state = tuple(as_bytes(records) for records in state)
        self._copies = tuple(as_bytes(records) for records in self.saved)
        self.save()

    def save(self) -> None:
        """Keep the present state as the one to be restored."""
        for state, copy in zip(self._state, self._copies, strict=True):
            copy[:] = state

    def restore(self) -> None:
        """Undo what was done to the state since the last `save`."""
        for state, copy in zip(self._state, self._copies, strict=True):
            state[:] = copy

    def run_step(self, step: Callable[[int, float], R], begin_ns: int, dt: float) -> R:
        """Return `step(begin_ns, dt)`; if the process stalled, that of a second one from `saved`.

        The second step is given the present time, and counts the stall as passed. It is not checked
        again: what the next tick sees of a second stall is the age of its inputs.

        `step` changes the state, given the present stamp [ns] and the time since the last tick [s].
        """
        result = step(begin_ns, dt)
        late_ns = now_ns() - begin_ns
        if late_ns > STALL_NS:
            self.restore()
            result = step(begin_ns + late_ns, dt + late_ns * 1e-9)
        return result
