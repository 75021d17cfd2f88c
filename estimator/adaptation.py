"""Adaptation of K to a sheath that moves: a posterior over friction and where it sits.

The play operators of (T10) do not depend on K: the motor brings the log tension at the friction
depth s to max(y, u - s) or min(y, u + rho s), u = ln(T_in + tau). So one bank of them, at
`AdaptationConstants.depth`, serves every hypothesis h: its elongation is a weighted sum,

    e_h = (1/EA) ∫ exp(y(s_h(x))) dx,   T_out,h = exp(y(K_h)) - tau,

with the length that h has at each depth as weights. EA and L do not change with the shape. A
hypothesis scales all friction, or that of a third, by one of `FACTORS`, which bound K.

Evidence comes in pieces in which the elongation changes by that of `PIECE_TENSION`. While y(K_h)
stays, h says that the tip rests: the travel changes by e_h. Afterwards the tip follows the motor,
not the other way, most often by little. Where it follows far, all that let it follow agree: such a
piece tells nothing, unless the tip yields less than before, as where it meets something stiff, or
where K has grown. A piece that fits no hypothesis, and one that fits K as estimated less than
another, are signs of a change, too. All weights decay towards the prior, by `HAZARD` and `DRIFT`;
beyond that, the interval of K grows by `GROWTH` with the time since pieces last told K from others.
A sensing loop in the tube, if there is one, measures K itself: `estimator.sensing_loop_friction`.

This holds for one tendon against a spring or an environment that yields to it. Where something else
moves the tip, as the other tendon of a joint does, pieces contradict each other.
"""

import math
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.play_profile import (
    FLOOR,
    Profile,
    count_points,
    get_point,
    resize_profile,
)
from estimator.law.sheath import Sheath
from estimator.law.tables import MAX_SECTIONS, Tables, fill_tables
from estimator.law.transmission import read_profile
from estimator.online import online
from estimator.online.estimator_state import EstimatorState, PreparedTendon
from estimator.online.online import Estimates, TendonModel
from estimator.online.tendon_estimate import INVALID_INPUT, UNINITIALISED, TendonEstimate
from estimator.sensing_loop_friction import AGE_MAX_S, SensingLoopState, measure_loop_friction
from estimator.structs import F64, I64, Field, Flag, Struct, StructArray, view_struct

FACTOR_COUNT, FACTOR_MIN, FACTOR_MAX = 27, 0.5, 1.8
FACTORS = np.geomspace(FACTOR_MIN, FACTOR_MAX, FACTOR_COUNT)  # of friction
FAMILIES = 4  # all friction, or the first, second or last third of it
HYPOTHESES = FAMILIES * FACTOR_COUNT
DEPTHS = 48  # play operators
CELLS = 24  # of equal friction, for pairs: estimator.pair_adaptation
SECTION_PIECES = 100  # of each section, for its integrals
K_MIN = 0.1  # with less friction there is nothing to adapt
PIECE_TENSION = 0.8  # [N]
PIECE_MAX_S = 1.0  # [s] after which a piece is dropped: creep and temperature are slow
TAUT_TENSION = 0.15  # [N] below, a tendon may be slack at the tip
ACCURACY = 0.08  # of the right hypothesis' elongation
ZERO_ERROR = 0.1  # [N] of the load cell since its calibration
LOOP_ACCURACY = 0.03  # of K, by a sensing loop
LOOP_TEMPER = 0.25  # of the evidence of a reading
LOOP_EVIDENCE_MAX = 25.0  # squared sigma by which a reading of it counts at most
TRAVEL_FLOOR = 2e-6  # [m]
TENSION_SIGMAS = 3.0  # of the tension's noise, as elongation
TEMPER = 0.5  # of the evidence of a piece: neighbouring ones share their errors
MISFIT_MAX = 9.0  # squared sigma of the best hypothesis: more, and the piece fits none
EVIDENCE_MAX = 8.0  # squared sigma by which a piece counts at most against a hypothesis
# -2 ln of the density of the tip's travel, Cauchy's for its tails, less that of noise
FOLLOW_COST, FOLLOW_TAILS = 0.5, 2.0
STILL_SHARE = 1e-3  # of T_out: change up to which the tip rests
HAZARD = 1.0 / 1200.0  # [1/s] of a sudden change
HAZARD_CONTRADICTED = 0.02  # of a sudden change, by a piece that is a sign of it
STIFFENED = 0.9  # of the largest compliance at the tip: below, K may have grown
DRIFT = 0.01  # [1/sqrt(s)] relative change of friction that grows slowly
GROWTH = 0.02  # [1/s] of the interval of K, relative, since the last evidence: 40 % in 20 s
APART = 0.12  # relative difference of K from those that evidence tells it from
UPDATE_S = 0.1  # [s] between updates for the time passed
STEP_MAX = 0.02  # of a factor in use, per update: the estimate must not jump
CHANGE_MIN = 0.04  # of K, by which an estimate excludes the K as calibrated
TAIL = 0.005  # of the posterior, on either side of its interval

