"""The balance of contacts that stick or slide: all of a tendon in one step, implicit in time."""

from typing import NamedTuple

from estimator.array_types import Array
from estimator.compiled import jit_borrow, jit_inline
from estimator.lumped.nodes import Tendon, Tip, compute_elongation, compute_tip_travel
from estimator.small_arrays import copy_values

WORK_ROWS = 9
"""Rows of a node each that `solve_stick_slip` works with; `KNOWN` has zeros to begin with."""

_UPPER, _CONSTANT, _PIVOT, _FACTOR, _SOLVED, KNOWN, _SLOPE, _STIFFNESS, _REST = range(WORK_ROWS)
_IS_KNOWN, _SCALE, _DASHPOT, _IS_FREE = range(4)  # of row `KNOWN`


class _Springs(NamedTuple):
    """Nodes as springs, linear about a tension: length - extra = slope (T - T_rest); (n,) each.

    The last one has what the tip pulls at in series.
    """

    slope: Array  # [m/N]
    stiffness: Array  # [N/m], its inverse
    T_rest: Array  # [N] at which it is as long as one sample ago


class _Drive(NamedTuple):
    """What the housing's end does in the step."""

    displacement: float  # [m] of travel, if it is not free
    free: bool  # whether it goes where its tension takes it
    tension: float  # [N], if it is free


@jit_borrow
def solve_stick_slip(
    tendon: Tendon,
    tip: Tip,
    T_old: Array,
    lengths: Array,
    target: float,
    forced: bool,
    T_new: Array,
    direction: Array,
    slip: Array,
    work: Array,
    steady: bool,
) -> tuple[bool, float]:
    """Find the balance of contacts that stick or slide, by how far each of them slides.

    Each contact is guessed to stick or to slide one way (`direction`, kept from the sample before),
    the balance of all is solved, and guesses that Coulomb contradicts are put right until none is
    left. The housing's end is at `target`, a tension [N] if `forced`, else a travel [m]. What is
    eliminated of the balance stays in `work` for the next step if that has the same friction
    (`steady`): as far as its contacts do the same.

    Returns whether that came to an end, and dq_p/dT_in [m/N]; fills `slip` [m].
    """
    last = len(T_old) - 1
    springs, known = _Springs(work[_SLOPE], work[_STIFFNESS], work[_REST]), work[KNOWN]
    has_bent_springs = tendon.law.toe != 0.0 or tendon.law.compression != 0.0
    is_nonlinear = has_bent_springs or tip.low != tip.high or tip.contact_stiffness > 0.0
    if not steady or has_bent_springs or known[_SCALE] != tendon.scale:
        known[_IS_KNOWN] = 0.0
    q_old = tip.q_old
    for j in range(last + 1):
        q_old += lengths[j]
    copy_values(T_old, T_new)
    _fill_linear_springs(tendon, lengths, known[_IS_KNOWN] > 0.0, springs)
    known[_SCALE] = tendon.scale
    drive = _Drive(target - q_old, forced, target if forced else 0.0)
    converged = False
    free_slope, free_rest = (springs.slope[last], springs.T_rest[last])  # without what it pulls at
    for _ in range(6 * last):
        if has_bent_springs:
            _linearise_springs(tendon, lengths, T_new, springs)
            known[_IS_KNOWN] = 0.0
            free_slope, free_rest = springs.slope[last], springs.T_rest[last]
        _add_tip(tip, T_new[last], free_slope, free_rest, springs)
        _solve_slips(tendon, springs, drive, direction, work, slip)
        change = _update_tensions(springs, drive, slip, T_new)
        converged = not (is_nonlinear and change > 1e-9)
        if _correct_guesses(tendon, T_new, slip, direction):
            converged = False
        if converged and not drive.free and T_new[0] < 0.0:  # slack: its end goes where it likes
            drive, converged = _Drive(drive.displacement, True, 0.0), False
        if converged:
            break
    for j in range(last + 1):
        T_new[j] = max(T_new[j], 0.0)
    return converged, _compute_compliance(tendon, springs.slope, direction)


@jit_inline
def _fill_linear_springs(
    tendon: Tendon, lengths: Array, are_known: bool, springs: _Springs
) -> None:
    """Fill in the springs of a tendon whose elasticity is linear; of known ones, where they rest.

    The last one is never known: what the tip pulls at was added to it.
    """
    last = len(lengths) - 1
    for j in range(last if are_known else 0, last + 1):
        springs.slope[j] = tendon.scale * tendon.weights[j] + tendon.tip_compliance[j]
        springs.stiffness[j] = 1.0 / springs.slope[j]
    for j in range(last + 1):
        springs.T_rest[j] = (lengths[j] - tendon.extra[j]) * springs.stiffness[j]


@jit_inline
def _linearise_springs(tendon: Tendon, lengths: Array, tension: Array, springs: _Springs) -> None:
    """Fill in the springs about a tension."""
    for j in range(len(lengths)):
        elongation, springs.slope[j] = compute_elongation(tendon, j, tension[j])
        springs.stiffness[j] = 1.0 / springs.slope[j]
        springs.T_rest[j] = (
            tension[j] - (elongation + tendon.extra[j] - lengths[j]) * springs.stiffness[j]
        )


