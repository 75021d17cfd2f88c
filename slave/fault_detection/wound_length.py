"""Detect broken and jammed tendons by comparing the length wound in with the tensions.

The tips of a joint's two tendons travel by q and -q, so the length wound in by both motors is the
elongation of both tendons plus a constant:

    q_p,a + q_p,b = e_a + e_b + c.

Of n + 1 tendons of n joints it is the sum over all, each by its tension t_i in balance: the tips
travel by sum t_i x_i = const.

A tension allows an interval of elongations (`compliance`), unbounded below for a slack tendon. So
each sample gives an interval for c, and all intervals must overlap. If the newest lies above the
others, a slack tendon was wound in by more than its length: it is broken. If it lies below, a
tendon has more tension than its stretch allows: it is jammed and stretched only between motor and
jam.
"""

from collections.abc import Sequence
from math import inf, nan

from estimator.compiled import jit_compile
from estimator.law import tables
from estimator.law.sheath import Sheath
from estimator.structs import F64, Struct
from slave.fault_detection.config import FaultDetectionConfig
from slave.fault_detection.load_cell import LoadCell, TendonAverage
from slave.rig_layout import TendonGroup
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
    """Process one sample of a tendon, `dt` [s] after the last; return whether it is broken.

    `tension` [N] at the housing is of this sample, `tension_before` of the last few, `wound` [m]
    the length wound in by all motors of its joint. `slack` is changed in place.
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
    """State of the check of tendons that work against each other."""

    low: F64 = -inf  # [m] interval for c from all samples
    high: F64 = inf
    above: F64 = 0.0  # [s] for which a sample lies above it
    below: F64 = 0.0  # [s] for which a sample lies below it


@jit_compile
def check_winding(
    config: FaultDetectionConfig,
    winding: WindingCheck,
    tendons: Sequence[CheckedTendon],
    group: TendonGroup,
    dt: float,
) -> tuple[Reason, int]:
    """Process one sample of a group; return the fault found and its tendon, -1 without one.

    If several are slack because the joint was flung aside, the one that went slack first is broken;
    at the same time, the one with more tension.

    The sample is `dt` [s] after the last. `winding` is changed in place; `tendons` are those of the
    rig, averaged over the same samples, their `slack` includes this one; a group has at least two.
    """
    wound, taut, of_all = 0.0, True, 0.0
    for n in range(group.count):
        average = tendons[group.tendon[n]].average
        wound += group.balance[n] * average.displacement
        of_all += group.balance[n]
        taut = taut and average.tension > config.slack
    least, largest, unsure = 0.0, 0.0, 0.0
    longest_slack, tightest, stretch_max = group.tendon[0], -1, -inf
    for n in range(group.count):
        i, t = group.tendon[n], group.balance[n]
        average, compliance = tendons[i].average, tendons[i].compliance
        stretch = t * compute_elongation_min(compliance, average.tension)
        least += stretch
        largest += t * compute_elongation_max(compliance, average.tension)
        joint_travel = 0.5 * t * abs(average.displacement - wound / of_all)
        unsure += config.misfit_share * (stretch + joint_travel)
        unsure += config.lag * t * abs(average.speed)
        if is_slack_longer(tendons[i].slack, tendons[longest_slack].slack):
            longest_slack = i
        if stretch > stretch_max:
            tightest, stretch_max = i, stretch
    low = wound - largest - unsure
    high = wound - least + unsure if taut else inf
    is_above = low > winding.high + config.misfit and not taut
    is_below = high < winding.low - config.misfit
    winding.above = winding.above + dt if is_above else 0.0
    winding.below = winding.below + dt if is_below else 0.0
    if winding.above == 0.0 and winding.below == 0.0:
        winding.low = max(winding.low - INTERVAL_GROWTH * dt, low)
        winding.high = min(winding.high + INTERVAL_GROWTH * dt, high)
    if winding.above >= MISFIT_TIME:
        return Reason.TENDON_BROKEN, longest_slack
    if winding.below >= MISFIT_TIME:
        return Reason.TENDON_JAMMED, tightest
    return Reason.NONE, -1
