"""What motion proves about T_out, whoever drives: the certified interval beyond (T2).

By (T7) the travel a change of T_in takes tells how deep the motor slides the tendon: with
dq_p >= G(a) dT_in the front was at depth a or deeper, and beyond it friction leaves the tip the
cone of (T2) that opens there: one point once a = K. What was proved ages: by what the motor may
have changed since, and by `tip_tension_rate`, at which the tip may change unseen.

A motor that goes on and on at one tension takes the whole tendon along, whatever the profile says:
so a loose tendon is dragged out by the other tendon of its joint while its motor pays out. Then the
profile is wrong, because the tip moved unseen, and is put right.
"""

import math

from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.play_profile import TIP, drive_end, from_log_tension, to_log_tension
from estimator.law.tables import Tables, integrate_exponential
from estimator.law.transmission import read_profile
from estimator.online.driving_end import anchor_window
from estimator.online.estimator_state import (
    BOUND_SIGMAS,
    TENSION_FLOOR,
    EstimatorState,
    PreparedTendon,
)

PRECISE_MARGINS = 10.0  # margins a window's change must exceed to be called precisely known
# times the travel that proves all of the tendon to slide puts the profile right
CORRECTION_RATIO = 2.0
WINDOW_S = 0.1  # [s] after which a window of proof is closed as it is

_K, _EA, _ASYMMETRY = _tables.K, _tables.EA, _tables.ASYMMETRY


@jit_compile
def _find_sliding_depth(table: Tables, side: float, compliance: float) -> float:
    """Return the depth a with G(a)/EA = `compliance` [m/N], at most K (T7)."""
    target = compliance * table[_EA]
    low, high = 0.0, table[_K]
    if target >= integrate_exponential(table, high, side):
        return float(high)
    for _ in range(50):
        middle = 0.5 * (low + high)
        if integrate_exponential(table, middle, side) < target:
            low = middle
        else:
            high = middle
    return low


@jit_compile
def open_window(state: EstimatorState, T: float, q: float) -> None:
    """Begin a window of proof at (T [N], q [m])."""
    state.window_tension = state.window_min = state.window_max = T
    state.window_displacement, state.window_age = q, 0.0


@jit_compile
def tighten_interval(
    prepared: PreparedTendon,
    state: EstimatorState,
    T: float,
    q: float,
    sigma_mean: float,
    dt: float,
) -> float:
    """Cut the proved interval of T_out by how deep the motor end slides at least, in place.

    `T` [N] and `q` [m] are averages, `sigma_mean` [N] the noise of `T`.

    Over a window in which T_in went one way, dq_p >= G(a) dT_in says that at some time the front
    was at a or deeper. Noise in dT_in widens the bound.

    Returns the side (-1 or rho) to which all of it slides where the profile was wrong; else 0.
    """
    corrected_side = 0.0
    table = prepared.tables[:]
    state.window_age += dt
    dT, dq = T - state.window_tension, q - state.window_displacement
    margin_q = BOUND_SIGMAS * math.sqrt(2.0) * prepared.displacement_noise
    margin_T = BOUND_SIGMAS * (math.sqrt(2.0) * sigma_mean + TENSION_FLOOR)
    T_min = state.window_min = min(T, state.window_min)
    T_max = state.window_max = max(T, state.window_max)
    reversal = T_max - T_min - abs(dT)
    if reversal > margin_T:
        open_window(state, T, q)
    elif abs(dq) > 2.0 * margin_q:
        side = -1.0 if dq > 0.0 else table[_ASYMMETRY]
        sure_q = (abs(dq) - margin_q) * (1.0 - prepared.elongation_error)
        along = max(math.copysign(dT, dT * dq), 0.0)  # of dT, what slides the way the motor went
        sure_T = along + reversal + 2.0 * margin_T
        compliance = sure_q / sure_T
        full_travel = sure_T * integrate_exponential(table, table[_K], side) / table[_EA]
        full = sure_q >= full_travel
        precise = abs(dq) > PRECISE_MARGINS * margin_q and abs(dT) > PRECISE_MARGINS * margin_T
        if not (full or precise or state.window_age > WINDOW_S):
            return corrected_side
        margin = BOUND_SIGMAS * prepared.tension_noise
        T_min, T_max = max(T_min - margin, 0.0), T_max + margin
        depth = _find_sliding_depth(table, side, compliance)
        slack_K = prepared.friction_error * table[_K]
        K_left = table[_K] - depth + slack_K
        low = from_log_tension(table, to_log_tension(table, T_min) + side * depth - K_left)
        high = from_log_tension(
            table, to_log_tension(table, T_max) + side * depth + table[_ASYMMETRY] * K_left
        )
        tip_change = prepared.tip_tension_rate * state.window_age if state.window_age > 0.0 else 0.0
        doubt = math.exp(max(prepared.K_below, prepared.K_above))
        state.proved_low = max(state.proved_low, low / doubt - tip_change)
        state.proved_high = min(state.proved_high, high * doubt + tip_change)
        profile = state.profile[:]
        T_out = read_profile(table, profile)[1]
        if full and not low <= T_out <= high:
            if sure_q < CORRECTION_RATIO * full_travel and state.window_age <= WINDOW_S:
                return corrected_side
            if sure_q >= CORRECTION_RATIO * full_travel:
                u = to_log_tension(table, state.held_tension)
                drive_end(table, profile, u + side * table[_K], TIP)
                state.tip_drives, corrected_side = False, side
                anchor_window(prepared, state, state.held_tension, q)
        open_window(state, T, q)
    elif state.window_age > WINDOW_S:
        open_window(state, T, q)
    return corrected_side
