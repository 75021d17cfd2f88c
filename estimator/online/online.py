"""The online estimator of one tendon: from what the housing measures to what the tip feels.

`advance` is the compiled step: it takes one sample, writes a `TendonEstimate` and changes the state
in place. `step` is the same as a pure function for Python, and `run` the same over a whole record,
so live operation, replay and tests give the same numbers.

estimator_state has what the estimator knows (`PreparedTendon`) and what it remembers
(`EstimatorState`); driving_end decides which end drives, interval keeps the interval that motion
has proved.

The interval does not rest on the decision who drives. It is (T2), widened by the sensor noise and
cut by what motion has proved; it always holds the estimate.

A model with an extension (estimator.online.extended_model) has its readings put right before
(estimator.online.reading_correction), and what its effects add to the law
(estimator.online.dynamic_correction) put on top.
"""

import math
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from estimator.law import tables as _tables
from estimator.law.play_profile import (
    find_extremes,
    from_log_tension,
    push_proximal,
    to_log_tension,
)
from estimator.law.transmission import evaluate_tension, read_profile
from estimator.online.driving_end import anchor_window, drive_profile
from estimator.online.dynamic_correction import (
    bound_function_error,
    bound_tip_tension,
    slide_tendons,
    update_correction,
    varies_friction,
)
from estimator.online.estimator_state import (
    BOUND_SIGMAS,
    TENSION_FLOOR,
    EstimatorState,
    PreparedTendon,
    build_initial_state,
    build_initial_states,
    prepare,
    prepare_all,
)
from estimator.online.interval import open_window, tighten_interval
from estimator.online.reading_correction import correct_reading
from estimator.online.tendon_estimate import (
    INVALID_INPUT,
    SLACK,
    TENSION_ONLY,
    TIP_MOVED,
    UNINITIALISED,
    Status,
    TendonEstimate,
)
from estimator.online.tendon_model import ModelError, TendonModel
from estimator.structs import StructArray

__all__ = [
    "Estimates",
    "EstimatorState",
    "ModelError",
    "PreparedTendon",
    "Status",
    "TendonEstimate",
    "TendonModel",
    "advance",
    "build_initial_state",
    "build_initial_states",
    "compute_profile",
    "prepare",
    "prepare_all",
    "run",
    "step",
]

ZERO_OFFSET_MAX = 0.05
"""Zero offset [N] that is not a broken load cell."""

TENSION_MAX = 1e6
"""Largest plausible tension [N]."""

_EMPTY_ESTIMATE = TendonEstimate.new()
_K, _ASYMMETRY, _DRAG = _tables.K, _tables.ASYMMETRY, _tables.DRAG


class Estimates(NamedTuple):
    """The fields of `TendonEstimate` over a record, arrays of shape (n,)."""

    distal_tension: Array
    low: Array
    high: Array
    adapted_low: Array
    adapted_high: Array
    elongation: Array
    distal_displacement: Array
    front: Array
    phase: NDArray[np.int64]
    status: NDArray[np.int64]

    @property
    def tension(self) -> Array:
        """The estimated tension at the tip [N], `distal_tension`."""
        return self.distal_tension


def step(
    prepared: PreparedTendon,
    state: EstimatorState,
    proximal_tension: float,
    proximal_displacement: float,
    dt: float,
) -> tuple[TendonEstimate, EstimatorState]:
    """Take one sample; return the estimate and the next state. `state` is left as it was.

    Parameters
    ----------
    prepared : PreparedTendon
        From `prepare`.
    state : EstimatorState
        From `initial` or the previous step.
    proximal_tension : float
        T_in measured [N].
    proximal_displacement : float
        q_p measured [m], positive = pulled in; NaN where there is none.
    dt : float
        Time since the previous sample [s]; 0 for the first.
    """
    new_state, estimates = _copy_as_array(state), _copy_as_array(_EMPTY_ESTIMATE)
    _step_arrays(
        _as_array(prepared), new_state, proximal_tension, proximal_displacement, dt, estimates
    )
    return cast(TendonEstimate, estimates[0]), cast(EstimatorState, new_state[0])


