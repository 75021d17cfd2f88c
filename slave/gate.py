"""The safety gate before the motors: finite, fresh, within limits, or the motors hold.

Every motor position the slave loop writes has passed `step`, at every tick. For any request the
output is finite and within the travel limits (from beyond them it can only return); it changes by
at most the speed limit, and does not pull a tendon further whose tension is over its limit, too old
or not finite, or whose joint is at the end of its range or at its force limit. A request to stay is
always granted; while the gate holds, a tendon over its limit may be paid out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from typing import TypeAlias

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, Struct, StructArray
from slave.control.joint_estimate import JointEstimates
from slave.rig_layout import RigLayout
from teleop.config.ranges import MAY_BE_INFINITE, build_ranged_field, check_ranges
from teleop.runtime.clock import STEP_MAX_S


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Limits of one rig, the same for each of its tendons and joints."""

    # furthest pay-out
    displacement_min: float = build_ranged_field(-0.005, -math.inf, 0.0, "m", bound=0.5)
    # furthest pull
    displacement_max: float = build_ranged_field(0.060, 0.0, math.inf, "m", bound=0.5)
    # of a motor's tendon
    speed_max: float = build_ranged_field(0.10, 0.0, math.inf, "m/s", above=True, bound=0.5)
    # at the housing; above it a tendon is only paid out
    tension_max: float = build_ranged_field(25.0, 0.0, math.inf, "N", above=True, bound=300.0)
    # without a newer tension a tendon is only paid out
    tension_age_max: float = build_ranged_field(0.030, 0.0, 0.5, "s", above=True)
    joint_min: float = field(  # [m] lowest estimated travel of a joint
        default=-math.inf, metadata=MAY_BE_INFINITE
    )
    joint_max: float = field(  # [m] highest estimated travel of a joint
        default=math.inf, metadata=MAY_BE_INFINITE
    )
    # estimated at a tip; above it the joint moves no further
    force_max: float = build_ranged_field(math.inf, 0.0, math.inf, "N", above=True, bound=300.0)
    # paying-out gain of a holding tendon above tension_max
    yield_gain: float = build_ranged_field(0.004, 0.0, 1.0, "m/s/N")
    exceed_bounds: bool = False  # accept limits beyond those of docs/explanation/safety.md

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.joint_min < self.joint_max:
            raise ValueError("joint_min: must be below joint_max")


class GateFlags(IntFlag):
    """Interventions of the gate at a tick; 0 = request passed unchanged."""

    PASSED = 0
    HELD = 1  # not allowed to move
    NOT_FINITE = 2  # the request, or the tension it depends on, is not a number
    TRAVEL = 4  # clamped to the travel limits
    SPEED = 8  # clamped to the speed limit
    TENSION = 16  # tension limit: no further pull
    STALE_TENSION = 32  # no recent tension: no further pull
    JOINT = 64  # joint at the end of its range, or unknown: no further pull
    FORCE = 128  # tip force at its limit, or unknown: no further pull
    YIELDED = 256  # held, but paid out because of its tension


# for compiled code, which does not support flags
PASSED = int(GateFlags.PASSED)
HELD = int(GateFlags.HELD)
NOT_FINITE = int(GateFlags.NOT_FINITE)
TRAVEL = int(GateFlags.TRAVEL)
SPEED = int(GateFlags.SPEED)
TENSION = int(GateFlags.TENSION)
STALE_TENSION = int(GateFlags.STALE_TENSION)
JOINT = int(GateFlags.JOINT)
FORCE = int(GateFlags.FORCE)
YIELDED = int(GateFlags.YIELDED)

ALONE = 1.0 - 1e-6  # of a tendon's travel: what follows from it without those of antagonists


class Reach(Struct):
    """Remaining range of a tendon's joint; NaN if unknown."""

    ahead: F64 = math.nan  # [m] to the end of the range in the pulling direction
    behind: F64 = math.nan  # [m] to the other end, if only this tendon holds the joint off it
    force: F64 = math.nan  # [N] at the tip, against pulling


Reaches: TypeAlias = Sequence[Reach] | StructArray
"""One for each tendon of a rig, as a field of a record or as an array of records."""
NO_REACH = Reach.array(0)


@jit_compile
def compute_reaches(
    config: GateConfig, layout: RigLayout, joint_estimates: JointEstimates, out_reach: Reaches
) -> None:
    """Write the reach of each tendon of a rig.

    A joint of one tendon returns by its spring; otherwise other tendons must pull it back.
    Positions [m] of joints and forces on them [N] are NaN if unknown.
    """
    for i in range(layout.tendons):
        up, down, f, own = math.inf, math.inf, 0.0, 0.0
        for j in range(layout.joints):
            own += layout.travel[i, j] * layout.inverse[j, i]  # less than 1 with antagonists
        for j in range(layout.joints):  # that the tendon moves, if the others only give way
            share = layout.inverse[j, i] / own
            if share != 0.0:
                q, to_max, to_min = joint_estimates[j].position, math.inf, math.inf
                if math.isfinite(config.joint_max):
                    to_max = (config.joint_max - q) / abs(share)
                if math.isfinite(config.joint_min):
                    to_min = (q - config.joint_min) / abs(share)
                up = _choose_nearer(up, to_max if share > 0.0 else to_min)
                down = _choose_nearer(down, to_min if share > 0.0 else to_max)
                f += share * joint_estimates[j].force
        reach = out_reach[i]
        reach.ahead, reach.behind, reach.force = up, math.inf, f
        if own > ALONE:
            reach.behind = down


