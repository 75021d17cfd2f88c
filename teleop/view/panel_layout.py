"""Places on the panel [units], y downwards."""

from dataclasses import dataclass

import numpy as np

from estimator.array_types import Array

WIDE, TALL = 16.0, 9.6
BANNER = (0.0, 0.0, WIDE, 2.9)  # left, top, right, bottom
STATE_TOP, STATE_HEIGHT = 0.32, 1.35  # with a reason below
REASON_TOP, REASON_HEIGHT = 2.09, 0.45
_FORCES = (3.1, 8.4)  # top and bottom of the rows of forces
LINK_TOP, LINK_HEIGHT = 8.85, 0.33
LINK_LEFT = (0.4, 3.6, 7.3, 11.4)  # what is said of the link: each part has its place
_BAR_LEFT, _BAR_RIGHT, _NUMBER_RIGHT = 7.7, 15.6, 6.4
_FILL_LINES, _OVERLAP = 16, 1.5  # lines that fill a box, and how much thicker than apart


@dataclass(frozen=True, slots=True)
class ForceRow:
    """Places of a joint's force: its name and its limit on one line, number and bar below."""

    name_top: float
    name_height: float
    number_top: float
    number_height: float
    bar_half: float  # half its height

    number_right = _NUMBER_RIGHT
    unit_gap = 0.35  # from there to the unit, of the number's height
    bar_right = _BAR_RIGHT

    @property
    def _middle(self) -> float:
        return self.number_top + self.number_height / 2

    def bar(self, share: float, two_way: bool) -> tuple[float, float, float, float]:
        """Return left, top, right, bottom of the bar: `share` of the limit, and at most all."""
        zero = (_BAR_LEFT + _BAR_RIGHT) / 2 if two_way else _BAR_LEFT
        share = float(np.clip(np.nan_to_num(share), -1.0 if two_way else 0.0, 1.0))
        left, right = sorted((zero, zero + share * (_BAR_RIGHT - zero)))
        return left, self._middle - self.bar_half, right, self._middle + self.bar_half

    def frame(self, two_way: bool) -> list[Array]:
        """Return the frame of the bar, and the mark at 0 N."""
        top, bottom = self._middle - self.bar_half, self._middle + self.bar_half
        corners = [(_BAR_LEFT, top), (_BAR_RIGHT, top), (_BAR_RIGHT, bottom), (_BAR_LEFT, bottom)]
        lines = [np.array([*corners, corners[0]])]
        if two_way:
            zero = (_BAR_LEFT + _BAR_RIGHT) / 2
            lines.append(np.array([(zero, top), (zero, bottom)]))
        return lines


def filled(box: tuple[float, float, float, float]) -> tuple[list[Array], float]:
    """Return line strips that fill a box (left, top, right, bottom), and their radius.

    A line has round ends, so the box is made of thin ones that are set in by their radius.
    """
    left, top, right, bottom = box
    radius = _OVERLAP * (bottom - top) / (2 * _FILL_LINES)
    if right - left < 2 * radius:
        return [], radius
    heights = np.linspace(top + radius, bottom - radius, _FILL_LINES)
    lines = [np.array([[left + radius, y], [right - radius, y]]) for y in heights]
    return lines, radius


def force_rows(joints: int) -> list[ForceRow]:
    """Return the rows of all joints, as tall as their number allows."""
    top, bottom = _FORCES
    pitch = (bottom - top) / joints
    name = min(0.4, 0.24 * pitch)
    number = min(1.3, 0.42 * pitch)
    gap = 0.8 * name + 0.1 * (pitch - 1.8 * name - number)  # more where there is room
    block = name + gap + number
    return [
        ForceRow(begin, name, begin + name + gap, number, 0.5 * number)
        for begin in (top + k * pitch + (pitch - block) / 2 for k in range(joints))
    ]
