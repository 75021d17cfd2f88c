"""Places and lettering on the panel [units], y downwards."""

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

    def place_bar(self, share: float, two_way: bool) -> tuple[float, float, float, float]:
        """Return left, top, right, bottom of the bar: `share` of the limit, and at most all."""
        zero = (_BAR_LEFT + _BAR_RIGHT) / 2 if two_way else _BAR_LEFT
        share = float(np.clip(np.nan_to_num(share), -1.0 if two_way else 0.0, 1.0))
        left, right = sorted((zero, zero + share * (_BAR_RIGHT - zero)))
        return left, self._middle - self.bar_half, right, self._middle + self.bar_half

    def build_frame(self, two_way: bool) -> list[Array]:
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


# --- large text as line strips: Rerun's own labels have one small size
# Each glyph is drawn on a grid 4 wide and 6 tall, y downwards; strokes are separated by commas, the
# points of a stroke are pairs of digits x, y.


# height of a capital, and from one glyph to the next [grid units]
_CAPITAL_HEIGHT, _GLYPH_ADVANCE = 6.0, 5.8
_SPACE = 3.6
# marks that need less room, and how much [grid units]
_NARROW_MARKS, _NARROW_REDUCTION = (".,:;'", 3.0)
STROKE = 0.085  # radius of a stroke, of the height of a capital
_GLYPHS = {
    "A": "06 01 10 30 41 46, 03 43", "B": "06 00 30 41 42 33 03, 33 44 45 36 06",
    "C": "41 30 10 01 05 16 36 45", "D": "00 06 26 45 41 20 00", "E": "40 00 06 46, 03 33",
    "F": "40 00 06, 03 33", "G": "41 30 10 01 05 16 36 45 43 23", "H": "00 06, 40 46, 03 43",
    "I": "10 30, 20 26, 16 36", "J": "40 45 36 16 05", "K": "00 06, 40 03 46", "L": "00 06 46",
    "M": "06 00 23 40 46", "N": "06 00 46 40", "O": "10 30 41 45 36 16 05 01 10",
    "P": "06 00 30 41 42 33 03", "Q": "10 30 41 45 36 16 05 01 10, 24 46",
    "R": "06 00 30 41 42 33 03, 23 46", "S": "41 30 10 01 02 13 33 44 45 36 16 05",
    "T": "00 40, 20 26", "U": "00 05 16 36 45 40", "V": "00 26 40", "W": "00 16 22 36 40",
    "X": "00 46, 40 06", "Y": "00 23 40, 23 26", "Z": "00 40 06 46",
    "0": "10 30 41 45 36 16 05 01 10", "1": "11 20 26, 16 36", "2": "01 10 30 41 42 06 46",
    "3": "01 10 30 41 42 33 13, 33 44 45 36 16 05", "4": "36 30 04 44",
    "5": "40 00 03 33 44 45 36 16 05", "6": "41 30 10 01 05 16 36 45 44 33 03", "7": "00 40 16",
    "8": "13 02 01 10 30 41 42 33 13 04 05 16 36 45 44 33", "9": "05 16 36 45 41 30 10 01 02 13 43",
    ".": "25 26", ",": "25 17", ":": "21 22, 24 25", ";": "21 22, 24 16", "-": "13 33",
    "+": "03 43, 21 25", "/": "06 40", "%": "06 40, 00 11, 35 46", "'": "20 21", "(": "30 21 25 36",
    ")": "10 21 25 16", "_": "06 46", "=": "02 42, 04 44", "<": "40 03 46", ">": "00 43 06",
}  # fmt: skip
_UNKNOWN = "00 40 46 06 00"


def _parse_glyph(glyph: str) -> list[Array]:
    """Return the glyph's straight pieces: the ends of a strip are round, its corners are not."""
    strokes = [
        np.array([[float(digit) for digit in point] for point in stroke.split()])
        for stroke in glyph.split(",")
    ]
    return [stroke[k : k + 2] for stroke in strokes for k in range(len(stroke) - 1)]


_STROKES = {letter: _parse_glyph(glyph) for letter, glyph in _GLYPHS.items()}
_BOX = _parse_glyph(_UNKNOWN)


def compute_text_width(text: str, height: float) -> float:
    """Return the width of `text` in capitals of `height`."""
    advance = sum(map(_compute_advance, text))
    return max(0.0, advance - (_GLYPH_ADVANCE - 4.0)) * height / _CAPITAL_HEIGHT


def build_text_strips(text: str, left: float, top: float, height: float) -> list[Array]:
    """Return `text`, in capitals, as line strips of shape (points, 2).

    An unknown character is a box. The upper left corner is at `left`, `top`, y downwards; `height`
    is that of a capital.
    """
    scale, strips, x = height / _CAPITAL_HEIGHT, [], 0.0
    for letter in text.upper():
        if letter != " ":
            begin = x - _NARROW_REDUCTION / 2 if letter in _NARROW_MARKS else x
            corner = np.array([left + scale * begin, top])
            strips += [corner + scale * stroke for stroke in _STROKES.get(letter, _BOX)]
        x += _compute_advance(letter)
    return strips


def _compute_advance(letter: str) -> float:
    """Return the distance from a character to the next [grid units]."""
    if letter == " ":
        return _SPACE
    return _GLYPH_ADVANCE - _NARROW_REDUCTION if letter in _NARROW_MARKS else _GLYPH_ADVANCE


def fit_height(text: str, width: float, height: float) -> float:
    """Return the largest height of capitals up to `height` at which `text` is at most `width`."""
    wide = compute_text_width(text, height)
    return height if wide <= width else height * width / wide