def run(
    prepared: PreparedTendon, time: Array, tension: Array, displacement: Array | None = None
) -> Estimates:
    """Return the estimates of a whole record: the numbers `step` gives sample for sample.

    Parameters
    ----------
    prepared : PreparedTendon
        From `prepare`.
    time, tension, displacement : ndarray
        Sample times [s], T_in [N] and q_p [m], shape (n,); None where there is no displacement.
    """
    q = np.full(len(tension), math.nan) if displacement is None else displacement
    if not time.shape == tension.shape == q.shape or tension.ndim != 1:
        raise ModelError(
            f"time {time.shape}, tension {tension.shape}, displacement {q.shape}: "
            "give rows of equal length"
        )
    time, T, q = (np.ascontiguousarray(row, dtype=np.float64) for row in (time, tension, q))
    estimates = TendonEstimate.array(len(T))
    _run_arrays(
        _as_array(prepared), _copy_as_array(build_initial_state(prepared)), time, T, q, estimates
    )
    return Estimates(*(estimates[name].copy() for name in Estimates._fields))


def compute_profile(prepared: PreparedTendon, state: EstimatorState, x: Array) -> Array:
    """Return the tension T(x) [N] the state remembers at the arc lengths `x` [m], shape (n,)."""
    return evaluate_tension(prepared.tables, state.profile, np.asarray(x, dtype=np.float64))


@jit_compile
def advance(
    prepared: PreparedTendon,
    state: EstimatorState,
    T: float,
    q: float,
    dt: float,
    estimate: TendonEstimate,
    with_dynamics: bool | None = True,
) -> tuple[float, float]:
    """Take one sample: change `state` and `estimate` in place; return the corrected reading.

    Parameters
    ----------
    prepared : PreparedTendon
        From `prepare`, or one of `prepare_all`.
    state : EstimatorState
        From `build_initial_state`, or one of `build_initial_states`.
    T, q : float
        T_in [N] and q_p [m] as read; q is NaN where there is none.
    dt : float
        Time since the previous sample [s]; 0 for the first.
    estimate : TendonEstimate
        All fields are written.
    with_dynamics : bool or None
        None for a tendon whose model has no `dynamics`: numba omits a branch on an argument that
        is None, so that the law alone is compiled, in half the time.

    Returns
    -------
    T, q : float
        T_in [N] and q_p [m] without the sensors' effects, as the estimator took them; the same as
        read where the model has no such effects.
    """
    T, q = correct_reading(prepared.corrections, state.remembered[:], T, q)
    _advance_law(prepared, state, T, q, dt, estimate, with_dynamics)
    if with_dynamics is not None and prepared.has_dynamics:
        _add_dynamics(prepared, state, estimate)
    return T, q


class _FilteredTension(NamedTuple):
    """T_in of one sample, filtered [N]."""

    mean: float  # over the time constant
    held_mean: float  # the mean behind its dead band; 0 for a slack tendon
    sigma: float  # of the mean
    band: float  # the dead band
    slack: bool


@jit_compile
def _advance_law(
    prepared: PreparedTendon,
    state: EstimatorState,
    T: float,
    q: float,
    dt: float,
    estimate: TendonEstimate,
    with_dynamics: bool | None,
) -> None:
    """Take one corrected sample by the closed law, whose travel is the motor's without effects'."""
    table = prepared.tables[:]
    tip_change = prepared.tip_tension_rate * dt if dt > 0.0 else 0.0
    state.proved_low -= tip_change
    state.proved_high += tip_change
    if not _is_valid(prepared, T, q, dt):
        status = INVALID_INPUT | (0 if _is_initialised(table, state) else UNINITIALISED)
        state.has_displacement = False
        if with_dynamics is not None and 0.0 <= dt < math.inf:
            state.dynamics.refused_time += dt
        low, high = max(state.low - tip_change, 0.0), state.high + tip_change
        _write_estimate(prepared, state, low, high, math.nan, status, estimate)
        return
    if not state.started:
        state.started = True
        state.mean_tension = state.held_tension = T
        state.tension_variance = prepared.tension_noise * prepared.tension_noise
    tension = _filter_tension(prepared, state, T, dt)
    status, effects_travel = SLACK if tension.slack else 0, 0.0
    if with_dynamics is not None and prepared.has_dynamics:
        # first: a travel one sample late looks like a tip that moves
        update_correction(prepared.dynamics, state.dynamics, tension.held_mean, q, dt)
        effects_travel = state.dynamics.travel
    profile_status, slid_side = _update_profile(prepared, state, tension, q - effects_travel, dt)
    status |= profile_status
    if with_dynamics is not None and slid_side != 0.0 and varies_friction(prepared.dynamics):
        slide_tendons(prepared.dynamics, state.dynamics, tension.held_mean, slid_side)
    if not _is_initialised(table, state):
        status |= UNINITIALISED
    low, high = _compute_bounds(prepared, state, tension, T)
    _write_estimate(prepared, state, low, high, q, status, estimate)


