"""Probing: friction from a motion of the motor that the tip does not notice.

A motor at rest releases its tendon until ln T_in has fallen by 2a from its peak, and pulls it back.
If the tension had risen by more to that peak, the sheath pulls to beyond the friction depth a, so
the sliding front gets to a and back (T10), whatever K and the bends are: the tip rests (T19) as
long as a < K. a is `share` of `K_RATIO_MIN` times the calibrated K. Travel over the
model's elongation is then 1/f on an evenly bent sheath, if all friction has changed by the factor
f; each probe goes to the monitor as a transition.

A change beyond the depth a is not seen, and one within it counts as one of all friction.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.noise_treatment import update_average
from estimator.online.online import TendonModel
from estimator.small_arrays import interpolate
from estimator.structs import F64, I64, Field, Flag, Struct, StructArray, view_struct
from slave.calibration import monitor
from slave.calibration.monitor import FRICTION_FACTORS, Transition
from slave.control.joint_estimate import TAUT_TENSION
from slave.rig_layout import EstimatedTendons, RigLayout
from teleop.config.ranges import RangedConfig, build_ranged_field
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS

K_RATIO_MIN = FRICTION_FACTORS[0]  # least K over the calibrated one
AMPLIFIED_MAX = 4.0  # relative error of K over that of travel; above, probes show too little
REST_TRAVEL = 2e-5  # [m] of a commanded tip: less is rest
LAG_S = 0.003  # [s] of the averaged tension: by which a release goes too far
FORCE_CHANGE_MAX = 0.06  # of a tension, besides `FORCE_CHANGE_MIN` [N]: it has changed
FORCE_CHANGE_MIN = 0.08
SPAN_MIN = 2e-5  # [m] of elongation in a probe
TRAVEL_RATIO_MAX = 3.0  # over the model's, besides `SPAN_MIN`: more, and the tip gives way
DURATION_MAX_S = 5.0  # of a probe
SCATTER_MAX = 0.06  # of the span, about the line; a few percent are the lag of the tension
POINTS_MIN = 10
ACCURACY = 0.02  # of the travel


@dataclass(frozen=True, slots=True)
class ProbingConfig(RangedConfig):
    """When and how far motors at rest move to measure friction."""

    enabled: bool = False  # at rest, motors move their tendons by what no tip notices
    # of the least possible K, for the depth of the sliding front
    share: float = build_ranged_field(0.75, 0.1, 0.9)
    pause: float = build_ranged_field(0.2, 0.05, 60.0, "s")  # at rest before each probe
    speed: float = build_ranged_field(0.0005, 1e-5, 0.01, "m/s")  # of the motor's tendon


class ProbeConstants(Struct):
    """What probes of one tendon show."""

    K: F64 = 0.0  # as calibrated
    depth: F64 = 0.0  # a; 0 = not to be probed
    travel: F64 = 0.0  # [m/N] of a release over the peak of the tension
    amplified: F64 = math.inf  # relative error of K over that of travel
    lag: F64 = 0.0  # [s] by which the estimator averages the tension
    # travel over that of the model, ascending, and factors of all friction
    shares: Annotated[Array, Field("f8", len(FRICTION_FACTORS))]
    factors: Annotated[Array, Field("f8", len(FRICTION_FACTORS))]


class Probe(Struct):
    """State of the probing of a rig."""

    tendon: I64 = -1  # being probed
    last: I64 = -1  # probed before
    pulls: Flag = False  # is on its way back
    holds: Flag = False  # all motors hold, but for the probed one, until something changes
    start: F64 = 0.0  # [m] motor position at the beginning of the probe
    rested: F64 = 0.0  # [s] for which nothing has changed
    lasted: F64 = 0.0  # [s] of this probe
    requested: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] of the tips, at rest
    tension: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] averaged
    resting: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] at rest
    valley: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] from which it rose to the peak
    peak: Annotated[Array, Field("f8", MAX_TENDONS)]  # [N] of the newest pull
    travel: F64 = math.nan  # [m] of the probed tendon's motor, averaged
    line: Transition
    finished: I64 = -1  # tendon whose line is complete


def build_probe_constants(models: Sequence[TendonModel], config: ProbingConfig) -> StructArray:
    """Return the constants of tendons with these models, shape (n,)."""
    records = ProbeConstants.array(len(models))
    for k, model in enumerate(models if config.enabled else ()):
        constants, sheath = view_struct(records, k), model.sheath
        depth = config.share * K_RATIO_MIN * sheath.K
        if depth == 0.0:
            continue
        dx, ds = monitor.divide_sheath(sheath)
        shares, factors, shown, travel = monitor.compute_travel_shares(dx, ds, depth)
        constants.amplified = 1.0 / shown if shown > 0.0 else math.inf
        constants.K, constants.travel = sheath.K, travel / sheath.axial_stiffness
        constants.shares[:], constants.factors[:] = shares, factors
        constants.lag = model.treatment.time_constant if model.tension_noise > 0.0 else 0.0
        constants.depth = depth if constants.amplified < AMPLIFIED_MAX else 0.0
    return records


@jit_compile
def estimate_friction(constants: ProbeConstants, share: float) -> tuple[float, float, float]:
    """Return K and the ends of its interval from a `share` of travel over the model's."""
    K = constants.K * interpolate(share, constants.shares[:], constants.factors[:])
    error = 2.0 * ACCURACY * constants.amplified * K
    return K, K - error, K + error


