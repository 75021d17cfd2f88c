"""Tension behind each passed joint, from the tension at the sheath's end and the joint angles.

The tendon behind its sheath is stretches of compliance c_e between friction elements e, of K_e =
mu |phi_e(theta)|. Two things hold at once (theory, section on passed joints):

    |ln T_e - ln T_(e-1)| <= K_e, at a limit where material slips, not within
    slip at e towards the motor = sum over the stretches behind of (c dT + shortening)

As what slips at e rises with T_e, there is one tension T*_e at which e sticks; it follows from
those behind it. Then T_e is T*_e, as near as T_(e-1) and friction let it be. This map rises with
all tensions before the step and at the sheath's end, hence two more copies of it, driven by the
worst of all errors, enclose it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.routing.routing import PreparedRouting, RoutingError

_ROOT_ITERATIONS = 60
_ROOT_TOLERANCE = 1e-12  # relative to the tension, or to 1 N


class RoutingState(NamedTuple):
    """What the past leaves: tensions of all rows, and the angles taken for the present ones."""

    tensions: Array  # [N] shape (3, rows): likeliest, least, largest
    angles: Array  # [rad] shape (joints,)


class JointTensions(NamedTuple):
    """Tensions along all tendons, and the torques they make.

    Tables have the shape (tendons, joints): the tension [N] behind the guide of each joint, NaN
    where a tendon does not pass it. Torques [N m] have the shape (joints,).
    """

    tension: Array
    low: Array
    high: Array
    torque: Array
    torque_low: Array
    torque_high: Array


def build_initial_state(
    prepared: PreparedRouting, tension: ArrayLike, angles: ArrayLike
) -> RoutingState:
    """Return the state of which only the `tension` [N] at each sheath's end is known.

    Likeliest is one tension along a tendon, as after pretensioning; the interval holds whatever
    friction allows.
    """
    theta = _read_angles(prepared, angles)
    T = np.broadcast_to(np.asarray(tension, dtype=np.float64), len(prepared.first) - 1)
    rows = np.repeat(T, np.diff(prepared.first))
    state = np.array([rows, rows, rows])
    for tendon in range(len(T)):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        for copy, sign in ((1, -1.0), (2, 1.0)):
            _open_cone(prepared, theta, begin, end, sign, state[copy])
    return RoutingState(state, theta)


def step(
    prepared: PreparedRouting,
    state: RoutingState,
    tension: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    angles: ArrayLike,
) -> tuple[JointTensions, RoutingState]:
    """Take the next sample, and return tensions, torques and the next state.

    Friction knows no rate, so the time between samples does not matter; what turned back between
    two of them is not seen.

    Parameters
    ----------
    tension, low, high : array_like
        T_out [N] of each sheath and its interval, shape (tendons,); `high` may be infinite.
    angles : array_like
        [rad], shape (joints,).

    Raises
    ------
    RoutingError
        If a shape is wrong, or a number that must be finite is not.
    """
    T = np.array([tension, low, high], dtype=np.float64)
    theta = _read_angles(prepared, angles)
    if T.shape != (3, len(prepared.first) - 1) or not np.isfinite(T[:2]).all():
        raise RoutingError(f"tension, low: give {len(prepared.first) - 1} finite numbers each")
    driven = RoutingState(state.tensions.copy(), state.angles.copy())
    reported = np.empty_like(state.tensions)
    advance(prepared, driven.tensions, driven.angles, T, theta, reported)
    torques = np.empty((3, len(theta)))
    add_torques(prepared, reported, torques)
    rows = np.where(prepared.behind < 0, 0, prepared.behind)
    tables = np.where(prepared.behind < 0, np.nan, reported[:, rows])
    return JointTensions(*tables, *torques), driven


def _read_angles(prepared: PreparedRouting, angles: ArrayLike) -> Array:
    theta = np.array(angles, dtype=np.float64)
    if theta.shape != prepared.shortening.shape[1:] or not np.isfinite(theta).all():
        raise RoutingError(
            f"angles: give {prepared.shortening.shape[1]} finite numbers, one for each joint"
        )
    return theta


@jit_compile
def advance(
    prepared: PreparedRouting,
    tensions: Array,
    angles: Array,
    sheath_end: Array,
    new_angles: Array,
    reported: Array,
) -> None:
    """Advance a state in place; write tensions of all rows and their intervals to `reported`.

    Parameters
    ----------
    tensions, angles : array
        The state: shapes (3, rows) and (joints,).
    sheath_end : array, shape (3, tendons)
        T_out [N] of the sheaths, its least and its largest.
    new_angles : array, shape (joints,)
        [rad]
    reported : array, shape (3, rows)
        [N] likeliest, least and largest.
    """
    rows, joints = prepared.shortening.shape
    change = np.zeros(joints)
    for j in range(joints):
        band = prepared.angle_error
        nearest = min(max(angles[j], new_angles[j] - band), new_angles[j] + band)
        change[j] = nearest - angles[j]
        angles[j] = nearest
    shortening, margin = np.zeros(rows), np.zeros(rows)
    for e in range(rows):
        for j in range(joints):
            shortening[e] += prepared.shortening[e, j] * change[j]
            margin[e] += abs(prepared.shortening[e, j]) * 2.0 * prepared.angle_error
    more, less = 1.0 + prepared.compliance_error, 1.0 / (1.0 + prepared.compliance_error)
    low_factor, high_factor = np.ones(rows), np.ones(rows)
    rise, fall, shift, stuck = np.zeros(rows), np.zeros(rows), np.zeros(rows), np.zeros(rows)
    for copy in range(3):
        sign = 0.0 if copy == 0 else (1.0 if copy == 1 else -1.0)  # of what lowers the tension
        for e in range(rows):
            bend = abs(prepared.wrap[e] + prepared.side[e] * angles[prepared.joint[e]])
            slack = prepared.angle_error if copy > 0 else 0.0
            K = prepared.friction[e] * bend
            K_more = (K + prepared.friction[e] * slack) * (1.0 + prepared.friction_error)
            K_less = max(K - prepared.friction[e] * slack, 0.0) * (1.0 - prepared.friction_error)
            c = prepared.compliance[e]
            if copy == 0:
                low_factor[e], high_factor[e] = math.exp(-K), math.exp(K)
                rise[e] = fall[e] = c
                shift[e] = 0.0
            else:
                low_factor[e] = math.exp(-K_more if copy == 1 else -K_less)
                high_factor[e] = math.exp(K_less if copy == 1 else K_more)
                rise[e], fall[e] = (c * more, c * less) if copy == 1 else (c * less, c * more)
                shift[e] = sign * margin[e] / (c * less) if c > 0.0 else 0.0
        row = tensions[copy]
        for tendon in range(len(prepared.first) - 1):
            begin, end = prepared.first[tendon], prepared.first[tendon + 1]
            T = sheath_end[copy, tendon]
            if not math.isfinite(T):
                row[begin:end] = math.inf
                reported[copy, begin:end] = math.inf
                continue
            shift[begin] = 0.0
            if not math.isfinite(row[begin]):
                row[begin] = T
                _open_cone(prepared, angles, begin, end, 1.0, row)
            _find_stuck_tensions(
                begin, end, row, shortening, low_factor, high_factor, rise, fall, shift, stuck
            )
            row[begin] = reported[copy, begin] = max(T, 0.0)
            for e in range(begin + 1, end):
                row[e] = _limit(e, row[e - 1], stuck[e], low_factor, high_factor, shift)[0]
                seen = row[e] - shift[e]
                before = reported[copy, e - 1]
                if copy == 1:
                    seen = max(seen, low_factor[e] * before)
                elif copy == 2:
                    seen = min(seen, high_factor[e] * before)
                reported[copy, e] = seen
    for e in range(rows):
        reported[0, e] = min(max(reported[0, e], reported[1, e]), reported[2, e])


@jit_compile
def _find_stuck_tensions(
    begin: int,
    end: int,
    before: Array,
    shortening: Array,
    low_factor: Array,
    high_factor: Array,
    rise: Array,
    fall: Array,
    shift: Array,
    stuck: Array,
) -> None:
    """Write T*_e [N] of one tendon's elements to `stuck`, from the last to the first."""
    for e in range(end - 1, begin, -1):
        T, below, above = before[e], -math.inf, math.inf
        for _ in range(_ROOT_ITERATIONS):
            slip, slope, tension, gain = 0.0, 0.0, T, 1.0
            for k in range(e, end):
                if k > e:
                    tension, factor = _limit(k, tension, stuck[k], low_factor, high_factor, shift)
                    if factor == 0.0:
                        break  # it sticks: nothing slips here, whatever is behind
                    gain *= factor
                c = rise[k] if tension > before[k] else fall[k]
                slip += shortening[k] + c * (tension - before[k])
                slope += c * gain
            if slip > 0.0:
                above = T
            else:
                below = T
            change = -slip / slope
            if abs(change) <= _ROOT_TOLERANCE * (1.0 + abs(T)):
                break
            T += change
            if not below < T < above:
                T = 0.5 * (below + above)
        stuck[e] = T


