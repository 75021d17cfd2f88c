"""How much of an estimated force may be felt, in compiled code: see `teleop.confidence`."""

import math

from estimator.compiled import compiled
from teleop.confidence import ConfidenceConfig

__all__ = ["ConfidenceConfig", "attenuated", "certain"]


@compiled
def certain(low: float, high: float) -> float:
    """Return the force [N] in `low ... high` that is nearest to zero."""
    return max(low, 0.0) + min(high, 0.0)


@compiled
def attenuated(config: ConfidenceConfig, force: float, low: float, high: float) -> float:
    """Return how much of an estimated `force` [N], certified to be in `low ... high`, is felt.

    An estimate beyond its interval counts as the end of it, but is felt no stronger than it is, and
    not at all if that end has the other sign. An interval that is none (an end is
    NaN, or they are swapped) certifies nothing: 0. A force that is not finite is returned as it
    is, for the gate to refuse.
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
    felt = abs(sure + weight * (near - sure))
    return math.copysign(min(felt, abs(force)), force)
