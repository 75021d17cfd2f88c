"""`--column NAME=COLUMN` of a diagnosis: NAME tells the units, too."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from estimator.effects import CATALOGUE, CHANNELS, NAMES, Effect
from estimator.units import Units
from teleop.cli import estimate
from teleop.config.suggestions import suggest_spelling
from teleop.data import channel_names
from teleop.data.channel_names import to_channel
from teleop.data.effect_extensions import is_extension, load_effects
from teleop.data.table import Columns
from teleop.errors import UsageError


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


# --- parser of `--effects`


def parse_effects(text: str) -> Sequence[Effect]:
    """Return the effects of `--effects`: comma-separated names, or all."""
    if text.strip() == "all":
        return CATALOGUE
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UsageError("--effects: names of effects with commas between them, or all")
    others = tuple(effect for name in names if is_extension(name) for effect in load_effects(name))
    for name in names:
        if name not in NAMES and not is_extension(name):
            listed = suggest_spelling(name, NAMES, 3, 0.5) or f"; there are {', '.join(NAMES)}"
            raise UsageError(f"--effects {name}: no such effect{listed}")
    return (*(effect for effect in CATALOGUE if effect.name in names), *others)


# --- `--noise NAME=SIGMA`: noise of a channel that is known better than the data tell it


def parse_noise(words: Sequence[str]) -> dict[str, float]:
    """Return standard deviations by channel, in its unit; `UsageError` if a word is none."""
    noise = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            sigma = float(text)
        except ValueError:
            sigma = math.nan
        channel = to_channel(name)
        if channel not in CHANNELS or not 0.0 <= sigma < math.inf:
            raise UsageError(
                f"--noise {word}: expected NAME=SIGMA in the unit of the data, NAME one of "
                f"{', '.join(CHANNELS)}"
            )
        noise[channel] = sigma
    return noise
