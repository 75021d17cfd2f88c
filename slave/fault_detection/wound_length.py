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

from math import inf, nan

from estimator.compiled import jit_compile
from estimator.law import tables
from estimator.law.sheath import Sheath
from estimator.records import F64, Struct
from slave.fault_detection.cell import LoadCell, TendonAverage
from slave.fault_detection.config import FaultDetectionConfig
from teleop.session.state_machine import Reason

# --- bounds of the elongation of a tendon at a tension, for any earlier motion
# With friction the elongation at housing tension T lies between e(T) of a pull and e(T) of a
# release (theory.md (T2), (T4)),  M_pull (T + tau) - tau L/EA  <=  e  <=  M_rel (T + tau) -
# tau L/EA.


class ComplianceBounds(Struct):
    """Bounds of the compliance of a tendon."""

    pull: F64 = 0.0  # M_pull [m/N]
    release: F64 = 0.0  # M_rel [m/N]
    drag: F64 = 0.0  # tau [N]
    rest: F64 = 0.0  # tau L/EA [m]


def compute_compliance(sheath: Sheath) -> ComplianceBounds:
    """Return the compliance of a tendon in a sheath."""
    table = tables.build_tables(sheath)
    K, EA, rho = table[tables.K], table[tables.EA], table[tables.ASYMMETRY]
    drag = table[tables.DRAG]
    return ComplianceBounds.new(
        pull=tables.integrate_exponential(table, K, -1.0) / EA,
        release=tables.integrate_exponential(table, K, rho) / EA,
        drag=drag,
        rest=drag * table[tables.LENGTH] / EA,
    )


@jit_compile
def compute_elongation_min(compliance: ComplianceBounds, tension: float) -> float:
    """Return the least elongation [m] of a taut tendon with `tension` [N] at the housing."""
    return max(compliance.pull * (tension + compliance.drag) - compliance.rest, 0.0)


@jit_compile
def compute_elongation_max(compliance: ComplianceBounds, tension: float) -> float:
    """Return the largest elongation [m] of a tendon with `tension` [N] at the housing."""
    return compliance.release * (max(tension, 0.0) + compliance.drag) - compliance.rest


# --- detect a broken tendon by the length wound in since it lost its tension
# A moving joint may slacken a tendon, and winding it in makes it taut again. One that is wound in
# further than the joint can have moved is broken.


class SlackState(Struct):
    """State of a tendon without tension; the defaults are those of a taut one."""

    time: F64 = -1.0  # [s] since the tension was lost; below 0 while taut
    lost: F64 = 0.0  # [N] tension before
    wound: F64 = nan  # [m] wound in by the joint's motors when it went slack


@jit_compile
def check_slack(
    config: FaultDetectionConfig,
    slack: SlackState,
    tension: float,
    tension_before: float,
    wound: float,
    dt: float,
) -> bool:
    """Process one sample of a tendon; return whether the tendon is broken.

    Parameters
    ----------
    slack : SlackState
        Changed in place.
    tension, tension_before : float
        At the housing [N], of this sample and of the last few.
    wound : float
        Length wound in by all motors of its joint [m].
    dt : float
        Time since the last sample [s].
    """
    if tension > config.slack:
        slack.time, slack.lost, slack.wound = -1.0, 0.0, nan
        return False
    if slack.time < 0.0:
        slack.time, slack.lost, slack.wound = 0.0, tension_before, wound
        return False
    slack.time += dt
    return slack.wound + config.take_up < wound


@jit_compile
def is_slack_longer(slack: SlackState, other: SlackState) -> bool:
    """Return whether a tendon lost its tension first; at the same time, whether it had more."""
    if slack.time != other.time:
        return slack.time > other.time
    if slack.lost != other.lost:
        return slack.lost > other.lost
    return slack.wound > other.wound


# --- constants and state of the fault detection of one tendon


class CheckedTendon(Struct):
    """One tendon: constants of its model, then the state of its checks."""

    compliance: ComplianceBounds
    noise: F64 = 0.0  # [N] of its load cell
    cell: LoadCell
    average: TendonAverage
    slack: SlackState


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
    winding : WindingCheck
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