@jit_compile
def _choose_nearer(first: float, second: float) -> float:
    """Return the shorter of two distances [m], NaN if one is unknown."""
    return first if first < second or math.isnan(first) else second


@jit_compile
def step(
    config: GateConfig,
    tendons: int,
    last: Array,
    requested: Array,
    tension: Array,
    tension_age: float,
    may_move: bool,
    dt: float,
    reach: Reaches,
    has_reach: bool,
    may_yield: bool,
    out_passed: Array,
) -> int:
    """Limit `requested` to safe positions; return the bits of `GateFlags`.

    `ValueError` if an array is shorter than `tendons`.

    Parameters
    ----------
    tendons : int
        How many tendons there are; the arrays may be longer.
    last, requested : arrays, shape (tendons,)
        Motor positions [m] written last, and requested now.
    tension : array, shape (tendons,)
        Newest tension at the housing [N].
    tension_age : float
        Its age [s].
    may_move : bool
        Whether the session is engaged and the command fresh.
    dt : float
        Time since the last tick [s].
    reach : Reaches, shape (tendons,)
        Remaining range of each tendon's joint.
    has_reach : bool
        Whether `reach` is used; otherwise it may have any length.
    may_yield : bool
        Whether holding motors may pay out a tendon over its tension limit.
    out_passed : array, shape (tendons,)
        Motor positions [m] to be written, and `last` of the next tick; it may be the array `last`.
    """
    shortest = min(len(last), len(requested), len(tension), len(out_passed))
    if tendons > shortest or (has_reach and tendons > len(reach)):
        raise ValueError("gate: an array is shorter than the number of tendons")
    dt = min(dt, STEP_MAX_S) if dt > 0.0 else 0.0
    if not may_move:
        may_yield = may_yield and tension_age <= config.tension_age_max
        return _hold_motors(config, tendons, last, tension, may_yield, dt, out_passed)
    stride = config.speed_max * dt
    is_stale = not tension_age <= config.tension_age_max
    verdict = PASSED
    for k in range(tendons):
        previous, target, force = last[k], requested[k], tension[k]
        if not (math.isfinite(target) and math.isfinite(force)):
            verdict |= NOT_FINITE
            target = previous
        lowest = min(config.displacement_min, previous)
        highest = max(config.displacement_max, previous)
        bounded = min(max(target, lowest), highest)
        if bounded != target:
            verdict |= TRAVEL
        is_pull = bounded > previous
        if is_pull and force > config.tension_max:
            verdict |= TENSION
            bounded = previous
        if is_pull and is_stale:
            verdict |= STALE_TENSION
            bounded = previous
        refusal = (
            _find_refusal(config, reach[k], bounded - previous, force) if has_reach else PASSED
        )
        if refusal != PASSED:
            verdict |= refusal
            bounded = previous
        slewed = min(max(bounded, previous - stride), previous + stride)
        if slewed != bounded:
            verdict |= SPEED
        out_passed[k] = slewed
    return verdict


def limit_targets(
    config: GateConfig, last: Array, target: Array, tension: Array, tension_age: float, dt: float
) -> tuple[Array, GateFlags]:
    """Return positions [m] outside a session, where no range of a joint is known, and the flags.

    For the arguments see `step`; `config` is a record (`to_struct`).
    """
    passed = np.empty_like(last)
    verdict = step(
        config, len(last), last, target, tension, tension_age, True, dt, NO_REACH, False, False,
        passed,
    )  # fmt: skip
    return passed, GateFlags(verdict)


@jit_compile
def _find_refusal(config: GateConfig, reach: Reach, change: float, tension: float) -> int:
    """Return why a motor must not move by `change` [m]; paying out is always allowed."""
    refusal = PASSED
    if change > 0.0:
        if not reach.ahead > 0.0:
            refusal |= JOINT
        if math.isfinite(config.force_max) and not reach.force < config.force_max:
            refusal |= FORCE
    elif change < 0.0 and not reach.behind > 0.0 and not tension > config.tension_max:
        refusal |= JOINT
    return refusal


@jit_compile
def _hold_motors(
    config: GateConfig,
    tendons: int,
    last: Array,
    tension: Array,
    may_yield: bool,
    dt: float,
    out_passed: Array,
) -> int:
    """Hold; if `may_yield`, pay out tendons in proportion to their excess tension."""
    verdict = HELD
    for k in range(tendons):
        previous = held_position = last[k]
        if may_yield:
            yielded = previous - _compute_yield_speed(config, tension[k]) * dt
            held_position = max(yielded, min(config.displacement_min, previous))
        if held_position != previous:
            verdict |= YIELDED
        out_passed[k] = held_position
    return verdict


@jit_compile
def _compute_yield_speed(config: GateConfig, tension: float) -> float:
    """Return the paying-out speed [m/s] of a holding tendon."""
    if not tension > config.tension_max or config.yield_gain == 0.0:
        return 0.0  # infinite tension times zero would be NaN
    return min(config.yield_gain * (tension - config.tension_max), config.speed_max)
