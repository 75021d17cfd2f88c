"""Which end drives: decided from the direction in which the tendon slides (docs/theory.md (T18)).

The sign of dT_in/dt does not tell. If T_in rises while the motor stands still, the tip draws the
tendon out and T_out is T_in e^(rho K), not T_in e^-K; the two differ by e^2K. So the motor drives
unless its travel contradicts that: over a window in which T_in surely changed, the motor went less
than a tenth of the way that it would have had to go to cause the change, or went the other way.

A tenth, because that way is computed with an elongation that may be wrong by a factor: a bend next
to the motor that the model spreads along the sheath is enough. A finer threshold sees finer things
on a perfect model, and the tip moving when only the motor does on any other (tests/slave/
test_estimate_on_rig.py). A window begins where T_in or the motor turns; it is forgotten after
`PATIENCE`, so that slow creep of a tendon at rest is not taken for the tip.
"""

import math

from estimator import signals
from estimator import tables as _tables
from estimator.compiled import compiled
from estimator.memory import (
    ANCHOR_AGE,
    ANCHOR_E,
    ANCHOR_Q,
    ANCHOR_T,
    DRIVER,
    HEADING,
    HELD,
    MEAN_Q,
    MEMORY,
    PLACE,
    PLACE_HEADING,
    SCALARS,
    SIGMA_Q,
    Array,
    State,
)
from estimator.profile import TIP, log_tension, push_proximal, slide
from estimator.tables import Tables
from estimator.transmission import read_out

SURE = 8.0  # sigma of a displacement before it decides: a running extreme stands 3 to 4 off
STILL = 0.1  # of the travel a motor would need for the change seen: less, and it stands still
DRIVING = 0.3  # of that travel: more, and it is the motor that drives
PATIENCE = 2.0  # [s] that a window of evidence lasts; a slower change is creep, not the tip

_K, _ASYMMETRY = _tables.K, _tables.ASYMMETRY


@compiled
def anchor(table: Tables, state: State, T: float, q: float) -> None:
    """Begin a new window of evidence at (T, q), with the profile as it is."""
    profile = state[SCALARS:MEMORY]
    state[ANCHOR_T], state[ANCHOR_Q], state[ANCHOR_AGE] = T, q, 0.0
    _, _, state[ANCHOR_E], _, _ = read_out(table, profile)
    state[MEMORY:] = profile


@compiled
def follow(
    table: Tables, constants: Array, state: State, T: float, q: float, sure_T: float, dt: float
) -> None:
    """Move the profile to T_in = `T`, driven by whichever end the displacement tells."""
    profile = state[SCALARS:MEMORY]
    T_before, q_before = state[HELD], state[MEAN_Q]
    sure_q = SURE * constants[SIGMA_Q]
    turned = _turned(state, HEADING, T - T_before)
    place = signals.play(state[PLACE], q, 0.5 * sure_q)
    turned |= _turned(state, PLACE_HEADING, place - state[PLACE])
    state[HELD], state[MEAN_Q], state[PLACE] = T, q, place
    if turned:
        state[DRIVER] = 0.0
        anchor(table, state, T_before, q_before)
    state[ANCHOR_AGE] += dt

    motor_driven = profile if state[DRIVER] == 0.0 else state[MEMORY:].copy()
    push_proximal(table, motor_driven, T)
    _, _, e, _, _ = read_out(table, motor_driven)
    expected = abs(e - state[ANCHOR_E])
    dT, dq = T - state[ANCHOR_T], q - state[ANCHOR_Q]
    along = math.copysign(dq, dT * dq)  # of dq, what would change T_in the way it changed
    still = abs(dT) > sure_T and max(along, 0.0) + sure_q < STILL * expected
    driving = along > sure_q and along >= DRIVING * expected
    tip = still or (state[DRIVER] != 0.0 and not driving)

    if tip and dT != 0.0:
        K = table[_K]
        u = log_tension(table, T)
        slide(table, profile, u - K if dT < 0.0 else u + table[_ASYMMETRY] * K, TIP)
    elif state[DRIVER] != 0.0 and not tip:
        profile[:] = motor_driven  # since the anchor it was the motor after all
    state[DRIVER] = 1.0 if tip else 0.0
    if still or driving or state[ANCHOR_AGE] > PATIENCE:
        anchor(table, state, T, q)


@compiled
def _turned(state: State, slot: int, change: float) -> bool:
    """Note the direction of a change; return whether it is another one than before."""
    if change == 0.0:
        return False
    heading = math.copysign(1.0, change)
    turned: bool = heading != state[slot]
    state[slot] = heading
    return turned
