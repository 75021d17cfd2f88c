"""Detect broken and jammed tendons by comparing the length wound in with the tensions.

The tips of a joint's two tendons travel by q and -q, so the length wound in by both motors is the
elongation of both tendons plus a constant:

    q_p,a + q_p,b = e_a + e_b + c.

A tension allows an interval of elongations (`compliance`), unbounded below for a slack tendon. So
each sample gives an interval for c, and all intervals must overlap. If the newest lies above the
others, a slack tendon was wound in by more than its length: it is broken. If it lies below, a
tendon has more tension than its stretch allows: it is jammed and stretched only between motor and
jam.
"""

from math import inf

from estimator.compiled import jit_compile
from estimator.records import F64, Struct
from slave.fault_detection.broken_tendon import is_slack_longer
from slave.fault_detection.compliance import compute_elongation_max, compute_elongation_min
from slave.fault_detection.config import FaultDetectionConfig
from slave.fault_detection.tendon_state import CheckedTendon
from teleop.session.state_machine import Reason

MISFIT_TIME = 0.010  # [s] least duration of a misfit
INTERVAL_GROWTH = 2e-5  # [m/s] at which the interval for c widens: creep, temperature


class WindingCheck(Struct):
    """State of the check of a joint's two tendons."""

    low: F64 = -inf  # [m] interval for c from all samples
    high: F64 = inf
    above: F64 = 0.0  # [s] for which a sample lies above it
    below: F64 = 0.0  # [s] for which a sample lies below it


@jit_compile
def check_winding(
    config: FaultDetectionConfig,
    winding: WindingCheck,
    tendon_a: CheckedTendon,
    tendon_b: CheckedTendon,
    dt: float,
) -> tuple[Reason, int]:
    """Process one sample of a joint; return the fault found and its tendon.

    The tendon is 0 or 1, -1 without a fault. If both are slack because the joint was flung aside,
    the one that went slack first is broken; at the same time, the one with more tension.

    Parameters
    ----------
    winding : Winding
        Changed in place.
    tendon_a, tendon_b : CheckedTendon
        Averaged over the same samples; `slack` includes this one.
    dt : float
        Time since the last sample [s].
    """
    a, b = tendon_a.average, tendon_b.average
    wound = a.displacement + b.displacement
    least_a = compute_elongation_min(tendon_a.compliance, a.tension)
    least_b = compute_elongation_min(tendon_b.compliance, b.tension)
    largest_a = compute_elongation_max(tendon_a.compliance, a.tension)
    largest_b = compute_elongation_max(tendon_b.compliance, b.tension)
    joint_travel = 0.5 * abs(a.displacement - b.displacement)
    unsure = config.misfit_share * (least_a + least_b + joint_travel)
    unsure += config.lag * (abs(a.speed) + abs(b.speed))
    low = wound - largest_a - largest_b - unsure
    taut = min(a.tension, b.tension) > config.slack
    high = wound - least_a - least_b + unsure if taut else inf
    is_above = low > winding.high + config.misfit and not taut
    is_below = high < winding.low - config.misfit
    winding.above = winding.above + dt if is_above else 0.0
    winding.below = winding.below + dt if is_below else 0.0
    if winding.above == 0.0 and winding.below == 0.0:
        winding.low = max(winding.low - INTERVAL_GROWTH * dt, low)
        winding.high = min(winding.high + INTERVAL_GROWTH * dt, high)
    if winding.above >= MISFIT_TIME:
        return Reason.TENDON_BROKEN, int(is_slack_longer(tendon_b.slack, tendon_a.slack))
    if winding.below >= MISFIT_TIME:
        return Reason.TENDON_JAMMED, int(least_b > least_a)
    return Reason.NONE, -1
