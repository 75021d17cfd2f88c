"""Where an arm's parts and its tip are, and how its coordinates move the tip.

Frames are homogeneous matrices, shape (4, 4), in the frame of the base. The Jacobian is geometric:
rows 0 to 2 are the linear velocity of the tip point, rows 3 to 5 the angular velocity of the tip,
in the frame of the base, per coordinate velocity.

A curved section of length L that bends by b = (b_x, b_y), with phi = |b|, is the exponential of
the twist (L e_z; theta), theta = (-b_y, b_x, 0), so that with the angle functions of
`rotations.compute_angle_functions`

    p = L (B b_x, B b_y, sin phi / phi),   R = I + sin phi / phi [theta] + B [theta]^2,
    angular velocity = (I + B [theta] + C [theta]^2) dtheta/dt,

all of which are analytic functions of b_x and b_y (Webster and Jones 2010 review the model).
"""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics import arm as _arm
from estimator.kinematics.arm import PreparedArm
from estimator.kinematics.rotations import compute_angle_functions, rotate, to_quaternion

_REVOLUTE, _PRISMATIC, _CURVED = _arm.REVOLUTE, _arm.PRISMATIC, _arm.CURVED


@jit_compile
def write_tip_pose(arm: PreparedArm, q: Array, pose: Array) -> None:
    """Write the pose of the tip, shape (4, 4), at coordinates `q`, shape (n,) or longer."""
    _reset_pose(pose)
    for part in range(arm.parts):
        _move_along_part(arm, part, q, 1.0, pose)
    _multiply_pose(pose, arm.tip)


@jit_compile
def compute_tip_pose(arm: PreparedArm, q: Array) -> Array:
    """Return the pose of the tip, shape (4, 4), at coordinates `q`, shape (n,) or longer."""
    pose = np.empty((4, 4))
    write_tip_pose(arm, q, pose)
    return pose


@jit_compile
def compute_jacobian(arm: PreparedArm, q: Array) -> Array:
    """Return the geometric Jacobian of the tip, shape (6, n)."""
    jacobian = np.empty((6, arm.coordinates))
    write_kinematics(arm, q, np.empty((4, 4)), jacobian)
    return jacobian


@jit_compile
def write_kinematics(arm: PreparedArm, q: Array, pose: Array, jacobian: Array) -> None:
    """Write pose, shape (4, 4), and Jacobian, shape (6, n) or wider, of the tip; no allocation."""
    _reset_pose(pose)
    for part in range(arm.parts):
        _write_part_columns(arm, part, q, pose, jacobian)
    _multiply_pose(pose, arm.tip)
    for column in range(arm.coordinates):  # from the origin of the base to the tip point
        wx, wy, wz = jacobian[3, column], jacobian[4, column], jacobian[5, column]
        jacobian[0, column] += wy * pose[2, 3] - wz * pose[1, 3]
        jacobian[1, column] += wz * pose[0, 3] - wx * pose[2, 3]
        jacobian[2, column] += wx * pose[1, 3] - wy * pose[0, 3]


@jit_compile
def write_weight_torque(
    arm: PreparedArm, q: Array, gravity: Array, pose: Array, jacobian: Array, torque: Array
) -> None:
    """Write what the weight of the links does to each coordinate; no allocation.

    Parameters
    ----------
    gravity : array, shape (3,)
        [m/s^2] in the base.
    pose, jacobian : array, shape (4, 4), (6, n) or wider
        To work with; overwritten.
    torque : array, shape (2, n) or wider
        [N m] or [N] with the coordinate, and the sum of what the links do, each without its sign.
    """
    _reset_pose(pose)
    jacobian[:, : arm.coordinates] = 0.0
    torque[:, : arm.coordinates] = 0.0
    for part in range(arm.parts):
        _write_part_columns(arm, part, q, pose, jacobian)
        if arm.mass[part] == 0.0:
            continue
        x, y, z = arm.centre[part]
        x, y, z = _rotate_to_base(pose, x, y, z)
        x, y, z = x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]
        for column in range(arm.coordinates):
            vx, vy, vz, wx, wy, wz = jacobian[:, column]
            power = gravity[0] * (vx + wy * z - wz * y) + gravity[1] * (vy + wz * x - wx * z)
            power = arm.mass[part] * (power + gravity[2] * (vz + wx * y - wy * x))
            torque[0, column] += power
            torque[1, column] += abs(power)


