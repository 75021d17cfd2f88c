"""The balance of a closed loop of two cables: all contacts in one step, implicit in time.

A loop is one line from the drive pulley through the first sheath to the driven pulley, and back
through the second sheath: springs in a row, a contact with the sheath between each two, the driven
pulley in the middle. Both ends of the line go with the drive pulley. Displacements along the line
are positive towards the end where the first cable begins.

Contacts are rigid until they slide, or follow Dahl (1968): df/dx = stiffness (1 -/+ f/limit), so
that friction comes near its limit over limit/stiffness.
"""

import math
from typing import NamedTuple

from estimator.array_types import Array
from estimator.compiled import jit_compile

_TRAVEL_TOLERANCE = 1e-9  # [m] by which an iteration moves contacts in the end
_FULL_STEPS = 20  # iterations in full steps
_ITERATIONS = 60  # of contacts that follow Dahl
_LIMIT_MIN = 1e-9  # [N] limit of a contact, below which it has no friction

SLACK_STIFFNESS_RATIO = 1e-7
"""Stiffness of a slack spring over that of a taut one, for a unique balance."""

WORK_ROWS = 6
"""Rows of a contact each that `solve_balance` works with."""


class Line(NamedTuple):
    """The loop in one step; arrays of the springs (n + 1,) or the contacts (n,)."""

    pretension: float  # [N] of all springs at zero displacement
    stiffness: Array  # [N/m] of each spring
    friction: Array  # limit of each contact over the mean tension beside it
    drag: Array  # [N] limit of each contact that no tension changes
    bristle: Array  # [N/m] of each contact at no friction; not used if `is_rigid`
    dashpot: Array  # [N/m] of each contact: viscous friction over the time of the step
    is_rigid: bool  # contacts do not give before they slide
    tip: int  # the contact that is the driven pulley
    is_blocked: bool  # whether the driven pulley stays at `load_position`
    load_position: float  # [m]
    load_stiffness: float  # [N/m] of what the driven pulley moves, inertia of the step included
    load_force: float  # [N] that is taken from its force


@jit_compile
def solve_balance(
    line: Line,
    drive: float,
    old: Array,
    force: Array,
    sliding: Array,
    places: Array,
    tension: Array,
    work: Array,
) -> bool:
    """Find the balance of a loop whose drive pulley is at `drive` [m].

    Rigid contacts are guessed to stick or to slide one way (`sliding`, from the step before),
    the balance of all is solved, and guesses that Coulomb contradicts are corrected until none is
    left. Those that follow Dahl are solved by Newton's method. `old` [m] and `force` [N], (n,),
    are places and friction of the contacts one step ago. Fills `places` [m] and `tension` [N];
    returns whether a balance was found.
    """
    n = len(places)
    _update_tensions(line, drive, places, tension)
    for i in range(6 * n if line.is_rigid else _ITERATIONS):
        share = 1.0 if line.is_rigid or i < _FULL_STEPS else 0.5
        move = _solve_step(line, drive, old, force, sliding, places, tension, work, share)
        if _update_tensions(line, drive, places, tension):
            continue  # springs went slack or taut: their tensions tell nothing of contacts yet
        if not line.is_rigid:
            if move < _TRAVEL_TOLERANCE:
                return True
        elif not _correct_guesses(line, old, sliding, places, tension):
            return True
    return False


@jit_compile
def compute_friction_limit(line: Line, tension: Array, j: int) -> float:
    """Return the limit of a contact [N]."""
    normal_tension: float = max(tension[j] + tension[j + 1], 0.0)
    return float(line.friction[j] * 0.5 * normal_tension + line.drag[j])


@jit_compile
def compute_dahl_friction(
    line: Line, tension: Array, j: int, slip: float, direction: float, force: float
) -> tuple[float, float, float]:
    """Return the friction of a contact that slid [N], its slope [N/m], and that by its limit.

    `direction` is where it slides if it has not yet, `force` its friction before. A slack cable has
    none: friction of a billionth of a newton has no balance that Newton's method would find.
    """
    limit = compute_friction_limit(line, tension, j)
    if limit < _LIMIT_MIN:
        return 0.0, 0.0, 0.0
    initial_force = min(max(force, -limit), limit)
    d = direction
    if slip != 0.0:
        d = 1.0 if slip > 0.0 else -1.0
    x = abs(slip) * line.bristle[j] / limit
    decay = math.exp(-x)
    remainder = (initial_force - d * limit) * decay
    slope = line.bristle[j] * (1.0 - d * initial_force / limit) * decay
    return d * limit + remainder, slope, d * (1.0 - decay) + remainder * x / limit