@jit_compile
def _limit(
    e: int, before: float, stuck: float, low_factor: Array, high_factor: Array, shift: Array
) -> tuple[float, float]:
    """Return the tension [N] behind an element, and how it changes with that before it."""
    driving = max(before - shift[e - 1], 0.0)
    low, high = low_factor[e] * driving - shift[e], high_factor[e] * driving - shift[e]
    if stuck < low:
        return low, low_factor[e]
    if stuck > high:
        return high, high_factor[e]
    return stuck, 0.0


@jit_compile
def _open_cone(
    prepared: PreparedRouting, angles: Array, begin: int, end: int, sign: float, tensions: Array
) -> None:
    """Write the largest (sign 1) or least (-1) tensions that friction allows, from row `begin`."""
    for e in range(begin + 1, end):
        bend = abs(prepared.wrap[e] + prepared.side[e] * angles[prepared.joint[e]])
        K = prepared.friction[e] * (bend + 2.0 * prepared.angle_error)
        tensions[e] = tensions[e - 1] * math.exp(sign * K * (1.0 + prepared.friction_error))


@jit_compile
def add_torques(prepared: PreparedRouting, reported: Array, torques: Array) -> None:
    """Write joint torques [N m] of tensions and the ends of their intervals to `torques`.

    Parameters
    ----------
    reported : array, shape (3, rows)
    torques : array, shape (3, joints)
    """
    rows, joints = prepared.shortening.shape
    for j in range(joints):
        torques[:, j] = 0.0
        for e in range(rows):
            arm = prepared.shortening[e, j]
            torques[0, j] += arm * reported[0, e]
            if arm != 0.0:
                torques[1, j] += arm * reported[1 if arm > 0.0 else 2, e]
                torques[2, j] += arm * reported[2 if arm > 0.0 else 1, e]
