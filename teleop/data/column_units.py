"""Units of the columns that `--column` names, converted to SI units.

The unit is of the dimension of the channel, and told by the column's name (`q_mm`, `Force [kgf]`)
or by the option (`--column time=t[ms]`).
"""

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from estimator.array_types import Array
from estimator.units import Units
from teleop.data.raw_table import RawTable
from teleop.data.standard_columns import STANDARD_NAMES
from teleop.data.time_text import has_moments
from teleop.errors import UsageError

UNIT_FACTORS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
        | {"min": 60.0, "h": 3600.0, "d": 86400.0},
        "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "nm": 1e-9}
        | {"inch": 0.0254, "mil": 2.54e-5, "ft": 0.3048},
        "force": {"N": 1.0, "mN": 1e-3, "cN": 1e-2, "kN": 1e3, "kgf": 9.80665, "kg": 9.80665}
        | {"gf": 9.80665e-3, "g": 9.80665e-3, "lbf": 4.4482216, "lb": 4.4482216}
        | {"ozf": 0.27801385, "daN": 10.0},
        "torque": {"Nm": 1.0, "mNm": 1e-3, "Nmm": 1e-3, "Ncm": 1e-2, "kgcm": 0.0980665}
        | {"gcm": 9.80665e-5, "ozin": 0.0070615518, "lbin": 0.11298483, "lbft": 1.3558179},
        "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    }
)
"""Dimension -> unit -> its size in SI units."""

_AMBIGUOUS_UNITS = ("min", "sec", "g", "h", "s", "m", "N", "d")
"""Ends of names that mean something else beside another dimension, such as `T_min`."""

_WORDS: Mapping[str, str] = MappingProxyType(
    {"°": "deg", "degree": "deg", "radian": "rad", "second": "s", "newton": "N"}
    | {"metre": "m", "meter": "m", "msec": "ms", "usec": "µs", "sek": "s", "lb": "lb"}
    | {"millisecond": "ms", "millimetre": "mm", "millimeter": "mm", "minute": "min"}
    | {"microsecond": "us", "nanosecond": "ns", "hour": "h", "hr": "h", "day": "d"}
    | {"inche": "inch", "thou": "mil", "feet": "ft", "centimeter": "cm", "centimetre": "cm"}
    | {"micron": "um", "micrometer": "um", "micrometre": "um", "turn": "rev", "revolution": "rev"}
    | {"gram": "gf", "kilogram": "kgf", "kp": "kgf", "pound": "lbf", "oz": "ozf", "ounce": "ozf"}
    | {"millinewton": "mN", "kilonewton": "kN", "kgfcm": "kgcm", "gfcm": "gcm", "ozfin": "ozin"}
    | {"inoz": "ozin", "lbfin": "lbin", "inlb": "lbin", "inlbf": "lbin"}
    | {"lbfft": "lbft", "ftlb": "lbft", "ftlbf": "lbft"}
)
"""Words for units, singular, in small letters, products without a sign."""

_RAW_UNITS = {"V", "mV", "mV/V", "Volt", "Volts", "volt", "volts", "A", "mA", "Ampere", "%"} | {
    "counts", "count", "ticks", "adc", "ADC", "LSB", "pct", "percent", "pwm", "PWM", "psi", "bar"
}  # fmt: skip
"""Units of readings that need a scale."""

_PERIOD_USUAL, _PERIOD_SLOW = 0.4, 10.0  # [s] between samples, at most: of a bench, of any record
PERIOD_MIN = 2e-5  # [s] between samples; below this the unit is wrong, unless it is told
_TIME_UNITS = ("d", "h", "min", "s", "ms", "us", "ns")

TIME_NAMES = ("time", "timestamp", "datetime", "zeit")
_STANDARD_STEM = re.compile(r"(proximal|distal)(tension|force|torque|displacement|angle)(\d*)")
_QUANTITIES = {"tension": ("force", "N"), "force": ("force", "N"), "torque": ("torque", "Nm")} | {
    "displacement": ("length", "m"),
    "angle": ("angle", "rad"),
}

_TIMES = r"[\s·⋅∙.*-]+"  # between the two units of a torque
_PRODUCT = re.compile(rf"(m?N){_TIMES}(?=[cm]?m$)")
_IN_BRACKETS = re.compile(r"[\[({<]\s*([^][(){}<>]*[^][(){}<>\s])\s*[])}>]?\s*$")
_BRACKETS = re.compile(r"[\[({<]([^][(){}<>]+)[])}>]")
_UNIT_SUFFIX = re.compile(rf"(?:_|\s+|/\s*)((?:m?N{_TIMES})?[A-Za-zµμ°]+)$")
_BRACKETED_UNIT = re.compile(r"(.+?)\s*\[([^\[\]]+)\]")


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of a channel, or of a reading."""
    return _match_unit(text) != "" or text in _RAW_UNITS


def states_unit(name: str, row_unit: str) -> bool:
    """Return whether a column's name ends with a unit, or the row below the names has one."""
    end = _IN_BRACKETS.search(name) or _UNIT_SUFFIX.search(name)
    return bool(row_unit.strip("-") or (end and _match_unit(end[1])))


