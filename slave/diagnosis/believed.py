"""What a calibration believes of the sheath, beside what the data say."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from estimator.diagnosis.model import COMPLIANCE, FRICTION
from estimator.diagnosis.outcome import Diagnosis, Number
from estimator.sheath import Sheath
from slave.calibration import file
from slave.diagnosis import words
from slave.experiment.report import Table
from teleop.errors import UsageError


class Compared(NamedTuple):
    """A number of the sheath, twice."""

    believed: float
    found: Number

    @property
    def agrees(self) -> bool:
        """Whether what is believed is inside the interval of what was found."""
        return self.found.low <= self.believed <= self.found.high


def load(path: Path, tendon: int) -> Sheath:
    """Return the sheath of a tendon, from 0, of a calibration file; one model is for all."""
    tendons = file.load(path).tendons
    if len(tendons) > 1 and tendon >= len(tendons):
        raise UsageError(f"{path}: has {len(tendons)} tendons, not tendon {tendon + 1}")
    return tendons[tendon if len(tendons) > 1 else 0].model().sheath


def compared(found: Diagnosis, sheath: Sheath) -> dict[str, Compared]:
    """Return the numbers that both the calibration and the data have, by name."""
    believed = {
        FRICTION.name: sheath.K,
        COMPLIANCE.name: sheath.length / sheath.axial_stiffness,
    }
    return {
        name: Compared(value, found.parameters[name])
        for name, value in believed.items()
        if name in found.parameters
    }


def table(numbers: Mapping[str, Compared]) -> Table:
    """Return them for a person to read."""
    rows = [
        (
            name,
            words.quantity(one.believed, one.found.unit),
            words.quantity(one.found.value, one.found.unit),
            words.interval(one.found),
            "yes" if one.agrees else "NO",
        )
        for name, one in numbers.items()
    ]
    return Table(("sheath", "calibration", "these data", "95 % interval", "agree"), tuple(rows))
