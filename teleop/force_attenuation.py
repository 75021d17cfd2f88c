"""Attenuation of an estimated force by its certified interval: all of it, or what is certain.

An estimate f comes with a certified interval [low, high]. Certain is the force in it that is
nearest to zero,

    c = max(low, 0) + min(high, 0)

which is zero as long as the interval contains zero. What is rendered lies between the two,

    f_port = c + w (f - c),   w = 1 for h <= full |f|,  0 for h >= none |f|,  straight in between

with h = (high - low) / 2. It is never stronger than f, never of the other sign, never weaker than
what is certain, and continuous in all three numbers: where |f| -> 0, c and f meet.

Both sides of a session use this rule with the same constants, so that both know the port force
(`teleop.coupling`) from the same message.
"""

import math
from dataclasses import dataclass

from estimator.compiled import compiled


@dataclass(frozen=True, slots=True)
class ConfidenceConfig:
    """Between which relative half-widths of the interval an estimate is attenuated."""

    full: float = 0.5  # half-width over |force| up to which the estimate itself is rendered
    none: float = 1.5  # ... from which only what is certain is rendered

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 <= self.full <= 1e3:
            raise ValueError("full: must be within 0 ... 1000")
        if not self.full + 1e-3 <= self.none <= 1e6:
            raise ValueError("none: must be above full, by 0.001 at least, and at most 1e6")


@compiled
def certain(low: float, high: float) -> float:
    """Return the force [N] in `low ... high` that is nearest to zero."""
    return max(low, 0.0) + min(high, 0.0)


@compiled
def attenuate(config: ConfidenceConfig, force: float, low: float, high: float) -> float:
    """Return how much of an estimated `force` [N], certified to be in `low ... high`, is rendered.

    An estimate beyond its interval counts as the end of it, but is rendered no stronger than it is,
    and not at all if that end has the other sign. An interval that is none (an end is NaN, or they
    are swapped) certifies nothing: 0. A force that is not finite is returned as it is, for the
    gate to refuse.
    """
    if not math.isfinite(force):
        return force
    if not low <= high:
        return 0.0
    near = min(max(force, low), high)
    if not near * math.copysign(1.0, force) > 0.0:
        return 0.0
    size = abs(near)
    # divided before they are subtracted: the ends may be as large as numbers are
    width = 0.5 * high / size - 0.5 * low / size
    weight = min(max((config.none - width) / (config.none - config.full), 0.0), 1.0)
    sure = certain(low, high)
    rendered = abs(sure + weight * (near - sure))
    return math.copysign(min(rendered, abs(force)), force)
