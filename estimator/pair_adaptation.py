"""Adaptation of K for the two tendons of one joint, whatever moves the joint.

Evidence is taken where a motor has moved the joint so far in one direction that both tendons slide
fully, one pulled, the other dragged out. Both profiles are then known in closed form, whatever was
before, and so are the elongations of (T21),

    q_a + q_b = e_a + e_b + constant,

and the tensions at the tips of (T20). The load on the joint is their difference. One that depends
on place alone (spring, weight, elastic tissue) helps one direction as much as it resists the other,
so the tensions with which the joint passes one place both ways give K_a + K_b (T22):

    T_in,a e^-K_a - T_in,b e^K_b  +  T'_in,b e^-K_b - T'_in,a e^K_a  =  2 f.

An extended Kalman filter estimates the friction of each third of both sheaths, errors of L/EA, the
constant and the friction f of the joint, all but f being known at the start. What does not fit is
not used: tissue adds friction of its own. If most passes agree that K differs, K has changed.
(T21) with the friction in use holds at all times, as a joint that moves unseen shortens one tendon
by what it lengthens the other. Where it fails, K may be anywhere until passes tell it again.

T_out is that of profiles at the ends of `CELLS` cells of equal friction, driven from the housing
by T_in, and from the tip (T18) by the travel of the joint, which is that of a tendon that slides
fully, the way it slides. T_in holds meanwhile: a tip that moves further drags all along.
"""

import math
from typing import Annotated

import numpy as np

from estimator import noise_treatment
from estimator.adaptation import (
    APART,
    CELLS,
    EVIDENCE_MAX,
    FACTOR_COUNT,
    FACTOR_MAX,
    FACTOR_MIN,
    LOOP_ACCURACY,
    LOOP_TEMPER,
    MISFIT_MAX,
    TAUT_TENSION,
    UPDATE_S,
    AdaptationConstants,
    AdaptedFriction,
    AdaptedRun,
    build_adaptation,
    follow_estimate,
    has_loop,
    hold_interval,
    measure_friction,
    resize_profiles,
    store_friction,
)
from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.online import online
from estimator.online.estimator_state import EstimatorState, PreparedTendon
from estimator.online.online import Estimates, TendonModel
from estimator.online.tendon_estimate import INVALID_INPUT, TendonEstimate
from estimator.structs import F64, Field, Flag, Struct, StructArray

# log factors of the thirds of a and b, relative errors of L/EA of a and b, the constant, and the
# friction of the joint
STATES, FRICTIONS, CONSTANT, JOINT = 10, 6, 8, 9
PASSES = 64  # of the joint in each direction, that are remembered
LEAST_TENSION = 1e-3  # [N]
AVERAGE_S = 1e-3  # [s] of the averages of tension and travel, at most: what lags moves the tip
TENSION_BAND, TRAVEL_BAND = 1.0, 2.0  # sigma of averages: less is noise
SLIDING_SHARE = 0.005  # of the tension at the tip, within which the tendon slides fully
TURN_BAND = 2e-5  # [m] of the mean travel of both motors
SLIDE_MARGIN = 1e-4  # [m] of it, beyond what elongations and a reversal take
PIECE_TRAVEL = 2e-4  # [m] of it, for a piece of evidence
PIECE_S = 0.1  # [s] within which pieces share their errors
TEMPER = 0.5  # of the evidence of a piece: later ones share some errors, too
ELONGATION_NOISE, ELONGATION_ACCURACY = 4e-6, 0.005  # [m], relative
PASS_DISTANCE, PASS_S = 1.5e-4, 8.0  # [m], [s] between two passes of one place
LOAD_ACCURACY = 0.01  # relative to the tensions at the tips
LOAD_FRICTION = 0.25  # of what loads the joint, as of tissue, over that load
LOAD_SHARED = 8.0  # variance of that added in an update, as passes share it
START_SIGMA, DRIFT = 0.03, 0.005  # of each log factor, and in [1/sqrt(s)]
COMMON_SHARE = 0.5  # of the variance of a log factor, common to the thirds of a sheath
COMPLIANCE_SIGMA = 0.02  # of L/EA, relative
CONSTANT_SIGMA, CONSTANT_DRIFT = 1e-3, 2e-6  # [m], [m/sqrt(s)]
# [N], [N], [N/sqrt(s)]: friction of the joint, and a load cell's zero
JOINT_MEAN, JOINT_SIGMA, JOINT_DRIFT = 0.1, 0.1, 2e-3
MISFIT_SIGMA = 0.1  # of each log factor, added by elongations that fit no sheath
JUMP_PASSES = 12  # over which passes that fit no sheath are averaged
JUMP_AGREEMENT, JUMP_SHARE = 0.1, 0.6  # of their log ratios, and of them among all passes
SIGMAS = 3.0  # of the interval of K

