"""Names of the columns of a record, which tell its units: linear or rotary as a whole.

A column that is named by `--column` may be in another unit of the same dimension, which its name
tells (`q_mm`, `Force [kgf]`) or the option (`--column time=t[ms]`); it is converted.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from estimator.units import FORCE, LINEAR, ROTARY, Units
from teleop.errors import UsageError

STANDARD_NAMES: Mapping[Units, Mapping[str, str]] = MappingProxyType(
    {
        LINEAR: {
            "proximal_tension": "proximal_tension_N",
            "proximal_displacement": "proximal_displacement_m",
            "distal_tension": "distal_tension_N",
            "distal_displacement": "distal_displacement_m",
        },
        FORCE: {
            "proximal_tension": "proximal_force_N",
            "proximal_displacement": "proximal_displacement_m",
            "distal_tension": "distal_force_N",
            "distal_displacement": "distal_displacement_m",
        },
        ROTARY: {
            "proximal_tension": "proximal_torque_Nm",
            "proximal_displacement": "proximal_angle_rad",
            "distal_tension": "distal_torque_Nm",
            "distal_displacement": "distal_angle_rad",
        },
    }
)
"""Channel -> standard column, by units."""

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

_QUANTITY_UNITS = {
    "tension": "N",
    "force": "N",
    "displacement": "m",
    "torque": "Nm",
    "angle": "rad",
}
_COLUMN_NAME = re.compile(
    r"(proximal|distal)_(tension|force|torque|displacement|angle)(_\d+)?_([A-Za-z]+)"
)
_UNIT_QUANTITIES = {"Nm": "torque", "rad": "angle", "deg": "angle"}
_UNIT_PHRASES = {"rad": "in radians", "Nm": "in newton metres", "N": "in newtons", "m": "in metres"}


def format_standard_name(units: Units, channel: str, number: int = 1) -> str:
    """Return the standard column of a channel of tendon 1, 2, ..."""
    return format_numbered_name(STANDARD_NAMES[units][channel], number)


def format_numbered_name(name: str, number: int) -> str:
    """Return the name of a column `<what>_<unit>` for tendon 1, 2, ..."""
    if number == 1:
        return name
    stem, _, unit = name.rpartition("_")
    return f"{stem}_{number}_{unit}"


def check_names(path: Path, names: Collection[str]) -> None:
    """Refuse columns whose name contradicts its unit, such as `proximal_tension_Nm`.

    Raises
    ------
    UsageError
        One line with the right name.
    """
    for name in names:
        match = _COLUMN_NAME.fullmatch(name)
        if match is None:
            continue
        end, what, number, unit = match.groups()
        meant = _UNIT_QUANTITIES.get(unit, what)
        right = f"{end}_{meant}{number or ''}_{_QUANTITY_UNITS[meant]}"
        rotary = what in ("torque", "angle")
        if right == name or (meant == what and not rotary):
            continue  # other units of a tension or travel are what the reader looks for misspelt
        linear = "displacement_m" if what == "angle" else "tension_N"
        if rotary and f"{end}_{linear}" in names:
            continue  # a further column of a linear record
        kind = f"is {'an angle' if meant == 'angle' else 'a torque'}, not a {what}"
        wrong = kind if meant != what else f"is not {_UNIT_PHRASES[_QUANTITY_UNITS[meant]]}"
        how = (
            ""
            if unit == _QUANTITY_UNITS[meant]
            else f", its values {_UNIT_PHRASES[_QUANTITY_UNITS[meant]]}"
        )
        raise UsageError(f"{path}: column {name!r} {wrong}; name it {right!r}{how}")


def check_linear_names(path: Path, names: Collection[str]) -> None:
    """Refuse a column as a tension or travel if its name ends in N m, radians or degrees."""
    for name in names:
        meant = _UNIT_QUANTITIES.get(name.rpartition("_")[2])
        if meant is not None:
            raise UsageError(
                f"{path}: column {name!r} is of {meant}s, and is given as a tension or travel; "
                f"name the channel by --column proximal_{meant}={name} or distal_{meant}={name}"
            )


def split_unit(name: str, names: Collection[str]) -> tuple[str, str]:
    """Split `COLUMN[UNIT]`, if there is no column of that whole name; the unit is "" without."""
    match = None if name in names else _BRACKETED_UNIT.fullmatch(name)
    if match is None or match[1] not in names:
        return name, ""
    return match[1], match[2]


def find_unit_factor(
    path: Path, name: str, channel: str, units: Units, told: str
) -> tuple[str, float]:
    """Return the unit of a column and its size in the unit of `units`; ("", 1) if none is known.

    Parameters
    ----------
    path : Path
        The file.
    name, channel : str
        Of the column, and the field of `MeasuredTable` that it is for.
    units : Units
        Of the record.
    told : str
        The unit by the option; "" for that of the name.

    Raises
    ------
    UsageError
        The unit is of another dimension; or it is unknown, and the option or brackets tell it.
    """
    dimension = _find_dimension(channel, units)
    known = UNIT_FACTORS[dimension]
    if told:
        if (unit := _match_unit(told)) not in known:
            raise UsageError(
                f"{path}: column {name!r} [{told}]: {dimension} is in {', '.join(known)}"
            )
        return unit, known[unit]
    brackets = _IN_BRACKETS.search(name)
    end = brackets or _UNIT_SUFFIX.search(name)
    if end is None or end[1].isdecimal():  # an index, such as `effort[0]`
        return "", 1.0
    unit = _match_unit(end[1])
    if unit in known:
        return unit, known[unit]
    option = STANDARD_NAMES[units].get(channel, "time_s").rpartition("_")[0]
    remedy = f"its unit can be given as in --column '{option}={name}[{next(iter(known))}]'"
    if unit and (brackets or unit not in _AMBIGUOUS_UNITS):
        raise UsageError(
            f"{path}: column {name!r} is in {unit}, and is given as {channel.replace('_', ' ')}, "
            f"which is in {', '.join(known)}; {remedy}"
        )
    if not unit and (brackets or _is_mega(end[1])):
        raise UsageError(
            f"{path}: column {name!r}: unknown unit {end[1]}, {dimension} is in "
            f"{', '.join(known)}; {remedy}"
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
    return "" if _is_mega(unit) else _in_any_case(unit)


def _in_any_case(word: str) -> str:
    every = [unit for known in UNIT_FACTORS.values() for unit in known]
    units = [unit for unit in every if len(unit) > 1 and unit.lower() == word.lower()]
    return max(units, key=lambda unit: unit[0] == word[0], default="")  # NM is Nm, not nm


def _is_mega(word: str) -> bool:
    """Return whether a word is a unit with the prefix M, as in MN, not one in capitals (MM)."""
    unit = _in_any_case(word)
    in_capitals = word.isupper() and word[1:] != unit[1:]
    return word.startswith("M") and unit.startswith("m") and unit != "min" and not in_capitals


def detect_units(path: Path, names: Collection[str], number: int = 1) -> Units:
    """Return the units of a record with such columns; linear where none tells.

    Raises
    ------
    UsageError
        It is linear in part and rotary in part.
    """
    there = {
        units: [
            name
            for channel in STANDARD_NAMES[units]
            if (name := format_standard_name(units, channel, number)) in names
        ]
        for units in STANDARD_NAMES
    }
    linear, rotary = [*there[LINEAR], *there[FORCE]], there[ROTARY]
    if (
        format_standard_name(LINEAR, "proximal_tension", number) in names
    ):  # further columns are ignored
        rotary = [
            name
            for channel in STANDARD_NAMES[ROTARY]
            if (name := format_standard_name(ROTARY, channel, number)) in names
            and (
                format_standard_name(LINEAR, channel, number) not in names
                or channel == "proximal_tension"
            )
        ]
    if linear and rotary:
        raise UsageError(
            f"{path}: has {linear[0]!r} and {rotary[0]!r}, but a record is linear (N, m) or rotary "
            "(N m, rad) as a whole; rename the columns that are not to be used"
        )
    if rotary:
        return ROTARY
    forces = [name for name in there[FORCE] if "_force" in name]
    tensions = [name for name in there[LINEAR] if "_tension" in name]
    if forces and tensions:
        raise UsageError(
            f"{path}: has {tensions[0]!r} and {forces[0]!r}; name both tensions (of one tendon) or "
            "both forces (of a closed loop, of either sign)"
        )
    return FORCE if forces else LINEAR


def detect_option_units(words: Sequence[str]) -> Units | None:
    """Return the units that channel names in `--column` tell, None where they tell none.

    Raises
    ------
    UsageError
        They contradict one another.
    """
    told = [
        ROTARY if "_torque" in w or "_angle" in w else FORCE for w in words if _has_unit_hint(w)
    ]
    linear = [w for w in words if "_tension" in w or "_displacement" in w]
    if len(set(told)) > 1 or (ROTARY in told and linear):
        raise UsageError(
            f"--column: {', '.join(words)}: a record is linear (tension or force, displacement) or "
            "rotary (torque, angle) as a whole"
        )
    return told[0] if told else None


def _has_unit_hint(word: str) -> bool:
    return any(f"_{what}" in word for what in ("torque", "angle", "force"))


def to_channel(word: str) -> str:
    """Return the channel that a name means: `proximal_torque` is that of `proximal_tension`."""
    end, _, what = word.partition("_")
    if what in ("torque", "force"):
        return f"{end}_tension"
    return f"{end}_displacement" if what == "angle" else word