@jit_compile
def track_pulls(
    constants: Sequence[ProbeConstants],
    layout: RigLayout,
    probe: Probe,
    tendons: EstimatedTendons,
    dt: float,
) -> None:
    """Average the tensions and follow their pulls, in every state of the session.

    A hand that stops lets go a little: less than half of a probe does not end a pull.
    """
    for i in range(layout.tendons):
        measured = tendons[i].corrected_tension
        if not math.isfinite(measured):
            continue
        known = probe.peak[i] > 0.0
        mean = update_average(probe.tension[i], measured, dt, LAG_S) if known else measured
        probe.tension[i] = mean
        if i == probe.tendon:
            continue
        if not known or mean < probe.peak[i] * math.exp(-constants[i].depth):
            probe.peak[i] = probe.valley[i] = max(mean, 1e-3)
        probe.peak[i] = max(probe.peak[i], mean)


@jit_compile
def step(
    config: ProbingConfig,
    constants: Sequence[ProbeConstants],
    layout: RigLayout,
    probe: Probe,
    tendons: EstimatedTendons,
    requested: Array,
    motor: Array,
    may_probe: bool,
    dt: float,
    out_target: Array,
) -> bool:
    """Probe for a tick, one tendon at a time; return whether `out_target` is to be used.

    The controller does not rest with the hand: it follows noise, and hunts if K is wrong. So after
    a pause all motors hold, and after another one, in which no force has changed, probes begin.

    `requested` [m], shape (MAX_JOINTS,), is the travel of the joints that the hand asks for; any
    motion ends a probe at once. `motor` [m], shape (MAX_TENDONS,), are the last gated positions,
    `out_target` [m] likewise the targets, those of the controller on entry. `may_probe` tells
    whether the session lets motors move that are at rest.
    """
    if not may_probe or not _is_at_rest(layout, probe, tendons, requested):
        _rest_from_now(layout, probe, requested)
        return False
    probe.rested += dt
    if not probe.holds:
        if probe.rested < config.pause or _find_tendon(constants, layout, probe) < 0:
            return False
        _rest_from_now(layout, probe, requested)
        probe.holds = True
    for k in range(layout.tendons):
        out_target[k] = motor[k]
    if probe.tendon < 0:
        if probe.rested < config.pause:
            return True
        i = _find_tendon(constants, layout, probe)
        if i < 0:
            _rest_from_now(layout, probe, requested)
            return False
        probe.tendon, probe.pulls, probe.lasted, probe.start = i, False, 0.0, motor[i]
        probe.travel = math.nan
        monitor.clear_transition(probe.line)
    i = probe.tendon
    probe.lasted += dt
    _add_sample(constants[i], probe, tendons, i, dt)
    floor = probe.peak[i] * math.exp(-2.0 * constants[i].depth)
    # a stiff tendon falls far within the averaging's lag
    probe.pulls = probe.pulls or min(probe.tension[i], tendons[i].corrected_tension) <= floor
    if probe.pulls and motor[i] >= probe.start:
        probe.finished, probe.last, probe.tendon, probe.rested = i, i, -1, 0.0
        return True
    released = probe.start - motor[i]
    allowed = TRAVEL_RATIO_MAX * constants[i].travel * probe.peak[i] + SPAN_MIN
    if probe.lasted > DURATION_MAX_S or released > allowed:
        probe.last = i
        _rest_from_now(layout, probe, requested)
        return False
    change = config.speed * dt
    out_target[i] = min(motor[i] + change, probe.start) if probe.pulls else motor[i] - change
    return True