_K, _LENGTH, _EA = _tables.K, _tables.LENGTH, _tables.EA
_DRAG, _ASYMMETRY = _tables.DRAG, _tables.ASYMMETRY


class PairTendon(AdaptedFriction):
    """One tendon of a pair, between two samples."""

    tension: Annotated[Array, Field("f8", CELLS + 1)]  # T + tau [N]
    pull_ratio: Annotated[Array, Field("f8", 3)]  # e^-ds of a cell in each third
    release_ratio: Annotated[Array, Field("f8", 3)]  # e^(rho ds)
    drive: F64 = 0.0  # T_in + tau [N]
    elongation: F64 = 0.0  # [m]
    turn_tension: F64 = 0.0  # T_in + tau [N] where the motors turned
    piece_tension: F64 = 0.0  # [N] where the piece began
    tip: F64 = 0.0  # travel of the tip by this tendon [m], behind a dead band
    sigma: F64 = 0.0  # of the average of T_in [N]
    travel_band: F64 = 0.0  # [m], half of that dead band


class PairAdaptation(Struct):
    """What is known of the tendons of a pair, between two samples."""

    a: PairTendon
    b: PairTendon
    started: Flag = False
    mean: Annotated[Array, Field("f8", STATES)]
    covariance: Annotated[Array, Field("f8", (STATES, STATES))]
    age: F64 = 0.0  # [s] since the last piece
    travel: F64 = math.nan  # mean travel of both motors towards a [m], behind a dead band
    direction: F64 = 0.0  # of it, 0 = not known
    turn_travel: F64 = 0.0  # [m] where it turned
    piece_travel: F64 = 0.0  # [m] where the piece began
    has_slid: Flag = False  # there
    sums: Annotated[Array, Field("f8", 5)]  # of the piece: 1, T_in + tau [N] and q_p [m] of a and b
    piece: Annotated[Array, Field("f8", 4)]  # their means over the last one
    time: F64 = 0.0  # [s]
    passes: Annotated[Array, Field("i8", 2)]  # so far, towards a and b
    place: Annotated[Array, Field("f8", (2, PASSES), fill=math.nan)]  # [m] of the joint
    pass_time: Annotated[Array, Field("f8", (2, PASSES))]  # [s]
    pass_tension: Annotated[Array, Field("f8", (2, PASSES, 2))]  # T_in + tau of a and b [N]
    excess: F64 = 0.0  # mean log ratio of passes that fit no sheath
    excess_share: F64 = 0.0  # of passes, those that agree with it


@jit_compile
def observe_pair(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    prepared_a: PreparedTendon,
    prepared_b: PreparedTendon,
    estimator_a: EstimatorState,
    estimator_b: EstimatorState,
    estimate_a: TendonEstimate,
    estimate_b: TendonEstimate,
    loop_a: Array,
    loop_b: Array,
    dt: float,
) -> None:
    """Take a sample of both tendons of a joint, after `online.advance` of each.

    The arguments are those of `adaptation.observe`, of a and b. T_out, elongation and travel in
    both estimates become those of the profiles that the tips drive too.
    """
    if not (constants_a.active and constants_b.active):
        return
    a, b = state.a, state.b
    if not (_is_valid(estimate_a) and _is_valid(estimate_b)):
        # what the joint has moved meanwhile is seen afterwards, but not whether it turned
        state.direction = 0.0
        if state.started and _is_valid(estimate_a):
            _drive_housing(constants_a, a, prepared_a, estimator_a)
            _write_estimate(a, prepared_a, estimate_a)
        if state.started and _is_valid(estimate_b):
            _drive_housing(constants_b, b, prepared_b, estimator_b)
            _write_estimate(b, prepared_b, estimate_b)
        return
    if not state.started:
        _initialise(state)
        _initialise_tendon(constants_a, a, prepared_a)
        _initialise_tendon(constants_b, b, prepared_b)
    _drive_housing(constants_a, a, prepared_a, estimator_a)
    _drive_housing(constants_b, b, prepared_b, estimator_b)
    q_a, q_b = estimator_a.mean_displacement, estimator_b.mean_displacement
    if not state.started:
        a.tip, b.tip, state.started = q_a - a.elongation, q_b - b.elongation, True
    is_taut_a = estimator_a.mean_tension > TAUT_TENSION
    is_taut_b = estimator_b.mean_tension > TAUT_TENSION
    travel = _find_joint_travel(a, q_a, is_taut_a, b, q_b, is_taut_b)
    if travel != 0.0:
        _drive_tip(constants_a, a, -travel)
        _drive_tip(constants_b, b, travel)
    is_usable = is_taut_a and is_taut_b
    state.age += dt
    state.time += dt
    T_a = estimator_a.mean_tension + prepared_a.tables[_DRAG]
    T_b = estimator_b.mean_tension + prepared_b.tables[_DRAG]
    direction = _find_slide(constants_a, constants_b, state, q_a, q_b, T_a, T_b)
    if is_usable and direction != 0.0:
        rho_a, rho_b = prepared_a.tables[_ASYMMETRY], prepared_b.tables[_ASYMMETRY]
        _take_evidence(constants_a, constants_b, state, direction, rho_a, rho_b)
    if is_usable and _has_change(constants_a, constants_b, state, q_a + q_b):
        a.doubt = b.doubt = 1.0  # K may be anywhere within its bounds
    _take_loop(constants_a, state, a, 0, loop_a, dt)
    _take_loop(constants_b, state, b, 3, loop_b, dt)
    _adapt(constants_a, state, a, prepared_a, estimator_a, 0, is_usable, dt)
    _adapt(constants_b, state, b, prepared_b, estimator_b, 3, is_usable, dt)
    _write_estimate(a, prepared_a, estimate_a)
    _write_estimate(b, prepared_b, estimate_b)


