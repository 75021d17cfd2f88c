"""The newest read of a haptic device as a record, for compiled functions.

Devices return a `HandState` of as many numbers as they have axes; `fill_hand_input` copies it.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import I64, Field, Flag, Struct, StructArray
from master.device import HandState
from teleop.messages.messages import MAX_JOINTS

Axes = Annotated[Array, Field("f8", MAX_JOINTS)]
"""A field with one number per axis of a device, zero beyond its axes."""


class HandInput(Struct):
    """One read of a device; all zero if it cannot be read."""

    present: Flag = False  # the device can be read
    axes: I64 = 0  # how many entries of the arrays are in use
    position: Axes  # [m]
    velocity: Axes  # [m/s]
    engage: Flag = False  # the engage switch is held
    clutch: Flag = False  # ... the clutch
    stop: Flag = False  # ... the emergency stop


_ZEROS = (0.0,) * MAX_JOINTS
_ABSENT_HAND = (False, 0, _ZEROS, _ZEROS, False, False, False)


def fill_hand_input(records: StructArray, hand: HandState | None) -> None:
    """Set the first of an array of `HandInput` to what a device returned, in 2 us.

    `hand` is None if the device cannot be read.
    """
    if hand is None:
        records[0] = _ABSENT_HAND
        return
    axes = len(hand.position)
    zeros = _ZEROS[axes:]
    records[0] = (
        True,
        axes,
        hand.position + zeros,
        hand.velocity + zeros,
        hand.engage,
        hand.clutch,
        hand.stop,
    )


def fill_axes(field: Array, values: Sequence[float]) -> None:
    """Set a field to one number for each axis, and to zero beyond them."""
    field[:] = 0.0
    field[: len(values)] = values


@jit_compile
def is_all_finite(values: Array, axes: int) -> bool:
    """Return whether the first `axes` of `values` are finite."""
    for k in range(axes):  # noqa: SIM110 - compiled
        if not np.isfinite(values[k]):
            return False
    return True
