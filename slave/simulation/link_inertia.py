"""Links of an arm: what couples its joints, what their motion throws, their weight, and its tip.

The chain is walked once from its base. Each link adds its part to the equations of motion by the
velocities that a unit speed of each joint gives to it (Kane's method): with these columns V and W
of its centre of mass and of its turning, mass m and inertia I about that centre,

    M = sum m V^T V + W^T I W,   b = sum V^T m (a - g) + W^T (I alpha + omega x I omega)

where a and alpha are its accelerations while all joints keep their speeds. The place of the tip and
the columns of the last link are what surfaces act by (`space_contacts`). A curved section is
`LUMPS` point masses evenly along its middle line, so the turning of its slices about their own
centres is left out. Links that hang beside the chain of a URDF have no inertia.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import CurvedSection, Joint
from teleop.config.arm import LinkedArmConfig

FIXED, TURNING, SLIDING, CURVED = range(4)
KINDS = {"fixed": FIXED, "revolute": TURNING, "continuous": TURNING, "prismatic": SLIDING}
LUMPS = 4  # point masses of a curved section

Vector: TypeAlias = tuple[float, float, float]


class Links(NamedTuple):
    """The parts of all arms of a rig with kinematics, one arm after another; a tip ends each."""

    kind: NDArray[np.int64]  # shape (parts,)
    joint: NDArray[np.int64]  # first joint of the rig that moves the part, shape (parts,)
    base: NDArray[np.int64]  # first joint of its arm, shape (parts,)
    rotation: Array  # of its frame in the one before, shape (parts, 3, 3)
    position: Array  # [m] shape (parts, 3)
    axis: Array  # of unit length, shape (parts, 3)
    length: Array  # [m] of a curved section, shape (parts,)
    mass: Array  # [kg] shape (parts,)
    centre: Array  # [m] of that mass, in the moved frame, shape (parts, 3)
    inertia: Array  # [kg m^2] about it, shape (parts, 3, 3)
    gravity: Array  # [m/s^2] in the base of its arm, shape (parts, 3)
    radius: Array  # [m] of all joints' own pulleys, shape (joints,)


def build_links(arms: Sequence[LinkedArmConfig], radius: Array) -> Links:
    """Return the links of arms; `UsageError` if an arm's kinematics cannot be read.

    `radius` [m] are the joints' own pulleys, shape (joints,).
    """
    places: list[tuple[int, int, int]] = []  # kind, joint, base
    numbers: list[Array] = []
    base = 0
    for config in arms:
        parts: tuple[Joint | CurvedSection, ...] = ()
        if config.has_kinematics:
            arm = config.load_kinematics()
            parts = (*arm.parts, Joint("tip", "fixed", offset=arm.tip))
        joint = base
        for part in parts:
            frame, axis, length = part.offset.to_matrix(), np.zeros(3), 0.0
            centre, inertia = (0.0, 0.0, 0.0), np.zeros((3, 3))
            if isinstance(part, CurvedSection):
                kind, length = CURVED, part.length
            else:
                kind, centre, inertia = KINDS[part.kind], part.centre, part.to_inertia_matrix()
                axis = np.array(part.axis) / (math.hypot(*part.axis) or 1.0)
            places.append((kind, joint, base))
            numbers.append(
                np.concatenate(
                    [frame[:3, :3].ravel(), frame[:3, 3], axis, [length, part.mass], centre,
                     inertia.ravel(), config.gravity]
                )
            )  # fmt: skip
            joint += len(part.coordinates)
        base += config.joints
    kinds, joints, bases = np.array(places, np.int64).reshape(-1, 3).T.copy()
    table = np.array(numbers).reshape(-1, 32)
    rotation, position, axes, lengths, masses, centres, inertias, gravity = (
        np.ascontiguousarray(part) for part in np.split(table, (9, 12, 15, 16, 17, 20, 29), axis=1)
    )
    return Links(
        kinds, joints, bases, rotation.reshape(-1, 3, 3), position, axes, lengths.ravel(),
        masses.ravel(), centres, inertias.reshape(-1, 3, 3), gravity, radius,
    )  # fmt: skip


class LinkMotion(NamedTuple):
    """What the links say about the motion of n joints, at their own pulleys."""

    mass: Array  # [kg] shape (n, n), symmetric
    force: Array  # [N] that drives the joints at constant speeds, against inertia and weight
    columns: Array  # per unit speed, shape (2, n, 3): velocity at the base's origin, and turning
    tips: Array  # [m] shape (n, 3): in the row of the first joint of each arm


@jit_compile
def compute_link_motion(links: Links, travel: Array, speed: Array) -> LinkMotion:
    """Return mass matrix, forces at no acceleration, and what moves the tips.

    `travel` [m] and `speed` [m/s], shape (n,), are of the joints at their own pulleys.
    """
    n = len(travel)
    mass, force = np.zeros((n, n)), np.zeros(n)
    columns, tips = np.zeros((2, n, 3)), np.zeros((n, 3))
    turn = np.eye(3)  # of the frame that is reached
    place = spin = spin_rate = acceleration = (0.0, 0.0, 0.0)  # of its origin, in the base
    for part in range(len(links.kind)):
        first, kind = links.joint[part], links.kind[part]
        base = links.base[part]
        if part == 0 or base != links.base[part - 1]:
            turn[:] = np.eye(3)
            place = spin = spin_rate = (0.0, 0.0, 0.0)
            gravity = links.gravity[part]
            acceleration = (-gravity[0], -gravity[1], -gravity[2])
        arm = _rotate(turn, links.position[part])
        place, acceleration = _add(place, arm), _carry(acceleration, spin, spin_rate, arm)
        turn[:] = turn @ links.rotation[part]
        last = first
        if kind == CURVED:
            place, spin, spin_rate, acceleration = _walk_curve(
                links, part, travel, speed, turn, columns, place, spin, spin_rate, acceleration,
                mass, force,
            )  # fmt: skip
            continue
        if kind != FIXED:
            last = first + 1
            radius = links.radius[first]
            axis = _rotate(turn, links.axis[part])
            motion = _scale(speed[first] / radius, axis)
            if kind == TURNING:
                spin_rate = _add(spin_rate, _cross(spin, motion))
                spin = _add(spin, motion)
                _rotate_about(turn, links.axis[part], travel[first] / radius)
                _set(columns[0, first], _scale(1.0 / radius, _cross(place, axis)))
                _set(columns[1, first], _scale(1.0 / radius, axis))
            else:
                arm = _scale(travel[first] / radius, axis)
                place, acceleration = _add(place, arm), _carry(acceleration, spin, spin_rate, arm)
                acceleration = _add(acceleration, _scale(2.0, _cross(spin, motion)))
                _set(columns[0, first], _scale(1.0 / radius, axis))
                _set(columns[1, first], (0.0, 0.0, 0.0))
        if links.mass[part] > 0.0 or links.inertia[part].any():
            arm = _rotate(turn, links.centre[part])
            _add_body(
                links.mass[part], turn @ links.inertia[part] @ turn.T, _add(place, arm),
                _carry(acceleration, spin, spin_rate, arm), spin, spin_rate, base, last, columns,
                mass, force,
            )  # fmt: skip
        _set(tips[base], place)
    return LinkMotion(mass, force, columns, tips)


@jit_compile
def _walk_curve(
    links: Links,
    part: int,
    travel: Array,
    speed: Array,
    turn: Array,
    columns: Array,
    place: Vector,
    spin: Vector,
    spin_rate: Vector,
    acceleration: Vector,
    out_mass: Array,
    out_force: Array,
) -> tuple[Vector, Vector, Vector, Vector]:
    """Add the lumps of a curved section, and return place and motion of its far end."""
    first, base, length = links.joint[part], links.base[part], links.length[part]
    bends = (travel[first] / links.radius[first], travel[first + 1] / links.radius[first + 1])
    rates = (speed[first] / links.radius[first], speed[first + 1] / links.radius[first + 1])
    rigid = np.zeros((3, 3))
    for lump in range(LUMPS + 1):  # the last one is the end, without mass
        share = (lump + 0.5) / LUMPS if lump < LUMPS else 1.0
        x, y = share * bends[0], share * bends[1]
        dx, dy = share * rates[0], share * rates[1]
        c = compute_stumpff(x * x + y * y)
        f1, f2 = c[4] - 0.5 * c[3], 0.25 * (8.0 * c[6] - 5.0 * c[5] + c[4])  # of c2 over x^2 + y^2
        g1, g2 = 0.5 * (c[3] - c[2]), 0.25 * (3.0 * (c[5] - c[4]) + c[3])  # of c1
        dz, ddz, size = 2.0 * (x * dx + y * dy), 2.0 * (dx * dx + dy * dy), share * length
        arm = _rotate(turn, (size * c[2] * x, size * c[2] * y, size * c[1]))
        by_x = _rotate(
            turn, (size * (c[2] + 2.0 * f1 * x * x), size * 2.0 * f1 * x * y, size * 2.0 * g1 * x)
        )
        by_y = _rotate(
            turn, (size * 2.0 * f1 * x * y, size * (c[2] + 2.0 * f1 * y * y), size * 2.0 * g1 * y)
        )
        bending = f2 * dz * dz + f1 * ddz
        further = _rotate(
            turn,
            (
                size * (bending * x + 2.0 * f1 * dz * dx),
                size * (bending * y + 2.0 * f1 * dz * dy),
                size * (g2 * dz * dz + g1 * ddz),
            ),
        )
        at = _add(place, arm)
        motion = _add(_scale(dx, by_x), _scale(dy, by_y))
        moved = _add(_carry(acceleration, spin, spin_rate, arm), further)
        moved = _add(moved, _scale(2.0, _cross(spin, motion)))
        for k in range(2):
            column = _scale(share / links.radius[first + k], by_x if k == 0 else by_y)
            _set(columns[0, first + k], column)
            _set(columns[1, first + k], (0.0, 0.0, 0.0))
        if lump < LUMPS:
            _add_body(
                links.mass[part] / LUMPS, rigid, at, moved, spin, spin_rate, base, first + 2,
                columns, out_mass, out_force,
            )  # fmt: skip
    bend, bend_rate = (-y, x, 0.0), (-dy, dx, 0.0)
    across = _cross(bend, bend_rate)
    twice = _cross(bend, across)
    local = _add(bend_rate, _add(_scale(c[2], across), _scale(c[3], twice)))
    local_rate = _add(_scale(f1 * dz, across), _scale((1.5 * c[5] - 0.5 * c[4]) * dz, twice))
    local_rate = _add(local_rate, _scale(c[3], _cross(bend_rate, across)))
    for k in range(2):
        unit = (0.0, 1.0, 0.0) if k == 0 else (-1.0, 0.0, 0.0)
        across = _cross(bend, unit)
        own = _add(unit, _add(_scale(c[2], across), _scale(c[3], _cross(bend, across))))
        angular = _scale(1.0 / links.radius[first + k], _rotate(turn, own))
        _set(columns[1, first + k], angular)
        linear = columns[0, first + k]
        _set(linear, _add((linear[0], linear[1], linear[2]), _cross(at, angular)))
    added = _rotate(turn, local)
    spin_rate = _add(_add(spin_rate, _cross(spin, added)), _rotate(turn, local_rate))
    angle = math.hypot(x, y)
    if angle > 0.0:
        _rotate_about(turn, (-y / angle, x / angle, 0.0), angle)
    return at, _add(spin, added), spin_rate, moved


@jit_compile
def _add_body(
    mass: float,
    inertia: Array,
    place: Vector,
    acceleration: Vector,
    spin: Vector,
    spin_rate: Vector,
    first: int,
    last: int,
    columns: Array,
    out_mass: Array,
    out_force: Array,
) -> None:
    """Add a body that the joints `first` to before `last` move.

    `inertia` [kg m^2] is in the base, shape (3, 3); see `compute_link_motion`.
    """
    push = _scale(mass, acceleration)
    moment = _add(_rotate(inertia, spin_rate), _cross(spin, _rotate(inertia, spin)))
    for j in range(first, last):
        turning = (columns[1, j, 0], columns[1, j, 1], columns[1, j, 2])
        linear = (columns[0, j, 0], columns[0, j, 1], columns[0, j, 2])
        linear = _add(linear, _cross(turning, place))
        out_force[j] += _dot(linear, push) + _dot(turning, moment)
        momentum, angular = _scale(mass, linear), _rotate(inertia, turning)
        # of the body, moved to the base's origin, where the columns are
        angular = _add(angular, _cross(place, momentum))
        for i in range(first, j + 1):
            shared = _dot(columns[0, i], momentum) + _dot(columns[1, i], angular)
            out_mass[j, i] += shared
            if i < j:
                out_mass[i, j] += shared


@jit_compile
def compute_stumpff(square: float) -> tuple[float, float, float, float, float, float, float]:
    """Return c_k = sum over j of (-square)^j / (2 j + k)!, for k = 0 to 6.

    c_0 is the cosine of the root, c_1 its sine over it; 2 dc_k/dsquare = k c_(k + 2) - c_(k + 1).
    """
    five, six = 1.0 / 120.0, 1.0 / 720.0
    c5, c6, j = five, six, 0
    while abs(five) > 1e-19:
        j += 2
        five *= -square / ((j + 4) * (j + 5))
        six *= -square / ((j + 5) * (j + 6))
        c5, c6 = c5 + five, c6 + six
    c4, c3 = 1.0 / 24.0 - square * c6, 1.0 / 6.0 - square * c5
    c2, c1 = 0.5 - square * c4, 1.0 - square * c3
    return 1.0 - square * c2, c1, c2, c3, c4, c5, c6


# --- vectors of three numbers, as tuples: nothing is allocated


@jit_compile
def _add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@jit_compile
def _scale(factor: float, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


@jit_compile
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit_compile
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit_compile
def _set(out: Array, a: Vector) -> None:
    out[0], out[1], out[2] = a


@jit_compile
def _rotate(matrix: Array, a: Vector) -> Vector:
    return _dot(matrix[0], a), _dot(matrix[1], a), _dot(matrix[2], a)


@jit_compile
def _carry(acceleration: Vector, spin: Vector, spin_rate: Vector, arm: Vector) -> Vector:
    """Return the acceleration of a point at `arm` [m] from one of the same rigid body."""
    outward = _cross(spin, _cross(spin, arm))
    return _add(acceleration, _add(_cross(spin_rate, arm), outward))


@jit_compile
def _rotate_about(turn: Array, axis: Vector, angle: float) -> None:
    """Rotate a frame about an axis of its own, of unit length, in place: Rodrigues' formula."""
    sine, cosine = math.sin(angle), math.cos(angle)
    for row in range(3):
        old = (turn[row, 0], turn[row, 1], turn[row, 2])
        along = _scale((1.0 - cosine) * _dot(old, axis), axis)
        # a row times the matrix is the inverse rotation of the row
        _set(turn[row], _add(_add(_scale(cosine, old), along), _scale(sine, _cross(old, axis))))
