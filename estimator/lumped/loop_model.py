"""A closed loop of two cables in two sheaths between a drive pulley and a driven one.

Both cables are pretensioned, so that the loop transmits effort of either sign: effort = tension of
the first cable - tension of the second (times the pulley's radius, which the units hold; see
estimator.units). Without friction each carries pretension +- effort/2. Both rub in their sheaths,

    |dT/ds| <= T + drag,  s from 0 to K in each,

and a cable goes slack where its tension would fall below zero, which halves the loop's stiffness.
Contacts are rigid, or follow Dahl (1968) with a stiffness that no tension changes.
"""

import math

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.lumped.loop_solver import WORK_ROWS, Line, compute_dahl_friction, solve_balance
from estimator.lumped.lumped_model import Motion, Physics
from estimator.lumped.nodes import NODES, PLACES

_SPRINGS = 2 * NODES
_TIP = NODES - 1
_APPROACH = 12  # steps from rest to the first sample, and from each turn before it to the next
_SUBSTEP_MIN = 1.0 / 64.0  # of a step
_STEP_RATIO_MAX = 3.0  # of a step to that before it, from which contacts are extrapolated
_COMPLIANCE_MIN = 1e-9  # [m/N] of the load; below it the driven pulley is blocked
_STEP = np.diff(PLACES)
FRICTION_SHARES = np.concatenate([_STEP, [0.0], _STEP[::-1]])
"""Share of its cable's friction at each contact along the loop; none at the driven pulley."""

_PRETENSION, _DRAG, _BRISTLE, _VISCOSITY, _STRIBECK, _STRIBECK_SPEED, _MASS, _DAMPING = range(8)
_DT, _FRICTION, _OFFSET, _COMPLIANCE, _DRIVE, _SPEED = range(6)


def simulate_loop(
    physics: Physics, pretension: float, time: Array, travel: Array, speed: Array
) -> Motion:
    """Return what happens when the drive pulley goes through a `travel`.

    Parameters
    ----------
    physics : Physics
        Of each cable: `friction` (n,), `drag`, `compliance` and `weights`, `viscosity`, `stribeck`,
        `presliding`; of the load at the driven pulley `tip_compliance`, `tip_offset`, `mass` and
        `damping`; `earlier`. All else is left out.
    pretension : float
        [N] of both cables where the loop carries no effort.
    time : ndarray
        [s], shape (n,), rising.
    travel : ndarray
        Of the drive pulley [m], shape (n,), zero where the loop carries no effort.
    speed : ndarray
        Of it [m/s], shape (n,); its sign does not matter.

    Returns
    -------
    Motion
        Tensions are the efforts at both pulleys, of either sign.
    """
    samples = np.empty((len(time), 6))
    samples[:, _DT] = np.diff(time, prepend=time[0])
    samples[:, _FRICTION], samples[:, _OFFSET] = physics.friction, physics.tip_offset
    samples[:, _COMPLIANCE], samples[:, _DRIVE] = physics.tip_compliance, travel
    samples[:, _SPEED] = np.abs(speed)
    turns = np.concatenate([[0.0], travel[0] + physics.earlier_turns, [travel[0]]])
    approach = np.repeat(samples[:1], _APPROACH * (len(turns) - 1), axis=0)
    approach[:, _DRIVE] = np.interp(
        np.arange(1, len(approach) + 1) / _APPROACH, range(len(turns)), turns
    )
    weights = physics.weights * physics.compliance
    stiffness = 1.0 / np.concatenate([weights, weights[::-1]])
    reference = physics.presliding_tension or max(pretension + physics.drag, 1e-9)
    bristle = reference / physics.presliding if physics.presliding > 0.0 else 0.0
    scalars = np.array(
        [
            pretension,
            physics.drag,
            bristle,
            physics.viscosity,
            physics.stribeck,
            physics.stribeck_speed,
            physics.mass,
            physics.damping,
        ]
    )
    out = _advance_loop(scalars, stiffness, np.concatenate([approach, samples]))[len(approach) :]
    effort, tip = out[:, 0], out[:, 1]
    place = out[:, 2]
    return Motion(effort, tip, travel, place, _estimate_compliance(travel, effort))


def _estimate_compliance(travel: Array, effort: Array) -> Array:
    """Return dq_p/dT_in [m/N] from one sample to the next, (n,)."""
    rise = np.gradient(travel) * np.sign(np.gradient(effort))
    usual = float(np.ptp(travel)) / max(float(np.ptp(effort)), 1e-12)
    return np.clip(rise / np.maximum(np.abs(np.gradient(effort)), 1e-12), 0.0, 10.0 * usual)