@jit_inline
def _is_valid(prepared: PreparedTendon, T: float, q: float, dt: float) -> bool:
    """Return whether a sample can be one; a displacement may be missing."""
    lowest = T + ZERO_OFFSET_MAX + 6.0 * prepared.tension_noise
    return not (
        not math.isfinite(T)
        or math.isinf(q)
        or not (0.0 <= dt < math.inf)
        or lowest < 0.0
        or T > TENSION_MAX
    )


@jit_inline
def _filter_tension(
    prepared: PreparedTendon, state: EstimatorState, T: float, dt: float
) -> _FilteredTension:
    """Average the tension, hold it within its dead band, and age what was proved of T_out."""
    sigma, tau = prepared.tension_noise, prepared.time_constant
    mean = noise_treatment.update_average(state.mean_tension, T, dt, tau)
    # what was proved of T_out ages by what the motor itself may have changed since
    fall = state.mean_tension - mean
    state.proved_low -= max(fall, 0.0) * _compute_release_gain(prepared.tables[:])
    state.proved_high += max(-fall, 0.0)
    state.tension_variance = noise_treatment.update_variance(state.tension_variance, sigma, dt, tau)
    sigma_mean = math.sqrt(state.tension_variance)
    band = prepared.dead_band * sigma_mean
    held_mean = noise_treatment.update_play(state.held_tension, mean, band)
    state.mean_tension = mean
    slack = mean <= 3.0 * max(sigma_mean, TENSION_FLOOR)
    if slack:
        held_mean = 0.0
    state.min_tension = min(state.min_tension, held_mean)
    state.max_tension = max(state.max_tension, held_mean)
    return _FilteredTension(mean, held_mean, sigma_mean, band, slack)


@jit_inline
def _update_profile(
    prepared: PreparedTendon, state: EstimatorState, tension: _FilteredTension, q: float, dt: float
) -> tuple[int, float]:
    """Drive the profile by whichever end moved; return the status bits of that.

    And the side to which all of the tendon is found to slide, as by `tighten_interval`.
    """
    slid_side = 0.0
    table, profile = prepared.tables[:], state.profile[:]
    mean, held, sigma_mean = tension.mean, tension.held_mean, tension.sigma
    if math.isnan(q):
        state.has_displacement = state.tip_drives = False
        state.proved_low, state.proved_high = 0.0, math.inf
        state.held_tension = held
        push_proximal(table, profile, held)
        return TENSION_ONLY, slid_side
    if not state.has_displacement or tension.slack:
        push_proximal(table, profile, held)
        state.held_tension, state.mean_displacement = held, q
        state.held_displacement = q
        state.tip_drives, state.has_displacement = False, True
        anchor_window(prepared, state, held, q)
        open_window(state, mean, q)
    else:
        mean_q = noise_treatment.update_average(
            state.mean_displacement, q, dt, prepared.time_constant
        )
        sure_T = tension.band + BOUND_SIGMAS * (sigma_mean + TENSION_FLOOR)
        drive_profile(prepared, state, held, mean_q, sure_T, dt)
        slid_side = tighten_interval(prepared, state, mean, mean_q, sigma_mean, dt)
    return TIP_MOVED if state.tip_drives else 0, slid_side


@jit_inline
def _compute_bounds(
    prepared: PreparedTendon, state: EstimatorState, tension: _FilteredTension, T: float
) -> tuple[float, float]:
    """Return the interval of T_out [N]: (T2) with the sensor noise, cut by what was proved."""
    table, mean, held = prepared.tables[:], tension.mean, tension.held_mean
    margin = BOUND_SIGMAS * prepared.tension_noise
    K = table[_K] * (1.0 + prepared.friction_error) + prepared.K_above
    low = from_log_tension(table, to_log_tension(table, min(mean, T, held) - margin) - K)
    high = from_log_tension(
        table, to_log_tension(table, max(mean, T, held) + margin) + table[_ASYMMETRY] * K
    )
    if state.proved_low > state.proved_high:
        state.proved_low, state.proved_high = 0.0, math.inf
    # the average lags: so much the tip may be ahead of what was proved by it
    proved_low = state.proved_low - max(mean - T, 0.0) * _compute_release_gain(table)
    proved_high = state.proved_high + max(T - mean, 0.0)
    if max(low, proved_low) <= min(high, proved_high):
        low, high = max(low, proved_low), min(high, proved_high)
    return low, high