@jit_compile
def _is_at_rest(
    layout: RigLayout, probe: Probe, tendons: EstimatedTendons, requested: Array
) -> bool:
    """Return whether the hand rests and, while motors hold, each tension but the probed one's."""
    for k in range(layout.joints):
        if not abs(requested[k] - probe.requested[k]) <= REST_TRAVEL:
            return False
    for i in range(layout.tendons):
        change = abs(probe.tension[i] - probe.resting[i])
        limit = FORCE_CHANGE_MAX * probe.resting[i] + FORCE_CHANGE_MIN
        if not tendons[i].valid or (probe.holds and i != probe.tendon and change > limit):
            return False
    return True


@jit_compile
def _rest_from_now(layout: RigLayout, probe: Probe, requested: Array) -> None:
    """End a probe, and wait for rest."""
    probe.tendon, probe.rested, probe.holds = -1, 0.0, False
    for k in range(layout.joints):
        probe.requested[k] = requested[k]
    for i in range(layout.tendons):
        probe.resting[i] = probe.tension[i]


@jit_compile
def _find_tendon(constants: Sequence[ProbeConstants], layout: RigLayout, probe: Probe) -> int:
    """Return the next tendon that may be probed, -1 for none."""
    found = -1
    for k in range(layout.groups):
        group, taut = layout.group[k], True
        for n in range(group.count):
            taut = taut and probe.tension[group.tendon[n]] > TAUT_TENSION
        for n in range(group.count):
            i = group.tendon[n]
            known = constants[i]
            if not taut or known.depth == 0.0 or known.travel * probe.peak[i] < SPAN_MIN:
                continue
            if math.log(probe.peak[i] / probe.valley[i]) < 2.0 * K_RATIO_MIN * known.K:
                continue
            if found < 0 or (found <= probe.last < i):  # the one after the last, or the first
                found = i
    return found


@jit_compile
def _add_sample(
    constants: ProbeConstants, probe: Probe, tendons: EstimatedTendons, i: int, dt: float
) -> None:
    """Add a point of travel over the model's elongation, averaged as long as the tension is."""
    travel = tendons[i].corrected_displacement
    if not math.isfinite(travel):
        return
    before = travel if math.isnan(probe.travel) else probe.travel
    probe.travel = update_average(before, travel, dt, constants.lag)
    monitor.add_point(probe.line, tendons[i].estimate, probe.travel, 0.0, dt)


@jit_compile
def compute_share(probe: Probe) -> float:
    """Return travel over the model's elongation in the finished probe, NaN if no straight line."""
    line = probe.line
    if line.points < POINTS_MIN:
        return math.nan
    span = math.sqrt(12.0 * line.ee / line.points)
    slope = line.eq / line.ee
    scatter = math.sqrt(max(line.qq - slope * line.eq, 0.0) / line.points)
    return slope if span > 0.7 * SPAN_MIN and scatter < SCATTER_MAX * span else math.nan


@jit_compile
def transfer_probe_result(
    config: monitor.MonitorConfig,
    constants: Sequence[ProbeConstants],
    probe: Probe,
    monitors: Sequence[monitor.TendonMonitor],
) -> None:
    """Give the result of a finished probe to its tendon's monitor, as a transition."""
    i, probe.finished = probe.finished, -1
    if i < 0:
        return
    known = constants[i]
    K = estimate_friction(known, compute_share(probe))[0]
    if not math.isnan(K):
        uncertainty = math.exp(K - known.K) * K * known.amplified * ACCURACY
        monitor.add_error(config, monitors[i], math.expm1(K - known.K), uncertainty)
