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
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array, Mask
from estimator.compiled import jit_compile
from estimator.law.sheath import Sheath
from estimator.routing.routing import PreparedRouting, Routing, RoutingError, prepare
from estimator.small_arrays import copy_values

_LEAST_COMPLIANCE = 1e-11  # [m/N] of stretches on a pin that is hardly touched
_ROOT_ITERATIONS = 60
_ROOT_TOLERANCE = 1e-12  # relative to the tension, or to 1 N


class RoutingState(NamedTuple):
    """What the past leaves: tensions of all rows, and the angles taken for the present ones."""

    tensions: Array  # [N] shape (3, rows): likeliest, least, largest
    angles: Array  # [rad] shape (2, joints): of the likeliest, and of the interval


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
    state = np.empty((3, len(prepared.joint)))
    open_tensions(prepared, np.tile(T, (3, 1)), theta, state)
    return RoutingState(state, np.array([theta, theta]))


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
    band = prepared.angle_error
    held = np.clip(driven.angles[0], theta - band, theta + band)
    new_angles = np.array([held, theta])
    elements = begin_advance(prepared, driven.tensions, driven.angles, new_angles)
    advance(prepared, elements, driven.tensions, driven.angles, T, new_angles, reported)
    torques = np.empty((3, len(theta)))
    add_torques(prepared, reported, torques)
    rows = np.where(prepared.behind < 0, 0, prepared.behind)
    tables = np.where(prepared.behind < 0, np.nan, reported[:, rows])
    return JointTensions(*tables, *torques), driven


class JointEstimator:
    """Estimates tensions and torques of an arm's joints, for notebooks and recorded data.

    Parameters
    ----------
    routing : Routing
    sheaths : sequence of Sheath, optional
        Of each tendon: then `step` takes the tensions at the housing.
    tension, angles : array_like
        [N] and [rad] at the start.
    """

    def __init__(
        self,
        routing: Routing,
        sheaths: Sequence[Sheath] | None = None,
        *,
        tension: ArrayLike = 0.0,
        angles: ArrayLike | None = None,
    ) -> None:
        self._prepared = prepare(routing, sheaths)
        start = np.zeros(routing.joints) if angles is None else angles
        self._state = build_initial_state(self._prepared, tension, start)

    def step(
        self,
        tension: ArrayLike,
        angles: ArrayLike,
        *,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
    ) -> JointTensions:
        """Take the next sample: tensions [N] and their interval, and angles [rad]; see `step`."""
        least, largest = tension if low is None else low, tension if high is None else high
        estimate, self._state = step(self._prepared, self._state, tension, least, largest, angles)
        return estimate


def _read_angles(prepared: PreparedRouting, angles: ArrayLike) -> Array:
    theta = np.array(angles, dtype=np.float64)
    joints = prepared.behind.shape[1]
    if theta.shape != (joints,) or not np.isfinite(theta).all():
        raise RoutingError(f"angles: give {joints} finite numbers, one for each joint")
    return theta


class Elements(NamedTuple):
    """What one step needs of all rows, for one of the three copies at a time."""

    shortening: Array  # [m] of the stretch behind the element in this step
    compliance: Array  # [m/N] of that stretch
    bend: Array  # [rad]
    between: Array  # [m] half of what slips more at one end of the element than at the other
    one_way: Array  # part of the friction that acts where slip turns round within the element
    turns_round: Mask  # whether slip may turn round within the element
    low_factor: Array  # bounds of T_e over T_(e-1), shape (2, rows): as it is taken to be, and
    high_factor: Array  # as it is taken to be for what sticks nearer to the housing
    rise: Array  # [m/N] compliance for a rise and for a fall of tension
    fall: Array
    shift: Array  # [N] what the error of angles may take from the tension, shape (2, rows) too
    stuck: Array  # [N] T*_e


@jit_compile
def begin_advance(
    prepared: PreparedRouting, tensions: Array, angles: Array, new_angles: Array
) -> Elements:
    """Turn the joints of the likeliest copy, before `advance`; `angles` become the new ones."""
    rows, held = len(prepared.joint), np.empty(angles.shape[1])
    elements = Elements(
        np.zeros(rows), prepared.compliance.copy(), np.zeros(rows), np.zeros(rows),
        np.ones(rows), np.zeros(rows, dtype=np.bool_), np.ones((2, rows)), np.ones((2, rows)),
        np.zeros(rows), np.zeros(rows), np.zeros((2, rows)), np.zeros(rows),
    )  # fmt: skip
    _hold_angles(angles[1], new_angles[1], prepared.angle_error, held)
    _turn_joints(prepared, angles[0], held if prepared.spread.any() else new_angles[0], elements)
    _set_limits(prepared, elements, 0)
    for tendon in range(len(prepared.first) - 1):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        _find_stuck_tensions(begin, end, tensions[0], elements)
    return elements


