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

from estimator import tables as _tables
from estimator.compiled import compiled
from estimator.driver import anchor
from estimator.memory import (
    BOUND,
    DRIVER,
    E_ERROR,
    HELD,
    K_ERROR,
    MEMORY,
    PROVED_HIGH,
    PROVED_LOW,
    RATE,
    SCALARS,
    SIGMA_Q,
    SIGMA_T,
    TENSION_FLOOR,
    WINDOW_AGE,
    WINDOW_Q,
    WINDOW_T,
    WINDOW_T_LEAST,
    WINDOW_T_MOST,
    Array,
    State,
)
from estimator.profile import TIP, log_tension, slide, tension_of
from estimator.tables import Tables, integral
from estimator.transmission import read_out

PRECISE = 10.0  # margins a window's change must exceed to be called precisely known
CORRECTS = 2.0  # times the travel that proves all of the tendon to slide puts the profile right
WINDOW = 0.1  # [s] after which a window of proof is closed as it is

_K, _EA, _ASYMMETRY = _tables.K, _tables.EA, _tables.ASYMMETRY


@compiled
def _depth(table: Tables, side: float, compliance: float) -> float:
    """Return the depth a with G(a)/EA = `compliance` [m/N], at most K (T7)."""
    target = compliance * table[_EA]
    low, high = 0.0, table[_K]
    if target >= integral(table, high, side):
        return float(high)
    for _ in range(50):
        middle = 0.5 * (low + high)
        if integral(table, middle, side) < target:
            low = middle
        else:
            high = middle
    return low


@compiled
def open_window(state: State, T: float, q: float) -> None:
    """Begin a window of proof at (T, q)."""
    state[WINDOW_T] = state[WINDOW_T_LEAST] = state[WINDOW_T_MOST] = T
    state[WINDOW_Q], state[WINDOW_AGE] = q, 0.0


@compiled
def prove(
    table: Tables,
    constants: Array,
    state: State,
    T: float,
    q: float,
    sigma_mean: float,
    dt: float,
) -> None:
    """Cut the proved interval of T_out by how deep the motor end slides at least, in place.

    Over a window in which T_in went one way, dq_p >= G(a) dT_in says that at some time the front
    was at a or deeper. What of dT_in the noise hides counts against it.
    """
    state[WINDOW_AGE] += dt
    dT, dq = T - state[WINDOW_T], q - state[WINDOW_Q]
    margin_q = BOUND * math.sqrt(2.0) * constants[SIGMA_Q]
    margin_T = BOUND * (math.sqrt(2.0) * sigma_mean + TENSION_FLOOR)
    least = state[WINDOW_T_LEAST] = min(T, state[WINDOW_T_LEAST])
    most = state[WINDOW_T_MOST] = max(T, state[WINDOW_T_MOST])
    turned = most - least - abs(dT)
    if turned > margin_T:
        open_window(state, T, q)
    elif abs(dq) > 2.0 * margin_q:
        side = -1.0 if dq > 0.0 else table[_ASYMMETRY]
        sure_q = (abs(dq) - margin_q) * (1.0 - constants[E_ERROR])
        along = max(math.copysign(dT, dT * dq), 0.0)  # of dT, what slides the way the motor went
        sure_T = along + turned + 2.0 * margin_T
        compliance = sure_q / sure_T
        whole = sure_T * integral(table, table[_K], side) / table[_EA]
        full = sure_q >= whole
        precise = abs(dq) > PRECISE * margin_q and abs(dT) > PRECISE * margin_T
        if not (full or precise or state[WINDOW_AGE] > WINDOW):
            return
        margin = BOUND * constants[SIGMA_T]
        least, most = max(least - margin, 0.0), most + margin
        depth = _depth(table, side, compliance)
        slack_K = constants[K_ERROR] * table[_K]
        rest = table[_K] - depth + slack_K
        low = tension_of(table, log_tension(table, least) + side * depth - rest)
        high = tension_of(table, log_tension(table, most) + side * depth + table[_ASYMMETRY] * rest)
        unheard = constants[RATE] * state[WINDOW_AGE] if state[WINDOW_AGE] > 0.0 else 0.0
        state[PROVED_LOW] = max(state[PROVED_LOW], low - unheard)
        state[PROVED_HIGH] = min(state[PROVED_HIGH], high + unheard)
        profile = state[SCALARS:MEMORY]
        T_out = read_out(table, profile)[1]
        if full and not low <= T_out <= high:
            if sure_q < CORRECTS * whole and state[WINDOW_AGE] <= WINDOW:
                return
            if sure_q >= CORRECTS * whole:
                u = log_tension(table, state[HELD])
                slide(table, profile, u + side * table[_K], TIP)
                state[DRIVER] = 0.0
                anchor(table, state, state[HELD], q)
        open_window(state, T, q)
    elif state[WINDOW_AGE] > WINDOW:
        open_window(state, T, q)