@jit_compile
def _write_part_columns(
    arm: PreparedArm, part: int, q: Array, pose: Array, jacobian: Array
) -> None:
    """Move a pose along a part, and write the part's columns, at the origin of the base."""
    kind, first = arm.kind[part], arm.first[part]
    if kind == _CURVED:
        _multiply_pose(pose, arm.offset[part])
        _write_curve_columns(arm, part, q, pose, jacobian)
        _move_along_curve(arm, part, q, 1.0, pose)
        return
    _move_along_part(arm, part, q, 1.0, pose)
    if kind in (_REVOLUTE, _PRISMATIC):
        axis = arm.axis[part]
        x, y, z = _rotate_to_base(pose, axis[0], axis[1], axis[2])
        if kind == _REVOLUTE:
            _write_column(jacobian, first, 0.0, 0.0, 0.0, x, y, z, pose)
        else:
            _write_column(jacobian, first, x, y, z, 0.0, 0.0, 0.0, pose)


@jit_compile
def compute_part_frames(arm: PreparedArm, q: Array, points: int) -> tuple[Array, NDArray[np.int64]]:
    """Return frames to draw an arm by.

    Parameters
    ----------
    points : int
        Frames along each curved section, the last at its end.

    Returns
    -------
    frames : array, shape (m, 4, 4)
        The base, each joint where it has moved to, points along each section, the tip.
    parts : array of int, shape (m,)
        The part of each frame; -1 for the base, the number of parts for the tip.
    """
    count = 2
    for part in range(arm.parts):
        count += points if arm.kind[part] == _CURVED else 1
    frames, parts = np.empty((count, 4, 4)), np.empty(count, np.int64)
    pose, base = np.empty((4, 4)), np.empty((4, 4))
    _reset_pose(pose)
    frames[0], parts[0], row = pose, -1, 1
    for part in range(arm.parts):
        steps = points if arm.kind[part] == _CURVED else 1
        base[:] = pose
        for k in range(steps):
            pose[:] = base
            _move_along_part(arm, part, q, (k + 1.0) / steps, pose)
            frames[row], parts[row] = pose, part
            row += 1
    _multiply_pose(pose, arm.tip)
    frames[row], parts[row] = pose, arm.parts
    return frames, parts


@jit_compile
def _move_along_part(arm: PreparedArm, part: int, q: Array, share: float, pose: Array) -> None:
    """Move a pose over a part's offset and by its coordinates; `share` is of a curved section."""
    _multiply_pose(pose, arm.offset[part])
    kind, first, axis = arm.kind[part], arm.first[part], arm.axis[part]
    if kind == _REVOLUTE:
        angle = q[first]
        rotation = to_quaternion(angle * axis[0], angle * axis[1], angle * axis[2])
        for row in range(3):  # each row times the matrix: the inverse rotation of the row
            x, y, z = pose[row, 0], pose[row, 1], pose[row, 2]
            inverse = (-rotation[0], -rotation[1], -rotation[2], rotation[3])
            pose[row, 0], pose[row, 1], pose[row, 2] = rotate(inverse, x, y, z)
    elif kind == _PRISMATIC:
        for row in range(3):
            travel = axis[0] * pose[row, 0] + axis[1] * pose[row, 1] + axis[2] * pose[row, 2]
            pose[row, 3] += q[first] * travel
    elif kind == _CURVED:
        _move_along_curve(arm, part, q, share, pose)


