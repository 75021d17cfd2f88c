"""Places on the panel [units], y downwards."""

from dataclasses import dataclass

import numpy as np

from estimator.array_types import Array

PANEL_WIDTH, PANEL_HEIGHT = 16.0, 9.6
BANNER = (0.0, 0.0, PANEL_WIDTH, 2.9)  # left, top, right, bottom
STATE_TOP, STATE_HEIGHT = 0.32, 1.35  # with a reason below
REASON_TOP, REASON_HEIGHT = 2.09, 0.45
_FORCES = (3.1, 8.4)  # top and bottom of the rows of forces
LINK_TOP, LINK_HEIGHT = 8.85, 0.33
LINK_LEFT = (0.4, 3.75, 7.45, 11.45)  # what is said of the link: each part has its place
_BAR_LEFT, _BAR_RIGHT, _NUMBER_RIGHT = 8.0, 15.6, 6.4
_NAME_HEIGHT = 0.4  # of what all forces have in common
_FILL_LINES, _OVERLAP = 16, 1.5  # lines that fill a box, and how much thicker than apart


@dataclass(frozen=True, slots=True)
class ForceRow:
    """Places of a force: its name, its number and its bar."""

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


def fill_box(box: tuple[float, float, float, float]) -> tuple[list[Array], float]:
    """Return line strips that fill a box (left, top, right, bottom), and their radius.

    A line has round ends, so the box is made of thin ones that are set in by their radius.
    """
    left, top, right, bottom = box
    radius = _OVERLAP * (bottom - top) / (2 * _FILL_LINES)
    if right - left < 2 * radius:
        return [], radius
    heights = np.linspace(top + radius, bottom - radius, _FILL_LINES)
    ends = left + radius, right - radius
    lines = [np.array([[ends[0], y], [ends[1], y]]) for y in heights]
    lines += [np.array([[x, heights[0]], [x, heights[-1]]]) for x in ends]  # straight edges
    return lines, radius


def compute_force_rows(joints: int) -> tuple[float, float, list[ForceRow]]:
    """Return top and height of the words that all forces share, and the rows.

    A single force has its number and its bar below the words; each of several has its name, number
    and bar on a line of its own.
    """
    top, bottom = _FORCES
    if joints == 1:
        gap, number = 0.67, 1.3
        begin = (top + bottom - _NAME_HEIGHT - gap - number) / 2
        below = begin + _NAME_HEIGHT + gap
        return begin, _NAME_HEIGHT, [ForceRow(begin, _NAME_HEIGHT, below, number, 0.5 * number)]
    begin = top + 0.15
    first = begin + 2.0 * _NAME_HEIGHT
    pitch = (bottom - first) / joints
    number = min(0.8, 0.62 * pitch)
    name = min(0.33, 0.8 * number)
    middles = [first + (k + 0.5) * pitch for k in range(joints)]
    rows = [ForceRow(y - name / 2, name, y - number / 2, number, 0.5 * number) for y in middles]
    return begin, _NAME_HEIGHT, rows
