"""Attenuation of an estimated force by its certified interval.

An estimate f has a certified interval [low, high]. The certain force is the value in it nearest to
zero,

    c = max(low, 0) + min(high, 0)

which is zero if the interval contains zero. The rendered force lies between the two,

    f_port = c + w (f - c),   w = 1 for h <= full |f|,  0 for h >= none |f|,  linear in between

with h = (high - low) / 2. It never exceeds f, never has the opposite sign, is never below the
certain force, and is continuous in all three numbers: for |f| -> 0, c equals f.

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


@dataclass(frozen=True, slots=True)
class ConfidenceConfig:
    """Range of the interval's relative half-width over which an estimate is attenuated."""

    # half-width over |force| up to which the full estimate is rendered
    full: float = build_ranged_field(0.5, 0.0, 1e3)
    # half-width over |force| from which on only the certain force is rendered
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
def attenuate_force(config: ConfidenceConfig, force: float, low: float, high: float) -> float:
    """Return the rendered part of an estimated `force` [N], certified to be in `low ... high`.

    An estimate beyond its interval is clipped to it, never amplified, and zero if that end has the
    other sign. An invalid interval (NaN or swapped ends) gives 0. A non-finite force is returned
    unchanged, for the gate to reject.
    """
    if not math.isfinite(force):
        return force
    if not low <= high:
        return 0.0
    clipped = min(max(force, low), high)
    if not clipped * math.copysign(1.0, force) > 0.0:
        return 0.0
    size = abs(clipped)
    # divide before subtracting: the ends may be near overflow
    width = 0.5 * high / size - 0.5 * low / size
    weight = min(max((config.none - width) / (config.none - config.full), 0.0), 1.0)
    certain = find_smallest_force(low, high)
    rendered = abs(certain + weight * (clipped - certain))
    return math.copysign(min(rendered, abs(force)), force)


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
    for one by itself; the joints of an arm are neighbours. `estimates`, shape (3, joints) or wider,
    are force [N], low and high end of its interval; if one of an arm is invalid (NaN or swapped
    ends), the arm renders nothing. `reduction` is the part of them that is not rendered
    (`SlaveState.force_reduction`); all unless within 0 ... 1.
    """
    factor = 1.0
    share = 1.0 - reduction if 0.0 <= reduction <= 1.0 else 0.0
    for k in range(joints):
        force, low, high = estimates[0, k], estimates[1, k], estimates[2, k]
        if arm[k] < 0:
            out[k] = share * attenuate_force(config, force, low, high)
            continue
        if k == 0 or arm[k] != arm[k - 1]:
            factor = _compute_common_factor(config, arm, estimates, k, joints)
        out[k] = share * factor * force


@jit_compile
def _compute_common_factor(
    config: ConfidenceConfig, arm: NDArray[np.int64], estimates: Array, first: int, joints: int
) -> float:
    """Return the part that is rendered of the forces of the arm that begins with joint `first`."""
    size, rendered = 0.0, 0.0
    for k in range(first, joints):
        if arm[k] != arm[first]:
            continue
        force, low, high = estimates[0, k], estimates[1, k], estimates[2, k]
        if not math.isfinite(force):
            return 1.0  # for the gate to reject
        if not low <= high:
            return 0.0
        size = math.hypot(size, force)
        rendered = math.hypot(rendered, attenuate_force(config, force, low, high))
    return rendered / size if 0.0 < size < math.inf else 0.0