_SPREAD = 0.5 * (DRIFT / math.log(FACTORS[1] / FACTORS[0])) ** 2  # [1/s] to each neighbour
_PRIOR = 1.0 / HYPOTHESES
_K, _ASYMMETRY = _tables.K, _tables.ASYMMETRY


class AdaptationConstants(Struct):
    """Hypotheses about one tendon."""

    active: Flag = False  # whether there is friction to adapt
    sections: I64 = 0
    length: Annotated[Array, Field("f8", MAX_SECTIONS)]  # [m] of sections divided at the thirds
    friction: Annotated[Array, Field("f8", MAX_SECTIONS)]  # mu theta of each, as calibrated
    third: Annotated[Array, Field("i8", MAX_SECTIONS)]
    depth: Annotated[Array, Field("f8", DEPTHS)]  # friction coordinate of each play operator
    weight: Annotated[Array, Field("f8", (HYPOTHESES, DEPTHS))]  # [m/N] length over EA
    K: Annotated[Array, Field("f8", HYPOTHESES)]
    cell_friction: F64 = 0.0  # mu theta of each cell, as calibrated
    cell_weight: Annotated[Array, Field("f8", CELLS + 1)]  # [m/N] length over EA at their ends
    variance: F64 = 0.0  # [m^2] of noise in the travel of a piece
    compliance: F64 = 0.0  # L/EA [m/N]
    loop_ratio: F64 = 0.0  # K over the friction of the sensing loop, 0 without one


class AdaptedFriction(Struct):
    """The friction of one tendon as estimated and as in use."""

    adapted: Flag = False  # K has left its calibrated value
    K: F64 = math.nan  # mean, of `Adaptation` by squared weights as all means: see `_summarise`
    low: F64 = math.nan  # ends of its interval
    high: F64 = math.nan
    mean_factor: Annotated[Array, Field("f8", 3, fill=1.0)]  # of friction, of each third
    factor: Annotated[Array, Field("f8", 3, fill=1.0)]  # of those, in use
    evidence_age: F64 = 0.0  # [s] since the last evidence, less as pieces tell more
    doubt: F64 = 0.0  # of K, relative: a change is suspected
    update_age: F64 = 0.0  # [s] since the last update for the time passed
    pieces: I64 = 0  # of evidence so far
    contradictions: I64 = 0  # of them, those that fit no sheath
    loop: SensingLoopState


class Adaptation(AdaptedFriction):
    """What is known of one tendon, between two samples."""

    started: Flag = False  # a piece of evidence has begun
    log_posterior: Annotated[Array, Field("f8", HYPOTHESES, fill=math.log(_PRIOR))]
    mean_weight: Annotated[Array, Field("f8", DEPTHS)]  # [m/N]
    y: Annotated[Array, Field("f8", DEPTHS)]  # ln(T + tau)
    tension: Annotated[Array, Field("f8", DEPTHS)]  # exp(y) [N]
    begin_tension: Annotated[Array, Field("f8", DEPTHS)]  # [N] where the piece began
    begin_travel: F64 = 0.0  # [m]
    age: F64 = 0.0  # [s] of the piece
    direction: F64 = 0.0  # of the motor in it
    tip_compliance: F64 = 0.0  # [m/N] the largest since evidence last told K from others


class AdaptedRun(NamedTuple):
    """A record estimated with adaptation."""

    estimates: Estimates
    K: Array  # in use, shape (n,)
    K_low: Array  # ends of its interval
    K_high: Array
    adapted_from: int  # sample from which K is not as calibrated, -1 for none
    pieces: int  # of evidence
    contradictions: int


