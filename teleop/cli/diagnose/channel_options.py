"""`--column NAME=COLUMN` of a diagnosis: NAME tells the units, too."""

from collections.abc import Sequence
from typing import NamedTuple

from estimator.units import Units
from teleop.cli import estimate
from teleop.data import channel_names
from teleop.data.table import Columns


class NamedColumns(NamedTuple):
    """Column names, and the units that they were named in; None where none was told."""

    names: Columns
    units: Units | None


def parse_column_options(words: Sequence[str], tendon: int = 0) -> NamedColumns:
    """Return the columns of a tendon, from 0, with the overrides of `--column`.

    NAME may be that of a torque, an angle or a force, such as `proximal_torque`.

    Raises
    ------
    UsageError
        An override is none, or they are linear in part and rotary in part.
    """
    pairs = [word.partition("=") for word in words]
    units = channel_names.detect_option_units([name for name, _, _ in pairs])
    meant = [f"{channel_names.to_channel(name)}{equals}{column}" for name, equals, column in pairs]
    return NamedColumns(estimate.parse_column_names(meant, tendon), units)