@jit_compile
def _update_tensions(line: Line, drive: float, places: Array, tension: Array) -> bool:
    """Fill in the tensions of all springs; return whether any went slack or taut."""
    n, changed = len(places), False
    for j in range(n + 1):
        place_before = drive if j == 0 else places[j - 1]
        place_after = drive if j == n else places[j]
        T = line.pretension + line.stiffness[j] * (place_before - place_after)
        changed |= (T < 0.0) != (tension[j] < 0.0)
        tension[j] = T if T >= 0.0 else SLACK_STIFFNESS_RATIO * T
    return changed


@jit_compile
def _solve_step(
    line: Line,
    drive: float,
    old: Array,
    force: Array,
    sliding: Array,
    places: Array,
    tension: Array,
    work: Array,
    share: float,
) -> float:
    """Take all contacts a share of the way to their balance as guessed, or of a Newton step.

    Elimination and substitution; returns the largest move [m].
    """
    n = len(places)
    upper, constant = work[0], work[1]
    for j in range(n):
        is_taut, is_next_taut = tension[j] >= 0.0, tension[j + 1] >= 0.0
        k = line.stiffness[j] * (1.0 if is_taut else SLACK_STIFFNESS_RATIO)
        k_next = line.stiffness[j + 1] * (1.0 if is_next_taut else SLACK_STIFFNESS_RATIO)
        T = line.pretension * (1.0 if is_taut else SLACK_STIFFNESS_RATIO)
        T_next = line.pretension * (1.0 if is_next_taut else SLACK_STIFFNESS_RATIO)
        d, A, B, contact_stiffness, known_force = sliding[j], 1.0, 1.0, 0.0, 0.0
        is_fixed = False
        if j == line.tip:
            contact_stiffness, known_force = line.load_stiffness, line.load_force
            is_fixed = line.is_blocked
        elif not line.is_rigid:
            slip = places[j] - old[j]
            friction, slope, by_limit = compute_dahl_friction(line, tension, j, slip, d, force[j])
            if slip != 0.0:
                sliding[j] = 1.0 if slip > 0.0 else -1.0
            A -= 0.5 * by_limit * line.friction[j]
            B += 0.5 * by_limit * line.friction[j]
            contact_stiffness = slope + line.dashpot[j]
            known_force = (1.0 - A) * tension[j] - (1.0 - B) * tension[j + 1] - friction
            known_force += slope * places[j] + line.dashpot[j] * old[j]
        elif d != 0.0:
            A -= 0.5 * d * line.friction[j]
            B += 0.5 * d * line.friction[j]
            contact_stiffness = line.dashpot[j]
            known_force = contact_stiffness * old[j] - d * line.drag[j]
        else:
            is_fixed = True
        if is_fixed:
            upper[j], constant[j] = 0.0, line.load_position if j == line.tip else old[j]
            continue
        lower, diagonal, upper[j] = A * k, -A * k - B * k_next - contact_stiffness, B * k_next
        constant[j] = B * T_next - A * T - known_force
        if j == 0:
            constant[j] -= lower * drive
        else:
            diagonal -= lower * upper[j - 1]
            constant[j] -= lower * constant[j - 1]
        if j == n - 1:
            constant[j] -= upper[j] * drive
            upper[j] = 0.0
        upper[j] /= diagonal
        constant[j] /= diagonal
    next_place = move = 0.0
    for j in range(n - 1, -1, -1):
        next_place = constant[j] - upper[j] * next_place
        move = max(move, abs(next_place - places[j]))
        places[j] += share * (next_place - places[j])
    return move


@jit_compile
def _correct_guesses(line: Line, old: Array, sliding: Array, places: Array, tension: Array) -> bool:
    """Correct the guesses that Coulomb contradicts; return whether there were any."""
    corrected = False
    for j in range(len(places)):
        if j == line.tip:
            continue
        tension_drop = tension[j] - tension[j + 1]
        displacement = places[j] - old[j]
        friction = tension_drop - line.dashpot[j] * displacement
        limit = compute_friction_limit(line, tension, j)
        d = sliding[j]
        if d == 0.0:
            room = 1e-10 * (1.0 + limit)
            if friction > limit + room:
                sliding[j], corrected = 1.0, True
            elif friction < -limit - room:
                sliding[j], corrected = -1.0, True
        elif displacement * d < -1e-15:
            sliding[j], corrected = 0.0, True
    return corrected
