"""The balance of contacts that stick or slide: all of a tendon in one step, implicit in time."""

from typing import NamedTuple

from estimator.array_types import Array
from estimator.compiled import jit_compile, jit_inline
from estimator.lumped.nodes import Tendon, Tip, compute_elongation, compute_tip_travel

WORK_ROWS = 6
"""Rows of a node each that `solve_stick_slip` works with."""


class _Springs(NamedTuple):
    """Nodes as springs, linear about a tension: length - kept = slope (T - zero), shape (n,) each.

    The last one has what the tip pulls at in series.
    """

    slope: Array  # [m/N]
    stiff: Array  # [N/m], its inverse
    zero: Array  # [N] at which it is as long as one sample ago


class _Drive(NamedTuple):
    """What the housing's end does in the step."""

    moved: float  # [m] of travel, if it is not free
    free: bool  # whether it goes where its tension takes it
    tension: float  # [N], if it is free


@jit_compile
def solve_stick_slip(
    tendon: Tendon,
    tip: Tip,
    before: Array,
    lengths: Array,
    target: float,
    forced: bool,
    after: Array,
    sliding: Array,
    slid: Array,
    work: Array,
) -> tuple[bool, float]:
    """Find the balance of contacts that stick or slide, by how far each of them slides.

    Each contact is guessed to stick or to slide one way (`sliding`, kept from the sample before),
    the balance of all is solved, and guesses that Coulomb contradicts are put right until none is
    left. The housing's end is at `target`, a tension [N] if `forced`, else a travel [m].

    Returns whether that came to an end, and dq_p/dT_in [m/N]; fills `slid` [m].
    """
    last = len(before) - 1
    springs = _Springs(work[3], work[4], work[5])
    curved = tendon.law.toe != 0.0 or tendon.law.compression != 0.0
    held = tip.before
    for j in range(last + 1):
        held += lengths[j]
    after[:] = before
    _fill_linear_springs(tendon, lengths, springs)
    drive = _Drive(target - held, forced, target if forced else 0.0)
    ended = False
    free_slope, free_zero = springs.slope[last], springs.zero[last]  # without what it pulls at
    for _ in range(6 * last):
        if curved:
            _linearise_springs(tendon, lengths, after, springs)
            free_slope, free_zero = springs.slope[last], springs.zero[last]
        _add_tip(tip, after[last], free_slope, free_zero, springs)
        _solve_slips(tendon, springs, drive, sliding, work, slid)
        change = _update_tensions(springs, drive, slid, after)
        ended = not ((curved or tip.low != tip.high) and change > 1e-9)
        if _correct_guesses(tendon, after, slid, sliding):
            ended = False
        if ended and not drive.free and after[0] < 0.0:  # slack: its end goes where it likes
            drive, ended = _Drive(drive.moved, True, 0.0), False
        if ended:
            break
    for j in range(last + 1):
        after[j] = max(after[j], 0.0)
    return ended, _compute_compliance(tendon, springs.slope, sliding)


@jit_inline
def _fill_linear_springs(tendon: Tendon, lengths: Array, springs: _Springs) -> None:
    """Fill in the springs of a tendon whose elasticity is linear."""
    for j in range(len(lengths)):
        springs.slope[j] = tendon.scale * tendon.weights[j] + tendon.tied[j]
        springs.stiff[j] = 1.0 / springs.slope[j]
        springs.zero[j] = (lengths[j] - tendon.kept[j]) * springs.stiff[j]


@jit_inline
def _linearise_springs(tendon: Tendon, lengths: Array, tension: Array, springs: _Springs) -> None:
    """Fill in the springs about a tension."""
    for j in range(len(lengths)):
        longer, springs.slope[j] = compute_elongation(tendon, j, tension[j])
        springs.stiff[j] = 1.0 / springs.slope[j]
        springs.zero[j] = tension[j] - (longer + tendon.kept[j] - lengths[j]) * springs.stiff[j]


