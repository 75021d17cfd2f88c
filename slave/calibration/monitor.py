"""Monitor whether a sheath still has the shape in which it was calibrated.

When a motor reverses after a pull, the tip rests until the sliding front has passed the sheath.
Until then motor travel is elongation, whatever joint and environment do, and must equal the model's
prediction from the tension (docs/explanation/theory.md (T19)). If all friction has changed by a
factor f, the travel is a fraction of the prediction, 1/f on an evenly bent sheath, and T_out is
wrong by a factor e^(K(f - 1)). A tendon drawn out by the other may be in a state unknown to the
model, so only a transition after a pull well beyond tip motion is used.

The tip rests only while nothing else moves the joint. If the joint comes to rest by itself, both
tendons relax while the motor still moves; if the other tendon is released, the joint yields: T_out
then differs from that at the end of the pull, and 20 % of it look like 10 % of K. So a transition
must begin at a motor reversal and ends when the other tendon's force changes. If the environment
moved the tip, travel over elongation is not a straight line, and the transition is discarded.

A change at the tip alone does not affect the travel; a sheath bent only there is not monitored. One
transition is accurate to a few percent; the median of the latest ones decides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law.sheath import Sheath
from estimator.law.transmission import Phase
from estimator.online import tendon_estimate
from estimator.online.online import TendonModel
from estimator.online.tendon_estimate import TendonEstimate
from estimator.small_arrays import compute_median, copy_values, interpolate
from estimator.structs import F64, I64, Field, Flag, Struct, StructArray, view_struct
from slave.rig_layout import EstimatedTendon, RigLayout
from teleop.config.ranges import build_ranged_field, check_ranges

MOBILISED_SHARE = 0.999  # of the length: the front has reached the tip
FRONT_DEPTH = 0.7  # of K, up to which the front is inside the sheath even if friction has fallen
# times the tension at which the tip moves in the model: there it moves in any case
TENSION_RATIO_MIN = 1.8
MIN_TRANSITIONS = 3  # transitions before the first advice
# allowed scatter of the errors: absolute, and relative to the error
SCATTER_MAX, SCATTER_SHARE_MAX = 0.04, 0.2
POINT_SPACING = 2e-6  # [m] of elongation between points of the line
POINTS_MIN = 5  # that the line needs
SPAN_MIN = 3e-5  # [m] of elongation that the line needs
# times the lag: least duration; averaging a curved signal would tilt the line
DURATION_LAGS_MIN = 5.0
LINE_SCATTER_MAX = 0.03  # of the span: scatter about the line, above which the tip has moved
# of the tilt of the line, allowed in addition: uneven friction also curves it
TILT_SCATTER_MAX = 0.06
FORWARD_SHARE_MAX = 0.05  # of the span: allowed forward motion of the motor after the tension falls
FORCE_CHANGE_MAX = 0.04  # of T_out: allowed change of the antagonist's force during a transition

TRAVEL_ACCURACY = 0.02  # of the travel: accuracy of one transition, as the tip yields a little
# of the lag: possible delay between tension and travel while the motor accelerates
DELAY_SHARE = 0.5
SIGNIFICANCE = 2.0  # times its uncertainty, above which an error counts
ERROR_RATIO_MAX = 8.0 / 3.0  # largest ratio of the relative errors of T_out and of travel
TRANSITIONS_MAX = 99  # largest value of `transitions`
SECTION_PIECES = 200  # of each section, for its integrals
FRICTION_FACTORS = np.linspace(0.5, 2.0, 61)  # of all friction: the grid of hypotheses
UNCHANGED = int(np.argmin(np.abs(FRICTION_FACTORS - 1.0)))


_UNUSABLE = (
    tendon_estimate.TENSION_ONLY
    | tendon_estimate.UNINITIALISED
    | tendon_estimate.TIP_MOVED
    | tendon_estimate.INVALID_INPUT
)
_PULL = int(Phase.PULL)


@dataclass(frozen=True, slots=True)
class MonitorConfig:
    """Thresholds of the monitor, relative errors of T_out."""

    advise: float = 0.07  # above it a calibration is advised
    demand: float = 0.15  # above it a calibration is demanded
    # number of latest transitions whose median decides
    transitions: int = build_ranged_field(5, MIN_TRANSITIONS, TRANSITIONS_MAX)
    # a demand ends the session, or limits force and motion until the shape is as calibrated
    on_demand: Literal["stop", "degrade"] = "stop"
    # of the forces, rendered at most while degraded
    degraded_force: float = build_ranged_field(0.5, 0.0, 0.9)
    degraded_speed: float = build_ranged_field(0.005, 1e-4, 1.0, "m/s")  # of the tips then

    def __post_init__(self) -> None:
        if not 0.0 < self.advise <= self.demand <= 10.0:
            raise ValueError("advise: must be above 0 and at most demand, which is at most 10")
        check_ranges(self)


class Advice(IntEnum):
    """What to do about the calibration."""

    NONE = 0
    ADVISED = 1  # calibrate again when there is time
    DEMANDED = 2  # calibrate again before anything else


class MonitorConstants(Struct):
    """Constants of a tendon's model, and the effect of a friction change on a transition."""

    K: F64 = 0.0
    mobilised: F64 = math.inf  # [m] where the front is when the tip moves
    depth: F64 = 0.0  # [m] front position at which a transition ends
    lag: F64 = 0.0  # [s] by which the estimator averages the tension
    # measured over predicted travel, ascending
    shares: Annotated[Array, Field("f8", len(FRICTION_FACTORS))]
    # of all friction, corresponding to `shares`
    factors: Annotated[Array, Field("f8", len(FRICTION_FACTORS))]
    amplified: F64 = math.inf  # ratio of the relative errors of T_out and of travel
    blind: Flag = True  # whether such changes are not observable, as if all bends are at the tip


