"""`--noise NAME=SIGMA`: noise of a channel that is known better than the data tell it."""

import math
from collections.abc import Sequence

from estimator.effects import CHANNELS
from teleop.data.channel_names import to_channel
from teleop.errors import UsageError


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