@jit_inline
def _add_tip(
    tip: Tip, tension: float, free_slope: float, free_zero: float, springs: _Springs
) -> None:
    """Put what the tip pulls at in series with the last node."""
    last = len(springs.slope) - 1
    q, dq, _load = compute_tip_travel(tip, tension)
    known = q - dq * tension - tip.before
    springs.slope[last] = free_slope + dq
    springs.stiff[last] = 1.0 / springs.slope[last]
    springs.zero[last] = (free_slope * free_zero - known) * springs.stiff[last]


@jit_inline
def _solve_slips(
    tendon: Tendon, springs: _Springs, drive: _Drive, sliding: Array, work: Array, slid: Array
) -> None:
    """Solve for how far the contacts slide that are guessed to.

    A T_before - B T_after - g slid = c of each, tridiagonal in what slid: elimination from the
    housing to the tip, then substitution back.
    """
    last = len(slid)
    upper, right, pivot = work[0], work[1], work[2]
    stiff, zero = springs.stiff, springs.zero
    law, half, drag = tendon.law, tendon.half, tendon.drag
    rho, dashpot = law.asymmetry, 2.0 * law.viscosity / tendon.dt if tendon.dt > 0.0 else 0.0
    for j in range(last):
        if sliding[j] == 0.0:
            upper[j], right[j], pivot[j] = 0.0, 0.0, 1.0
            continue
        x = half[j]
        A, B, c, g = 1.0 - x, 1.0 + x, drag[j], x * dashpot
        if sliding[j] < 0.0:
            A, B, c, g = 1.0 + rho * x, 1.0 - rho * x, -rho * c, rho * g
        lower, upper[j] = A * stiff[j], B * stiff[j + 1]
        diagonal = -lower - upper[j] - g
        right[j] = c - A * zero[j] + B * zero[j + 1]
        if j > 0:
            factor = lower * pivot[j - 1]
            diagonal -= factor * upper[j - 1]
            right[j] -= factor * right[j - 1]
        elif drive.free:
            diagonal += lower
            right[0] += A * (zero[0] - drive.tension)
        else:
            right[0] -= lower * drive.moved
        pivot[j] = 1.0 / diagonal
    ahead = 0.0
    for j in range(last - 1, -1, -1):
        ahead = (right[j] - upper[j] * ahead) * pivot[j]
        slid[j] = ahead


@jit_inline
def _update_tensions(springs: _Springs, drive: _Drive, slid: Array, after: Array) -> float:
    """Fill in the tensions that follow from what slid; return the largest change [N]."""
    last = len(slid)
    change, into = 0.0, drive.moved
    for j in range(last + 1):
        out = 0.0 if j == last else slid[j]
        T = drive.tension
        if j > 0 or not drive.free:
            T = springs.zero[j] + (into - out) * springs.stiff[j]
        change = max(change, abs(T - after[j]))
        after[j], into = T, out
    return change


@jit_inline
def _correct_guesses(tendon: Tendon, tension: Array, slid: Array, sliding: Array) -> bool:
    """Put right the guesses that Coulomb contradicts; return whether there were any."""
    rho, found = tendon.law.asymmetry, False
    for j in range(len(slid)):
        total = max(tension[j] + tension[j + 1], 0.0)
        drop = tension[j] - tension[j + 1]
        if sliding[j] == 0.0:
            room = 1e-10 * (1.0 + total)
            friction = tendon.half[j] * total + tendon.drag[j]
            if drop > friction + room:
                sliding[j], found = 1.0, True
            elif drop < -rho * friction - room:
                sliding[j], found = -1.0, True
        elif sliding[j] * slid[j] < -1e-16:
            sliding[j], found = 0.0, True
    return found


@jit_inline
def _compute_compliance(tendon: Tendon, slope: Array, sliding: Array) -> float:
    """Return dq_p/dT_in [m/N]: of the nodes from the housing to the first contact that sticks."""
    reach, D, rho = 0.0, 1.0, tendon.law.asymmetry
    for j in range(len(slope)):
        reach += D * slope[j]
        if j < len(sliding) and sliding[j] != 0.0:
            x = tendon.half[j] if sliding[j] > 0.0 else -rho * tendon.half[j]
            D *= (1.0 - x) / (1.0 + x)
        else:
            D = 0.0
    return reach