@jit_compile
def _is_valid(estimate: TendonEstimate) -> bool:
    return estimate.status & INVALID_INPUT == 0 and math.isfinite(estimate.distal_displacement)


@jit_compile
def _initialise(state: PairAdaptation) -> None:
    _widen(state, 0, START_SIGMA**2)
    _widen(state, 3, START_SIGMA**2)
    for k in range(FRICTIONS, CONSTANT):
        state.covariance[k, k] = COMPLIANCE_SIGMA**2
    state.covariance[CONSTANT, CONSTANT] = CONSTANT_SIGMA**2
    state.mean[CONSTANT] = math.nan
    state.mean[JOINT], state.covariance[JOINT, JOINT] = JOINT_MEAN, JOINT_SIGMA**2


@jit_compile
def _widen(state: PairAdaptation, first: int, variance: float) -> None:
    """Add a variance to the log factors of a sheath, a share of it common to the thirds."""
    for k in range(first, first + 3):
        for n in range(first, first + 3):
            share = 1.0 if k == n else COMMON_SHARE
            state.covariance[k, n] = min(state.covariance[k, n] + share * variance, 1.0)


@jit_compile
def _initialise_tendon(
    constants: AdaptationConstants, state: PairTendon, prepared: PreparedTendon
) -> None:
    _set_friction(constants, state, prepared.tables[_ASYMMETRY])
    prepared.time_constant = min(prepared.time_constant, AVERAGE_S)
    state.tension[:] = max(prepared.pretension + prepared.tables[_DRAG], LEAST_TENSION)


@jit_compile
def _set_friction(constants: AdaptationConstants, state: PairTendon, rho: float) -> None:
    """Take over the friction of the model in use."""
    for third in range(3):
        ds = constants.cell_friction * state.factor[third]
        state.pull_ratio[third], state.release_ratio[third] = math.exp(-ds), math.exp(rho * ds)


@jit_compile
def _drive_housing(
    constants: AdaptationConstants,
    state: PairTendon,
    prepared: PreparedTendon,
    estimator: EstimatorState,
) -> None:
    """Bring T_in of the profile to the average, behind a dead band (T10)."""
    state.sigma = sigma = math.sqrt(estimator.tension_variance)
    T_in = max(estimator.mean_tension + prepared.tables[_DRAG], LEAST_TENSION)
    drive = noise_treatment.update_play(state.drive, T_in, TENSION_BAND * sigma)
    noise = (constants.compliance * sigma) ** 2 + prepared.displacement_noise**2
    state.travel_band = TRAVEL_BAND * math.sqrt(noise)
    if drive != state.drive:
        state.drive = drive
        _sweep(state.tension[:], state.pull_ratio[:], state.release_ratio[:], drive)
        state.elongation = _elongate(constants, state)


