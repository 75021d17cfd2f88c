"""The newest read of a haptic device as a record, for compiled functions.

Devices return a `HandState` of as many numbers as they have axes; `fill` copies it.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.records import I64, Field, Flag, Record, Records, one
from master.device import HandState
from teleop.messages import MAX_JOINTS

Axes = Annotated[NDArray[np.float64], Field("f8", MAX_JOINTS)]
"""A field with one number for each axis of a device; what is beyond its axes is zero."""


class HandInput(Record):
    """What one read of a device returned; all zero if it cannot be read."""

    present: Flag = False  # the device can be read
    axes: I64 = 0  # how many entries of the arrays are in use
    position: Axes  # [m]
    velocity: Axes  # [m/s]
    engage: Flag = False  # the operator holds the engage switch
    clutch: Flag = False  # ... the clutch
    stop: Flag = False  # ... the emergency stop


def fill(record: HandInput, hand: HandState | None) -> None:
    """Set `record` to what a device returned; None if it cannot be read."""
    record.position[:] = 0.0
    record.velocity[:] = 0.0
    record.present = hand is not None
    record.axes = 0
    record.engage = record.clutch = record.stop = False
    if hand is None:
        return
    axes = len(hand.position)
    record.axes = axes
    record.position[:axes] = hand.position
    record.velocity[:axes] = hand.velocity
    record.engage = hand.engage
    record.clutch = hand.clutch
    record.stop = hand.stop


class HandWriter:
    """Writes what a device returns into records, with views that were made once.

    Parameters
    ----------
    records : Records
        `HandInput`, shape (1,).
    """

    def __init__(self, records: Records) -> None:
        self._present, self._axes = records["present"], records["axes"]
        self._position, self._velocity = records["position"][0], records["velocity"][0]
        self._engage, self._clutch, self._stop = (
            records[name] for name in ("engage", "clutch", "stop")
        )
        self._records = records

    def __call__(self, hand: HandState | None) -> None:
        """Take over what a device returned; None if it cannot be read. See `fill`."""
        if hand is None:
            fill(one(self._records), None)
            return
        axes = len(hand.position)
        self._present[0], self._axes[0] = True, axes
        self._position[:axes] = hand.position
        self._velocity[:axes] = hand.velocity
        self._engage[0], self._clutch[0], self._stop[0] = hand.engage, hand.clutch, hand.stop


def fill_axes(field: NDArray[np.float64], values: Sequence[float]) -> None:
    """Set a field to one number for each axis, and to zero beyond them."""
    field[:] = 0.0
    field[: len(values)] = values


@compiled
def all_finite(values: NDArray[np.float64], axes: int) -> bool:
    """Return whether the first `axes` of `values` are finite."""
    for k in range(axes):  # noqa: SIM110 - compiled
        if not np.isfinite(values[k]):
            return False
    return True