@jit_compile
def _advance_loop(scalars: Array, stiffness: Array, samples: Array) -> Array:
    """Take a loop from rest through samples; return efforts at both pulleys and the tip, (n, 3)."""
    n = _SPRINGS - 1
    out = np.empty((len(samples), 3))
    place, trial = np.zeros(n), np.zeros(n)
    force, sliding, sliding_old = np.zeros(n), np.zeros(n), np.zeros(n)
    tension, work = np.full(n + 1, scalars[_PRETENSION]), np.empty((WORK_ROWS, n))
    friction, drag = np.empty(n), np.empty(n)
    bristle, dashpot = np.empty(n), np.empty(n)
    q = v = a = drive = last_step = 0.0
    last_move = np.zeros(n)
    for i in range(len(samples)):
        row = samples[i]
        progress, share = 0.0, 1.0
        while progress < 1.0:
            share = min(share, 1.0 - progress)
            dt = row[_DT] * share
            goal = drive + (row[_DRIVE] - drive) * (share / (1.0 - progress))
            line = _build_line(
                scalars, stiffness, row, dt, q, v, a, friction, drag, bristle, dashpot
            )
            step = goal - drive
            trial[:] = place
            if not line.is_rigid and abs(step) < _STEP_RATIO_MAX * abs(last_step):
                trial += step / last_step * last_move  # Newton's method begins close to its end
            sliding_old[:] = sliding
            solved = solve_balance(line, goal, place, force, sliding, trial, tension, work)
            if not solved:
                sliding[:] = 0.0
                trial[:] = place
                solved = solve_balance(line, goal, place, force, sliding, trial, tension, work)
            if not solved and share > _SUBSTEP_MIN:
                sliding[:] = sliding_old
                share *= 0.5
                continue
            progress += share
            if not line.is_rigid:
                _store_friction(line, tension, place, trial, sliding, force)
            last_move, last_step = trial - place, step
            place[:] = trial
            drive = goal
            q_new = place[_TIP]
            if dt > 0.0:
                v_new = 2.0 * (q_new - q) / dt - v
                a = 2.0 * (v_new - v) / dt - a
                v = v_new
            q = q_new
            share *= 2.0
        out[i, 0] = max(tension[0], 0.0) - max(tension[n], 0.0)
        out[i, 1] = max(tension[_TIP], 0.0) - max(tension[_TIP + 1], 0.0)
        out[i, 2] = q
    return out


@jit_compile
def _store_friction(
    line: Line, tension: Array, places_old: Array, places: Array, sliding: Array, force: Array
) -> None:
    """Keep what friction has become in each contact, in place."""
    for j in range(len(force)):
        if j != line.tip:
            slip = places[j] - places_old[j]
            force[j] = compute_dahl_friction(line, tension, j, slip, sliding[j], force[j])[0]


@jit_compile
def _build_line(
    scalars: Array,
    stiffness: Array,
    row: Array,
    dt: float,
    q: float,
    v: float,
    a: float,
    friction: Array,
    drag: Array,
    bristle: Array,
    dashpot: Array,
) -> Line:
    """Return the loop in one step; the last four arrays are filled in."""
    share = 1.0
    if scalars[_STRIBECK] != 0.0:
        x = row[_SPEED] / scalars[_STRIBECK_SPEED]
        share += scalars[_STRIBECK] * math.exp(-x * x)
    for j in range(len(FRICTION_SHARES)):
        ds = row[_FRICTION] * FRICTION_SHARES[j]
        friction[j] = min(ds * share, 0.9)
        drag[j] = ds * share * scalars[_DRAG]
        bristle[j] = max(ds * scalars[_BRISTLE], 1e-9)
        dashpot[j] = ds * scalars[_VISCOSITY] / dt if dt > 0.0 else 0.0
    compliance, is_blocked = row[_COMPLIANCE], row[_COMPLIANCE] < _COMPLIANCE_MIN
    load_stiffness = load_force = 0.0
    if not is_blocked:
        load_stiffness = 1.0 / compliance
        load_force = load_stiffness * row[_OFFSET]
        mass, damping = scalars[_MASS], scalars[_DAMPING]
        if dt > 0.0 and (mass > 0.0 or damping > 0.0):
            inertia = 4.0 * mass / dt**2 + 2.0 * damping / dt
            load_stiffness += inertia
            load_force += inertia * q + (4.0 * mass / dt + damping) * v + mass * a
    return Line(
        scalars[_PRETENSION], stiffness, friction, drag, bristle, dashpot,
        scalars[_BRISTLE] == 0.0, _TIP, is_blocked, row[_OFFSET], load_stiffness, load_force,
    )  # fmt: skip
