"""The last gate before the motors: finite, fresh, within limits, or the motors hold.

Every motor position the slave loop writes has come through `step`, on every tick. Whatever asks
for it, the output is a finite displacement that stays within the travel limits, or if it stood
beyond them goes nowhere but back; it differs from the last one by no more than the speed limit
allows, and does not pull a tendon any further whose tension is over its limit, too old, or cannot
be read, nor one whose joint is at the end of its range or meets too large a force already. What is
wanted to stay stays, wherever that is; while it holds, a tendon over its limit may be paid out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import NamedTuple

from teleop.config import MAY_BE_INFINITE

_DT_MAX = 0.005  # [s] however long a tick was skipped, a motor may go no further than this allows


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Limits of one rig, the same for each of its tendons and joints."""

    displacement_min: float = -0.005  # [m] furthest pay-out
    displacement_max: float = 0.060  # [m] furthest pull
    speed_max: float = 0.10  # [m/s] of a motor's tendon
    tension_max: float = 25.0  # [N] at the housing; above it a tendon is only paid out
    tension_age_max: float = 0.030  # [s] with no tension younger than this it is only paid out
    joint_min: float = field(  # [m] estimated travel of a joint, from here ...
        default=-math.inf, metadata=MAY_BE_INFINITE
    )
    joint_max: float = field(  # [m] ... to there
        default=math.inf, metadata=MAY_BE_INFINITE
    )
    force_max: float = field(  # [N] estimated at a tip; above it the joint goes no further
        default=math.inf, metadata=MAY_BE_INFINITE
    )
    yield_gain: float = 0.004  # [m/s/N] with which a tendon that holds gives way above tension_max

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
        if not self.joint_min < self.joint_max:
            raise ValueError("joint_min: must be below joint_max")
        if not self.force_max > 0.0:
            raise ValueError("force_max: must be above 0 [N]")
        if not 0.0 <= self.yield_gain <= 1.0:
            raise ValueError("yield_gain: must be 0 to 1 [m/s/N]")


class Verdict(IntFlag):
    """What the gate had to do to a tick; 0 = let through as asked."""

    PASSED = 0
    HELD = 1  # not allowed to move
    NOT_FINITE = 2  # the request, or the tension it depends on, is not a number
    TRAVEL = 4  # clamped to the travel limits
    SPEED = 8  # clamped to the speed limit
    TENSION = 16  # tension limit: pulling refused
    STALE = 32  # no tension young enough: pulling refused
    JOINT = 64  # the joint is at the end of its range, or cannot be told: pulling refused
    FORCE = 128  # the force at the tip is at its limit, or cannot be told: pulling refused
    YIELDED = 256  # held, but paid out for its tension


class Gated(NamedTuple):
    """What leaves the gate; `displacement` [m] is also the memory of the next tick."""

    displacement: tuple[float, ...]
    verdict: Verdict


class Reach(NamedTuple):
    """How much further a tendon may take its joint, as far as that can be told."""

    ahead: float  # [m] until the joint is at the end towards which it pulls
    behind: float  # [m] until it is at the other one, if nothing but this tendon keeps it off that
    force: float  # [N] at the tip, against pulling


def reaches(
    config: GateConfig,
    joints: Sequence[Sequence[int]],
    position: Sequence[float],
    force: Sequence[float],
) -> tuple[Reach, ...]:
    """Return the reach of each tendon of a rig.

    The second tendon of a pair pulls its joint the other way. A joint of one tendon goes back by
    itself when that is paid out; of a pair, the other tendon has to pull it.

    Parameters
    ----------
    joints : sequence of sequences of int
        Which tendons each joint has, `Rig.joints`.
    position, force : sequences of float
        Estimated travel [m] of each joint and force on it [N], positive against pulling by its
        first tendon; NaN where they cannot be told.
    """
    seen = {}
    for joint, q, f in zip(joints, position, force, strict=True):
        up = config.joint_max - q if math.isfinite(config.joint_max) else math.inf
        down = q - config.joint_min if math.isfinite(config.joint_min) else math.inf
        if len(joint) == 1:
            seen[joint[0]] = Reach(up, down, f)
        else:
            seen[joint[0]] = Reach(up, math.inf, f)
            seen[joint[1]] = Reach(down, math.inf, -f)
    return tuple(seen[tendon] for tendon in sorted(seen))


def step(
    config: GateConfig,
    last: Sequence[float],
    wanted: Sequence[float],
    tension: Sequence[float],
    tension_age: float,
    may_move: bool,
    dt: float,
    reach: Sequence[Reach] = (),
    may_yield: bool = False,
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
    reach : sequence of Reach
        Of each tendon; empty if the rig has no such limits.
    may_yield : bool
        Whether motors that hold may give way to too large a tension.
    """
    dt = min(dt, _DT_MAX) if dt > 0.0 else 0.0
    if not may_move:
        may_yield = may_yield and tension_age <= config.tension_age_max
        return _hold(config, last, tension, may_yield, dt)
    stride = config.speed_max * dt
    stale = not tension_age <= config.tension_age_max
    verdict = Verdict.PASSED
    passed = []
    for k, (was, want, force) in enumerate(zip(last, wanted, tension, strict=True)):
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
        refusal = _refusal(config, reach[k], bounded - was, force) if reach else Verdict.PASSED
        if refusal:
            verdict |= refusal
            bounded = was
        slewed = min(max(bounded, was - stride), was + stride)
        if slewed != bounded:
            verdict |= Verdict.SPEED
        passed.append(slewed)
    return Gated(tuple(passed), verdict)


def _refusal(config: GateConfig, reach: Reach, change: float, tension: float) -> Verdict:
    """Return why a motor must not go on by `change` [m]; a tendon over its limit may be let go."""
    refusal = Verdict.PASSED
    if change > 0.0:
        if not reach.ahead > 0.0:
            refusal |= Verdict.JOINT
        if math.isfinite(config.force_max) and not reach.force < config.force_max:
            refusal |= Verdict.FORCE
    elif change < 0.0 and not reach.behind > 0.0 and not tension > config.tension_max:
        refusal |= Verdict.JOINT
    return refusal


def _hold(
    config: GateConfig, last: Sequence[float], tension: Sequence[float], may_yield: bool, dt: float
) -> Gated:
    """Stay; if that is allowed, pay out what is too tight, as fast as it is too tight."""
    held = tuple(last)
    if may_yield:
        held = tuple(
            max(was - _give(config, force) * dt, min(config.displacement_min, was))
            for was, force in zip(last, tension, strict=True)
        )
    return Gated(held, Verdict.HELD | Verdict.YIELDED if held != tuple(last) else Verdict.HELD)


def _give(config: GateConfig, tension: float) -> float:
    """Return the speed [m/s] at which a tendon that holds is paid out."""
    if not tension > config.tension_max:
        return 0.0
    return min(config.yield_gain * (tension - config.tension_max), config.speed_max)