def run_adapting(
    model: TendonModel,
    time: Array,
    tension: Array,
    displacement: Array,
    loop_tension: Array | None = None,
) -> AdaptedRun:
    """Return the estimates of a record of a tendon whose sheath may move.

    Parameters
    ----------
    model : TendonModel
        As calibrated, at the begin of the record.
    time, tension, displacement : ndarray
        Sample times [s], T_in [N] and q_p [m], shape (n,).
    loop_tension : ndarray, optional
        At the moved and at the held end of a sensing loop [N], shape (n, 2).
    """
    constants, states = build_adaptation(model), Adaptation.array()
    prepared = online.prepare_all([model])
    estimators, estimates = online.build_initial_states(prepared), TendonEstimate.array(len(time))
    K = np.empty((3, len(time)))
    with_dynamics = True if prepared["has_dynamics"].any() else None
    loop = np.full((len(time), 2), np.nan) if loop_tension is None else loop_tension
    data = (time, tension, displacement, loop)
    t, T, q, loop = (np.ascontiguousarray(column, np.float64) for column in data)
    adapted_from = _run_arrays(
        constants, states, prepared, estimators, t, T, q, loop, estimates, K, with_dynamics
    )
    if constants["active"][0]:
        K[1:] = np.clip(K[1:], constants["K"].min(), constants["K"].max())
    fields = Estimates(*(estimates[name].copy() for name in Estimates._fields))
    pieces, contradictions = int(states["pieces"][0]), int(states["contradictions"][0])
    return AdaptedRun(fields, K[0], K[1], K[2], adapted_from, pieces, contradictions)


def build_adaptation(model: TendonModel) -> StructArray:
    """Return the `AdaptationConstants` of a tendon, shape (1,)."""
    records, sheath = AdaptationConstants.array(), model.sheath
    constants = view_struct(records)
    pieces = _divide_sections(sheath)
    constants.active = sheath.K >= K_MIN and len(pieces) <= MAX_SECTIONS
    if not constants.active:
        return records
    constants.sections = n = len(pieces)
    length, friction, third = (np.array(column) for column in zip(*pieces, strict=True))
    constants.length[:n], constants.friction[:n], constants.third[:n] = length, friction, third
    constants.compliance = sheath.length / sheath.axial_stiffness
    tension_noise = TENSION_SIGMAS * model.tension_noise * constants.compliance
    constants.variance = tension_noise**2 + TRAVEL_FLOOR**2 + 2.0 * model.displacement_noise**2
    constants.depth[:] = depth = np.linspace(0.0, sheath.K * FACTOR_MAX, DEPTHS)
    third = np.repeat(third, SECTION_PIECES)
    dx, ds = (np.repeat(row / SECTION_PIECES, SECTION_PIECES) for row in (length, friction))
    for h in range(HYPOTHESES):
        family, k = divmod(h, FACTOR_COUNT)
        scaled = np.where((family == 0) | (third == family - 1), FACTORS[k], 1.0) * ds
        constants.K[h] = scaled.sum()
        _spread_compliance(scaled, dx / sheath.axial_stiffness, depth[1], constants.weight[h])
    if model.loop_friction > 0.0:
        constants.loop_ratio = sheath.K / model.loop_friction
    constants.cell_friction = cell = sheath.K / CELLS
    _spread_compliance(ds, dx / sheath.axial_stiffness, cell, constants.cell_weight)
    return records


def _spread_compliance(ds: Array, compliance: Array, spacing: float, weight: Array) -> None:
    """Add the `compliance` of pieces of so much friction to the nodes at either side of each."""
    s = (np.cumsum(ds) - 0.5 * ds) / spacing
    node = np.minimum(s.astype(int), len(weight) - 2)
    for offset, share in ((0, 1.0 - (s - node)), (1, s - node)):
        np.add.at(weight, node + offset, share * compliance)


def _divide_sections(sheath: Sheath) -> list[tuple[float, float, int]]:
    """Return length [m], friction and third of the sections, divided where a third of K ends."""
    pieces, s = [], 0.0
    for section in sheath.sections:
        ds = sheath.friction * section.bend_angle
        cuts = [k * sheath.K / 3.0 for k in (1, 2) if s < k * sheath.K / 3.0 < s + ds]
        for low, high in pairwise([s, *cuts, s + ds]):
            share = (high - low) / ds if ds > 0.0 else 1.0
            third = min(int(1.5 * (low + high) / max(sheath.K, K_MIN)), 2)
            pieces.append((share * section.length, high - low, third))
        s += ds
    return pieces