@jit_compile
def compute_excess_slip(
    prepared: PreparedRouting, tendon: int, before: Array, elements: Elements, tension: float
) -> tuple[float, float]:
    """Return the travel [m] of a sheath's end towards the motor, and its slope [m/N].

    It is more by this than that of a tendon with one tension all along behind the sheath, whose
    joints rest. `tension` [N] is that of the end after this step, `before` has those of all rows
    before it.
    """
    begin, end = prepared.first[tendon], prepared.first[tendon + 1]
    change, slips = tension - before[begin], True
    slip, slope, gain = 0.0, 0.0, 1.0
    for e in range(begin, end):
        if slips and e > begin:
            tension, factor = _limit(e, tension, e == begin + 1, elements, 0)
            gain *= factor
            slips = factor != 0.0
        c = elements.compliance[e]
        slip -= c * change
        slope -= c
        if slips:
            slip += elements.shortening[e] + c * (tension - before[e])
            slope += c * gain
    return slip, slope


@jit_compile
def advance(
    prepared: PreparedRouting,
    elements: Elements,
    tensions: Array,
    angles: Array,
    sheath_end: Array,
    new_angles: Array,
    reported: Array,
) -> None:
    """Advance a state in place; write tensions of all rows and their intervals to `reported`.

    Parameters
    ----------
    elements : Elements
        Of `begin_advance` with the same state and angles.
    tensions, angles : array
        The state: shapes (3, rows) and (2, joints).
    sheath_end : array, shape (3, tendons)
        [N] at the sheath's ends, or at the housing, its least and its largest.
    new_angles : array, shape (2, joints)
        [rad] of the likeliest, without noise, and of the interval, within `angle_error`. A routing
        with curved sections takes the latter for both.
    reported : array, shape (3, rows)
        [N] likeliest, least and largest.
    """
    rows, held = len(prepared.joint), np.empty(angles.shape[1])
    _hold_angles(angles[1], new_angles[1], prepared.angle_error, held)
    before = tensions[0].copy()
    _drive_sheath_ends(prepared, angles[0], elements, 0, sheath_end, tensions, reported)
    if _find_turning_slip(prepared, before, tensions[0], elements):
        copy_values(before, tensions[0])
        _set_limits(prepared, elements, 0)
        _drive_sheath_ends(prepared, angles[0], elements, 0, sheath_end, tensions, reported)
    _turn_joints(prepared, angles[1], held, elements)
    for copy in range(1, 3):
        _set_limits(prepared, elements, copy)
        _drive_sheath_ends(prepared, angles[1], elements, copy, sheath_end, tensions, reported)
    for e in range(rows):
        reported[0, e] = min(max(reported[0, e], reported[1, e]), reported[2, e])


@jit_compile
def _compute_bend(prepared: PreparedRouting, angles: Array, e: int) -> float:
    """Return the bend of the tendon over an element [rad]."""
    bend = abs(prepared.wrap[e] + prepared.side[e] * angles[prepared.joint[e]])
    other = prepared.partner[e]
    return math.hypot(bend, angles[other]) if other >= 0 else bend


@jit_compile
def open_tensions(
    prepared: PreparedRouting, sheath_end: Array, angles: Array, tensions: Array
) -> None:
    """Write the tensions of all rows of which only those at the sheaths' ends are known.

    Likeliest is one tension along a tendon, as after pretensioning; for the shapes see `advance`.
    """
    for tendon in range(len(prepared.first) - 1):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        for copy in range(3):
            tensions[copy, begin:end] = sheath_end[copy, tendon]
        _open_cone(prepared, angles, begin, end, -1.0, tensions[1])
        _open_cone(prepared, angles, begin, end, 1.0, tensions[2])