class Transition(Struct):
    """Sums of a straight line of motor travel over predicted elongation, about their means."""

    points: I64 = 0
    elongation: F64 = 0.0  # [m]
    travel: F64 = 0.0  # [m]
    ee: F64 = 0.0  # [m^2]
    eq: F64 = 0.0  # [m^2]
    qq: F64 = 0.0  # [m^2]
    first: F64 = math.nan  # [m] elongation
    last: F64 = math.nan  # [m]
    lasted: F64 = 0.0  # [s] since the second point
    ahead: F64 = 0.0  # [m] largest forward motion of the motor from the first point
    tip: F64 = 0.0  # [N] T_out at the first point
    antagonist_tension: F64 = 0.0  # [N] T_out of the other tendon then
    travel_begin: F64 = math.nan  # [m] travel then


class TendonMonitor(Struct):
    """State of the monitor of one tendon."""

    reached: F64 = math.nan  # [N] tension at which the front reached the tip in this pull
    pulled: Flag = False  # whether far enough beyond that the profile is known
    travel: F64 = math.nan  # [m] averaged as the estimator averages the tension
    transition: Transition
    force_error: F64 = 0.0  # of T_out, relative, from all `errors`: see `compute_force_error`
    count: I64 = 0  # number of stored transitions, oldest first
    errors: Annotated[Array, Field("f8", TRANSITIONS_MAX)]  # of T_out, relative, from each of them
    uncertainties: Annotated[Array, Field("f8", TRANSITIONS_MAX)]  # standard uncertainty of each


def build_monitor_constants(models: Sequence[TendonModel]) -> StructArray:
    """Return the constants of tendons with these models, shape (n,)."""
    constants = MonitorConstants.array(len(models))
    for k, model in enumerate(models):
        _fill_constants(view_struct(constants, k), model)
    return constants


def _fill_constants(constants: MonitorConstants, model: TendonModel) -> None:
    sheath = model.sheath
    if sheath.K == 0.0:  # no friction: no transition to observe
        return
    dx, ds = divide_sheath(sheath)
    s = np.cumsum(ds)
    front = FRONT_DEPTH * sheath.K
    shares, factors, shown, _ = compute_travel_shares(dx, ds, front)
    constants.K = sheath.K
    constants.mobilised = MOBILISED_SHARE * sheath.length
    constants.depth = float(np.cumsum(dx)[np.searchsorted(s, front)])
    constants.lag = model.treatment.time_constant if model.tension_noise > 0.0 else 0.0
    constants.amplified = sheath.K / shown if shown > 0.0 else math.inf
    constants.shares[:], constants.factors[:] = shares, factors
    constants.blind = ERROR_RATIO_MAX * shown < sheath.K


def divide_sheath(sheath: Sheath) -> tuple[Array, Array]:
    """Return length [m] and friction of small pieces of a sheath, from the housing on."""
    radius = np.repeat([section.radius for section in sheath.sections], SECTION_PIECES)
    length = [section.length / SECTION_PIECES for section in sheath.sections]
    dx = np.repeat(length, SECTION_PIECES)
    return dx, sheath.friction * dx / radius


def compute_travel(dx: Array, ds: Array, factors: Array, front: float) -> Array:
    """Return motor travel over initial tension, from a full pull to a front at depth `front`.

    By (T5), pull to release, for friction `factors` times as large; in units of 1/EA.
    """
    middle = (np.cumsum(ds) - 0.5 * ds) * factors[:, None]
    inside = middle < front
    pulled, released = np.exp(-middle), np.exp(middle - 2.0 * front)
    return np.asarray(np.where(inside, pulled - released, 0.0) @ dx)


