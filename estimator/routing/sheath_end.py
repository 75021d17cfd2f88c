"""Tension at the ends of the sheaths of an antagonistic pair, whose tips travel together.

A tendon alone does not show at its housing that its tip begins to move: friction hides it until all
of the tendon slides. Its antagonist shows it earlier, as it is nearly slack. So the travel x of
both tips is taken from both, and drives the tension profile of each tendon at its tip: to the
tension (T18) for which its elongation e changes as the tip travels, beside T_in at the housing,

    de_a = -dx, de_b = dx,   T_in e^-K <= T_out <= T_in e^(rho K)

In an arm dx differs from the travel of the joints, since with friction at guides the tendon behind
its sheath stretches otherwise than at one tension (`tensions.compute_excess_slip`). As that depends
on T_out, both are met at once. At either limit all of the tendon slides along, and e follows from
T_in again.
"""

import math
from collections.abc import Sequence
from typing import Annotated

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.law import tables as _tables
from estimator.law.play_profile import (
    PROFILE_SIZE,
    TIP,
    count_points,
    drive_end,
    from_log_tension,
    get_point,
    integrate_tension,
    push_proximal,
    to_log_tension,
)
from estimator.law.tables import compute_arc_length, compute_length_density
from estimator.law.transmission import read_profile
from estimator.online.estimator_state import PreparedTendon
from estimator.routing.routing import PreparedRouting
from estimator.routing.tensions import Elements, compute_excess_slip
from estimator.small_arrays import copy_values
from estimator.structs import F64, Field, Flag, Struct

NOISE_SIGMAS, TRAVEL_SIGMAS = 2.0, 1.5  # dead bands of T_in and of the travel
TRAVEL_TIME_S = 0.005  # time constant of the travel of the tips, within its noise
OFFSET_TIME_S = 0.05  # within which the less certain tendon's travel follows the other's
DRIFT_TIME_S = 5.0  # within which both follow the travel that others know

_K, _LENGTH, _EA, _ASYMMETRY = _tables.K, _tables.LENGTH, _tables.EA, _tables.ASYMMETRY
_STEPS, _STEP_SHARE = 8, 0.5  # halves: it may stretch twice as far as is computed
_STRETCH_TOLERANCE = 0.02  # of a stretch
_MEETING_MARGIN = 1e-9  # of ln T, against rounding
_NEAR_TIP = 1.0 - 1e-9  # of K: before a straight stretch at the tip


class SheathEnd(Struct):
    """State of one tendon of a pair."""

    profile: Annotated[Array, Field("f8", PROFILE_SIZE)]  # estimator.law.play_profile
    held_tension: F64  # [N] T_in behind its dead band
    offset: F64  # [m] of the tip's travel by this tendon
    stretch: F64  # [m] travel of the tip away from the motor that the profile lacks


class SheathPair(Struct):
    """State of the two tendons of a joint."""

    started: Flag = False
    mean_travel: F64  # [m] of both tips, towards the motor of the first
    travel: F64  # [m] behind its dead band
    end: Annotated[Sequence[SheathEnd], Field(SheathEnd, 2)]


@jit_compile
def update_pair_travel(
    pair: SheathPair,
    prepared_a: PreparedTendon,
    prepared_b: PreparedTendon,
    reading_a: tuple[float, float],
    reading_b: tuple[float, float],
    share: float,
    known_travel: float,
    dt: float,
) -> None:
    """Take the next sample of a pair: update the travel of its joints, `pair.travel`.

    Parameters
    ----------
    pair : SheathPair
        Changed in place.
    prepared_a, prepared_b : PreparedTendon
        Without dynamic effects.
    reading_a, reading_b : tuple of float
        T_in [N], and q_p less the excess of stretch behind the sheath [m], both finite.
    share : float
        0 to 1: how much the first tendon decides of the travel of the tips.
    known_travel : float
        [m] of the tips as it is known otherwise, right in the long run.
    dt : float
        Time since the previous sample [s].
    """
    a, b = pair.end[0], pair.end[1]
    travel_a = reading_a[1] - _push_housing(prepared_a, a, reading_a[0])
    travel_b = _push_housing(prepared_b, b, reading_b[0]) - reading_b[1]
    if not pair.started:
        pair.started, pair.mean_travel, pair.travel = True, known_travel, known_travel
        a.offset, b.offset = travel_a - known_travel, travel_b - known_travel
    drift = dt / DRIFT_TIME_S * (pair.mean_travel - known_travel)
    a.offset, b.offset = a.offset + drift, b.offset + drift
    noise = max(_compute_travel_noise(prepared_a), _compute_travel_noise(prepared_b))
    _update_travel(pair, travel_a - a.offset, travel_b - b.offset, share, noise, dt)


@jit_compile
def start_sheath_end(end: SheathEnd, profile: Array, tension: float) -> None:
    """Start a tendon from a tension `profile`, with T_in [N]."""
    copy_values(profile, end.profile[:])
    end.held_tension, end.stretch = tension, 0.0