@jit_compile
def _turn_joints(
    prepared: PreparedRouting, angles: Array, new_angles: Array, elements: Elements
) -> None:
    """Turn the joints, and write what follows for the rows."""
    rows = len(prepared.joint)
    for e in range(rows):
        first, second = prepared.turned_by[e]
        elements.shortening[e] = prepared.shortening[e, 0] * (new_angles[first] - angles[first])
        elements.shortening[e] += prepared.shortening[e, 1] * (new_angles[second] - angles[second])
        j = prepared.joint[e]
        elements.between[e] = prepared.spread[e] * abs(new_angles[j] - angles[j])
        elements.bend[e] = _compute_bend(prepared, new_angles, e)
    copy_values(new_angles, angles)
    for e in range(rows):
        own, follower = prepared.contact[e]
        compliance = prepared.compliance[e] + own * elements.bend[e]
        if e + 1 < rows:
            compliance += follower * elements.bend[e + 1]
        elements.compliance[e] = max(compliance, _LEAST_COMPLIANCE)


@jit_compile
def _hold_angles(angles: Array, new_angles: Array, band: float, out: Array) -> None:
    """Write what is left of new angles without what may be an error."""
    for j in range(len(angles)):
        out[j] = min(max(angles[j], new_angles[j] - band), new_angles[j] + band)


@jit_compile
def _find_turning_slip(
    prepared: PreparedRouting, before: Array, after: Array, elements: Elements
) -> bool:
    """Find elements of curved sections within which slip turns round; return whether there are.

    Turning a curved section slips the tendon more at its near end, by 2 `between` an element. Where
    the mean slip S is less than that, both ways occur and the part |S|/between of friction is left.
    """
    is_any = False
    slip, rigid_slip = np.zeros(len(before) + 1), np.zeros(len(before) + 1)
    for tendon in range(len(prepared.first) - 1):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        slip[end] = rigid_slip[end] = 0.0
        for e in range(end - 1, begin - 1, -1):
            stretch = elements.compliance[e] * (after[e] - before[e])
            rigid_slip[e] = rigid_slip[e + 1] + elements.shortening[e]
            slip[e] = slip[e + 1] + elements.shortening[e] + stretch
        for e in range(begin + 1, end):
            between, mean = elements.between[e], slip[e]
            if between == 0.0 or not math.isfinite(mean):
                continue
            least = 1e-9 * between
            is_between = (
                min(slip[e - 1], slip[e + 1]) < -least < least < max(slip[e - 1], slip[e + 1])
            )
            if abs(mean) < least:
                mean = rigid_slip[e]  # between two that slide it only seems to stick
            if is_between and abs(mean) < between:
                elements.one_way[e] = abs(mean) / between
                is_any = True
            elements.turns_round[e] = (
                abs(slip[e]) < between
                or abs(rigid_slip[e]) < between
                or slip[e] * rigid_slip[e] < 0.0
            )
    return is_any


@jit_compile
def _set_limits(prepared: PreparedRouting, elements: Elements, copy: int) -> None:
    """Set what friction and compliance allow in the likeliest, least or largest copy.

    Less tension behind an element is more material for what sticks before it, and so raises it: for
    that, the least copy takes what the largest takes.
    """
    more, less = 1.0 + prepared.compliance_error, 1.0 / (1.0 + prepared.compliance_error)
    for e in range(len(prepared.joint)):
        c, K = elements.compliance[e], prepared.friction[e] * elements.bend[e]
        if copy == 0:
            high_factor = math.exp(K * elements.one_way[e])
            elements.high_factor[:, e], elements.low_factor[:, e] = high_factor, 1.0 / high_factor
            elements.rise[e] = elements.fall[e] = c
            continue
        K_angle = 2.0 * prepared.friction[e] * prepared.angle_error
        K_more = (K + K_angle) * (1.0 + prepared.friction_error[e])
        K_less = max(K - K_angle, 0.0) * (1.0 - prepared.friction_error[e])
        if elements.turns_round[e]:
            K_less = -K_more
        arm = abs(prepared.shortening[e, 0]) + abs(prepared.shortening[e, 1])
        margin = 2.0 * prepared.angle_error * arm
        least, largest = copy - 1, 2 - copy
        elements.shift[least, e] = margin / (c * less)
        elements.shift[largest, e] = -margin / (c * less)
        more_factor, less_factor = math.exp(K_more), math.exp(K_less)
        elements.low_factor[least, e] = 1.0 / more_factor
        elements.low_factor[largest, e] = 1.0 / less_factor
        elements.high_factor[least, e] = less_factor
        elements.high_factor[largest, e] = more_factor
        elements.rise[e] = c * more if copy == 1 else c * less
        elements.fall[e] = c * less if copy == 1 else c * more


