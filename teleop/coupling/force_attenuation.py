"""Attenuation of an estimated force by its certified interval.

An estimate f has a certified interval [low, high]. The certain force is the value in it nearest to
zero,

    c = max(low, 0) + min(high, 0)

which is zero if the interval contains zero. The rendered force lies between it and g, the estimate
less the margin m by which it is smaller with another K of its interval (adaptation; else 0):

    f_port = c + w (g - c),   |g| = max(|f| - m, |c|)
    w = 1 for d <= full |f|,  0 for d >= none |f|,  linear in between

where d is half the interval's width, or the distance from f to the interval's end towards zero if
that is larger: an estimate at the far end of a wide interval may be all too much.

It never exceeds g, never has the opposite sign, is never below the certain force, and is continuous
in all four numbers: for |f| -> 0, c equals f.

With a margin of `MARGIN_MIN` |f| and more, w compares the distance from g to that end with |g|
instead. A tip that sticks has T_in e^-K and T_in e^K as ends: their distance
would render less, then more again as T_in falls, and a hand would oscillate on it. By the lower end
alone, the force never grows as T_in falls.

The joints of an arm in space have one common factor, |f_port|/|f| of their vectors, so the force in
the hand keeps its direction.

Both sides of a session use the same constants, so both know the port force
(`teleop.coupling`) from the same message.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from teleop.config.ranges import build_ranged_field, check_ranges

MARGIN_MIN = 0.05
"""Margin over |force| from which on only the interval's end towards zero counts."""


@dataclass(frozen=True, slots=True)
class ConfidenceConfig:
    """Range of the interval's relative width over which an estimate is attenuated."""

    # half the interval's width, or more if its end towards zero is further off, over |force|
    # up to which the full estimate is rendered
    full: float = build_ranged_field(0.5, 0.0, 1e3)
    # the same from which on only the certain force is rendered
    none: float = 1.5

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.full + 1e-3 <= self.none <= 1e6:
            raise ValueError("none: must be above full, by 0.001 at least, and at most 1e6")


@jit_compile
def find_smallest_force(low: float, high: float) -> float:
    """Return the force [N] in `low ... high` that is nearest to zero."""
    return max(low, 0.0) + min(high, 0.0)


@jit_compile
def attenuate_force(
    config: ConfidenceConfig, force: float, low: float, high: float, margin: float
) -> float:
    """Return the rendered part of an estimated `force` [N], certified to be in `low ... high`.

    Its size may be less by `margin` [N]. An estimate beyond its interval is clipped to it, never
    amplified, and zero if that end has the other sign. An invalid interval (NaN or swapped ends) or
    margin (NaN or negative) gives 0. A non-finite force is returned unchanged, for the gate to
    reject.
    """
    if not math.isfinite(force):
        return force
    if not (low <= high and margin >= 0.0):
        return 0.0
    clipped = min(max(force, low), high)
    if not clipped * math.copysign(1.0, force) > 0.0:
        return 0.0
    size, certain = abs(clipped), abs(find_smallest_force(low, high))
    least = max(size - margin, certain)
    if least == 0.0:
        return 0.0
    # divide before subtracting: the ends may be near overflow
    near = low if force > 0.0 else -high
    weight = _compute_weight(config, max(0.5 * high / size - 0.5 * low / size, 1.0 - near / size))
    if margin > 0.0:
        one_sided = _compute_weight(config, 1.0 - near / least)
        weight += min(margin / size / MARGIN_MIN, 1.0) * (one_sided - weight)
    rendered = certain + weight * (least - certain)
    return math.copysign(min(rendered, abs(force)), force)


@jit_compile
def _compute_weight(config: ConfidenceConfig, width: float) -> float:
    """Return the rendered part of what is not certain, by the interval's relative `width`."""
    return min(max((config.none - width) / (config.none - config.full), 0.0), 1.0)


@jit_compile
def attenuate_forces(
    config: ConfidenceConfig,
    arm: NDArray[np.int64],
    estimates: Array,
    joints: int,
    reduction: float,
    out: Array,
) -> None:
    """Write the rendered forces [N] of so many joints to `out`.

    `arm`, shape (joints,) or longer, is the number of the arm in space that a joint belongs to, -1
    for one by itself; the joints of an arm are neighbours. `estimates`, shape (4, joints) or wider,
    are force [N], low and high end of its interval, and margin; if one of an arm is invalid (NaN or
    swapped ends), the arm renders nothing. `reduction` is the part of them that is not rendered
    (`SlaveState.force_reduction`); all unless within 0 ... 1.
    """
    factor = 1.0
    share = 1.0 - reduction if 0.0 <= reduction <= 1.0 else 0.0
    for k in range(joints):
        force, low, high, margin = _get_estimate(estimates, k)
        if arm[k] < 0:
            out[k] = share * attenuate_force(config, force, low, high, margin)
            continue
        if k == 0 or arm[k] != arm[k - 1]:
            factor = _compute_common_factor(config, arm, estimates, k, joints)
        out[k] = share * factor * force


@jit_compile
def _get_estimate(estimates: Array, k: int) -> tuple[float, float, float, float]:
    """Return force, low and high end, and margin of a joint [N]."""
    return estimates[0, k], estimates[1, k], estimates[2, k], estimates[3, k]


@jit_compile
def _compute_common_factor(
    config: ConfidenceConfig, arm: NDArray[np.int64], estimates: Array, first: int, joints: int
) -> float:
    """Return the part that is rendered of the forces of the arm that begins with joint `first`."""
    size, rendered = 0.0, 0.0
    for k in range(first, joints):
        if arm[k] != arm[first]:
            continue
        force, low, high, margin = _get_estimate(estimates, k)
        if not math.isfinite(force):
            return 1.0  # for the gate to reject
        if not (low <= high and margin >= 0.0):
            return 0.0
        size = math.hypot(size, force)
        rendered = math.hypot(rendered, attenuate_force(config, force, low, high, margin))
    return rendered / size if 0.0 < size < math.inf else 0.0
