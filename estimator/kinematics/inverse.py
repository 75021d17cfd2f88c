"""Differential inverse kinematics: from the twist of the tip to joint velocities, by one matrix.

The result of a tick is a velocity map J#, and nothing else moves the joints: with the twist v that
is asked of the tip, dq/dt = J# v. What the hand feels of joint torques tau is J#^T tau, so that
the power at both ends, v^T J#^T tau = tau^T dq/dt, is the same for any J#. So whatever limits,
damping or corrections do, they do it to J#:

* The map minimises |W^1/2 (J dq/dt - v)|, by singular values s of W^1/2 J: directions with s at
  least the bound s_0 are exact, those below have the gain s / s_0^2 in place of 1 / s (damped least
  squares with lambda^2 = s_0^2 - s^2 for these alone). No gain exceeds 1 / s_0, so that the force
  in the hand is bounded by the torques: |J#^T tau| <= |tau| / s_0.
* A joint that would pass its limit within the tick is limited: it may move inwards only. Those that
  would not are held, their rows of J# are zero, and the others do what they can: the active set of
  the least squares problem, found as for non-negative ones (Lawson and Hanson 1974, chapter 23).
* Where a joint exceeds its speed limit, the whole map is scaled: the tip slows down on its path.
* The error of the tip's pose is corrected only while the hand moves, by c = k e bounded by a share
  of the speed of v; the work is done by the hand: dq/dt = M (v + c) is the map
  J# = M (I + c (W v)^T / (v^T W v)). With the hand at rest no joint moves.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import MAX_COORDINATES, ArmError, Coordinates, PreparedArm
from estimator.structs import F64, Field, Struct, StructArray, view_struct

Twist = Annotated[Array, Field("f8", 6)]
"""A field with a linear [m/s] and an angular velocity [rad/s], in the frame of the base."""

_SWEEPS = 12  # of the Jacobi method, which needs 4 to 7
_RELEASES = 12  # of held joints in a tick; one or two are needed
_RELEASE_TOLERANCE = 1e-9  # of the largest pull a residual could have
_AT_REST = 1e-12  # [m/s] weighted speed below which nothing is corrected


@dataclass(frozen=True, slots=True)
class InverseConfig:
    """How the twist of the tip becomes joint velocities."""

    weights: tuple[float, ...] = (1.0,) * 6  # of x, y, z and the rotations about them; 0 = free
    rotation_length: float = 0.05  # [m] of error that counts as much as 1 rad
    singular_value: float = 0.005  # [m] s_0, of weighted motion per rad
    correction_rate: float = 2.0  # [1/s] at which errors of the pose are corrected
    correction_share: float = 0.1  # of the tip's speed, at most
    correction_speed: float = 0.005  # [m/s] weighted; below it, less than that share

    def __post_init__(self) -> None:
        """Check the values; raises `ArmError`."""
        if len(self.weights) != 6 or not all(0.0 <= w < math.inf for w in self.weights):
            raise ArmError("weights: six numbers, not negative: x, y, z and the rotations")
        if not max(self.weights) > 0.0:
            raise ArmError("weights: all are zero, at least one must be positive")
        for name in ("rotation_length", "singular_value", "correction_speed"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArmError(f"{name}: {getattr(self, name)}, must be positive and finite")
        if not 0.0 <= self.correction_rate <= 100.0:
            raise ArmError(f"correction_rate: {self.correction_rate}, allowed are 0 to 100 [1/s]")
        if not 0.0 <= self.correction_share <= 0.5:
            raise ArmError(f"correction_share: {self.correction_share}, allowed are 0 to 0.5")


class InverseSettings(Struct):
    """An `InverseConfig` as a record."""

    weights: Twist  # of squares: rotations times rotation_length^2
    rotation_length: F64
    singular_value: F64
    correction_rate: F64
    correction_share: F64
    correction_speed: F64


def build_inverse_settings(config: InverseConfig) -> StructArray:
    """Return the record of a config as an array of one."""
    records = InverseSettings.array()
    settings: InverseSettings = view_struct(records)
    settings.weights[:] = config.weights
    settings.weights[3:] *= config.rotation_length**2
    settings.rotation_length = config.rotation_length
    settings.singular_value = config.singular_value
    settings.correction_rate = config.correction_rate
    settings.correction_share = config.correction_share
    settings.correction_speed = config.correction_speed
    return records


class InverseStep(Struct):
    """What `step_inverse` returns, and where it calculates."""

    joint_velocity: Coordinates  # [rad/s] or [m/s]
    velocity_map: Annotated[Array, Field("f8", (MAX_COORDINATES, 6))]  # J#: zero rows beyond n
    held: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]  # at the lower -1, upper 1
    scale: F64  # by which speed limits slow the tip, 1 = not
    singular_value: F64  # [m] the smallest of the joints that move; 0 if there are none

    limited: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]  # as `held`, may move in
    rejected: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]  # not to be released
    feasible: Coordinates  # velocities of the last set that obeys the limits
    columns: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]  # joints that move
    corrected: Twist  # v + c
    weighted: Annotated[Array, Field("f8", (6, MAX_COORDINATES))]
    gram: Annotated[Array, Field("f8", (MAX_COORDINATES, MAX_COORDINATES))]
    vectors: Annotated[Array, Field("f8", (MAX_COORDINATES, MAX_COORDINATES))]


@jit_compile
def step_inverse(
    arm: PreparedArm,
    settings: InverseSettings,
    jacobian: Array,
    q: Array,
    twist: Array,
    error: Array,
    dt: float,
    step: InverseStep,
) -> None:
    """Compute joint velocities and the map that gives them, for one tick.

    Parameters
    ----------
    jacobian : array, shape (6, n) or wider
        At `q`, from `forward.write_kinematics`.
    q : array, shape (n,) or longer
        Coordinates at the beginning of the tick [rad] or [m].
    twist : array, shape (6,)
        Asked of the tip [m/s], [rad/s]; rows of no weight are ignored.
    error : array, shape (6,)
        Of the tip's pose, target less tip: position [m], rotation vector [rad].
    dt : float
        Length of the tick [s], positive.
    step : InverseStep
        All is written. `joint_velocity` times `dt` never passes a limit from within.
    """
    speed = _correct_twist(settings, twist, error, step)
    for j in range(MAX_COORDINATES):
        step.limited[j] = 0
    releases = 0
    search = True
    while search:  # at most once for each joint that becomes limited
        search = False
        for j in range(MAX_COORDINATES):
            step.held[j], step.rejected[j] = step.limited[j], 0
        _solve(arm, settings, jacobian, step)
        if _limit_joints(arm, q, dt, step):
            search = True
            continue
        while releases < _RELEASES:
            released = _find_release(arm, settings, jacobian, step)
            if released < 0:
                break
            releases += 1
            _release_joint(arm, settings, jacobian, step, released)
            if _limit_joints(arm, q, dt, step):
                search = True
                break
    _finish_map(arm, settings, twist, speed, step)


@jit_compile
def _correct_twist(
    settings: InverseSettings, twist: Array, error: Array, step: InverseStep
) -> float:
    """Write v + c; return the weighted speed |v| [m/s]."""
    speed, size = 0.0, 0.0
    for row in range(6):
        weight = settings.weights[row]
        speed += weight * twist[row] * twist[row]
        size += weight * error[row] * error[row]
    speed = math.sqrt(speed)
    size = settings.correction_rate * math.sqrt(size)
    bound = settings.correction_share * speed * speed / (speed + settings.correction_speed)
    gain = 0.0
    if speed > _AT_REST and size > 0.0:
        gain = settings.correction_rate * min(1.0, bound / size)
    for row in range(6):
        step.corrected[row] = twist[row] + gain * error[row]
    return speed


@jit_compile
def _write_map(
    arm: PreparedArm, settings: InverseSettings, jacobian: Array, step: InverseStep
) -> None:
    """Write the damped inverse M of the joints that are not held."""
    columns, vectors, moving = step.columns, step.vectors, 0
    for j in range(arm.coordinates):
        if step.held[j] == 0:
            columns[moving] = j
            moving += 1
        for row in range(6):
            step.velocity_map[j, row] = 0.0
    weighted = step.weighted
    rows = write_weighted_jacobian(arm, settings, jacobian, columns, moving, weighted)
    step.singular_value = 0.0
    if moving == 0:
        return
    size = min(moving, rows)
    decompose_weighted_jacobian(weighted, rows, moving, step.gram, vectors)
    smallest = math.inf
    least = settings.singular_value * settings.singular_value
    for k in range(size):
        value = step.gram[k, k]
        smallest = min(smallest, value)
        value = max(value, least)
        # M = V (1/d) (A V)^T for few joints, (A^T U) (1/d) U^T for few rows
        for index in range(moving):
            by_joint = vectors[index, k]
            if moving > rows:
                by_joint = 0.0
                for row in range(rows):
                    by_joint += weighted[row, index] * vectors[row, k]
            step.joint_velocity[index] = by_joint / value
        row = 0
        for place in range(6):
            weight = settings.weights[place]
            if weight == 0.0:
                continue
            by_row = vectors[row, k]
            if moving <= rows:
                by_row = 0.0
                for index in range(moving):
                    by_row += weighted[row, index] * vectors[index, k]
            by_row *= math.sqrt(weight)
            for index in range(moving):
                step.velocity_map[columns[index], place] += step.joint_velocity[index] * by_row
            row += 1
    step.singular_value = math.sqrt(max(smallest, 0.0))
    for index in range(moving):
        j = columns[index]
        if arm.is_linear[j]:
            for place in range(6):
                step.velocity_map[j, place] *= settings.rotation_length


@jit_compile
def write_weighted_jacobian(
    arm: PreparedArm,
    settings: InverseSettings,
    jacobian: Array,
    columns: NDArray[np.int64],
    moving: int,
    weighted: Array,
) -> int:
    """Write A = W^1/2 J of some columns, rows of no weight left out; return its number of rows.

    Linear coordinates count in units of `rotation_length`, so that all of A is in metres.
    """
    rows = 0
    for place in range(6):
        if settings.weights[place] == 0.0:
            continue
        factor = math.sqrt(settings.weights[place])
        for index in range(moving):
            j = columns[index]
            unit = settings.rotation_length if arm.is_linear[j] else 1.0
            weighted[rows, index] = factor * unit * jacobian[place, j]
        rows += 1
    return rows


@jit_compile
def decompose_weighted_jacobian(
    weighted: Array, rows: int, columns: int, gram: Array, vectors: Array
) -> None:
    """Write eigenvalues and eigenvectors of the smaller of A^T A and A A^T.

    The eigenvalues are on the diagonal of `gram`, the vectors the columns of `vectors`; A A^T is
    taken where there are more columns than rows. Jacobi's method (Golub and Van Loan, section 8.5):
    exact to rounding for such sizes, and without LAPACK, for which compiled code loads scipy.
    """
    size = min(rows, columns)
    for i in range(size):
        for k in range(size):
            total = 0.0
            if columns > rows:
                for index in range(columns):
                    total += weighted[i, index] * weighted[k, index]
            else:
                for row in range(rows):
                    total += weighted[row, i] * weighted[row, k]
            gram[i, k] = total
            vectors[i, k] = 1.0 if i == k else 0.0
    for _ in range(_SWEEPS):
        is_diagonal = True
        for i in range(size - 1):
            for k in range(i + 1, size):
                off = gram[i, k]
                if abs(off) <= 1e-16 * math.sqrt(abs(gram[i, i] * gram[k, k])):
                    continue
                is_diagonal = False
                ratio = (gram[k, k] - gram[i, i]) / (2.0 * off)
                tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.hypot(1.0, ratio))
                cosine = 1.0 / math.hypot(1.0, tangent)
                sine = tangent * cosine
                for index in range(size):
                    a, b = gram[index, i], gram[index, k]
                    gram[index, i], gram[index, k] = cosine * a - sine * b, sine * a + cosine * b
                    a, b = vectors[index, i], vectors[index, k]
                    vectors[index, i] = cosine * a - sine * b
                    vectors[index, k] = sine * a + cosine * b
                for index in range(size):
                    a, b = gram[i, index], gram[k, index]
                    gram[i, index], gram[k, index] = cosine * a - sine * b, sine * a + cosine * b
        if is_diagonal:
            break


@jit_compile
def _apply_map(arm: PreparedArm, step: InverseStep) -> None:
    """Write dq/dt = M (v + c), and the scale by which speed limits slow it."""
    scale = 1.0
    for j in range(arm.coordinates):
        velocity = 0.0
        for row in range(6):
            velocity += step.velocity_map[j, row] * step.corrected[row]
        step.joint_velocity[j] = velocity
        if abs(velocity) * scale > arm.speed[j]:
            scale = arm.speed[j] / abs(velocity)
    step.scale = scale


@jit_compile
def _solve(arm: PreparedArm, settings: InverseSettings, jacobian: Array, step: InverseStep) -> None:
    """Write the map of the joints that are not held, and the velocities by it."""
    _write_map(arm, settings, jacobian, step)
    _apply_map(arm, step)


@jit_compile
def _limit_joints(arm: PreparedArm, q: Array, dt: float, step: InverseStep) -> bool:
    """Limit the joints that would pass a limit within the tick; return whether there are any.

    If not, the velocities are remembered as feasible.
    """
    found = False
    for j in range(arm.coordinates):
        velocity = step.scale * step.joint_velocity[j]
        if velocity > 0.0 and q[j] + velocity * dt > arm.upper[j]:
            step.limited[j] = 1
            found = True
        elif velocity < 0.0 and q[j] + velocity * dt < arm.lower[j]:
            step.limited[j] = -1
            found = True
    if not found:
        for j in range(arm.coordinates):
            step.feasible[j] = step.joint_velocity[j]
    return found


@jit_compile
def _find_release(
    arm: PreparedArm, settings: InverseSettings, jacobian: Array, step: InverseStep
) -> int:
    """Return the held joint that the residual pulls inwards most, -1 if there is none.

    With the residual r = v + c - J dq/dt, the pull on joint j is J_j^T W r: the optimum has it
    outwards at every joint that is held (Karush, Kuhn, Tucker).
    """
    found, strongest = -1, 0.0
    for j in range(arm.coordinates):
        if step.held[j] == 0 or step.rejected[j] != 0:
            continue
        pull, largest = 0.0, 0.0
        for row in range(6):
            residual = step.corrected[row]
            for k in range(arm.coordinates):
                residual -= jacobian[row, k] * step.joint_velocity[k]
            weight = settings.weights[row] * jacobian[row, j]
            pull += weight * residual
            largest += abs(weight * step.corrected[row])
        pull *= -step.held[j]
        if pull > max(strongest, _RELEASE_TOLERANCE * largest):
            found, strongest = j, pull
    return found


@jit_compile
def _release_joint(
    arm: PreparedArm,
    settings: InverseSettings,
    jacobian: Array,
    step: InverseStep,
    released: int,
) -> None:
    """Release a joint, and hold the limited ones that would move outwards then, one by one."""
    step.held[released] = 0
    _solve(arm, settings, jacobian, step)
    for _ in range(arm.coordinates):
        blocking, least = -1, math.inf
        for j in range(arm.coordinates):
            velocity = step.joint_velocity[j]
            if step.held[j] == 0 and velocity * step.limited[j] > 0.0:
                share = step.feasible[j] / (step.feasible[j] - velocity)
                if share < least:
                    blocking, least = j, share
        if blocking < 0:
            return
        for j in range(arm.coordinates):
            step.feasible[j] += least * (step.joint_velocity[j] - step.feasible[j])
        step.held[blocking] = step.limited[blocking]
        step.feasible[blocking] = 0.0
        if blocking == released:
            step.rejected[released] = 1
        _solve(arm, settings, jacobian, step)


@jit_compile
def _finish_map(
    arm: PreparedArm, settings: InverseSettings, twist: Array, speed: float, step: InverseStep
) -> None:
    """Make J# of M: with the correction and the scale; write dq/dt = J# v."""
    for j in range(arm.coordinates):
        correction = 0.0
        if speed > _AT_REST:
            for row in range(6):
                correction += step.velocity_map[j, row] * (step.corrected[row] - twist[row])
            correction /= speed * speed
        velocity = 0.0
        for row in range(6):
            gain = step.velocity_map[j, row] + correction * settings.weights[row] * twist[row]
            step.velocity_map[j, row] = step.scale * gain
            velocity += step.velocity_map[j, row] * twist[row]
        step.joint_velocity[j] = velocity