@jit_inline
def _add_tip(
    tip: Tip, tension: float, free_slope: float, free_rest: float, springs: _Springs
) -> None:
    """Put what the tip pulls at in series with the last node."""
    last = len(springs.slope) - 1
    q, dq, _load = compute_tip_travel(tip, tension)
    offset = q - dq * tension - tip.q_old
    springs.slope[last] = free_slope + dq
    springs.stiffness[last] = 1.0 / springs.slope[last]
    springs.T_rest[last] = (free_slope * free_rest - offset) * springs.stiffness[last]


@jit_inline
def _solve_slips(
    tendon: Tendon, springs: _Springs, drive: _Drive, direction: Array, work: Array, slip: Array
) -> None:
    """Solve for how far the contacts slide that are guessed to.

    A T_before - B T_after - g slid = c of each, tridiagonal in what slid: elimination from the
    housing to the tip, then substitution back. Rows as far as those known are kept.
    """
    last = len(slip)
    upper, constant, pivot, factor = work[_UPPER], work[_CONSTANT], work[_PIVOT], work[_FACTOR]
    solved, known = work[_SOLVED], work[KNOWN]
    stiffness, zero = springs.stiffness, springs.T_rest
    law, half_k, drag = tendon.law, tendon.half_k, tendon.drag
    rho, dashpot = law.asymmetry, 2.0 * law.viscosity / tendon.dt if tendon.dt > 0.0 else 0.0
    is_free = 1.0 if drive.free else 0.0
    kept = 0
    if known[_IS_KNOWN] > 0.0 and known[_DASHPOT] == dashpot and known[_IS_FREE] == is_free:
        # the last contact's row has what the tip pulls at
        while kept < last - 1 and solved[kept] == direction[kept]:
            kept += 1
    known[_IS_KNOWN], known[_DASHPOT], known[_IS_FREE] = 1.0, dashpot, is_free
    for j in range(last):
        if direction[j] == 0.0:
            if j >= kept:
                upper[j], constant[j], pivot[j], factor[j], solved[j] = 0.0, 0.0, 1.0, 0.0, 0.0
            continue
        solved[j] = direction[j]
        x = half_k[j]
        A, B, c, g = 1.0 - x, 1.0 + x, drag[j], x * dashpot
        if direction[j] < 0.0:
            A, B, c, g = 1.0 + rho * x, 1.0 - rho * x, -rho * c, rho * g
        constant[j] = c - A * zero[j] + B * zero[j + 1]
        lower = A * stiffness[j]
        if j >= kept:
            upper[j] = B * stiffness[j + 1]
            diagonal = -lower - upper[j] - g
            if j > 0:
                factor[j] = lower * pivot[j - 1]
                diagonal -= factor[j] * upper[j - 1]
            elif drive.free:
                diagonal += lower
            pivot[j] = 1.0 / diagonal
        if j > 0:
            constant[j] -= factor[j] * constant[j - 1]
        elif drive.free:
            constant[0] += A * (zero[0] - drive.tension)
        else:
            constant[0] -= lower * drive.displacement
    next_slip = 0.0
    for j in range(last - 1, -1, -1):
        slides = direction[j] != 0.0
        next_slip = (constant[j] - upper[j] * next_slip) * pivot[j] if slides else 0.0
        slip[j] = next_slip


@jit_inline
def _update_tensions(springs: _Springs, drive: _Drive, slip: Array, tension: Array) -> float:
    """Fill in the tensions that follow from what slid; return the largest change [N]."""
    last = len(slip)
    change, slip_in = 0.0, drive.displacement
    for j in range(last + 1):
        slip_out = 0.0 if j == last else slip[j]
        T = drive.tension
        if j > 0 or not drive.free:
            T = springs.T_rest[j] + (slip_in - slip_out) * springs.stiffness[j]
        change = max(change, abs(T - tension[j]))
        tension[j], slip_in = T, slip_out
    return change


@jit_inline
def _correct_guesses(tendon: Tendon, tension: Array, slip: Array, direction: Array) -> bool:
    """Put right the guesses that Coulomb contradicts; return whether there were any."""
    rho, corrected = tendon.law.asymmetry, False
    for j in range(len(slip)):
        if direction[j] == 0.0:
            total = max(tension[j] + tension[j + 1], 0.0)
            drop = tension[j] - tension[j + 1]
            room = 1e-10 * (1.0 + total)
            friction = tendon.half_k[j] * total + tendon.drag[j]
            if drop > friction + room:
                direction[j], corrected = 1.0, True
            elif drop < -rho * friction - room:
                direction[j], corrected = -1.0, True
        elif direction[j] * slip[j] < -1e-16:
            direction[j], corrected = 0.0, True
    return corrected


@jit_inline
def _compute_compliance(tendon: Tendon, slope: Array, direction: Array) -> float:
    """Return dq_p/dT_in [m/N]: of the nodes from the housing to the first contact that sticks."""
    compliance, D, rho = 0.0, 1.0, tendon.law.asymmetry
    for j in range(len(slope)):
        compliance += D * slope[j]
        if j == len(direction) or direction[j] == 0.0:
            break
        x = tendon.half_k[j] if direction[j] > 0.0 else -rho * tendon.half_k[j]
        D *= (1.0 - x) / (1.0 + x)
    return compliance
