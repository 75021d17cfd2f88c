"""Wrench at an arm's tip from the torques on its joints, and its interval."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array, Mask
from estimator.kinematics.arm import ArmError

NO_MOMENT_JOINTS = 3
"""Up to so many joints, contact at the tip point without a moment is assumed unless told else."""

SMALLEST_LEVER_M = 0.005
"""[m] Lever below which a force at the tip turns the joints too little to be told."""

_AXIS_TOLERANCE = 1e-6  # of a unit vector that lies outside of what is told
_ZERO_SHARE = 1e-9  # of the largest element of an inverse: rounding, which an infinite end meets


class TipWrench(NamedTuple):
    """Wrench that the arm exerts on its environment, as far as joint torques tell it.

    Components are force [N] and moment [N m] at the tip point, on the Jacobian's axes. Leading
    dimensions are those of the Jacobian.
    """

    wrench: Array
    """Shape (6,); nothing of it lies in a direction that is not identified."""
    low: Array
    """Least value of each component, shape (6,); -inf where the component cannot be identified."""
    high: Array
    """Largest value, shape (6,); inf where the component cannot be identified."""
    directions: Array
    """Unit vectors, shape (m, 6): m is 3 without a moment, else 6. Moments are divided by
    `length_scale`, so that all are in newtons."""
    is_identified: Mask
    """Which directions are identified, shape (m,). The others must not be rendered."""
    inverse: Array
    """Wrench per joint torque, shape (6, joints)."""


def compute_tip_wrench(
    jacobian: ArrayLike,
    torque: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    *,
    with_moment: bool | None = None,
    length_scale: float = 0.05,
    smallest_lever: float = SMALLEST_LEVER_M,
) -> TipWrench:
    """Return the wrench W with J^T W = torque, at rest, and its interval.

    Fewer than six joints tell only what lies in the span of the Jacobian. Of the rest nothing is
    known, so it is zero in `wrench` and marked.

    Parameters
    ----------
    jacobian : array_like, shape (..., 6, joints)
        Velocity [m/s] and angular velocity [rad/s] of the tip point by joint velocities [rad/s].
    torque, low, high : array_like, shape (..., joints)
        [N m] the tendons' less that of springs and weight, with its interval.
    with_moment : bool, optional
        False: contact at the tip point without a moment, so the force is what is looked for. By
        default so for arms of up to three joints.
    length_scale : float
        [m] lever at which a moment counts as much as a force.
    smallest_lever : float
        [m] Directions whose singular value is less are not told: along them a small error of torque
        is a large one of force.

    Raises
    ------
    ArmError
        If a shape is wrong, or the Jacobian is not finite.
    """
    J = np.array(jacobian, dtype=np.float64)
    tau, ends = np.array(torque, np.float64), np.array([low, high], np.float64)
    joints = (*J.shape[:-2], J.shape[-1]) if J.ndim > 1 else ()
    if J.ndim < 2 or J.shape[-2] != 6 or tau.shape != joints or ends.shape != (2, *joints):
        raise ArmError(
            f"jacobian: shape {J.shape} for torques of shape {tau.shape}, must be (..., 6, joints) "
            "and (..., joints)"
        )
    if not np.isfinite(J).all():
        raise ArmError("jacobian: must be finite")
    if with_moment is None:
        with_moment = J.shape[-1] > NO_MOMENT_JOINTS
    m = 6 if with_moment else 3
    scale = np.array([1.0, 1.0, 1.0, *[length_scale] * 3])[:m, None]
    left, values, right = np.linalg.svd(scale * J[..., :m, :])
    singular = np.zeros((*J.shape[:-2], m))
    count = values.shape[-1]
    singular[..., :count] = values
    is_identified = singular >= smallest_lever
    factors = np.where(is_identified, 1.0 / np.where(is_identified, singular, 1.0), 0.0)
    inverse = np.zeros_like(J)
    inverse[..., :m, :] = scale * (
        (left[..., :count] * factors[..., None, :count]) @ right[..., :count, :]
    )
    bounds = np.array(bound_product(inverse, *ends))
    other_parts = np.where(is_identified[..., None, :], 0.0, left)
    unidentified = np.linalg.norm(other_parts, axis=-1) > _AXIS_TOLERANCE
    bounds[0, ..., :m][unidentified], bounds[1, ..., :m][unidentified] = -math.inf, math.inf
    directions = np.zeros((*J.shape[:-2], m, 6))
    directions[..., :m] = np.swapaxes(left, -1, -2)
    wrench = np.einsum("...ij,...j->...i", inverse, tau)
    return TipWrench(wrench, bounds[0], bounds[1], directions, is_identified, inverse)


def bound_product(factors: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the ends of factors, shape (..., m, k), times numbers between ends, shape (..., k)."""
    largest = np.abs(factors).max(axis=(-2, -1), keepdims=True)
    factors = np.where(np.abs(factors) > _ZERO_SHARE * largest, factors, 0.0)
    with np.errstate(invalid="ignore"):  # no factor times an infinite end
        a, b = (np.where(factors == 0.0, 0.0, factors * end[..., None, :]) for end in (low, high))
    return np.minimum(a, b).sum(axis=-1), np.maximum(a, b).sum(axis=-1)
