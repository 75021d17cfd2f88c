"""The last gate before the hand: finite, fresh, engaged, within limits, or no force.

Every force the master loop writes to a device has come through `step`, on every tick. Whatever
asks for it, the output is finite, no larger than the limits, grows no faster than the slew limit,
and is zero as soon as the session is not engaged, whatever the reason. Zero is always within reach:
nothing here slows a force on its way down. There are two exceptions, both of the caller's choice.
A peer that fell silent lets the force `fade`: each axis goes to zero at `axis_max` per `FADE_S`,
so no axis is felt `FADE_S` after the silence was noticed. And a device may be kept from falling by
a small force of its own, `rest`, which takes the place of zero.
"""

import math
from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple

from master.device import Axes

FADE_S = 0.015  # [s] within which the largest force on one axis is gone; 30 ms + this < 50 ms
_DT_MAX = 0.005  # [s] however long a tick was skipped, a force may grow by no more than this allows


@dataclass(frozen=True, slots=True)
class GateConfig:
    """What the device and the hand on it may be given."""

    axis_max: float = 3.0  # [N] on one axis; desktop haptic devices reach about 3 N
    total_max: float = 4.0  # [N] length of the force vector
    slew_max: float = 200.0  # [N/s] at which a force may grow

    def __post_init__(self) -> None:
        """Refuse limits that limit nothing."""
        for name in ("axis_max", "total_max", "slew_max"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: must be above 0 and finite")


class Verdict(IntFlag):
    """What the gate had to do to a tick; 0 = let through as asked."""

    PASSED = 0
    NOT_ENGAGED = 1  # zero
    STALE = 2  # zero
    NOT_FINITE = 4  # zero
    AXIS_LIMIT = 8  # clamped
    TOTAL_LIMIT = 16  # shortened, same direction
    SLEW = 32  # growth slowed


class Gated(NamedTuple):
    """What leaves the gate; `force` [N] is also the memory of the next tick."""

    force: Axes
    verdict: Verdict


def step(
    config: GateConfig,
    last: Axes,
    wanted: Axes,
    fresh: bool,
    may_render: bool,
    dt: float,
    fades: bool = False,
    rest: Axes = (),
) -> Gated:
    """Let `wanted` through as far as it is safe.

    Parameters
    ----------
    last, wanted : tuples of float
        Forces [N] written last, and asked for now, one for each axis.
    fresh : bool
        Whether the slave's state behind `wanted` is young enough.
    may_render : bool
        Whether the session is engaged on both sides.
    dt : float
        Time since the last tick [s].
    fades : bool
        Whether what is refused goes to zero by a ramp, and not at once.
    rest : tuple of float
        Forces [N] in place of zero, one for each axis; empty = zero.
    """
    refusal = Verdict.PASSED
    if not may_render:
        refusal |= Verdict.NOT_ENGAGED
    if not fresh:
        refusal |= Verdict.STALE
    if not all(map(math.isfinite, wanted)):
        refusal |= Verdict.NOT_FINITE
    verdict = refusal
    if refusal:
        wanted = rest if all(map(math.isfinite, rest)) and rest else (0.0,) * len(last)
        if fades and Verdict.NOT_FINITE not in refusal:
            wanted = _faded(config, last, wanted, dt)
    limit = config.axis_max
    bounded = [min(max(force, -limit), limit) for force in wanted]
    if bounded != list(wanted):
        verdict |= Verdict.AXIS_LIMIT
    total = math.hypot(*bounded)
    if total > config.total_max:
        verdict |= Verdict.TOTAL_LIMIT
        bounded = [force * (config.total_max / total) for force in bounded]
    growth = config.slew_max * min(dt, _DT_MAX) if dt > 0.0 else 0.0
    slewed = tuple(
        min(max(force, min(was, 0.0) - growth), max(was, 0.0) + growth)
        for was, force in zip(last, bounded, strict=True)
    )
    if slewed != tuple(bounded):
        verdict |= Verdict.SLEW
    return Gated(slewed, verdict)


def _faded(config: GateConfig, last: Axes, target: Axes, dt: float) -> Axes:
    """Return forces a tick nearer to `target` [N], or there."""
    if not 0.0 < dt < FADE_S:
        return target
    by = config.axis_max * dt / FADE_S
    return tuple(
        max(to, was - by) if was > to else min(to, was + by)
        for was, to in zip(last, target, strict=True)
    )