@jit_compile
def _drive_sheath_ends(
    prepared: PreparedRouting,
    angles: Array,
    elements: Elements,
    copy: int,
    sheath_end: Array,
    tensions: Array,
    reported: Array,
) -> None:
    """Bring all sheath ends of one copy to their new tensions, and report what follows."""
    row, shift = tensions[copy], elements.shift[0]
    for tendon in range(len(prepared.first) - 1):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        T = sheath_end[copy, tendon]
        if not math.isfinite(T):
            row[begin:end] = math.inf
            reported[copy, begin:end] = math.inf
            continue
        if not math.isfinite(row[begin]):
            row[begin] = T
            _open_cone(prepared, angles, begin, end, 1.0, row)
        _find_stuck_tensions(begin, end, row, elements)
        row[begin] = reported[copy, begin] = max(T, 0.0)
        for e in range(begin + 1, end):
            row[e] = _limit(e, row[e - 1], e == begin + 1, elements, 0)[0]
            seen, nearer = row[e] - shift[e], reported[copy, e - 1]
            if copy == 1:
                seen = max(seen, elements.low_factor[0, e] * nearer)
            elif copy == 2:
                seen = min(seen, elements.high_factor[0, e] * nearer)
            reported[copy, e] = seen


@jit_compile
def _find_stuck_tensions(begin: int, end: int, before: Array, elements: Elements) -> None:
    """Write T*_e [N] of one tendon's elements to `elements`, from the last to the first."""
    for e in range(end - 1, begin, -1):
        T, below, above = before[e], -math.inf, math.inf
        for _ in range(_ROOT_ITERATIONS):
            slip, slope, tension, gain = 0.0, 0.0, T, 1.0
            for k in range(e, end):
                if k > e:
                    tension, factor = _limit(k, tension, False, elements, 1)
                    if factor == 0.0:
                        break  # it sticks: nothing slips here, whatever is behind
                    gain *= factor
                c = elements.rise[k] if tension > before[k] else elements.fall[k]
                slip += elements.shortening[k] + c * (tension - before[k])
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
        elements.stuck[e] = T


@jit_compile
def _limit(
    e: int, nearer: float, is_first: bool, elements: Elements, use: int
) -> tuple[float, float]:
    """Return the tension [N] behind an element, and how it changes with the `nearer` before it."""
    driving = nearer if is_first else max(nearer - elements.shift[use, e - 1], 0.0)
    low = elements.low_factor[use, e] * driving - elements.shift[use, e]
    high = elements.high_factor[use, e] * driving - elements.shift[use, e]
    if elements.stuck[e] < low:
        return low, elements.low_factor[use, e]
    if elements.stuck[e] > high:
        return high, elements.high_factor[use, e]
    return elements.stuck[e], 0.0


@jit_compile
def _open_cone(
    prepared: PreparedRouting, angles: Array, begin: int, end: int, sign: float, tensions: Array
) -> None:
    """Write the largest (sign 1) or least (-1) tensions that friction allows, from row `begin`."""
    for e in range(begin + 1, end):
        bend = _compute_bend(prepared, angles, e)
        K = prepared.friction[e] * (bend + 2.0 * prepared.angle_error)
        tensions[e] = tensions[e - 1] * math.exp(sign * K * (1.0 + prepared.friction_error[e]))


@jit_compile
def compute_excess(
    prepared: PreparedRouting, elements: Elements, tensions: Array, out_excess: Array
) -> None:
    """Write how much more tendons stretch behind their sheaths than at the tension there [m].

    `tensions` [N] are those of all rows, `elements` those of the step. Zero if they are not finite.
    """
    for tendon in range(len(prepared.first) - 1):
        begin, end = prepared.first[tendon], prepared.first[tendon + 1]
        out_excess[tendon] = 0.0
        for e in range(begin + 1, end if math.isfinite(tensions[begin]) else begin):
            out_excess[tendon] += elements.compliance[e] * (tensions[e] - tensions[begin])


@jit_compile
def add_torques(prepared: PreparedRouting, reported: Array, torques: Array) -> None:
    """Write joint torques [N m] of tensions and the ends of their intervals to `torques`.

    Parameters
    ----------
    reported : array, shape (3, rows)
    torques : array, shape (3, joints)
    """
    torques[:] = 0.0
    for e in range(len(prepared.joint)):
        for k in range(2):
            arm, j = prepared.shortening[e, k], prepared.turned_by[e, k]
            if arm != 0.0:
                torques[0, j] += arm * reported[0, e]
                torques[1, j] += arm * reported[1 if arm > 0.0 else 2, e]
                torques[2, j] += arm * reported[2 if arm > 0.0 else 1, e]
