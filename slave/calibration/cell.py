"""Whether a load cell has reached the end of its range: the one thing it cannot say itself.

Its reading stands still while the motor pulls on; but so it may, without noise or by a coarse
converter, while the joint moves freely. The motor then goes back a few micrometres: the tension
falls at once, and a cell that does not see it is saturated.
"""

import math
from typing import NamedTuple

READINGS = 5  # alike
TRAVEL = 2e-4  # [m] that the motor has pulled meanwhile


class Cell(NamedTuple):
    """What is remembered of one load cell's readings."""

    reading: float = math.nan  # [N] newest
    alike: int = 0  # times that it has come again since
    since: float = math.nan  # [m] motor travel when it came first


def update(cell: Cell, reading: float, travel: float) -> Cell:
    """Take in a new reading [N], at a motor travel [m]."""
    if reading == cell.reading:
        return cell._replace(alike=cell.alike + 1)
    return Cell(reading, 0, travel)


def is_stuck(cell: Cell, travel: float) -> bool:
    """Return whether it reads the very same although the motor has pulled on, to `travel` [m]."""
    return cell.alike >= READINGS and travel - cell.since > TRAVEL