@jit_compile
def _compute_release_gain(table: Array) -> float:
    """Return by how much more T_out falls than T_in when all of the tendon is released."""
    return math.exp(table[_ASYMMETRY] * table[_K])


@jit_compile
def _write_estimate(
    prepared: PreparedTendon,
    state: EstimatorState,
    low: float,
    high: float,
    q: float,
    status: int,
    estimate: TendonEstimate,
) -> None:
    """Write what the profile says, and the interval, opened as far as to hold it."""
    table, profile = prepared.tables[:], state.profile[:]
    _, T_out, e, phase, front = read_profile(table, profile)
    estimate.adapted_low = estimate.adapted_high = T_out
    if prepared.K_below > 0.0 or prepared.K_above > 0.0:
        # the play operators of (T10) are the same for any K: with a smaller one, the tip is at a
        # smaller depth; beyond the tip the profile is within (T2)
        y = to_log_tension(table, T_out)
        y_low, y_high = find_extremes(profile, table[_K] - prepared.K_below)
        estimate.adapted_low = from_log_tension(table, min(y_low, y - prepared.K_above))
        y_high = max(y_high, y + table[_ASYMMETRY] * prepared.K_above)
        estimate.adapted_high = from_log_tension(table, y_high)
    state.low, state.high = min(low, T_out), max(high, T_out)
    estimate.distal_tension, estimate.low, estimate.high = T_out, state.low, state.high
    estimate.elongation, estimate.distal_displacement = e, q - e
    estimate.front, estimate.phase, estimate.status = front, phase, status


@jit_compile
def _add_dynamics(
    prepared: PreparedTendon, state: EstimatorState, estimate: TendonEstimate
) -> None:
    """Put what effects add to the law on top of its estimate."""
    dynamics = state.dynamics
    change, T_out, low, high = (
        dynamics.tension, estimate.distal_tension, estimate.low, estimate.high,
    )  # fmt: skip
    tension_max = max(
        state.max_tension, T_out
    )  # no tip that is only pulled at pulls harder than that
    corrected = bound_tip_tension(prepared.dynamics, T_out, max(T_out + change, 0.0))
    corrected = min(corrected, tension_max)
    estimate.distal_tension = corrected
    estimate.adapted_low = max(estimate.adapted_low + corrected - T_out, 0.0)
    estimate.adapted_high += corrected - T_out
    estimate.low = min(max(min(low, low + change), 0.0), corrected)
    estimate.high = max(high, min(high + change, tension_max), corrected)
    margin = bound_function_error(prepared.dynamics, dynamics, corrected)
    estimate.low = max(estimate.low - margin, 0.0)
    estimate.high = max(estimate.high, min(estimate.high + margin, tension_max))
    estimate.elongation += dynamics.elongation
    estimate.distal_displacement -= dynamics.elongation


@jit_compile
def _is_initialised(table: Array, state: EstimatorState) -> bool:
    """Return whether T_in has swung so far since the start that the first profile is forgotten."""
    swing = math.exp((1.0 + table[_ASYMMETRY]) * table[_K])
    drag = table[_DRAG]
    tension_min = max(state.min_tension, TENSION_FLOOR)
    erased: bool = state.max_tension + drag >= swing * (tension_min + drag)
    return erased


@jit_compile
def _step_arrays(
    prepared: StructArray,
    states: StructArray,
    T: float,
    q: float,
    dt: float,
    estimates: StructArray,
) -> None:
    """Take one sample of one tendon; arrays of one record cost less to call with than records."""
    advance(prepared[0], states[0], T, q, dt, estimates[0])


@jit_compile
def _run_arrays(
    prepared: StructArray,
    states: StructArray,
    time: Array,
    tension: Array,
    displacement: Array,
    estimates: StructArray,
) -> None:
    """Take all samples of a record of one tendon, in place."""
    for i in range(len(tension)):
        dt = time[i] - time[i - 1] if i > 0 else 0.0
        advance(prepared[0], states[0], tension[i], displacement[i], dt, estimates[i])


def _as_array(record: Any) -> StructArray:
    """Return a record as an array, shape (1,), in the same memory."""
    return np.asarray(record).reshape(1)


def _copy_as_array(record: Any) -> StructArray:
    """Return a copy of a record as an array, shape (1,); numpy's own copies field by field."""
    return np.frombuffer(bytearray(record.tobytes()), record.dtype)