@jit_compile
def observe(
    constants: AdaptationConstants,
    state: Adaptation,
    prepared: PreparedTendon,
    estimator: EstimatorState,
    estimate: TendonEstimate,
    loop_tension: Array,
    dt: float,
) -> None:
    """Take a sample after `online.advance`; change `state` and the model `prepared` in place.

    Parameters
    ----------
    constants : AdaptationConstants
        From `build_adaptation`, of the model as calibrated.
    prepared, estimator : PreparedTendon, EstimatorState
        Those of the estimator. Its model follows the posterior once that excludes the K in use; its
        interval holds the posterior's.
    estimate : TendonEstimate
        Of this sample.
    loop_tension : array, shape (2,)
        At the ends of the sensing loop [N], NaN without one.
    dt : float
        Time since the previous sample [s].
    """
    usable = (
        estimate.status & (INVALID_INPUT | UNINITIALISED) == 0
        and math.isfinite(estimate.distal_displacement)
        and estimator.mean_tension > TAUT_TENSION
    )
    if not constants.active:
        return
    _read_bank(constants, state, prepared.tables[:], estimator.profile[:], estimator.tip_drives)
    state.age += dt
    state.update_age += dt
    state.evidence_age += dt
    if state.update_age >= UPDATE_S:
        _decay(state, HAZARD * state.update_age, _SPREAD * state.update_age)
        _summarise(constants, state)
        state.update_age = 0.0
        K = prepared.tables[_K]
        if usable or has_loop(constants, state):
            follow_estimate(constants, state, prepared)
            if state.adapted:
                tip_tension = _interpolate(constants, state.tension[:], prepared.tables[_K])
                resize_profiles(prepared, estimator, tip_tension)
        hold_interval(constants, state, prepared, estimator, K)
    K = measure_friction(constants, state, loop_tension, dt)
    if not math.isnan(K):
        costs = ((1.0 - K / constants.K[:]) / LOOP_ACCURACY) ** 2
        age = state.evidence_age
        _weigh(constants, state, costs, LOOP_TEMPER, LOOP_EVIDENCE_MAX, 0.0)
        # it may have another friction than the tendon: without pieces that agree, K is doubted
        state.evidence_age = age
    change = 0.0
    for n in range(DEPTHS):
        change += state.mean_weight[n] * (state.tension[n] - state.begin_tension[n])
    has_turned = estimator.displacement_direction != state.direction
    state.direction = estimator.displacement_direction
    is_usable = usable and state.started and not has_turned
    is_whole = is_usable and abs(change) >= PIECE_TENSION * constants.compliance
    if is_whole:
        travel = estimator.mean_displacement - state.begin_travel
        _add_evidence(constants, state, travel, change)
    if is_whole or not is_usable or state.age > PIECE_MAX_S:
        state.begin_tension[:] = state.tension[:]
        state.begin_travel, state.age = estimator.mean_displacement, 0.0
        state.started = usable


@jit_compile
def measure_friction(
    constants: AdaptationConstants, state: AdaptedFriction, loop_tension: Array, dt: float
) -> float:
    """Return K by the sensing loop, if that has a new reading within the bounds of K, else NaN."""
    if constants.loop_ratio == 0.0:
        return math.nan
    measured = constants.loop_ratio * measure_loop_friction(
        state.loop, loop_tension[0], loop_tension[1], dt
    )
    if measured < constants.K[0] or measured > constants.K[FACTOR_COUNT - 1]:
        state.contradictions += 1
        state.loop.age = AGE_MAX_S
        return math.nan
    return measured


@jit_compile
def has_loop(constants: AdaptationConstants, state: AdaptedFriction) -> bool:
    """Return whether a sensing loop is measured, which sees a change where pieces contradict."""
    return constants.loop_ratio > 0.0 and state.loop.age < AGE_MAX_S


@jit_compile
def _read_bank(
    constants: AdaptationConstants,
    state: Adaptation,
    table: Tables,
    profile: Profile,
    tip_drives: bool,
) -> None:
    """Take the bank from the estimator's profile; beyond its tip, drive it from there."""
    last = count_points(profile) - 1
    k, rho = 0, table[_ASYMMETRY]
    s_a, y_a, slope = get_point(profile, 0)
    K, y_tip, _ = get_point(profile, last)
    tip_slope = get_point(profile, last - 1)[2]
    for n in range(DEPTHS):
        s = constants.depth[n]
        if s <= K:
            while k < last - 1 and get_point(profile, k + 1)[0] <= s:
                k += 1
                s_a, y_a, slope = get_point(profile, k)
            y = y_a + slope * (s - s_a)
        elif tip_drives or state.tension[n] == 0.0:
            y = y_tip + tip_slope * (s - K)
        else:
            y = min(max(state.y[n], y_tip - (s - K)), y_tip + rho * (s - K))
        if y != state.y[n] or state.tension[n] == 0.0:
            state.y[n], state.tension[n] = y, math.exp(y)


