"""Detect a saturated load cell.

Its reading stays constant while the motor pulls on. Without noise or with a coarse converter that
also happens while the joint moves freely, so the motor then goes back a few micrometres: the
tension falls at once, and a cell that does not measure it is saturated.
"""

import math
from typing import NamedTuple

REPEATS_MIN = 5  # alike
TRAVEL_MIN = 2e-4  # [m] that the motor has pulled meanwhile


class CellState(NamedTuple):
    """State of one load cell: the newest reading and how often it was repeated."""

    reading: float = math.nan  # [N] newest
    alike: int = 0  # how often it was repeated
    since: float = math.nan  # [m] motor travel at its first occurrence


def update(cell: CellState, reading: float, travel: float) -> CellState:
    """Return the state after a new reading [N] at a motor travel [m]."""
    if reading == cell.reading:
        return cell._replace(alike=cell.alike + 1)
    return CellState(reading, 0, travel)


def is_stuck(cell: CellState, travel: float) -> bool:
    """Return whether the reading stayed constant although the motor pulled on to `travel` [m]."""
    return cell.alike >= REPEATS_MIN and travel - cell.since > TRAVEL_MIN