def compute_travel_shares(dx: Array, ds: Array, front: float) -> tuple[Array, Array, float, float]:
    """Return what a change of all friction does to `compute_travel`.

    Travel over that of the model, ascending, with the factors of friction; how much it changes with
    the factor, about 1; and the travel of the model.
    """
    unchanged = compute_travel(dx, ds, np.ones(1), front)
    shares = compute_travel(dx, ds, FRICTION_FACTORS, front) / unchanged
    order, slope = np.argsort(shares), np.gradient(shares, FRICTION_FACTORS)[UNCHANGED]
    return shares[order], FRICTION_FACTORS[order], abs(float(slope)), float(unchanged[0])


@jit_compile
def step_rig(
    config: MonitorConfig,
    layout: RigLayout,
    constants: Sequence[MonitorConstants],
    monitors: Sequence[TendonMonitor],
    tendons: Sequence[EstimatedTendon],
    dt: float,
) -> Advice:
    """Process one sample of all tendons of a rig; return the advice on its calibration.

    `constants` are of the estimators' models, `monitors` `TendonMonitor.array(n)` to begin with,
    changed in place. Of the sample `dt` [s] after the last the corrected readings are used.
    """
    for g in range(layout.groups):
        group = layout.group[g]
        for m in range(group.count if group.count < 3 else 0):  # of more it does not know who pulls
            i = group.tendon[m]
            antagonist_tension = 0.0
            if group.count > 1:
                antagonist_tension = tendons[group.tendon[1 - m]].estimate.distal_tension
            tension, travel = tendons[i].corrected_tension, tendons[i].corrected_displacement
            estimate = tendons[i].estimate
            step(
                config, constants[i], monitors[i], estimate, tension, travel, antagonist_tension, dt
            )
    return compute_advice(config, monitors, layout.tendons)


@jit_compile
def step(
    config: MonitorConfig,
    constants: MonitorConstants,
    monitor: TendonMonitor,
    estimate: TendonEstimate,
    tension: float,
    travel: float,
    antagonist_tension: float,
    dt: float,
) -> None:
    """Process one sample of one tendon, `dt` [s] after the last; `monitor` is changed in place.

    `constants` are of the model behind `estimate`, `tension` [N] and `travel` [m] T_in and q_p of
    the sample, `antagonist_tension` [N] T_out of the antagonist; 0 if it is a spring.
    """
    if constants.blind or estimate.status & _UNUSABLE != 0 or not math.isfinite(travel):
        _await_pull(monitor)
        return
    share = -math.expm1(-dt / constants.lag) if constants.lag > 0.0 else 1.0
    travel_before = travel if math.isnan(monitor.travel) else monitor.travel
    averaged = travel_before + share * (travel - travel_before)
    is_pull, line = estimate.phase == _PULL, monitor.transition
    gave_way = (
        line.points > 0
        and abs(antagonist_tension - line.antagonist_tension) > FORCE_CHANGE_MAX * line.tip
    )
    if is_pull and estimate.front >= constants.mobilised:
        reached = tension if math.isnan(monitor.reached) else monitor.reached
        _finish_transition(config, constants, monitor)
        monitor.reached, monitor.pulled = reached, tension > TENSION_RATIO_MIN * reached
    elif not monitor.pulled:
        monitor.reached = math.nan
    elif is_pull or estimate.front > constants.depth or gave_way:
        _finish_transition(config, constants, monitor)
    else:
        add_point(line, estimate, averaged, antagonist_tension, dt)
    monitor.travel = averaged


@jit_compile
def compute_force_error(monitor: TendonMonitor) -> float:
    """Return the relative error of T_out while pulling; 0 while it is not known.

    Positive if the estimate is too high. It is 0 if the median is within its uncertainty or the
    transitions scatter too much: an environment that moves the tip gives varying errors, a changed
    sheath a constant one. `monitor.force_error` holds the value between transitions.
    """
    if monitor.count < MIN_TRANSITIONS:
        return 0.0
    middle, spread = _compute_median_error(monitor)
    values = np.empty(monitor.count)
    copy_values(monitor.uncertainties[: monitor.count], values)
    if abs(middle) < SIGNIFICANCE * compute_median(values):
        return 0.0
    return middle if spread < SCATTER_MAX + SCATTER_SHARE_MAX * abs(middle) else 0.0


