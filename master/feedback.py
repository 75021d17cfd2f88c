"""From the estimated force at the tips to the force on the hand, as links of a chain.

    tip_forces   the estimate, as far as its interval allows (`teleop.coupling.force_attenuation`)
    reflect      F_hand = -scale * F_tip
    (coupling: `master.coupling_adapter`)
    limit_slew   grows no faster than `slew`
    clamp        no larger than `limit` (`master.force.limit`)

The estimate counts a force against pulling as positive, and a hand moving along its positive axis
pulls, so the hand is pushed the other way.

A joint whose sample the estimator rejected is not rendered: its estimate is outdated.
A value that is not finite goes through as it is, for the gate to refuse. The gate has limits of its
own above `limit`, on each axis and in total (`master.gate.axis_max`, `total_max`; `master.gate`).
"""

import math
from dataclasses import dataclass

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from teleop.config.ranges import RangedConfig, build_ranged_field
from teleop.coupling.config import BilateralSettings
from teleop.coupling.force_attenuation import attenuate_forces
from teleop.messages.messages import MAX_JOINTS, STATUS_NAMES, SlaveState
from teleop.runtime.clock import STEP_MAX_S

INVALID = 1 << STATUS_NAMES.index("invalid input")


@dataclass(frozen=True, slots=True)
class FeedbackConfig(RangedConfig):
    """How the force at the tips is rendered."""

    scale: float = build_ranged_field(0.2, 0.0, 10.0)  # force on the hand per force at the tip
    # on one axis; rendering saturates here, below the gate's limits
    limit: float = build_ranged_field(2.5, 0.0, math.inf, "N", above=True)
    # at which a force on one axis grows, below the gate's limit
    slew: float = build_ranged_field(150.0, 0.0, math.inf, "N/s", above=True)


@jit_compile
def compute_tip_forces(
    bilateral: BilateralSettings, state: SlaveState, has_state: bool, axes: int, out: Array
) -> None:
    """Write the admissible force at each tip [N] to the first `axes` of `out`, shape (8,).

    Zero before the first state, for axes without a joint, and for joints with an invalid estimate.
    """
    estimates = np.zeros((4, MAX_JOINTS))
    reduction = state.force_reduction if has_state else 0.0
    for k in range(axes):
        if has_state and k < state.joints and is_valid(state, k):
            estimates[0, k], estimates[3, k] = state.force[k], state.force_margin[k]
            estimates[1, k], estimates[2, k] = state.force_low[k], state.force_high[k]
        else:
            estimates[1:, k] = math.nan  # of an arm, no joint is then rendered
    attenuate_forces(bilateral.confidence, bilateral.arm, estimates, axes, reduction, out)


@jit_compile
def is_valid(state: SlaveState, joint: int) -> bool:
    """Return whether the estimate of a joint is one of its newest sample."""
    return state.status[joint] & INVALID == 0


@jit_compile
def reflect_force(scale: float, force: float) -> float:
    """Return the force on the hand [N] for a force at the tip [N], positive = against pulling."""
    return -scale * force


@jit_compile
def compute_saturation(config: FeedbackConfig) -> float:
    """Return the force at the tip [N] at which the force on the hand saturates."""
    return config.limit / config.scale if config.scale > 0.0 else 0.0


@jit_compile
def limit_slew(slew_max: float, last: float, force: float, dt: float) -> float:
    """Return `force` [N] with its growth since `last` [N] limited to `slew_max` [N/s].

    Decreasing towards zero is not limited; non-finite values are kept.
    """
    if not math.isfinite(force):
        return force
    growth = slew_max * min(dt, STEP_MAX_S) if dt > 0.0 else 0.0
    return min(max(force, min(last, 0.0) - growth), max(last, 0.0) + growth)


@jit_compile
def clamp(limit: float, force: float) -> float:
    """Return `force` [N] saturated at `limit` [N]; non-finite values are kept.

    The device's limits, `axis_max` and `total_max` of `master.gate`, come last.
    """
    return min(max(force, -limit), limit) if math.isfinite(force) else force