def propose_time_unit(period: float, known: str = "", *, slower: bool | None = None) -> str:
    """Return the unit in which samples that are `period` apart are those of a measurement.

    Of those shorter than the `known` one, which is wrong, or longer if `slower`; "UNIT" unless it
    is a single one.
    """
    at = _TIME_UNITS.index(known) if known in _TIME_UNITS else _TIME_UNITS.index("s")
    units = _TIME_UNITS[:at] if slower else _TIME_UNITS[at + 1 :]
    if slower is None:  # minutes to days only if nothing else can be
        if _PERIOD_USUAL <= period < _PERIOD_SLOW:
            return "UNIT"  # milliseconds of a bench, or seconds of a slow record
        units = _TIME_UNITS[3:] if period > PERIOD_MIN else _TIME_UNITS[:3]
    sizes = {unit: UNIT_FACTORS["time"][unit] * period for unit in units}
    lows = dict.fromkeys(_TIME_UNITS[:3], 5e-3)
    usual = [unit for unit, size in sizes.items() if lows.get(unit, 2e-4) < size < _PERIOD_USUAL]
    return "s" if "s" in usual else usual[0] if len(usual) == 1 else "UNIT"


def propose_length_unit(span: float) -> str:
    """Return the unit in which a travel is that of a tendon; "UNIT" for none."""
    sizes = {unit: UNIT_FACTORS["length"][unit] * span for unit in ("mm", "um", "nm")}
    return next((unit for unit, size in sizes.items() if size < 2.0), "UNIT")


class Aliases(NamedTuple):
    """Columns that have a standard name but for its spelling or unit, by standard name."""

    stated: dict[str, str]  # with a unit of its dimension, such as `Time [ms]`
    unstated: dict[str, str]  # without one


def find_aliases(raw: RawTable) -> Aliases:
    """Return which columns are standard ones in another unit or spelling.

    Raises `UsageError` if two columns could be one.
    """
    aliases = Aliases({}, {})
    for name, column in raw.columns.items():
        end = _IN_BRACKETS.search(name) or _UNIT_SUFFIX.search(name)
        row_unit = raw.units.get(name, "").strip("-")
        has_unit = end is not None and _match_unit(end[1]) != ""
        stem = name[: end.start()] if end is not None and has_unit else name
        unit = _match_unit(row_unit or (end[1] if end is not None else ""), stated=True)
        key = re.sub(r"[\W_]+", "", stem)
        unnamed = name.startswith("column ") and has_moments(column)
        if key == "t" or key.lower() in TIME_NAMES or unnamed:
            standard = "time_s"
            is_text = column.dtype == object and not row_unit
            stated = unit in UNIT_FACTORS["time"] or is_text
        elif match := _STANDARD_STEM.fullmatch(key.lower()):
            dimension, si = _QUANTITIES[match[2]]
            number = f"_{match[3]}" if match[3] not in ("", "1") else ""
            standard = f"{match[1]}_{match[2]}{number}_{si}"
            stated = unit in UNIT_FACTORS[dimension]
        else:
            continue
        if standard in raw.columns:
            continue
        if stated and standard in aliases.stated:
            what = "time" if standard == "time_s" else standard.rpartition("_")[0]
            raise UsageError(
                f"{raw.path}: which is it, {aliases.stated[standard]!r} or {name!r}? Say --column "
                f"'{what}={name}'"
            )
        aliases[not stated][standard] = name
    return aliases


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
    row_units: Mapping[str, str],
    units: Units,
) -> dict[str, tuple[str, float]]:
    """Convert columns to SI units, in place; return the unit of each, "" if none, and its factor.

    A unit by the option may end with the reading at zero, which is subtracted: `2.5 N, zero 8060`.

    `numbers` are values, shape (samples,), by column; `columns` are those of each tendon by the
    field of `MeasuredTable`, `stated_units` likewise column and unit by the option (`split_unit`);
    `row_units` are those by a row of units below the names. `UsageError` if a unit is of another
    dimension; or it is unknown, and the option or brackets tell it.
    """
    factors: dict[str, tuple[str, float]] = {}
    zeros: dict[str, float] = {}
    for names, told_of in zip(columns, stated_units, strict=True):
        for item, name in names.items():
            stated, unit_text, zero = told_of[item][1].partition("zero ")
            unit, factor = _find_unit_factor(
                path, name, item, units, stated.rstrip(" ,"), row_units.get(name, "")
            )
            zeros[name] = _parse_zero(path, name, zero) if unit_text else 0.0
            factors[name] = (f"{unit}, zero {zero}" if unit_text else unit, factor)
    for name, (_, factor) in factors.items():
        if factor != 1.0 or zeros[name]:
            numbers[name] = factor * (numbers[name] - zeros[name])
    return factors


