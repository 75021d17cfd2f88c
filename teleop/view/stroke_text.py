"""Large text as line strips: Rerun's own labels have one small size.

Each glyph is drawn on a grid 4 wide and 6 tall, y downwards; strokes are separated by commas, the
points of a stroke are pairs of digits x, y.
"""

import numpy as np

from estimator.array_types import Array

# height of a capital, and from one glyph to the next [grid units]
_CAPITAL_HEIGHT, _GLYPH_ADVANCE = 6.0, 5.8
_SPACE = 3.6
_NARROW_MARKS, _NARROW_REDUCTION = (
    ".,:;'",
    3.0,
)  # marks that need less room, and how much [grid units]
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

    Parameters
    ----------
    text : str
        Letters, digits and punctuation; an unknown character is a box.
    left, top : float
        Upper left corner of the text, y downwards.
    height : float
        Of a capital.
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
