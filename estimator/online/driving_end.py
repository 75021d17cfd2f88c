"""Which end drives: decided from the direction in which the tendon slides (T18).

The sign of dT_in/dt does not tell. If T_in rises while the motor stands still, the tip draws the
tendon out and T_out is T_in e^(rho K), not T_in e^-K; the two differ by e^2K. So the motor drives
unless its travel contradicts that: over a window in which T_in surely changed, the motor went less
than a tenth of the way that it would have had to go to cause the change, or went the other way.

A tenth, because that way is computed with an elongation that may be wrong by a factor: a bend next
to the motor that the model spreads along the sheath is enough. A smaller threshold
detects more on an exact model but reports false tip motion otherwise (`test_estimate_on_rig`). A
window begins where T_in or the motor turns; it is forgotten after `WINDOW_MAX_S`, so that slow
creep of a tendon at rest is not taken for the tip.
"""

import math

from estimator import noise_treatment
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.play_profile import TIP, drive_end, push_proximal, to_log_tension
from estimator.law.transmission import read_profile
from estimator.online.dynamic_correction import varies_friction
from estimator.online.estimator_state import EstimatorState, PreparedTendon
from estimator.small_arrays import copy_values

# sigma of a displacement before it decides: a running extreme stands 3 to 4 off
TRAVEL_SIGMAS = 8.0
STILL_RATIO = 0.1  # of the travel a motor would need for the change seen: less, and it stands still
DRIVING_RATIO = 0.3  # of that travel: more, and it is the motor that drives
WINDOW_MAX_S = 2.0  # [s] that a window of evidence lasts; a slower change is creep, not the tip

_K, _ASYMMETRY = _tables.K, _tables.ASYMMETRY


@jit_compile
def anchor_window(prepared: PreparedTendon, state: EstimatorState, T: float, q: float) -> None:
    """Begin a new window of evidence at (T [N], q [m]), with the profile as it is."""
    profile = state.profile[:]
    state.anchor_tension, state.anchor_displacement, state.anchor_age = T, q, 0.0
    state.anchor_elongation = read_profile(prepared.tables[:], profile)[2]
    copy_values(profile, state.anchor_profile[:])


@jit_compile
def drive_profile(
    prepared: PreparedTendon, state: EstimatorState, T: float, q: float, sure_T: float, dt: float
) -> None:
    """Move the profile to T_in = `T` [N], driven by whichever end the travel `q` [m] tells.

    A change of T_in by more than `sure_T` [N] is no noise.
    """
    table, profile = prepared.tables[:], state.profile[:]
    T_before, q_before = state.held_tension, state.mean_displacement
    sure_q = TRAVEL_SIGMAS * prepared.displacement_noise
    heading = _compute_direction(state.tension_direction, T - T_before)
    held = noise_treatment.update_play(state.held_displacement, q, 0.5 * sure_q)
    motor_heading = _compute_direction(state.displacement_direction, held - state.held_displacement)
    is_reversed = (
        heading != state.tension_direction or motor_heading != state.displacement_direction
    )
    state.tension_direction, state.displacement_direction = heading, motor_heading
    state.held_tension, state.mean_displacement, state.held_displacement = T, q, held
    if is_reversed:
        state.tip_drives = False
        anchor_window(prepared, state, T_before, q_before)
    state.anchor_age += dt

    motor_driven = state.anchor_profile[:].copy() if state.tip_drives else profile
    push_proximal(table, motor_driven, T)
    _, _, e, _, _ = read_profile(table, motor_driven)
    expected = abs(e - state.anchor_elongation)
    dT, dq = T - state.anchor_tension, q - state.anchor_displacement
    along = math.copysign(dq, dT * dq)  # of dq, what would change T_in the way it changed
    if varies_friction(prepared.dynamics):  # where friction falls, so does T_in, however it goes
        along = abs(dq)
    is_still = abs(dT) > sure_T and max(along, 0.0) + sure_q < STILL_RATIO * expected
    driving = along > sure_q and along >= DRIVING_RATIO * expected
    tip = is_still or (state.tip_drives and not driving)

    if tip and dT != 0.0:
        K = table[_K]
        u = to_log_tension(table, T)
        drive_end(table, profile, u - K if dT < 0.0 else u + table[_ASYMMETRY] * K, TIP)
    elif state.tip_drives and not tip:
        copy_values(motor_driven, profile)  # since the anchor it was the motor after all
    state.tip_drives = tip
    if is_still or driving or state.anchor_age > WINDOW_MAX_S:
        anchor_window(prepared, state, T, q)


@jit_compile
def _compute_direction(previous: float, change: float) -> float:
    """Return the sign of a change, and the one of `previous` where nothing changes."""
    return previous if change == 0.0 else math.copysign(1.0, change)
