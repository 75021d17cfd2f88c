"""Names of the columns of a record, which tell its units: linear or rotary as a whole."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Self

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

TENSIONS = ("proximal_tension", "distal_tension")  # whose zero errors a diagnosis identifies

# further columns of a sensing loop: at the moved and at the held end
LOOP_TENSIONS = "loop_moved_tension_N", "loop_held_tension_N"
# further columns of an arm's record: tension of a tendon where it ends, and the joints
ANCHOR_TENSION, JOINT_ANGLE = "anchor_tension_N", "joint_angle_{}_rad"

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


def strip_tendon_number(name: str) -> str:
    """Return a standard name of tendon 2, 3, ... as that of tendon 1."""
    return re.sub(r"_\d+(?=_(N|m|Nm|rad)$)", "", name)


def parse_tendon_number(name: str) -> int:
    """Return which tendon a standard name is of."""
    match = re.search(r"_(\d+)_(N|m|Nm|rad)$", name)
    return int(match.group(1)) if match else 1


@dataclass(frozen=True, slots=True)
class Columns:
    """Column names of a file; only the first two columns are required.

    A column with a non-standard name is required too; null omits it.
    """

    time: str = "time_s"  # [s] of the sample
    proximal_tension: str = "proximal_tension_N"  # [N] at the housing
    proximal_displacement: str | None = "proximal_displacement_m"  # [m] pulled in at the housing
    distal_tension: str | None = "distal_tension_N"  # [N] at the tip, on a bench
    distal_displacement: str | None = "distal_displacement_m"  # [m] positive towards the housing

    @classmethod
    def from_tendon(cls, number: int, units: Units = LINEAR) -> Self:
        """Return the standard names of tendon 1, 2, ... in a file that holds several."""
        names = {c: format_standard_name(units, c, number) for c in STANDARD_NAMES[units]}
        return cls(**names)

    def to_units(self, units: Units) -> Self:
        """Return names of which the standard ones are those of a record in `units`."""
        changed = {
            channel: format_standard_name(units, channel, parse_tendon_number(name))
            for channel in STANDARD_NAMES[units]
            if (name := getattr(self, channel)) is not None and self.is_standard(channel)
        }
        return replace(self, **changed)

    def list_names(self) -> dict[str, str]:
        """Return field -> column name, of the columns wanted."""
        return {f.name: name for f in fields(self) if (name := getattr(self, f.name)) is not None}

    def is_standard(self, item: str) -> bool:
        """Return whether a field has a standard name, so that its column may be missing."""
        name = strip_tendon_number(getattr(self, item))
        return name == "time_s" or any(name == names.get(item) for names in STANDARD_NAMES.values())


def check_names(path: Path, names: Collection[str]) -> None:
    """Raise `UsageError` with the right name for one that contradicts its unit.

    Such as `proximal_tension_Nm`.
    """
    for name in names:
        match = _COLUMN_NAME.fullmatch(name)
        if match is None:
            continue
        end, quantity, number, unit = match.groups()
        actual = _UNIT_QUANTITIES.get(unit, quantity)
        suggested = f"{end}_{actual}{number or ''}_{_QUANTITY_UNITS[actual]}"
        rotary = quantity in ("torque", "angle")
        if suggested == name or (actual == quantity and not rotary):
            continue  # other units of a tension or travel are what the reader looks for misspelt
        linear = "displacement_m" if quantity == "angle" else "tension_N"
        if rotary and f"{end}_{linear}" in names:
            continue  # a further column of a linear record
        kind = f"is {'an angle' if actual == 'angle' else 'a torque'}, not a {quantity}"
        fault = kind if actual != quantity else f"is not {_UNIT_PHRASES[_QUANTITY_UNITS[actual]]}"
        hint = (
            ""
            if unit == _QUANTITY_UNITS[actual]
            else f", its values {_UNIT_PHRASES[_QUANTITY_UNITS[actual]]}"
        )
        raise UsageError(f"{path}: column {name!r} {fault}; name it {suggested!r}{hint}")


def check_linear_names(path: Path, names: Collection[str]) -> None:
    """Refuse a column as a tension or travel if its name ends in N m, radians or degrees."""
    for name in names:
        quantity = _UNIT_QUANTITIES.get(name.rpartition("_")[2])
        if quantity is not None:
            raise UsageError(
                f"{path}: column {name!r} is of {quantity}s, and is given as a tension or travel; "
                f"name the channel by --column proximal_{quantity}={name} or "
                f"distal_{quantity}={name}"
            )


def detect_units(path: Path, names: Collection[str], number: int = 1) -> Units:
    """Return the units of a record with such columns; linear where none tells.

    Raises `UsageError` if it is linear in part and rotary in part.
    """
    present = {
        units: {
            channel: name
            for channel in STANDARD_NAMES[units]
            if (name := format_standard_name(units, channel, number)) in names
        }
        for units in STANDARD_NAMES
    }
    linear = [*present[LINEAR].values(), *present[FORCE].values()]
    rotary = [  # beside a tension further columns are ignored
        name
        for channel, name in present[ROTARY].items()
        if channel == "proximal_tension"
        or not {"proximal_tension", channel} <= present[LINEAR].keys()
    ]
    if linear and rotary:
        raise UsageError(
            f"{path}: has {linear[0]!r} and {rotary[0]!r}, but a record is linear (N, m) or rotary "
            "(N m, rad) as a whole; rename the columns that are not to be used"
        )
    if rotary:
        return ROTARY
    forces = [name for name in present[FORCE].values() if "_force" in name]
    tensions = [name for name in present[LINEAR].values() if "_tension" in name]
    if forces and tensions:
        raise UsageError(
            f"{path}: has {tensions[0]!r} and {forces[0]!r}; name both tensions (of one tendon) or "
            "both forces (of a closed loop, of either sign)"
        )
    return FORCE if forces else LINEAR


def detect_option_units(words: Sequence[str]) -> Units | None:
    """Return the units that channel names in `--column` tell, None where they tell none.

    Raises `UsageError` if they contradict one another.
    """
    options = [
        ROTARY if "_torque" in w or "_angle" in w else FORCE for w in words if _has_unit_hint(w)
    ]
    linear = [w for w in words if "_tension" in w or "_displacement" in w]
    if len(set(options)) > 1 or (ROTARY in options and linear):
        raise UsageError(
            f"--column: {', '.join(words)}: a record is linear (tension or force, displacement) or "
            "rotary (torque, angle) as a whole"
        )
    return options[0] if options else None


def _has_unit_hint(word: str) -> bool:
    return any(f"_{what}" in word for what in ("torque", "angle", "force"))


def to_channel(word: str) -> str:
    """Return the channel that a name means: `proximal_torque` is that of `proximal_tension`."""
    end, _, quantity = word.partition("_")
    if quantity in ("torque", "force"):
        return f"{end}_tension"
    return f"{end}_displacement" if quantity == "angle" else word
