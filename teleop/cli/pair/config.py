"""Column names of a pair's data, and the pattern of the bend in file names."""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from teleop.errors import UsageError

BEND = "{bend}"
_NUMBER = r"(?<![\d.])(-?\d+(?:\.\d+)?)"


@dataclass(frozen=True, slots=True)
class PairColumns:
    """Names of columns."""

    time: str = "time_s"  # [s]
    command: str = "command_angle_deg"  # of the motor, pulling a in and letting b out
    angle: str = "distal_angle_deg"  # of the joint
    tension_a: str = "proximal_tension_a_N"  # [N] at the housing
    tension_b: str = "proximal_tension_b_N"  # [N] at the housing


@dataclass(frozen=True, slots=True)
class FileBend:
    """The bend of one file."""

    file: str = ""  # its name, without the folder
    bend: float = 0.0  # in the unit of the angles


@dataclass(frozen=True, slots=True)
class PairConfig:
    """Format of the files of a pair."""

    columns: PairColumns = field(default_factory=PairColumns)
    unit: Literal["deg", "rad"] = "deg"  # of command, angle and bend
    bend: str = "bend{bend}"  # pattern of file names with the bend
    bends: tuple[FileBend, ...] = ()  # of files without the bend in their name

    def __post_init__(self) -> None:
        """Check the pattern; raises `ValueError`."""
        if self.bend.count(BEND) != 1:
            raise ValueError(f"bend: {self.bend!r}, must have {BEND} once, where the number stands")

    @property
    def radians(self) -> float:
        """One unit of an angle [rad]."""
        return math.radians(1.0) if self.unit == "deg" else 1.0

    def bend_of(self, path: Path) -> float:
        """Return the bend [rad] of a file's sheath, from the list or the file's name.

        Raises
        ------
        UsageError
            Neither has it.
        """
        for one in self.bends:
            if one.file == path.name:
                return self._checked(path, one.bend)
        before, after = self.bend.split(BEND)
        lead = re.escape(before) + r"(-?\d+(?:\.\d+)?)" if before else _NUMBER
        found = re.search(lead + re.escape(after), path.name)
        if not path.exists():
            raise UsageError(f"{path}: file not found")
        if found is None:
            raise UsageError(
                f"{path}: the name does not tell the sheath's bend as {self.bend!r} would; rename "
                "the file, or give pattern or list in --columns FILE (bend, bends)"
            )
        return self._checked(path, float(found[1]))

    def _checked(self, path: Path, bend: float) -> float:
        if not 0.0 <= bend < math.inf:
            raise UsageError(
                f"{path}: a bend of {bend:g}, must not be negative; if that is a dash, put it into "
                "the pattern in --columns FILE (bend: 'bend-{bend}')"
            )
        return self.radians * bend