@jit_compile
def _sweep(tension: Array, pull: Array, release: Array, drive: float) -> None:
    """Drive a profile from the housing."""
    tension[0] = drive
    for n in range(1, CELLS + 1):
        third = 3 * (n - 1) // CELLS
        before = tension[n - 1]
        tension[n] = min(max(tension[n], before * pull[third]), before * release[third])


@jit_compile
def _elongate(constants: AdaptationConstants, state: PairTendon) -> float:
    """Return the elongation [m] of the profile, with the drag's."""
    e = 0.0
    for n in range(CELLS + 1):
        e += constants.cell_weight[n] * state.tension[n]
    return e


@jit_compile
def _drive_tip(constants: AdaptationConstants, state: PairTendon, change: float) -> None:
    """Move the tip so that the elongation changes by `change` [m] (T18), or all slides."""
    ratio = state.release_ratio[:] if change > 0.0 else state.pull_ratio[:]
    _sweep_tip(state.tension[:], ratio, constants.cell_weight[:], change)
    before = state.elongation
    state.elongation = _elongate(constants, state)
    state.tip -= state.elongation - before


@jit_compile
def _sweep_tip(tension: Array, ratio: Array, weight: Array, change: float) -> None:
    """Drive a profile from the tip, with the slope by which tension grows by `ratio` a cell."""
    sign = 1.0 if change > 0.0 else -1.0
    # with the front at node n: T at the tip over that at n, and what the nodes beyond add up to
    share, compliance, area, tip, n = 1.0, 0.0, 0.0, 0.0, CELLS
    while n > 0:
        compliance += weight[n] / share
        area += weight[n] * tension[n]
        share *= ratio[3 * (n - 1) // CELLS]
        tip = tension[n - 1] * share  # as the front reaches the next node
        needed = (area + change) / max(compliance, 1e-15)
        if (tip - needed) * sign >= 0.0:
            tip = needed
            break
        n -= 1
    for m in range(CELLS, max(n, 1) - 1, -1):
        tension[m] = tip
        tip /= ratio[3 * (m - 1) // CELLS]


@jit_compile
def _find_joint_travel(
    a: PairTendon, q_a: float, is_taut_a: bool, b: PairTendon, q_b: float, is_taut_b: bool
) -> float:
    """Return the joint's travel towards a [m] in this sample, by a taut tendon that slides fully.

    A motor that takes up slack moves nothing else.
    """
    by_a, by_b = _move_tip(a, q_a), -_move_tip(b, q_b)
    slides_a = (is_taut_a or by_a < 0.0) and _slides(a, by_a)
    slides_b = (is_taut_b or by_b > 0.0) and _slides(b, -by_b)
    if slides_a and slides_b:
        share = b.elongation**2 / (a.elongation**2 + b.elongation**2)
        return float(share * by_a + (1.0 - share) * by_b)
    return by_a if slides_a else by_b if slides_b else 0.0


@jit_compile
def _move_tip(state: PairTendon, q: float) -> float:
    """Return the tip's travel by this tendon [m] in this sample, beyond its dead band."""
    before = state.tip
    state.tip = noise_treatment.update_play(before, q - state.elongation, state.travel_band)
    return state.tip - before


@jit_compile
def _slides(state: PairTendon, travel: float) -> bool:
    """Return whether the model in use lets the tip move so."""
    pull = release = state.drive
    for third in range(3):
        pull *= state.pull_ratio[third] ** (CELLS // 3)
        release *= state.release_ratio[third] ** (CELLS // 3)
    tip = state.tension[CELLS]
    is_pulled = tip < pull * (1.0 + SLIDING_SHARE)
    is_released = tip > release / (1.0 + SLIDING_SHARE)
    return (is_pulled and travel > 0.0) or (is_released and travel < 0.0)


@jit_compile
def _find_slide(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    q_a: float,
    q_b: float,
    T_a: float,
    T_b: float,
) -> float:
    """Return the direction of the joint at the end of a piece over which both tendons slid, else 0.

    The joint travels as the motors do, `travel` [m], less half of what the elongations change by.
    Whatever K is, the pulled tendon is elongated by at most L/EA T_in, and the other one was, where
    the motors turned.
    """
    a, b, travel = state.a, state.b, 0.5 * (q_a - q_b)
    if math.isnan(state.travel):
        state.travel = travel
    before = state.travel
    state.travel = noise_treatment.update_play(before, travel, TURN_BAND)
    if state.travel == before:
        return 0.0
    direction = math.copysign(1.0, state.travel - before)
    if direction != state.direction:
        state.direction, state.turn_travel, state.piece_travel = direction, before, before
        a.turn_tension, b.turn_tension = T_a, T_b
        a.piece_tension, b.piece_tension = T_a, T_b
        state.has_slid, state.sums[:] = False, 0.0
    for k, value in enumerate((1.0, T_a, q_a, T_b, q_b)):
        state.sums[k] += value
    piece = abs(state.travel - state.piece_travel)
    if piece < PIECE_TRAVEL:
        return 0.0
    friction_max = np.full(3, math.log(FACTOR_MAX))
    if direction > 0.0:
        elongation = constants_a.compliance * T_a + constants_b.compliance * b.turn_tension
        reversal = _slide_fully(constants_b, friction_max, 1.0, T_b, np.zeros(3))
        recoil = constants_a.compliance * (a.piece_tension - T_a)
    else:
        elongation = constants_b.compliance * T_b + constants_a.compliance * a.turn_tension
        reversal = _slide_fully(constants_a, friction_max, 1.0, T_a, np.zeros(3))
        recoil = constants_b.compliance * (b.piece_tension - T_b)
    state.piece_travel = state.travel
    a.piece_tension, b.piece_tension = T_a, T_b
    slide = abs(state.travel - state.turn_travel) - 0.5 * elongation - reversal
    is_driven = direction * (T_a - T_b) > 0.0  # by the motor, not by the environment
    had_slid = state.has_slid
    state.has_slid = is_driven and slide > SLIDE_MARGIN and recoil < 0.5 * piece
    state.piece[:], state.sums[:] = state.sums[1:] / state.sums[0], 0.0
    return direction if had_slid and state.has_slid else 0.0


@jit_compile
def _has_change(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    travel: float,
) -> bool:
    """Return whether both motors' `travel` [m] contradicts the friction in use (T21), once known.

    This needs no slide: a joint that moves unseen lengthens one tendon as it shortens the other.
    """
    slope, e_a, e_b = np.zeros(STATES), state.a.elongation, state.b.elongation
    slope[FRICTIONS], slope[FRICTIONS + 1], slope[CONSTANT] = e_a, e_b, 1.0
    noise = _compute_travel_noise(constants_a, constants_b, e_a, e_b)
    residual = travel - e_a - e_b - float(slope[FRICTIONS:JOINT] @ state.mean[FRICTIONS:JOINT])
    return math.isfinite(residual) and not _fits(state, slope, residual, noise)


@jit_compile
def _compute_travel_noise(
    constants_a: AdaptationConstants, constants_b: AdaptationConstants, e_a: float, e_b: float
) -> float:
    """Return the variance of (T21) [m^2]."""
    noise = ELONGATION_NOISE**2 + ELONGATION_ACCURACY**2 * (e_a**2 + e_b**2)
    return noise + (constants_a.variance + constants_b.variance) / 9.0


@jit_compile
def _slide_fully(
    constants: AdaptationConstants, log_factor: Array, rho: float, T_in: float, slope: Array
) -> float:
    """Return the elongation [m] while all slides, with `rho` -1 towards the motor.

    `slope` becomes its derivatives by the log factors of the thirds. `T_in` [N] includes tau.
    """
    T, e, depth = T_in, constants.cell_weight[0] * T_in, np.zeros(3)
    slope[:] = 0.0
    for n in range(CELLS):
        third = 3 * n // CELLS
        ds = rho * constants.cell_friction * math.exp(log_factor[third])
        depth[third] += ds
        T *= math.exp(ds)
        e += constants.cell_weight[n + 1] * T
        for k in range(3):
            slope[k] += constants.cell_weight[n + 1] * T * depth[k]
    return float(e)


@jit_compile
def _take_evidence(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    direction: float,
    rho_a: float,
    rho_b: float,
) -> None:
    """Update the filter by the last piece, in which both tendons slid.

    Elongations are then proportional to T_in, so means over a piece obey (T21), too. They keep out
    noise: it is in the residual and in its slope, and their product would draw K (measured: 18 %).
    """
    T_a, q_a = state.piece[0], state.piece[1]
    T_b, q_b = state.piece[2], state.piece[3]
    weight, state.age = TEMPER * min(max(state.age / PIECE_S, 0.01), 1.0), 0.0
    slope, sign_a, sign_b = np.zeros(STATES), -1.0, rho_b
    if direction < 0.0:
        sign_a, sign_b = rho_a, -1.0
    e_a = _slide_fully(constants_a, state.mean[:3], sign_a, T_a, slope[:3])
    e_b = _slide_fully(constants_b, state.mean[3:6], sign_b, T_b, slope[3:6])
    slope[FRICTIONS], slope[FRICTIONS + 1], slope[CONSTANT] = e_a, e_b, 1.0
    noise = _compute_travel_noise(constants_a, constants_b, e_a, e_b)
    _compare_elongations(state, slope, q_a + q_b - e_a - e_b, noise, weight)
    way = 0 if direction > 0.0 else 1
    n = state.passes[way] % PASSES
    state.passes[way] += 1
    state.place[way, n], state.pass_time[way, n] = 0.5 * (q_a - e_a - q_b + e_b), state.time
    state.pass_tension[way, n, 0], state.pass_tension[way, n, 1] = T_a, T_b
    m = _find_pass_back(state, way, n)
    if m >= 0:
        state.place[way, n] = state.place[1 - way, m] = math.nan
        to_a, to_b = state.pass_tension[way, n], state.pass_tension[1 - way, m]
        if way == 1:
            to_a, to_b = to_b, to_a
        age = state.time - state.pass_time[1 - way, m]
        _compare_passes(constants_a, constants_b, state, to_a, to_b, rho_a, rho_b, weight, age)


@jit_compile
def _compare_elongations(
    state: PairAdaptation, slope: Array, residual: float, noise: float, weight: float
) -> None:
    """Update the filter by what the travels leave over the elongations (T21) [m]."""
    if math.isnan(state.mean[CONSTANT]):
        state.mean[CONSTANT] = residual
    for k in range(FRICTIONS, CONSTANT + 1):
        residual -= slope[k] * state.mean[k]
    state.a.pieces += 1
    state.b.pieces += 1
    if _fits(state, slope, residual, noise):
        _update_filter(state, slope, residual, noise / weight)
    else:
        state.a.contradictions += 1
        state.b.contradictions += 1
        _widen(state, 0, TEMPER * MISFIT_SIGMA**2)
        _widen(state, 3, TEMPER * MISFIT_SIGMA**2)


@jit_compile
def _find_pass_back(state: PairAdaptation, way: int, n: int) -> int:
    """Return the newest pass of the place of pass `n` the other way, -1 if there is none."""
    newest = -1
    for m in range(PASSES):
        if abs(state.place[1 - way, m] - state.place[way, n]) < PASS_DISTANCE and (
            newest < 0 or state.pass_time[1 - way, m] > state.pass_time[1 - way, newest]
        ):
            newest = m
    return newest if state.time - state.pass_time[1 - way, newest] < PASS_S else -1


@jit_compile
def _compare_passes(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    to_a: Array,
    to_b: Array,
    rho_a: float,
    rho_b: float,
    weight: float,
    age: float,
) -> None:
    """Update the filter by tensions [N] of a and b as the joint passed a place both ways (T22).

    They tell nothing of a change since the earlier pass, `age` [s] ago.
    """
    slope_a = _compute_friction_slope(constants_a, state, 0)
    slope_b = _compute_friction_slope(constants_b, state, 3)
    K_a, K_b = slope_a.sum(), slope_b.sum()
    pulled_a, released_b = to_a[0] * math.exp(-K_a), to_a[1] * math.exp(rho_b * K_b)
    pulled_b, released_a = to_b[1] * math.exp(-K_b), to_b[0] * math.exp(rho_a * K_a)
    resisted_a, resisted_b = pulled_a - released_b, pulled_b - released_a
    residual = resisted_a + resisted_b - 2.0 * state.mean[JOINT]
    slope = slope_a * (pulled_a + rho_a * released_a) + slope_b * (pulled_b + rho_b * released_b)
    slope[JOINT] = 2.0
    size = 0.5 * (pulled_a + released_b + pulled_b + released_a)
    dissipated = LOAD_FRICTION * (resisted_a - resisted_b)
    # a pulled sheath divides the noise of T_in by e^K, one dragged out multiplies it
    noise = state.a.sigma**2 * (math.exp(-2.0 * K_a) + math.exp(2.0 * rho_a * K_a))
    noise += state.b.sigma**2 * (math.exp(-2.0 * K_b) + math.exp(2.0 * rho_b * K_b))
    noise += (2.0 * LOAD_ACCURACY * size) ** 2 + dissipated**2
    share = 1.0 / JUMP_PASSES
    if _fits(state, slope, residual, noise):
        noise = (noise + LOAD_SHARED * dissipated**2) / weight
        _update_filter(state, slope, residual, noise)
        state.excess_share *= 1.0 - share
        for tendon, change in ((state.a, slope[:3].sum()), (state.b, slope[3:6].sum())):
            distinction = (APART * change) ** 2 / noise
            kept = math.exp(-0.5 * min(distinction, EVIDENCE_MAX))  # of what was unknown
            tendon.evidence_age = min(tendon.evidence_age, max(kept * tendon.evidence_age, age))
            tendon.doubt *= kept
        return
    difference = residual / size - state.excess
    agreement = 1.0 if abs(difference) < JUMP_AGREEMENT else 0.0
    state.excess += difference * (0.1 if agreement == 1.0 else 0.3)
    state.excess_share += share * (agreement - state.excess_share)
    if state.excess_share > JUMP_SHARE:
        state.excess_share = 0.0
        for first in (0, 3):
            _widen(state, first, (state.excess / (K_a + K_b)) ** 2)


@jit_compile
def _fits(state: PairAdaptation, slope: Array, residual: float, noise: float) -> bool:
    """Return whether a residual is within the filter's covariance and its `noise`."""
    variance = float(slope @ state.covariance[:] @ slope) + noise
    return residual**2 <= MISFIT_MAX * variance


@jit_compile
def _update_filter(state: PairAdaptation, slope: Array, residual: float, noise: float) -> None:
    """Update the filter by a residual with so much variance of `noise`."""
    gain = state.covariance[:] @ slope
    predicted = float(slope @ gain)
    gain /= predicted + noise
    state.mean += gain * residual
    state.covariance -= np.outer(gain, gain) * (predicted + noise)


@jit_compile
def _take_loop(
    constants: AdaptationConstants,
    state: PairAdaptation,
    tendon: PairTendon,
    first: int,
    loop_tension: Array,
    dt: float,
) -> None:
    """Update the filter by a reading of the sensing loop of a tendon."""
    measured = measure_friction(constants, tendon, loop_tension, dt)
    if math.isnan(measured):
        return
    slope = _compute_friction_slope(constants, state, first)
    K = float(slope.sum())
    noise = (LOOP_ACCURACY * K) ** 2
    if _fits(state, slope, measured - K, noise):  # `evidence_age` stays: see `adaptation.observe`
        _update_filter(state, slope, measured - K, noise / LOOP_TEMPER)
    else:
        _widen(state, first, math.log(measured / K) ** 2)


@jit_compile
def _compute_friction_slope(
    constants: AdaptationConstants, state: PairAdaptation, first: int
) -> Array:
    """Return the derivatives of K by the filter's states, which are the friction of the thirds."""
    slope = np.zeros(STATES)
    for n in range(first, first + 3):
        slope[n] = constants.cell_friction * (CELLS // 3) * math.exp(state.mean[n])
    return slope


@jit_compile
def _adapt(
    constants: AdaptationConstants,
    state: PairAdaptation,
    tendon: PairTendon,
    prepared: PreparedTendon,
    estimator: EstimatorState,
    first: int,
    is_usable: bool,
    dt: float,
) -> None:
    """Let the filter age and the model follow it."""
    tendon.update_age += dt
    tendon.evidence_age += dt
    if tendon.update_age < UPDATE_S:
        return
    for k in range(3):
        n = first + k
        state.mean[n] = min(max(state.mean[n], math.log(FACTOR_MIN)), math.log(FACTOR_MAX))
        tendon.mean_factor[k] = math.exp(state.mean[n])
    state.mean[JOINT] = max(state.mean[JOINT], 0.0)
    slope = _compute_friction_slope(constants, state, first)
    tendon.K = slope.sum()
    _widen(state, first, DRIFT**2 * tendon.update_age)
    state.covariance[CONSTANT, CONSTANT] += 0.5 * CONSTANT_DRIFT**2 * tendon.update_age
    state.covariance[JOINT, JOINT] += 0.5 * JOINT_DRIFT**2 * tendon.update_age
    tendon.update_age = 0.0
    error = SIGMAS * math.sqrt(max(float(slope @ (state.covariance[:] @ slope)), 0.0))
    tendon.low = max(tendon.K - error, constants.K[0])
    tendon.high = min(tendon.K + error, constants.K[FACTOR_COUNT - 1])
    K = prepared.tables[_K]
    if is_usable or has_loop(constants, tendon):
        follow_estimate(constants, tendon, prepared)
        if tendon.adapted:
            _set_friction(constants, tendon, prepared.tables[_ASYMMETRY])
            _sweep(tendon.tension[:], tendon.pull_ratio[:], tendon.release_ratio[:], tendon.drive)
            before = tendon.elongation
            tendon.elongation = _elongate(constants, tendon)
            tendon.tip -= tendon.elongation - before  # no travel
            resize_profiles(prepared, estimator, tendon.tension[CELLS])
    hold_interval(constants, tendon, prepared, estimator, K)


@jit_compile
def _write_estimate(state: PairTendon, prepared: PreparedTendon, estimate: TendonEstimate) -> None:
    drag = prepared.tables[_DRAG]
    T_out = state.tension[CELLS] - drag
    estimate.distal_tension = T_out = min(max(T_out, estimate.low), estimate.high)
    # as in `online`: with a smaller K the tip is at a smaller depth; beyond it (T2) holds
    low, high, ratio = T_out + drag, T_out + drag, math.exp(-prepared.K_below)
    n = CELLS
    while ratio < 1.0 and n > 0:
        n -= 1
        ratio /= state.pull_ratio[3 * n // CELLS]
        low, high = min(low, state.tension[n]), max(high, state.tension[n])
    ratio = math.exp(prepared.K_above)
    estimate.adapted_low = max(min(low, (T_out + drag) / ratio) - drag, 0.0)
    estimate.adapted_high = max(high, (T_out + drag) * ratio) - drag
    e = state.elongation - drag * prepared.tables[_LENGTH] / prepared.tables[_EA]
    estimate.distal_displacement += estimate.elongation - e
    estimate.elongation = e


def run_adapting_pair(
    models: tuple[TendonModel, TendonModel],
    time: Array,
    tension: Array,
    displacement: Array,
    loop_tension: Array | None = None,
) -> tuple[AdaptedRun, AdaptedRun]:
    """Return the estimates of a record of both tendons of a joint, whose sheaths may move.

    Parameters
    ----------
    models : tuple of TendonModel
        As calibrated, at the begin of the record.
    time, tension, displacement : ndarray
        Sample times [s] shape (n,), T_in [N] and q_p [m], shape (n, 2).
    loop_tension : ndarray, optional
        At the moved and at the held end of the sensing loop of each tendon [N], shape (n, 2, 2).
    """
    constants = np.concatenate([build_adaptation(model) for model in models])
    prepared, states = online.prepare_all(models), PairAdaptation.array(1)
    estimators, estimates = (
        online.build_initial_states(prepared),
        TendonEstimate.array(2 * len(time)),
    )
    estimates = estimates.reshape(2, -1)
    K = np.empty((2, 3, len(time)))
    with_dynamics = True if prepared["has_dynamics"].any() else None
    loop = np.full((len(time), 2, 2), np.nan) if loop_tension is None else loop_tension
    data = (time, tension, displacement, loop)
    t, T, q, loop = (np.ascontiguousarray(column, np.float64) for column in data)
    adapted_from = np.full(2, -1)
    _run_arrays(
        constants,
        states,
        prepared,
        estimators,
        t,
        T,
        q,
        loop,
        estimates,
        K,
        adapted_from,
        with_dynamics,
    )
    runs = []
    for i in range(2):
        bounds, state = constants[i]["K"], states[0]["ab"[i]]
        low, high = (np.clip(row, bounds.min(), bounds.max()) for row in K[i, 1:])
        fields = Estimates(*(estimates[i][name].copy() for name in Estimates._fields))
        counts = int(state["pieces"]), int(state["contradictions"])
        runs.append(AdaptedRun(fields, K[i, 0], low, high, int(adapted_from[i]), *counts))
    return runs[0], runs[1]


@jit_compile
def _run_arrays(
    constants: StructArray,
    states: StructArray,
    prepared: StructArray,
    estimators: StructArray,
    time: Array,
    tension: Array,
    displacement: Array,
    loop_tension: Array,
    estimates: StructArray,
    K: Array,
    adapted_from: Array,
    with_dynamics: bool | None,
) -> None:
    for n in range(len(time)):
        dt = time[n] - time[n - 1] if n > 0 else 0.0
        for i in range(2):
            T, q = tension[n, i], displacement[n, i]
            online.advance(prepared[i], estimators[i], T, q, dt, estimates[i, n], with_dynamics)
        observe_pair(
            constants[0], constants[1], states[0], prepared[0], prepared[1],
            estimators[0], estimators[1], estimates[0, n], estimates[1, n],
            loop_tension[n, 0], loop_tension[n, 1], dt,
        )  # fmt: skip
        for i in range(2):
            is_adapted = states[0].a.adapted if i == 0 else states[0].b.adapted
            if is_adapted and adapted_from[i] < 0:
                adapted_from[i] = n
            store_friction(prepared[i], K[i], n)