def _parse_zero(path: Path, name: str, text: str) -> float:
    """Return what a column reads at zero, by the option."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(
            f"{path}: column {name!r}: {text!r} is not its reading at zero, as in 'zero 8060'"
        ) from None


def _find_unit_factor(
    path: Path, name: str, channel: str, units: Units, stated_unit: str, row_unit: str
) -> tuple[str, float]:
    """Return the unit of a column and its size in the unit of `units`; ("", 1) if none is known.

    `channel` is the field of `MeasuredTable` that the column is for; `stated_unit` the unit by the
    option, with a scale or without, and `row_unit` that below the names, "" for none.

    Raises `UsageError` if the unit is of another dimension, or is unknown, and the option or
    brackets tell it.
    """
    dimension = _find_dimension(channel, units)
    factors = UNIT_FACTORS[dimension]
    scale, word = split_scale(stated_unit)
    if word:
        if (unit := _match_unit(word, stated=True)) not in factors:
            raise UsageError(
                f"{path}: column {name!r} [{stated_unit}]: {dimension} is in {', '.join(factors)}"
            )
        return stated_unit, scale * factors[unit]
    end, brackets = _find_unit_text(name, dimension)
    if row_unit.strip("-"):
        named = _match_unit(end)
        unit = _match_unit(row_unit, stated=True)
        if named in factors and unit in factors and factors[named] != factors[unit]:
            raise UsageError(
                f"{path}: column {name!r}: its name says {named}, the row below it {row_unit}; say "
                f"which by --column '{_name_option(channel, units)}={name}[{named}]'"
            )
        end, brackets = row_unit, True
    if not end or end.isdecimal():  # an index, such as `effort[0]`
        return stated_unit, scale
    unit = _match_unit(end, stated=brackets)
    if unit in factors:
        return unit, scale * factors[unit]
    option = _name_option(channel, units)
    first = next(iter(factors))
    remedy = (
        f"its unit can be given by how many {first} it is, as in --column "
        f"'{option}={name}[SCALE {first}]'"
    )
    if unit and (brackets or unit not in _AMBIGUOUS_UNITS):
        raise UsageError(
            f"{path}: column {name!r} is in {unit}, and is given as {channel.replace('_', ' ')}, "
            f"which is in {', '.join(factors)}; {remedy}"
        )
    if not unit and (brackets or _is_mega(end) or (end in _RAW_UNITS and end != "A")):
        raise UsageError(
            f"{path}: column {name!r}: unknown unit {end}, {dimension} is in "
            f"{', '.join(factors)}; with its scale, such as [12.5 {first}], {remedy}"
        )
    return stated_unit, scale


def _find_unit_text(name: str, dimension: str) -> tuple[str, bool]:
    """Return what a name says of its unit, "" if nothing, and whether it is in brackets.

    At its end as a rule, or in brackets, or as a word of its own where it is one of the dimension.
    """
    factors = UNIT_FACTORS[dimension]
    if end := _IN_BRACKETS.search(name):
        inner = [text for text in _BRACKETS.findall(name) if _match_unit(text.strip()) in factors]
        return (inner[-1] if inner and end[1].isdecimal() else end[1]).strip(), True
    for text in _BRACKETS.findall(name):
        if _match_unit(text, stated=True) in factors:
            return text.strip(), True
    suffix = _UNIT_SUFFIX.search(name)
    words = [word for word in re.split(r"[\W_]+", name) if word]
    pairs = ["".join(pair) for pair in itertools.pairwise(words)] if dimension == "torque" else []
    if suffix is None or suffix[1] not in factors:
        for word in [*pairs, *words]:
            spelt = len(word) > 3 and dimension != "time" and _match_unit(word) in factors
            if spelt or (len(word) > 1 and word in factors and word not in _AMBIGUOUS_UNITS):
                return word, False
    return (suffix[1] if suffix else ""), False


def split_scale(stated: str) -> tuple[float, str]:
    """Split a unit with a scale before it, such as `12.5 N`, or `-1 mm` of a reversed sign."""
    match = re.match(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*\*?\s*", stated)
    return (float(match[1]), stated[match.end() :]) if match else (1.0, stated)


def _name_option(channel: str, units: Units) -> str:
    return STANDARD_NAMES[units].get(channel, "time_s").rpartition("_")[0]


def _find_dimension(channel: str, units: Units) -> str:
    if channel == "time":
        return "time"
    if channel.endswith("displacement"):
        return "angle" if units.rotary else "length"
    return "torque" if units.rotary else "force"


def _match_unit(word: str, *, stated: bool = False) -> str:
    """Return the unit of `UNIT_FACTORS` that a word means, in small or capital letters; "" if none.

    A prefix stays what it is: neither MN nor Mm is a unit here. In inches only where it is
    `stated`, not by the end of a name: T_in is the tension at the inlet.
    """
    if stated and word.strip() in ("in", '"'):
        return "inch"
    unit = _PRODUCT.sub(r"\1", word.strip().replace("\N{GREEK SMALL LETTER MU}", "µ"))
    unit = _WORDS.get(re.sub(_TIMES, "", unit).lower().removesuffix("s"), unit)
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
    return (
        word.startswith("M")
        and unit.startswith("m")
        and unit not in ("min", "mil")
        and not in_capitals
    )
