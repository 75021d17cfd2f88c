"""Adaptation of K for the two tendons of one joint, whatever moves the joint.

Their tips move oppositely, so the motors' travels add up to the elongations (T17):

    q_a + q_b = e_a + e_b + constant.

This needs no assumption of what moves the joint, environment included, but true profiles: the tip
of a tendon that is dragged out drives its own (T18). So the profiles here, at the ends of `CELLS`
cells of equal friction, are driven from the housing by T_in, and from the tip by the travel of the
joint, which is that of a tendon that slides fully, the way it slides. T_in holds meanwhile: a tip
that moves further drags all of the tendon along.

The friction of each third of both sheaths and the constant are estimated by an extended Kalman
filter, a sample of it being a piece in which the elongations change by those of `PIECE_TENSION`.
The derivatives are differences of profiles: one of the model in use, and one with more friction in
each third. A piece that fits no sheath within the covariance is not used, and widens it.
"""

import math
from typing import Annotated

import numpy as np

from estimator import signals
from estimator.adaptation import (
    APART,
    CELLS,
    CHANGE_MIN,
    DRIFT,
    EVIDENCE_MAX,
    FACTOR_COUNT,
    FACTOR_MAX,
    FACTOR_MIN,
    LOOP_ACCURACY,
    LOOP_TEMPER,
    MISFIT_MAX,
    PIECE_TENSION,
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
from estimator.records import F64, Field, Flag, Struct, StructArray

ROWS, IN_USE = 4, 3  # profiles: with more friction in each third, and of the model in use
# log factors of the thirds of a and b, relative errors of L/EA of a and b, the constant
STATES, FRICTIONS, CONSTANT = 9, 6, 8
PERTURBATION = 0.1  # of the log factor of a third
LEAST_TENSION = 1e-3  # [N]
TRAVEL_BAND = 2.5e-6  # [m] of the tip's travel by one tendon: less is noise
SLIDING_SHARE = 0.005  # of the tension at the tip, within which the tendon slides fully
PIECE_S = 0.1  # [s] within which pieces share their errors
TEMPER = 0.25  # of the evidence of a piece: later ones share some errors, too
ELONGATION_FLOOR = 4e-6  # [m] of noise: dead bands
COMPLIANCE_SIGMA = 0.02  # of L/EA, relative
ROOM_SHARE = 0.5  # of what elongations lack to full sliding: until then a tip moves unseen
LAG_S = 2e-3  # [s] between tensions and travels
START_SIGMA = 0.15  # of each log factor
MISFIT_SIGMA = 0.1  # of each log factor, added by a piece that fits no sheath
COMMON_SHARE = 0.5  # of the variance of a log factor, common to the thirds of a sheath
SIGNIFICANCE = 3.2  # sigma of noise, and
MODEL_ERROR = 0.02  # of K, times both tendons' elongation over that of one: 1 % of elongation
CONSTANT_SIGMA, CONSTANT_DRIFT = 1e-3, 2e-6  # [m], [m/sqrt(s)]
SIGMAS = 4.0  # of the interval of K

_K, _LENGTH, _EA = _tables.K, _tables.LENGTH, _tables.EA
_DRAG, _ASYMMETRY = _tables.DRAG, _tables.ASYMMETRY


class PairTendon(AdaptedFriction):
    """One tendon of a pair, between two samples."""

    was_pulled: Flag = False  # all of it slid towards the motor, and so the first profile is known
    was_released: Flag = False
    tension: Annotated[Array, Field("f8", (CELLS + 1, ROWS))]  # T + tau [N]
    pull_ratio: Annotated[Array, Field("f8", (3, ROWS))]  # e^-ds of a cell in each third
    release_ratio: Annotated[Array, Field("f8", (3, ROWS))]  # e^(rho ds)
    drive: F64 = 0.0  # T_in + tau [N]
    elongation: F64 = 0.0  # of the model in use [m]
    last_elongation: F64 = 0.0  # at the last piece
    tip: F64 = 0.0  # travel of the tip by this tendon [m], behind a dead band


class PairAdaptation(Struct):
    """What is known of the tendons of a pair, between two samples."""

    a: PairTendon
    b: PairTendon
    started: Flag = False
    mean: Annotated[Array, Field("f8", STATES)]
    covariance: Annotated[Array, Field("f8", (STATES, STATES))]
    noise: Annotated[Array, Field("f8", (STATES, STATES))]  # of it, by the noise of the pieces
    age: F64 = 0.0  # [s] since the last piece


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
        # what the joint has moved meanwhile is seen afterwards
        if state.started and _is_valid(estimate_a):
            _drive_housing(constants_a, a, prepared_a, estimator_a.held_tension)
            _write_estimate(a, prepared_a, estimate_a)
        if state.started and _is_valid(estimate_b):
            _drive_housing(constants_b, b, prepared_b, estimator_b.held_tension)
            _write_estimate(b, prepared_b, estimate_b)
        return
    if not state.started:
        _initialise(state)
        _initialise_tendon(constants_a, a, prepared_a)
        _initialise_tendon(constants_b, b, prepared_b)
    _drive_housing(constants_a, a, prepared_a, estimator_a.held_tension)
    _drive_housing(constants_b, b, prepared_b, estimator_b.held_tension)
    q_a, q_b = estimator_a.mean_displacement, estimator_b.mean_displacement
    if not state.started:
        a.tip, b.tip, state.started = q_a - a.elongation, q_b - b.elongation, True
    travel = _find_joint_travel(a, q_a, b, q_b)
    if travel != 0.0:
        _drive_tip(constants_a, a, -travel)
        _drive_tip(constants_b, b, travel)
    is_usable = min(estimator_a.mean_tension, estimator_b.mean_tension) > TAUT_TENSION and (
        a.was_pulled and a.was_released and b.was_pulled and b.was_released
    )
    state.age += dt
    if is_usable:
        T_a = estimator_a.mean_tension + prepared_a.tables[_DRAG]
        T_b = estimator_b.mean_tension + prepared_b.tables[_DRAG]
        _take_evidence(constants_a, constants_b, state, q_a + q_b, T_a, T_b)
    _take_loop(constants_a, state, a, 0, loop_a, dt)
    _take_loop(constants_b, state, b, 3, loop_b, dt)
    ratio = constants_b.compliance / constants_a.compliance
    _adapt(constants_a, state, a, prepared_a, estimator_a, 0, ratio, is_usable, dt)
    _adapt(constants_b, state, b, prepared_b, estimator_b, 3, 1.0 / ratio, is_usable, dt)
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
    state.tension[:] = max(prepared.pretension + prepared.tables[_DRAG], LEAST_TENSION)


@jit_compile
def _set_friction(constants: AdaptationConstants, state: PairTendon, rho: float) -> None:
    """Take over the friction of the model in use."""
    for third in range(3):
        for h in range(ROWS):
            factor = state.factor[third] * (math.exp(PERTURBATION) if h == third else 1.0)
            state.pull_ratio[third, h] = math.exp(-constants.cell_friction * factor)
            state.release_ratio[third, h] = math.exp(rho * constants.cell_friction * factor)


@jit_compile
def _drive_housing(
    constants: AdaptationConstants, state: PairTendon, prepared: PreparedTendon, T_in: float
) -> None:
    """Bring T_in of all profiles to `T_in` [N] (T10)."""
    drive = max(T_in + prepared.tables[_DRAG], LEAST_TENSION)
    if drive != state.drive:
        state.drive = drive
        _sweep(state.tension[:], state.pull_ratio[:], state.release_ratio[:], drive)
        state.elongation = _elongate(constants, state, IN_USE)


@jit_compile
def _sweep(tension: Array, pull: Array, release: Array, drive: float) -> None:
    """Drive all profiles from the housing."""
    tension[0] = drive
    for n in range(1, CELLS + 1):
        third = 3 * (n - 1) // CELLS
        for h in range(ROWS):
            before = tension[n - 1, h]
            low, high = before * pull[third, h], before * release[third, h]
            tension[n, h] = min(max(tension[n, h], low), high)


@jit_compile
def _elongate(constants: AdaptationConstants, state: PairTendon, h: int) -> float:
    """Return the elongation [m] of a profile, with the drag's."""
    e = 0.0
    for n in range(CELLS + 1):
        e += constants.cell_weight[n] * state.tension[n, h]
    return e


@jit_compile
def _drive_tip(constants: AdaptationConstants, state: PairTendon, change: float) -> None:
    """Move the tips so that all elongations change by `change` [m] (T18), or all slides."""
    ratio = state.release_ratio[:] if change > 0.0 else state.pull_ratio[:]
    for h in range(ROWS):
        _sweep_tip(state.tension[:, h], ratio[:, h], constants.cell_weight[:], change)
    before = state.elongation
    state.elongation = _elongate(constants, state, IN_USE)
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
def _find_joint_travel(a: PairTendon, q_a: float, b: PairTendon, q_b: float) -> float:
    """Return the joint's travel towards a [m] in this sample, by a tendon that slides fully."""
    by_a, by_b = _move_tip(a, q_a), -_move_tip(b, q_b)
    slides_a, slides_b = _slides(a, by_a), _slides(b, -by_b)
    if slides_a and slides_b:
        share = b.elongation**2 / (a.elongation**2 + b.elongation**2)
        return float(share * by_a + (1.0 - share) * by_b)
    return by_a if slides_a else by_b if slides_b else 0.0


@jit_compile
def _move_tip(state: PairTendon, q: float) -> float:
    """Return the tip's travel by this tendon [m] in this sample, beyond its dead band."""
    before = state.tip
    state.tip = signals.update_play(before, q - state.elongation, TRAVEL_BAND)
    return state.tip - before


@jit_compile
def _slides(state: PairTendon, travel: float) -> bool:
    """Return whether the model in use lets the tip move so; take down how it slides."""
    pull = release = state.drive
    for third in range(3):
        pull *= state.pull_ratio[third, IN_USE] ** (CELLS // 3)
        release *= state.release_ratio[third, IN_USE] ** (CELLS // 3)
    tip = state.tension[CELLS, IN_USE]
    is_pulled = tip < pull * (1.0 + SLIDING_SHARE)
    is_released = tip > release / (1.0 + SLIDING_SHARE)
    state.was_pulled = state.was_pulled or is_pulled
    state.was_released = state.was_released or is_released
    return (is_pulled and travel > 0.0) or (is_released and travel < 0.0)


@jit_compile
def _compute_room(constants: AdaptationConstants, state: PairTendon) -> float:
    """Return by how much the elongation [m] of the model in use differs from full sliding."""
    pull = release = state.drive
    e_pull = e_release = constants.cell_weight[0] * state.drive
    for n in range(CELLS):
        third = 3 * n // CELLS
        pull *= state.pull_ratio[third, IN_USE]
        release *= state.release_ratio[third, IN_USE]
        e_pull += constants.cell_weight[n + 1] * pull
        e_release += constants.cell_weight[n + 1] * release
    return float(max(min(state.elongation - e_pull, e_release - state.elongation), 0.0))


@jit_compile
def _predict_elongations(constants: AdaptationConstants, state: PairTendon, T_in: float) -> Array:
    """Return the elongations [m] of all profiles if T_in + tau went on to `T_in` [N]."""
    tension = state.tension.copy()
    _sweep(tension, state.pull_ratio[:], state.release_ratio[:], T_in)
    e = np.zeros(ROWS)
    for n in range(CELLS + 1):
        e += constants.cell_weight[n] * tension[n]
    return e


@jit_compile
def _take_evidence(
    constants_a: AdaptationConstants,
    constants_b: AdaptationConstants,
    state: PairAdaptation,
    travel: float,
    T_a: float,
    T_b: float,
) -> None:
    """Update the filter once the elongations have changed; `travel` [m] is that of both motors."""
    a, b = state.a, state.b
    change = (
        abs(a.elongation - a.last_elongation) / constants_a.compliance
        + abs(b.elongation - b.last_elongation) / constants_b.compliance
    )
    if change < PIECE_TENSION:
        return
    lag = abs(a.elongation - a.last_elongation) + abs(b.elongation - b.last_elongation)
    lag *= LAG_S / max(state.age, LAG_S)
    a.last_elongation, b.last_elongation = a.elongation, b.elongation
    weight, state.age = TEMPER * min(state.age / PIECE_S, 1.0), 0.0
    if weight == 0.0:
        return
    # as T_in is, not behind its dead band, which would make hysteresis look small
    e_a, e_b = _predict_elongations(constants_a, a, T_a), _predict_elongations(constants_b, b, T_b)
    slope = np.ones(STATES)
    residual = travel - e_a[IN_USE] - e_b[IN_USE]
    if math.isnan(state.mean[CONSTANT]):
        state.mean[CONSTANT] = residual
    slope[FRICTIONS], slope[FRICTIONS + 1] = e_a[IN_USE], e_b[IN_USE]
    for k in range(FRICTIONS, STATES):
        residual -= slope[k] * state.mean[k]
    for k in range(3):
        slope[k] = (e_a[k] - e_a[IN_USE]) / PERTURBATION
        slope[k + 3] = (e_b[k] - e_b[IN_USE]) / PERTURBATION
        residual -= slope[k] * (state.mean[k] - math.log(a.factor[k]))
        residual -= slope[k + 3] * (state.mean[k + 3] - math.log(b.factor[k]))
    doubt = ROOM_SHARE * (_compute_room(constants_a, a) + _compute_room(constants_b, b)) + lag
    noise = ELONGATION_FLOOR**2 + doubt**2 + (constants_a.variance + constants_b.variance) / 9.0
    a.pieces += 1
    b.pieces += 1
    if residual**2 > MISFIT_MAX * (float(slope @ state.covariance[:] @ slope) + noise):
        a.contradictions += 1
        b.contradictions += 1
        _widen(state, 0, weight * MISFIT_SIGMA**2)
        _widen(state, 3, weight * MISFIT_SIGMA**2)
        return
    _update_filter(state, slope, residual, noise / weight)
    for tendon, first in ((a, 0), (b, 3)):
        told = (APART * slope[first : first + 3].sum()) ** 2 * weight / noise
        tendon.evidence_age *= math.exp(-0.5 * min(told, EVIDENCE_MAX))


@jit_compile
def _update_filter(state: PairAdaptation, slope: Array, residual: float, noise: float) -> None:
    """Update the filter by a residual with so much variance of `noise`."""
    gain = state.covariance[:] @ slope
    predicted = float(slope @ gain)
    gain /= predicted + noise
    state.mean += gain * residual
    state.covariance -= np.outer(gain, gain) * (predicted + noise)
    kept = np.eye(STATES) - np.outer(gain, slope)
    state.noise[:] = kept @ state.noise[:] @ kept.T + np.outer(gain, gain) * noise


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
    predicted = float(slope @ state.covariance[:] @ slope)
    if (measured - K) ** 2 > MISFIT_MAX * (predicted + noise):
        _widen(state, first, MISFIT_SIGMA**2)
        return
    _update_filter(state, slope, measured - K, noise / LOOP_TEMPER)  # not `evidence_age`: pieces do


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
    compliance_ratio: float,
    is_usable: bool,
    dt: float,
) -> None:
    """Let the filter age and the model follow it; the ratio is L/EA of the other over this one."""
    tendon.update_age += dt
    tendon.evidence_age += dt
    if tendon.update_age < UPDATE_S:
        return
    for k in range(3):
        n = first + k
        state.mean[n] = min(max(state.mean[n], math.log(FACTOR_MIN)), math.log(FACTOR_MAX))
        tendon.mean_factor[k] = math.exp(state.mean[n])
    slope = _compute_friction_slope(constants, state, first)
    tendon.K = slope.sum()
    _widen(state, first, DRIFT**2 * tendon.update_age)
    state.covariance[CONSTANT, CONSTANT] += 0.5 * CONSTANT_DRIFT**2 * tendon.update_age
    tendon.update_age = 0.0
    error = SIGMAS * math.sqrt(max(float(slope @ (state.covariance[:] @ slope)), 0.0))
    tendon.low = max(tendon.K - error, constants.K[0])
    tendon.high = min(tendon.K + error, constants.K[FACTOR_COUNT - 1])
    sure = SIGNIFICANCE * math.sqrt(max(float(slope @ (state.noise[:] @ slope)), 0.0))
    calibrated = constants.cell_friction * CELLS
    least = max(CHANGE_MIN * calibrated, MODEL_ERROR * (1.0 + compliance_ratio))
    tendon.adapted |= abs(tendon.K - calibrated) > max(sure, least)
    K = prepared.tables[_K]
    if is_usable or has_loop(constants, tendon):
        follow_estimate(constants, tendon, prepared)
        if tendon.adapted:
            _set_friction(constants, tendon, prepared.tables[_ASYMMETRY])
            _sweep(tendon.tension[:], tendon.pull_ratio[:], tendon.release_ratio[:], tendon.drive)
            tendon.elongation = _elongate(constants, tendon, IN_USE)
            resize_profiles(prepared, estimator, tendon.tension[CELLS, IN_USE])
    hold_interval(constants, tendon, prepared, estimator, K)


@jit_compile
def _write_estimate(state: PairTendon, prepared: PreparedTendon, estimate: TendonEstimate) -> None:
    drag = prepared.tables[_DRAG]
    T_out = state.tension[CELLS, IN_USE] - drag
    estimate.distal_tension = min(max(T_out, estimate.low), estimate.high)
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