@jit_compile
def is_as_calibrated(config: MonitorConfig, monitor: TendonMonitor) -> bool:
    """Return whether the transitions agree that T_out is right, to less than `advise`."""
    if monitor.count < MIN_TRANSITIONS:
        return False
    middle, spread = _compute_median_error(monitor)
    return abs(middle) < config.advise and spread < SCATTER_MAX


@jit_compile
def _compute_median_error(monitor: TendonMonitor) -> tuple[float, float]:
    """Return the median of the errors and that of their deviations from it."""
    values = np.empty(monitor.count)
    copy_values(monitor.errors[: monitor.count], values)
    middle = compute_median(values)
    for k in range(monitor.count):
        values[k] = abs(monitor.errors[k] - middle)
    return middle, compute_median(values)


@jit_compile
def compute_advice(config: MonitorConfig, monitors: Sequence[TendonMonitor], count: int) -> Advice:
    """Return the advice for a rig of `count` tendons."""
    error_max = 0.0
    for i in range(count):
        error_max = max(error_max, abs(monitors[i].force_error))
    if error_max >= config.demand:
        return Advice.DEMANDED
    return Advice.ADVISED if error_max >= config.advise else Advice.NONE


@jit_compile
def add_point(
    line: Transition, estimate: TendonEstimate, travel: float, antagonist_tension: float, dt: float
) -> None:
    """Add a point unless it is too close to the last one."""
    elongation = estimate.elongation
    if line.points == 0:
        clear_transition(line)
        line.first, line.travel_begin = elongation, travel
        line.tip, line.antagonist_tension = estimate.distal_tension, antagonist_tension
    line.lasted = line.lasted + dt if line.points > 1 else 0.0
    line.ahead = max(line.ahead, travel - line.travel_begin)
    if line.points > 0 and abs(elongation - line.last) < POINT_SPACING:
        return
    line.points += 1
    n = line.points
    de, dq = elongation - line.elongation, travel - line.travel
    line.elongation += de / n
    line.travel += dq / n
    line.ee += de * de * (n - 1) / n
    line.eq += de * dq * (n - 1) / n
    line.qq += dq * dq * (n - 1) / n
    line.last = elongation


@jit_compile
def clear_transition(line: Transition) -> None:
    """Begin a line anew."""
    line.points = 0
    line.elongation = line.travel = line.ee = line.eq = line.qq = 0.0
    line.first = line.last = line.travel_begin = math.nan
    line.lasted = line.ahead = line.tip = line.antagonist_tension = 0.0


@jit_compile
def _await_pull(monitor: TendonMonitor) -> None:
    """Reset the pull and the transition; results of earlier ones are kept."""
    monitor.reached, monitor.pulled, monitor.travel = math.nan, False, math.nan
    clear_transition(monitor.transition)


@jit_compile
def _finish_transition(
    config: MonitorConfig, constants: MonitorConstants, monitor: TendonMonitor
) -> None:
    """Store the result of the transition, if valid, and wait for the next pull."""
    lasted = monitor.transition.lasted
    error = _compute_transition_error(constants, monitor.transition)
    if not math.isnan(error):
        uncertainty = TRAVEL_ACCURACY + DELAY_SHARE * constants.lag / max(lasted, constants.lag)
        add_error(config, monitor, error, constants.amplified * uncertainty)
    _await_pull(monitor)


@jit_compile
def add_error(
    config: MonitorConfig, monitor: TendonMonitor, error: float, uncertainty: float
) -> None:
    """Add the relative error of T_out from a transition; drop the oldest beyond `transitions`."""
    count = min(monitor.count, config.transitions - 1)
    dropped = monitor.count - count
    for k in range(count):
        monitor.errors[k] = monitor.errors[k + dropped]
        monitor.uncertainties[k] = monitor.uncertainties[k + dropped]
    monitor.errors[count], monitor.uncertainties[count] = error, uncertainty
    monitor.count = count + 1
    monitor.force_error = compute_force_error(monitor)


@jit_compile
def _compute_transition_error(constants: MonitorConstants, line: Transition) -> float:
    """Return the relative error of T_out from one transition, NaN if it is not valid."""
    span = line.first - line.last
    if (
        line.points < POINTS_MIN
        or not span > SPAN_MIN
        or line.lasted < DURATION_LAGS_MIN * constants.lag
    ):
        return math.nan
    if line.ahead > FORWARD_SHARE_MAX * span:
        return math.nan
    slope = line.eq / line.ee
    scatter = math.sqrt(max(line.qq - slope * line.eq, 0.0) / line.points)
    if scatter > (LINE_SCATTER_MAX + TILT_SCATTER_MAX * abs(slope - 1.0)) * span:
        return math.nan
    factor = interpolate(slope, constants.shares[:], constants.factors[:])
    return math.expm1(constants.K * (factor - 1.0))
