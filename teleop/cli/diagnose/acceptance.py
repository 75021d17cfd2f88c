"""Compare the parameters of a calibration with those from the data."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from estimator.diagnosis import report_tables
from estimator.diagnosis.dataset import COMPLIANCE, FRICTION
from estimator.diagnosis.outcome import Diagnosis, FittedValue
from estimator.law.sheath import Sheath
from estimator.text_table import Table
from estimator.units import format_quantity
from slave.calibration import file
from teleop.errors import UsageError


class ComparedParameter(NamedTuple):
    """A parameter of the sheath from calibration and data."""

    accepted: float
    found: FittedValue

    @property
    def agrees(self) -> bool:
        """Whether the calibration is inside the interval of the data."""
        return self.found.low <= self.accepted <= self.found.high


def load_sheath(path: Path, tendon: int) -> Sheath:
    """Return the sheath of a tendon, from 0, of a calibration file; a single one is for all."""
    tendons = file.load(path).tendons
    if len(tendons) > 1 and tendon >= len(tendons):
        raise UsageError(f"{path}: has {len(tendons)} tendons, not tendon {tendon + 1}")
    return tendons[tendon if len(tendons) > 1 else 0].model().sheath


def compare_parameters(found: Diagnosis, sheath: Sheath) -> dict[str, ComparedParameter]:
    """Return the parameters in both calibration and data, by name."""
    accepted = {
        FRICTION.name: sheath.K,
        COMPLIANCE.name: sheath.length / sheath.axial_stiffness,
    }
    return {
        name: ComparedParameter(value, found.parameters[name])
        for name, value in accepted.items()
        if name in found.parameters
    }


def build_comparison_table(numbers: Mapping[str, ComparedParameter]) -> Table:
    """Return the comparison as text."""
    rows = [
        (
            name,
            format_quantity(one.accepted, one.found.unit),
            format_quantity(one.found.value, one.found.unit),
            report_tables.format_interval(one.found),
            "yes" if one.agrees else "NO",
        )
        for name, one in numbers.items()
    ]
    return Table(("sheath", "calibration", "these data", "95 % interval", "agree"), tuple(rows))