@jit_compile
def _push_housing(prepared: PreparedTendon, end: SheathEnd, tension: float) -> float:
    """Bring T_in of a tendon to `tension` [N], behind its dead band; return its elongation [m]."""
    band = NOISE_SIGMAS * prepared.tension_noise
    end.held_tension = noise_treatment.update_play(end.held_tension, max(tension, 0.0), band)
    push_proximal(prepared.tables[:], end.profile[:], end.held_tension)
    return read_profile(prepared.tables[:], end.profile[:])[2]


@jit_compile
def _compute_travel_noise(prepared: PreparedTendon) -> float:
    """Return the standard deviation [m] of the travel of a tip, with that of the elongation."""
    tables = prepared.tables[:]
    return math.hypot(
        prepared.displacement_noise, prepared.tension_noise * tables[_LENGTH] / tables[_EA]
    )


@jit_compile
def _update_travel(
    pair: SheathPair, travel_a: float, travel_b: float, share: float, noise: float, dt: float
) -> None:
    """Take the travel of both tips by either tendon [m].

    An error of stiffness must not move the tips where the share changes, so each tendon follows the
    other, as far as it decides less, and at once if it decides nothing: a slack one measures no
    tip. The average lags behind tips that move by no more than the noise. With its dead band, tips
    that stick do not move while the motors sway; a wider one hides reversals.
    """
    a, b = pair.end[0], pair.end[1]
    fused = share * travel_a + (1.0 - share) * travel_b
    leak, weight = dt / (dt + OFFSET_TIME_S), dt / (dt + TRAVEL_TIME_S)
    a.offset += (leak * (1.0 - share) if share > 0.0 else 1.0) * (travel_a - fused)
    b.offset += (leak * share if share < 1.0 else 1.0) * (travel_b - fused)
    mean = pair.mean_travel + weight * (fused - pair.mean_travel)
    pair.mean_travel = noise_treatment.update_play(mean, fused, noise)
    pair.travel = noise_treatment.update_play(pair.travel, pair.mean_travel, TRAVEL_SIGMAS * noise)


@jit_compile
def drive_sheath_end(
    prepared: PreparedTendon,
    end: SheathEnd,
    routing: PreparedRouting,
    elements: Elements,
    tendon: int,
    tensions: Array,
) -> float:
    """Let the end of a sheath travel with the arm's joints; return T_out [N].

    `elements` are of `begin_advance`, `tensions` [N] those of all rows before this step. What
    slides in the sheath grows with the change, e = g (l u + w u^2 / (2 (1 + rho))), until it meets
    what slid before; hence steps short of it, and one up to where it meets what slid the same way
    before the last reversal. What is not finite moves nothing.
    """
    tables, profile = prepared.tables[:], end.profile[:]
    K, rho, EA = tables[_K], tables[_ASYMMETRY], tables[_EA]
    T = read_profile(tables, profile)[1]
    slip, slope = compute_excess_slip(routing, tendon, tensions, elements, T)
    left = wanted = end.stretch - slip
    if not math.isfinite(wanted):
        end.stretch = 0.0
        return T
    if wanted * slip >= 0.0:  # it went too far before
        end.stretch = wanted
        return T
    u_in, near = to_log_tension(tables, end.held_tension), K * _NEAR_TIP
    growth = 0.5 * compute_length_density(tables, near) / (1.0 + rho)
    limit = u_in + rho * K if wanted > 0.0 else u_in - K
    for _ in range(_STEPS):
        last = count_points(profile) - 1
        u = get_point(profile, last)[1]
        s, _, rise = get_point(profile, last - 1)
        slides = rise > 0.0 if wanted > 0.0 else rise < 0.0
        length = tables[_LENGTH] - compute_arc_length(tables, s if slides else near) + EA * slope
        share = _STEP_SHARE * abs(left) * EA * math.exp(-u)
        divisor = length + math.sqrt(length * length + 4.0 * growth * share)
        change = 2.0 * share / divisor if divisor > 0.0 else math.inf
        if change >= abs(limit - u):
            drive_end(tables, profile, limit, TIP)
            left = 0.0
            break
        reversal = last - 2 if slides else last - 1
        if reversal > 0:
            s, corner, _ = get_point(profile, reversal)
            met = corner + get_point(profile, reversal - 1)[2] * (K - s)
            if (met - u) * wanted > 0.0:
                change = min(change, abs(met - u) + _MEETING_MARGIN)
        before, slip_before = integrate_tension(tables, profile), slip
        while True:  # guides that begin to slide let it stretch further
            y = u + math.copysign(change, wanted)
            T = from_log_tension(tables, y)
            slip, slope = compute_excess_slip(routing, tendon, tensions, elements, T)
            if not abs(slip - slip_before) > abs(left):  # ends with NaN, too
                break
            change *= _STEP_SHARE
        drive_end(tables, profile, y, TIP)
        left -= (integrate_tension(tables, profile) - before) / EA + slip - slip_before
        if left * wanted <= _STRETCH_TOLERANCE * wanted * wanted:
            break
    end.stretch = left
    return read_profile(tables, profile)[1]
