"""Cells of text tables: numbers, and words for what is missing or out of range."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from teleop.data import time_text
from teleop.data.raw_table import Column

THOUSANDS = "thousands separators"
BLANKS = " \t\r\n\u00a0\u2007\u202f\ufeff\u200b\"'"
MINUS = str.maketrans("−–", "--")  # as typesetting writes it
_MISSING = {"na", "n/a", "n.a", "k.a", "nan", "nat", "null", "none", "nil", "-", "--", "---", "?"}
_MISSING |= {"missing", "\\n", "…", "", "nodata", "no data", "undef", "undefined", "void", "~"}
_MISSING |= {"invalid", "bad", "bad input", "timeout"}
_OVERLOADS = {"ovld", "ovl", "ol", "o.l", "overload", "overflow", "overrange", "1.#inf", "ovr"}
_OVERLOADS |= {"over", "over range", "überlauf", "sat", "saturated"}
_ERRORS = re.compile(r"#[^\s\da-z]+(?:/0)?[!?]?")  # of a spreadsheet in any language
_NAN = re.compile(r"nan\(.*\)|1\.#(?:qnan|snan|ind|j)")

EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_GROUPED = r"[1-9]\d{{0,2}}(?:([{0}'’ \u00a0\u202f])\d{{3}})(?:\1\d{{3}})*"
NUMBERS = {  # decimal sign -> numbers with thousands separators, or without
    sign: re.compile(
        rf"(?=[+-]?[{sign}]?\d)[+-]?(?:{_GROUPED.format(other)}|\d*)(?:[{sign}]\d*)?{EXPONENT}"
    )
    for sign, other in ((".", ","), (",", "."))
}


# a number with its unit
WITH_UNIT = re.compile(r"[+-]?\d[\d.,]*(?:[eE][+-]?\d+)?\s*([^\W\d]{1,8}|%)")


def classify_word(cell: str) -> str:
    """Return what a cell without a number says: missing, overload, error; "" if nothing known."""
    text = cell.strip(BLANKS)
    word = text.lower()
    digits = word.lstrip("+-") or word
    if (
        not word
        or {word, digits, digits.strip("<>()[]").rstrip(".")} & _MISSING
        or _NAN.fullmatch(digits)
    ):
        return "missing"
    if digits in _OVERLOADS or not word.strip("*>"):  # Fortran fills a field that is too narrow
        return "overload"
    if word in ("#n/a", "#na"):
        return "missing"
    named = _ERRORS.fullmatch(text) or word.rstrip(".") in ("error", "err", "fail")
    return "error" if named or not word.strip("#") else ""


def is_loose_value(cell: str) -> bool:
    """Return whether a cell is a number, with either sign of decimals, or a time."""
    text = cell.strip().translate(MINUS)
    is_number = any(form.fullmatch(text) for form in NUMBERS.values())  # with either sign
    return is_number or time_text.is_moment(text)


def to_number(cell: str, decimal: str) -> float | None:
    """Return the number of a cell, NaN for a missing value, None for anything else."""
    text = cell.strip(BLANKS).translate(MINUS)
    if decimal != "," and "_" not in text:  # which Python leaves out of numbers
        try:
            return float(text)
        except ValueError:
            pass
    if classify_word(text):
        return np.nan
    match = NUMBERS[decimal or "."].fullmatch(text)
    if match is None or (match[1] == "," and not decimal):
        return None
    text = text.replace(match[1], "") if match[1] else text
    return float(text.replace(",", ".").replace("d", "e").replace("D", "e"))


def parse_cells(cells: Sequence[str], decimal: str, words: Counter[str]) -> Column:
    """Return cells as numbers, NaN where missing; if any is text, as shared objects."""
    if decimal != "," and not any("_" in cell for cell in cells):
        try:
            return np.fromiter(map(float, cells), np.float64, len(cells))
        except ValueError:
            pass
    numbers = [to_number(cell, decimal) for cell in cells]
    if None in numbers:
        shared: dict[str, str] = {}
        return np.array([shared.setdefault(cell, cell) for cell in cells], dtype=object)
    named = (cell.strip(BLANKS) for cell in cells)
    words.update(word for word in named if word and classify_word(word))
    matches = map(NUMBERS[decimal or "."].fullmatch, map(str.strip, cells))
    if grouped := sum(bool(match and match[1]) for match in matches):
        words[THOUSANDS] += grouped
    return np.array(numbers, dtype=np.float64)
