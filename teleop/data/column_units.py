"""Units of the columns that `--column` names, converted to SI units.

The unit is of the dimension of the channel, and told by the column's name (`q_mm`, `Force [kgf]`)
or by the option (`--column time=t[ms]`).
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from estimator.array_types import Array
from estimator.units import Units
from teleop.data.channel_names import STANDARD_NAMES
from teleop.errors import UsageError

UNIT_FACTORS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
        | {"min": 60.0, "h": 3600.0},
        "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
        | {"inch": 0.0254},
        "force": {"N": 1.0, "mN": 1e-3, "cN": 1e-2, "kN": 1e3, "kgf": 9.80665, "kg": 9.80665}
        | {"gf": 9.80665e-3, "g": 9.80665e-3, "lbf": 4.4482216, "lb": 4.4482216},
        "torque": {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2},
        "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    }
)
"""Dimension -> unit -> its size in SI units."""

_AMBIGUOUS_UNITS = ("min", "sec", "g", "h", "s", "m", "N")
"""Ends of names that mean something else beside another dimension, such as `T_min`."""

_WORDS: Mapping[str, str] = MappingProxyType(
    {"°": "deg", "degree": "deg", "radian": "rad", "second": "s", "newton": "N"}
    | {"metre": "m", "meter": "m"}
)
"""Words for units, singular, in small letters."""

_TIMES = r"[\s·⋅∙.*-]+"  # between the two units of a torque
_PRODUCT = re.compile(rf"(m?N){_TIMES}(?=[cm]?m$)")
_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]*[^\[\]()\s])\s*[\])]?\s*$")
_UNIT_SUFFIX = re.compile(rf"(?:_|\s+)((?:m?N{_TIMES})?[A-Za-zµμ°]+)$")
_BRACKETED_UNIT = re.compile(r"(.+?)\s*\[([^\[\]]+)\]")


def split_unit(name: str, names: Collection[str]) -> tuple[str, str]:
    """Split `COLUMN[UNIT]`, if there is no column of that whole name; the unit is "" without."""
    match = None if name in names else _BRACKETED_UNIT.fullmatch(name)
    if match is None or match[1] not in names:
        return name, ""
    return match[1], match[2]


def convert_to_si(
    path: Path,
    numbers: dict[str, Array],
    columns: Sequence[Mapping[str, str]],
    stated_units: Sequence[Mapping[str, tuple[str, str]]],
    units: Units,
) -> list[str]:
    """Convert columns to SI units, in place; return what was converted, one line each.

    Parameters
    ----------
    numbers : dict
        Column name -> values, shape (samples,).
    columns : sequence of mapping
        Field of `MeasuredTable` -> column name, one of each tendon.
    stated_units : sequence of mapping
        Field -> column name and unit by the option (`split_unit`), likewise.

    Raises
    ------
    UsageError
        A unit is of another dimension; or it is unknown, and the option or brackets tell it.
    """
    factors: dict[str, tuple[str, float]] = {}
    for names, told_of in zip(columns, stated_units, strict=True):
        for item, name in names.items():
            unit = told_of[item][1]
            factors[name] = _find_unit_factor(path, name, item, units, unit)
    lines = []
    for name, (unit, factor) in factors.items():
        if factor != 1.0:
            numbers[name] = factor * numbers[name]
            lines.append(f"{path}: column {name!r} is in {unit}: converted to SI units")
    return lines


def _find_unit_factor(
    path: Path, name: str, channel: str, units: Units, stated_unit: str
) -> tuple[str, float]:
    """Return the unit of a column and its size in the unit of `units`; ("", 1) if none is known.

    Parameters
    ----------
    name, channel : str
        Of the column, and the field of `MeasuredTable` that it is for.
    stated_unit : str
        The unit by the option; "" for that of the name.

    Raises
    ------
    UsageError
        The unit is of another dimension; or it is unknown, and the option or brackets tell it.
    """
    dimension = _find_dimension(channel, units)
    factors = UNIT_FACTORS[dimension]
    if stated_unit:
        if (unit := _match_unit(stated_unit)) not in factors:
            raise UsageError(
                f"{path}: column {name!r} [{stated_unit}]: {dimension} is in {', '.join(factors)}"
            )
        return unit, factors[unit]
    brackets = _IN_BRACKETS.search(name)
    end = brackets or _UNIT_SUFFIX.search(name)
    if end is None or end[1].isdecimal():  # an index, such as `effort[0]`
        return "", 1.0
    unit = _match_unit(end[1])
    if unit in factors:
        return unit, factors[unit]
    option = STANDARD_NAMES[units].get(channel, "time_s").rpartition("_")[0]
    remedy = f"its unit can be given as in --column '{option}={name}[{next(iter(factors))}]'"
    if unit and (brackets or unit not in _AMBIGUOUS_UNITS):
        raise UsageError(
            f"{path}: column {name!r} is in {unit}, and is given as {channel.replace('_', ' ')}, "
            f"which is in {', '.join(factors)}; {remedy}"
        )
    if not unit and (brackets or _is_mega(end[1])):
        raise UsageError(
            f"{path}: column {name!r}: unknown unit {end[1]}, {dimension} is in "
            f"{', '.join(factors)}; {remedy}"
        )
    return "", 1.0


def _find_dimension(channel: str, units: Units) -> str:
    if channel == "time":
        return "time"
    if channel.endswith("displacement"):
        return "angle" if units.rotary else "length"
    return "torque" if units.rotary else "force"


def _match_unit(word: str) -> str:
    """Return the unit of `UNIT_FACTORS` that a word means, in small or capital letters; "" if none.

    A prefix stays what it is: neither MN nor Mm is a unit here.
    """
    unit = _PRODUCT.sub(r"\1", word.strip().replace("\N{GREEK SMALL LETTER MU}", "µ"))
    unit = _WORDS.get(unit.lower().removesuffix("s"), unit)
    if any(unit in known for known in UNIT_FACTORS.values()):
        return unit
    return "" if _is_mega(unit) else _match_case(unit)


def _match_case(word: str) -> str:
    every = [unit for factors in UNIT_FACTORS.values() for unit in factors]
    units = [unit for unit in every if len(unit) > 1 and unit.lower() == word.lower()]
    return max(units, key=lambda unit: unit[0] == word[0], default="")  # NM is Nm, not nm


def _is_mega(word: str) -> bool:
    """Return whether a word is a unit with the prefix M, as in MN, not one in capitals (MM)."""
    unit = _match_case(word)
    in_capitals = word.isupper() and word[1:] != unit[1:]
    return word.startswith("M") and unit.startswith("m") and unit != "min" and not in_capitals