@jit_compile
def _move_along_curve(arm: PreparedArm, part: int, q: Array, share: float, pose: Array) -> None:
    """Move a pose from the base of a curved section to a share of its arc."""
    first = arm.first[part]
    x, y = share * q[first], share * q[first + 1]
    length = share * _get_length(arm, part, q)
    squared = x * x + y * y
    B, C, _ = compute_angle_functions(squared)
    S = 1.0 - squared * C
    for row in range(3):
        a, b, c = pose[row, 0], pose[row, 1], pose[row, 2]
        bend = a * x + b * y
        pose[row, 3] += length * (B * bend + S * c)
        pose[row, 0] = a - B * x * bend - S * x * c
        pose[row, 1] = b - B * y * bend - S * y * c
        pose[row, 2] = S * bend + (1.0 - squared * B) * c


@jit_compile
def _write_curve_columns(
    arm: PreparedArm, part: int, q: Array, pose: Array, jacobian: Array
) -> None:
    """Write the columns of a curved section that starts at `pose`, at the origin of the base."""
    first = arm.first[part]
    x, y = q[first], q[first + 1]
    length = _get_length(arm, part, q)
    squared = x * x + y * y
    B, C, E = compute_angle_functions(squared)
    S = 1.0 - squared * C
    dB, dS = 2.0 * E - C, C - B  # over b_x, per b_x
    # the point that the linear velocity belongs to, in the frame of the section
    px, py, pz = length * B * x, length * B * y, length * S
    for k in range(2):
        b = x if k == 0 else y
        vx, vy, vz = length * dB * b * x, length * dB * b * y, length * dS * b
        if k == 0:
            vx += length * B
        else:
            vy += length * B
        # dtheta/db = e_y for b_x, -e_x for b_y, theta = (-y, x, 0)
        tx, ty = (0.0, 1.0) if k == 0 else (-1.0, 0.0)
        along = -y * tx + x * ty
        wx = tx + C * (-y * along - squared * tx)
        wy = ty + C * (x * along - squared * ty)
        wz = B * (-y * ty - x * tx)
        # at the origin of the section
        vx, vy, vz = vx - wy * pz + wz * py, vy - wz * px + wx * pz, vz - wx * py + wy * px
        vx, vy, vz = _rotate_to_base(pose, vx, vy, vz)
        wx, wy, wz = _rotate_to_base(pose, wx, wy, wz)
        _write_column(jacobian, first + k, vx, vy, vz, wx, wy, wz, pose)
    if arm.extends[part]:
        vx, vy, vz = _rotate_to_base(pose, B * x, B * y, S)
        _write_column(jacobian, first + 2, vx, vy, vz, 0.0, 0.0, 0.0, pose)


@jit_compile
def _get_length(arm: PreparedArm, part: int, q: Array) -> float:
    """Return the arc length of a curved section [m]."""
    length: float = arm.length[part]
    if arm.extends[part]:
        length += q[arm.first[part] + 2]
    return length


@jit_compile
def _write_column(
    jacobian: Array,
    column: int,
    vx: float,
    vy: float,
    vz: float,
    wx: float,
    wy: float,
    wz: float,
    pose: Array,
) -> None:
    """Write a twist at the place of `pose` as the twist at the origin of the base."""
    x, y, z = pose[0, 3], pose[1, 3], pose[2, 3]
    jacobian[0, column] = vx - (wy * z - wz * y)
    jacobian[1, column] = vy - (wz * x - wx * z)
    jacobian[2, column] = vz - (wx * y - wy * x)
    jacobian[3, column] = wx
    jacobian[4, column] = wy
    jacobian[5, column] = wz


@jit_compile
def _rotate_to_base(pose: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector of the frame `pose` in the frame of the base."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@jit_compile
def _reset_pose(pose: Array) -> None:
    """Make a pose the identity."""
    for row in range(4):
        for column in range(4):
            pose[row, column] = 1.0 if row == column else 0.0


@jit_compile
def _multiply_pose(pose: Array, offset: Array) -> None:
    """Move a pose by an offset in its own frame, in place."""
    for row in range(3):
        a, b, c = pose[row, 0], pose[row, 1], pose[row, 2]
        for column in range(4):
            moved = a * offset[0, column] + b * offset[1, column] + c * offset[2, column]
            pose[row, column] = moved + (pose[row, 3] if column == 3 else 0.0)
