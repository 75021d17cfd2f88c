"""Tensions of a tendon-driven arm: those that hold it, and those that make joint torques."""

import math

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.arrays import copy_values
from estimator.compiled import jit_compile
from estimator.routing.routing import Routing, RoutingError

_NEWTON_ITERATIONS = 60
_TOLERANCE = 1e-9  # of torque, relative to the largest that one tendon makes


def find_pretension(routing: Routing, minimum: ArrayLike, maximum: ArrayLike) -> Array:
    """Return tensions [N], shape (tendons,), that hold the arm at rest within the limits.

    They balance at all joints without a spring, and none is larger than the pattern of the routing
    needs for the `minimum`.

    Raises
    ------
    RoutingError
        If the balance for the `minimum` [N] needs more than the `maximum` [N] somewhere.
    """
    least = np.broadcast_to(np.asarray(minimum, dtype=np.float64), routing.tendons)
    most = np.broadcast_to(np.asarray(maximum, dtype=np.float64), routing.tendons)
    pattern = routing.find_pretension_pattern()
    tensions: Array = pattern * float(np.max(least / pattern))
    for tendon in np.flatnonzero(tensions > most):
        raise RoutingError(
            f"maximum: {most[tendon]:g} N of tendon {tendon}, but balance with the minimum needs "
            f"{tensions[tendon]:.4g} N; lower the minimum or raise the maximum"
        )
    return tensions


@jit_compile
def distribute_torque(
    arms: Array, torque: Array, pretension: Array, minimum: Array, maximum: Array
) -> tuple[Array, float]:
    """Return tensions [N] that make joint torques, as low as possible, and what part they make.

    The least sum of (T - minimum)^2 with arms^T T = torque and minimum <= T <= maximum. Where
    limits exclude the torque, its difference to that of the pretension is scaled down as a whole,
    so no joint is driven for the sake of another.

    Parameters
    ----------
    arms : array, shape (tendons, joints)
        [m] Radii, or torque per tension at the housing.
    torque : array, shape (joints,)
        [N m]
    pretension : array, shape (tendons,)
        [N] within the limits, as of `find_pretension`: what is left when nothing is asked for.
    minimum, maximum : array, shape (tendons,)
        [N]

    Returns
    -------
    tensions : array, shape (tendons,)
    part : float
        1 where the whole torque is made, less where limits exclude it.
    """
    tendons, joints = arms.shape
    base = np.zeros(joints)
    for j in range(joints):
        for t in range(tendons):
            base[j] += arms[t, j] * pretension[t]
    tensions = np.empty(tendons)
    if _balance(arms, torque, minimum, maximum, tensions):
        return tensions, 1.0
    feasible, excluded = 0.0, 1.0
    best = pretension.copy()
    for _ in range(20):
        part = 0.5 * (feasible + excluded)
        if _balance(arms, base + part * (torque - base), minimum, maximum, tensions):
            feasible = part
            copy_values(tensions, best)
        else:
            excluded = part
    return best, feasible


@jit_compile
def _balance(arms: Array, torque: Array, minimum: Array, maximum: Array, tensions: Array) -> bool:
    """Write the lowest tensions within limits that make a torque; return whether they do.

    T = clip(minimum + arms lambda), with lambda by Newton's method on a convex function whose
    gradient is the torque's error.
    """
    tendons, joints = arms.shape
    lagrange, error, step = np.zeros(joints), np.zeros(joints), np.zeros(joints)
    new_error, matrix = np.zeros(joints), np.zeros((joints, joints))
    tolerance, size = 0.0, 0.0
    for t in range(tendons):
        for j in range(joints):
            tolerance = max(tolerance, _TOLERANCE * abs(arms[t, j]) * maximum[t])
            size += arms[t, j] ** 2
    value = _evaluate(arms, lagrange, torque, minimum, maximum, tensions, error)
    damping = 1e-6
    for _ in range(_NEWTON_ITERATIONS):
        if _get_norm(error) <= tolerance:
            return True
        matrix[:] = 0.0
        for t in range(tendons):
            wanted = minimum[t]
            for j in range(joints):
                wanted += arms[t, j] * lagrange[j]
            if minimum[t] <= wanted <= maximum[t]:
                for j in range(joints):
                    for k in range(joints):
                        matrix[j, k] += arms[t, j] * arms[t, k]
        for j in range(joints):
            matrix[j, j] += damping * size
        _solve_symmetric(matrix, error, step)
        new = _evaluate(arms, lagrange - step, torque, minimum, maximum, tensions, new_error)
        if new < value or _get_norm(new_error) < _get_norm(error):
            lagrange, value, damping = lagrange - step, new, max(0.1 * damping, 1e-12)
            copy_values(new_error, error)
        else:
            damping *= 10.0
    return False


@jit_compile
def _get_norm(error: Array) -> float:
    worst = 0.0
    for j in range(len(error)):
        worst = max(worst, abs(error[j]))
    return worst


@jit_compile
def _evaluate(
    arms: Array,
    lagrange: Array,
    torque: Array,
    minimum: Array,
    maximum: Array,
    tensions: Array,
    error: Array,
) -> float:
    """Write tensions and the torque's error; return the function whose gradient it is."""
    value = 0.0
    for j in range(len(torque)):
        error[j] = -torque[j]
        value -= torque[j] * lagrange[j]
    for t in range(len(tensions)):
        rise = 0.0
        for j in range(len(torque)):
            rise += arms[t, j] * lagrange[j]
        T = min(max(minimum[t] + rise, minimum[t]), maximum[t])
        tensions[t] = T
        value += T * rise - 0.5 * (T - minimum[t]) ** 2
        for j in range(len(torque)):
            error[j] += arms[t, j] * T
    return value


@jit_compile
def _solve_symmetric(matrix: Array, right: Array, solution: Array) -> None:
    """Write the solution for a positive definite matrix, which is overwritten (Cholesky)."""
    n = len(right)
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] ** 2
        matrix[j, j] = math.sqrt(max(matrix[j, j], 1e-300))
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for i in range(n):
        solution[i] = right[i]
        for k in range(i):
            solution[i] -= matrix[i, k] * solution[k]
        solution[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            solution[i] -= matrix[k, i] * solution[k]
        solution[i] /= matrix[i, i]