@jit_compile
def _interpolate(constants: AdaptationConstants, tension: Array, K: float) -> float:
    """Return the tension of the bank at the depth `K` [N]."""
    s = K / constants.depth[1]
    n = min(int(s), DEPTHS - 2)
    return float(tension[n] + (s - n) * (tension[n + 1] - tension[n]))


@jit_compile
def _add_evidence(
    constants: AdaptationConstants, state: Adaptation, travel: float, change: float
) -> None:
    """Weigh the hypotheses by a piece: the motor's `travel`, the mean elongation's `change` [m]."""
    least_tension = min(state.tension[0], state.begin_tension[0])
    accuracy = ACCURACY**2 + (ZERO_ERROR / least_tension) ** 2
    variance = constants.variance + accuracy * change**2
    costs = np.empty(HYPOTHESES)
    elongations = constants.weight[:] @ (state.tension[:] - state.begin_tension[:])
    for h in range(HYPOTHESES):
        z = travel - elongations[h]
        costs[h] = z * z / variance
        before = _interpolate(constants, state.begin_tension[:], constants.K[h])
        after = _interpolate(constants, state.tension[:], constants.K[h])
        if abs(after - before) > STILL_SHARE * before:
            cost = FOLLOW_COST + FOLLOW_TAILS * math.log1p(costs[h])
            costs[h] = cost if z * travel > 0.0 else max(cost, costs[h])
    before = _interpolate(constants, state.begin_tension[:], state.K)
    after = _interpolate(constants, state.tension[:], state.K)
    compliance = (travel - change) / (after - before) if after != before else 0.0
    _weigh(constants, state, costs, TEMPER, EVIDENCE_MAX, compliance)


@jit_compile
def _weigh(
    constants: AdaptationConstants,
    state: Adaptation,
    costs: Array,
    temper: float,
    cost_max: float,
    compliance: float,
) -> None:
    """Update the posterior by what a piece costs each hypothesis [squared sigma].

    `compliance` is that at the tip [m/N] if it follows, with K as estimated; else not positive.
    """
    least, near, apart = costs.min(), math.inf, math.inf
    for h in range(FACTOR_COUNT):
        if abs(constants.K[h] - state.K) > APART * state.K:
            apart = min(apart, costs[h])
        else:
            near = min(near, costs[h])
    state.pieces += 1
    if least > MISFIT_MAX:
        if compliance > STIFFENED * state.tip_compliance:
            state.tip_compliance = max(state.tip_compliance, compliance)
            return
        state.contradictions += 1
        near = math.inf
    if not has_loop(constants, state):
        _decay(state, HAZARD_CONTRADICTED * (1.0 - math.exp(0.5 * (least - near))), 0.0)
    if least <= MISFIT_MAX:
        for h in range(HYPOTHESES):
            state.log_posterior[h] -= 0.5 * temper * min(costs[h] - least, cost_max)
        kept = math.exp(-0.5 * temper * min(apart - least, cost_max))  # of what was unknown
        state.evidence_age *= kept
        state.tip_compliance *= kept
    _summarise(constants, state)


@jit_compile
def _decay(state: Adaptation, share: float, spread: float) -> None:
    """Let the prior take a `share` of the posterior, and each neighbour the share `spread`."""
    before = np.exp(state.log_posterior[:])
    for h in range(HYPOTHESES):
        k, p = h % FACTOR_COUNT, before[h]
        left = before[h - 1] if k > 0 else p
        right = before[h + 1] if k < FACTOR_COUNT - 1 else p
        p += spread * (left + right - 2.0 * p)
        state.log_posterior[h] = math.log(max((1.0 - share) * p + share * _PRIOR, 1e-30))


