"""The last gate before the motors: finite, fresh, within limits, or the motors hold.

Every motor position the slave loop writes has come through `step`, on every tick. Whatever asks
for it, the output is a finite displacement that stays within the travel limits, or if it stood
beyond them goes nowhere but back; it differs from the last one by no more than the speed limit
allows, and does not pull a tendon any further whose tension is over its limit, too old, or cannot
be read. What is wanted to stay stays, wherever that is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple

_DT_MAX = 0.005  # [s] however long a tick was skipped, a motor may go no further than this allows


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Limits of one rig, the same for each of its tendons."""

    displacement_min: float = -0.005  # [m] furthest pay-out
    displacement_max: float = 0.060  # [m] furthest pull
    speed_max: float = 0.10  # [m/s] of a motor's tendon
    tension_max: float = 25.0  # [N] at the housing; above it a tendon is only paid out
    tension_age_max: float = 0.030  # [s] with no tension younger than this it is only paid out

    def __post_init__(self) -> None:
        """Refuse limits that limit nothing."""
        for name in ("displacement_min", "displacement_max", "speed_max", "tension_max"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name}: must be finite")
        if not self.displacement_min <= 0.0 <= self.displacement_max:
            raise ValueError("displacement_min: must be at most 0, displacement_max at least 0")
        if self.speed_max <= 0.0 or self.tension_max <= 0.0:
            raise ValueError("speed_max, tension_max: must be above 0")
        if not 0.0 < self.tension_age_max <= 0.5:
            raise ValueError("tension_age_max: must be above 0 and at most 0.5 s")


class Verdict(IntFlag):
    """What the gate had to do to a tick; 0 = let through as asked."""

    PASSED = 0
    HELD = 1  # not allowed to move
    NOT_FINITE = 2  # the request, or the tension it depends on, is not a number
    TRAVEL = 4  # clamped to the travel limits
    SPEED = 8  # clamped to the speed limit
    TENSION = 16  # tension limit: pulling refused
    STALE = 32  # no tension young enough: pulling refused


class Gated(NamedTuple):
    """What leaves the gate; `displacement` [m] is also the memory of the next tick."""

    displacement: tuple[float, ...]
    verdict: Verdict


def step(
    config: GateConfig,
    last: Sequence[float],
    wanted: Sequence[float],
    tension: Sequence[float],
    tension_age: float,
    may_move: bool,
    dt: float,
) -> Gated:
    """Let `wanted` through as far as it is safe.

    Parameters
    ----------
    last, wanted : sequences of float
        Motor positions [m] written last, and asked for now, one for each tendon.
    tension : sequence of float
        Newest tension at the housing [N], one for each tendon.
    tension_age : float
        Time since it came [s].
    may_move : bool
        Whether the session is engaged and the command fresh.
    dt : float
        Time since the last tick [s].
    """
    if not may_move:
        return Gated(tuple(last), Verdict.HELD)
    reach = config.speed_max * min(dt, _DT_MAX) if dt > 0.0 else 0.0
    stale = not tension_age <= config.tension_age_max
    verdict = Verdict.PASSED
    passed = []
    for was, want, force in zip(last, wanted, tension, strict=True):
        target = want
        if not (math.isfinite(want) and math.isfinite(force)):
            verdict |= Verdict.NOT_FINITE
            target = was
        lowest, highest = min(config.displacement_min, was), max(config.displacement_max, was)
        bounded = min(max(target, lowest), highest)
        if bounded != target:
            verdict |= Verdict.TRAVEL
        pulled = bounded > was
        if pulled and force > config.tension_max:
            verdict |= Verdict.TENSION
            bounded = was
        if pulled and stale:
            verdict |= Verdict.STALE
            bounded = was
        slewed = min(max(bounded, was - reach), was + reach)
        if slewed != bounded:
            verdict |= Verdict.SPEED
        passed.append(slewed)
    return Gated(tuple(passed), verdict)