@jit_compile
def _summarise(constants: AdaptationConstants, state: Adaptation) -> None:
    """Normalise the posterior; update its means and the interval of K."""
    posterior = np.exp(state.log_posterior[:] - state.log_posterior[:].max())
    posterior /= posterior.sum()
    # what the prior took is spread over all hypotheses, and would draw a plain mean to its own
    share = posterior**2 / (posterior**2).sum()
    state.mean_weight[:], state.mean_factor[:] = share @ constants.weight[:], 0.0
    for h in range(HYPOTHESES):
        p = share[h]
        state.log_posterior[h] = math.log(max(posterior[h], 1e-30))
        for third in range(3):
            is_scaled = h < FACTOR_COUNT or h // FACTOR_COUNT == third + 1
            state.mean_factor[third] += p * (FACTORS[h % FACTOR_COUNT] if is_scaled else 1.0)
    order: Any = np.argsort(constants.K[:])
    mass = np.cumsum(posterior[order])
    state.K = float((share * constants.K[:]).sum())
    first: Any = np.searchsorted(mass, TAIL)
    last: Any = np.searchsorted(mass, 1.0 - TAIL)
    state.low = constants.K[order[first]]
    state.high = constants.K[order[min(last, HYPOTHESES - 1)]]


@jit_compile
def follow_estimate(
    constants: AdaptationConstants, state: AdaptedFriction, prepared: PreparedTendon
) -> None:
    """Bring the model in use towards an estimate that excludes it."""
    table, n = prepared.tables[:], constants.sections
    is_excluded = not state.low <= table[_K] <= state.high
    state.adapted |= is_excluded and abs(state.K - table[_K]) > CHANGE_MIN * table[_K]
    if not state.adapted:
        return
    friction = constants.friction[:n].copy()
    for third in range(3):
        change = state.mean_factor[third] - state.factor[third]
        state.factor[third] += min(max(change, -STEP_MAX), STEP_MAX)
    for k in range(n):
        friction[k] *= state.factor[constants.third[k]]
    fill_tables(table, constants.length[:n], friction)


@jit_compile
def resize_profiles(
    prepared: PreparedTendon, estimator: EstimatorState, tip_tension: float
) -> None:
    """Fit the estimator's profiles to a changed model, with `tip_tension` [N] + tau at the tip."""
    table, y_tip = prepared.tables[:], math.log(max(tip_tension, FLOOR))
    resize_profile(table, estimator.profile[:], y_tip)
    # the window stays open, or slow travel would never tell who drives
    resize_profile(table, estimator.anchor_profile[:], y_tip)
    estimator.anchor_elongation = read_profile(table, estimator.anchor_profile[:])[2]


@jit_compile
def hold_interval(
    constants: AdaptationConstants,
    state: AdaptedFriction,
    prepared: PreparedTendon,
    estimator: EstimatorState,
    K_before: float,
) -> None:
    """Let the estimator's interval hold that of K, which grows with the time without evidence."""
    K, growth = prepared.tables[_K], (GROWTH * state.evidence_age + state.doubt) * state.K
    low = max(state.low - growth, constants.K[0])
    high = min(state.high + growth, constants.K[FACTOR_COUNT - 1])
    calibrated_error = prepared.friction_error * K
    before = max(prepared.K_below, prepared.K_above)
    prepared.K_below = max(K - low - calibrated_error, 0.0)
    prepared.K_above = max(high - K - calibrated_error, 0.0)
    # what was proved holds for the K of then
    growth = max(prepared.K_below, prepared.K_above) - before
    widening = math.exp(abs(K - K_before) + max(growth, 0.0))
    estimator.proved_low /= widening
    estimator.proved_high *= widening


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
    with_dynamics: bool | None,
) -> int:
    """Take all samples of a record of one tendon, in place; return where adaptation began."""
    adapted_from = -1
    for i in range(len(time)):
        dt = time[i] - time[i - 1] if i > 0 else 0.0
        online.advance(
            prepared[0], estimators[0], tension[i], displacement[i], dt, estimates[i], with_dynamics
        )
        observe(
            constants[0],
            states[0],
            prepared[0],
            estimators[0],
            estimates[i],
            loop_tension[i],
            dt,
        )
        if states[0].adapted and adapted_from < 0:
            adapted_from = i
        store_friction(prepared[0], K, i)
    return adapted_from


@jit_compile
def store_friction(prepared: PreparedTendon, K: Array, i: int) -> None:
    """Write K in use and the ends of its interval into column `i` of `K`, shape (3, n)."""
    K[0, i] = prepared.tables[_K]
    error = prepared.friction_error * K[0, i]
    K[1, i] = K[0, i] - error - prepared.K_below
    K[2, i] = K[0, i] + error + prepared.K_above
